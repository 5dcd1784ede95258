"""Standard errors of a recovered extinction, by random draws from the linear model at the end of a recovery."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from cloudtomo_cl.inversion.bound_prior import FrozenPrior, NoiseUnits
from cloudtomo_cl.inversion.solvers.conjugate_gradients import minimised
from cloudtomo_cl.inversion.terms import Around, Term
from cloudtomo_cl.opencl.device import Device

# Of a standard error where nobody says otherwise, in Python as on the command line.
DRAWS = 24
# Of a draw's minimisation: iterations at most, and the share of the gain at which it ends.
_ITERATIONS, _TOLERANCE = 40, 1e-5
# The draws' deviation times this is a recovery's standard error, for draws know nothing of the prior's bias, nor of the
# derivatives': with it about 68 % of the voxels of whole recoveries lie within it (docs/measurements/uncertainty.md).
WIDENED = 2.0
# Least curvature in scaling, of the mean one: voxels that no pixel feels.
LEAST_CURVATURE = 1e-3


def standard_errors(
    terms: Sequence[Term],
    slope_of_noise: Callable[[np.random.Generator], np.ndarray],
    prior: FrozenPrior,
    units: NoiseUnits,
    estimate: np.ndarray,
    gradient: np.ndarray,
    stiffness: np.ndarray,
    draws: int,
    seed: int,
    device: Device,
) -> np.ndarray:
    """Root mean square over draws from the posterior distribution of the linear model.

    Each draw changes the measured images by their noise, and the prior's mean by what it allows, and
    minimises the model again, over extinctions that are not negative. For linear images and without bounds these
    are samples of the posterior ("randomize then optimize": Papandreou and Yuille 2010; with bounds: Bardsley and
    Fox 2012). Other priors keep the slope that they have at the estimate.

    Parameters
    ----------
    terms : quadratic, whose second derivatives are the model's
    slope_of_noise : draws noise of the images: what it adds to the slope of the data term, shape (voxels of the mask,)
    prior : whose Gaussian part is among the terms
    units : what it is multiplied with
    estimate : km^-1, shape (voxels of the mask,)
    gradient : of the cost there, with all priors, same shape
    stiffness : about the second derivative's diagonal, same shape
    draws : how many: the result is good to 1 / sqrt(2 draws)
    seed : of the draws
    device : where to compute

    Returns
    -------
    km^-1, shape (voxels of the mask,)
    """
    random = np.random.default_rng([seed, draws])

    def moved(force: np.ndarray) -> np.ndarray:
        """The minimum of the model with another slope."""
        model = Around(terms, estimate, gradient - force, device)
        return minimised([model], estimate, stiffness, _ITERATIONS, device, _TOLERANCE)

    without = moved(np.zeros_like(gradient))
    squares = np.zeros_like(gradient)
    for _ in range(draws):
        squares += (moved(slope_of_noise(random) + prior.perturbation(random, units)) - without) ** 2
    return np.sqrt(squares / draws)
