"""Priors that scale with a cloud's mean extinction, so that they do not depend on its brightness."""

from __future__ import annotations

from dataclasses import dataclass
from typing import cast

import numpy as np

from cloudtomo_cl.inversion.noise_units import NoiseUnits
from cloudtomo_cl.inversion.stage_prior import DevicePrior, FrozenPrior, StagePrior
from cloudtomo_cl.inversion.terms import Term


def mean_extinction(extinction: np.ndarray) -> float:
    """s = sum b^2 / sum b, the mean of an extinction over the cloud's optical mass, km^-1; 0 where there is no cloud.

    It depends neither on the amount of clear air nor on a threshold.
    """
    total = float(np.sum(extinction))
    return float(np.sum(np.square(extinction))) / total if total > 0 else 0.0


@dataclass(frozen=True, eq=False)
class RelativePrior:
    """A prior W of b / f, with the factor f = s(b) / reference of the extinction b.

    `value_and_gradient` is that of the function W(b / f(b)), with its exact gradient. A solver's step minimises with
    the factor `frozen` at its start: a factor that changed within a step would reward peaks, since a peak raises it,
    and all else then looks smoother (docs/decisions/relative-priors.md).

    Attributes
    ----------
    inner : prior W
    reference : mean extinction s for which W's numbers hold, km^-1
    least : lower bound of s, km^-1: in units of a smaller one every cloud would look like a peak
    """

    inner: StagePrior
    reference: float
    least: float

    def value_and_gradient(self, extinction: np.ndarray, units: NoiseUnits) -> tuple[float, np.ndarray]:
        factor = self._factor(extinction)
        value, slope = self.inner.value_and_gradient(extinction / factor, units)
        total, mean = float(np.sum(extinction)), mean_extinction(extinction)
        if not mean > self.least:  # the factor is constant
            return value, slope / factor
        along = float(slope @ extinction) / factor / mean
        return value, slope / factor - along * (2 * extinction - mean) / total

    def frozen(
        self, extinction: np.ndarray, iteration: int | None = None, mass_share: float | None = None
    ) -> FrozenPrior:
        factor = self._factor(extinction)
        return ScaledPrior(self.inner.frozen(extinction / factor, iteration, mass_share), factor)

    @property
    def chooses(self) -> bool:
        """See `StagePrior`."""
        return getattr(self.inner, "chooses", False)

    @property
    def corrects_mass(self) -> bool:
        """See `StagePrior`."""
        return getattr(self.inner, "corrects_mass", False)

    def _factor(self, extinction: np.ndarray) -> float:
        return max(mean_extinction(extinction), self.least) / self.reference


@dataclass(frozen=True, eq=False)
class ScaledPrior:
    """A prior of b / factor, for one step."""

    inner: FrozenPrior
    factor: float

    def value_and_gradient(self, extinction: np.ndarray, units: NoiseUnits) -> tuple[float, np.ndarray]:
        value, slope = self.inner.value_and_gradient(extinction / self.factor, units)
        return value, slope / self.factor

    def curvature(self, extinction: np.ndarray, units: NoiseUnits) -> np.ndarray | float:
        return self.inner.curvature(extinction / self.factor, units) / self.factor**2

    def hessian_times(self, columns: np.ndarray, units: NoiseUnits) -> np.ndarray:
        return self.inner.hessian_times(columns, units) / self.factor**2

    def perturbation(self, random: np.random.Generator, units: NoiseUnits) -> np.ndarray:
        return self.inner.perturbation(random, units) / self.factor

    def term(self, units: NoiseUnits, scale: float = 1.0) -> Term:
        """See `DevicePrior`; the inner prior must be one, too."""
        inner = cast(DevicePrior, self.inner)
        return inner.term(units, scale / self.factor)
