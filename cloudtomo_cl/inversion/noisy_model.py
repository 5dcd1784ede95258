"""A quadratic model of data term and prior around an extinction, with draws of its noise."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from cloudtomo_cl.inversion.conjugate_gradients import minimised
from cloudtomo_cl.inversion.noise_units import NoiseUnits
from cloudtomo_cl.inversion.stage_prior import FrozenPrior
from cloudtomo_cl.inversion.terms import Around, Term
from cloudtomo_cl.opencl.device import Device

# Largest number of iterations of a minimisation, and its tolerance (conjugate_gradients.py).
_ITERATIONS, _TOLERANCE = 40, 1e-5


@dataclass(frozen=True, eq=False)
class NoisyModel:
    """A quadratic model of data term and prior around an extinction, without damping, and draws of its noise.

    Attributes
    ----------
    terms : quadratic terms, whose Hessians add up to the model's
    hessian_diagonal : approximate diagonal of that Hessian, shape (voxels of the mask,)
    data_slope : gradient of the data term at the extinction, same shape
    slope_of_noise : function that draws noise of the images and gives its part in that gradient, same shape
    prior : prior with its form chosen at the extinction; its Gaussian part is among the terms
    units : factors of the prior
    extinction : extinction around which the model holds, km^-1, same shape
    device : device that computes
    """

    terms: Sequence[Term]
    hessian_diagonal: np.ndarray
    data_slope: np.ndarray
    slope_of_noise: Callable[[np.random.Generator], np.ndarray]
    prior: FrozenPrior
    units: NoiseUnits
    extinction: np.ndarray
    device: Device

    @property
    def prior_slope(self) -> np.ndarray:
        """The gradient of the prior at the extinction, shape (voxels of the mask,)."""
        return self.prior.value_and_gradient(self.extinction, self.units)[1]

    def minimum(self, slope: np.ndarray) -> np.ndarray:
        """The minimum, over extinctions that are not negative, of the model with this gradient at `extinction`."""
        model = Around(self.terms, self.extinction, slope, self.device)
        return minimised([model], self.extinction, self.hessian_diagonal, _ITERATIONS, self.device, _TOLERANCE)
