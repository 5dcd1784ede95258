"""What solvers ask of a prior: value, gradient and curvature for the voxels of one stage."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from cloudtomo_cl.inversion.noise_units import NoiseUnits
from cloudtomo_cl.inversion.terms import Term


class FrozenPrior(Protocol):
    """A prior for the voxels of one stage as one step minimises with it: all that follows the estimate stands still.

    `DevicePrior`s are computed on the device; of others, as users write them, gradients are asked for on the host.
    """

    def value_and_gradient(self, extinction: np.ndarray, units: NoiseUnits) -> tuple[float, np.ndarray]:
        """In the unit of the data term; arrays of shape (voxels,), float64."""
        ...

    def curvature(self, extinction: np.ndarray, units: NoiseUnits) -> np.ndarray | float:
        """About the diagonal of the second derivative, or an upper bound of it: it only scales."""
        ...

    def hessian_times(self, columns: np.ndarray, units: NoiseUnits) -> np.ndarray:
        """The second derivative of its Gaussian part times columns, shape (voxels, columns); 0 of what has none."""
        ...

    def perturbation(self, random: np.random.Generator, units: NoiseUnits) -> np.ndarray:
        """A draw of mean 0 whose covariance is N times that second derivative, shape (voxels,)."""
        ...


class DevicePrior(FrozenPrior, Protocol):
    """A prior that is a term of what is minimised on a device."""

    def term(self, units: NoiseUnits, scale: float = 1.0) -> Term:
        """The function of scale x."""
        ...


class StagePrior(Protocol):
    """A prior for the voxels of one stage.

    One with a true `chooses` picks its quadratic form by the extinction (for patches, the component of each): then the
    cost has many minima, and steps are annealed. One with a true `corrects_mass` knows a `mass_share`.
    """

    def value_and_gradient(self, extinction: np.ndarray, units: NoiseUnits) -> tuple[float, np.ndarray]:
        """Of a function of the extinction alone. In the unit of the data term; arrays of shape (voxels,), float64."""
        ...

    def frozen(
        self, extinction: np.ndarray, iteration: int | None = None, mass_share: float | None = None
    ) -> FrozenPrior:
        """For a step from this extinction.

        iteration : of the stage, counted from 0, if the prior is to be gentler in the first ones
        mass_share : of the prior's pull on the cloud's mass, which the step takes back (`mass`); by default the prior's
            own
        """
        ...
