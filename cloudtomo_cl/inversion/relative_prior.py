"""Priors that measure a cloud by its own mean extinction: they know of no cloud's brightness."""

from __future__ import annotations

from dataclasses import dataclass
from typing import cast

import numpy as np

from cloudtomo_cl.inversion.noise_units import NoiseUnits
from cloudtomo_cl.inversion.stage_prior import DevicePrior, FrozenPrior, StagePrior
from cloudtomo_cl.inversion.terms import Term


def mean_extinction(extinction: np.ndarray) -> float:
    """s = sum b^2 / sum b, the mean of an extinction over the cloud's optical mass, km^-1; 0 where there is no cloud.

    It follows neither from how much clear air there is, nor from a threshold.
    """
    total = float(np.sum(extinction))
    return float(np.sum(np.square(extinction))) / total if total > 0 else 0.0


@dataclass(frozen=True, eq=False)
class RelativePrior:
    """A prior W of b / scale, with the scale f = s(b) / reference of the extinction itself.

    As it stands it is the function W(b / f(b)) of the extinction alone, with its exact gradient. A solver's step
    minimises with the scale `frozen` where it starts from: a scale that follows within a step would reward
    peaks, since a peak raises the scale and all else then looks smoother (docs/decisions/relative-priors.md).

    Attributes
    ----------
    inner : W
    reference : km^-1, the mean extinction s that W's numbers are said for
    least : km^-1, of which s is taken where the cloud has less: beside next to nothing every cloud would be a peak
    """

    inner: StagePrior
    reference: float
    least: float

    def value_and_gradient(self, extinction: np.ndarray, units: NoiseUnits) -> tuple[float, np.ndarray]:
        factor = self._factor(extinction)
        value, slope = self.inner.value_and_gradient(extinction / factor, units)
        total, mean = float(np.sum(extinction)), mean_extinction(extinction)
        if not mean > self.least:  # the scale is another's
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
        """See `DevicePrior`; the inner one is another."""
        inner = cast(DevicePrior, self.inner)
        return inner.term(units, scale / self.factor)
