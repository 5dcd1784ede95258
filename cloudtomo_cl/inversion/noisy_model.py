"""The linear model of images and the prior, around an extinction, and what its slope may be off by."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from cloudtomo_cl.inversion.conjugate_gradients import minimised
from cloudtomo_cl.inversion.noise_units import NoiseUnits
from cloudtomo_cl.inversion.stage_prior import FrozenPrior
from cloudtomo_cl.inversion.terms import Around, Term
from cloudtomo_cl.opencl.device import Device

# Of a minimisation: iterations at most, and the share of all that was gained that two in a row gain in the end.
_ITERATIONS, _TOLERANCE = 40, 1e-5


@dataclass(frozen=True, eq=False)
class NoisyModel:
    """A quadratic model of data term and prior around an extinction, without damping, and draws of its noise.

    Attributes
    ----------
    terms : quadratic, whose second derivatives are the model's
    hessian_diagonal : about the diagonal of these, shape (voxels of the mask,)
    data_slope : of the data term at the extinction, same shape
    slope_of_noise : draws noise of the images: what it adds to the slope of the data term, same shape
    prior : as it stands there; its Gaussian part is among the terms
    units : what it is multiplied with
    extinction : km^-1, same shape
    device : where to compute
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
        """Of the prior at the extinction, shape (voxels of the mask,)."""
        return self.prior.value_and_gradient(self.extinction, self.units)[1]

    def minimum(self, slope: np.ndarray) -> np.ndarray:
        """Where the model is least over what is not negative, if it has this slope at the extinction; same shape."""
        model = Around(self.terms, self.extinction, slope, self.device)
        return minimised([model], self.extinction, self.hessian_diagonal, _ITERATIONS, self.device, _TOLERANCE)
