"""Standard errors of a recovered extinction, by random draws from the linear model at the end of a recovery."""

from __future__ import annotations

import numpy as np

from cloudtomo_cl.inversion.noisy_model import NoisyModel

# Draws for the standard error, in Python and on the command line: by default, and at most (far more than it needs).
DRAWS, MOST_DRAWS = 24, 10_000
# Factor from the draws' standard deviation to a recovery's standard error where images are fitted and voxels are thin
# (`widening`): draws do not include the bias of the prior and the derivatives (docs/measurements/uncertainty.md).
WIDENED = 2.0
# Optical depth of a voxel, along its mean chord, beyond which errors outgrow noise: images hardly change with it.
_HARDLY_TOLD = 3.0
# Share of the mean curvature that is added in the scaling of unknowns, for voxels that hardly change any pixel.
LEAST_CURVATURE = 1e-3


def standard_errors(model: NoisyModel, draws: int, seed: int) -> np.ndarray:
    """Root mean square deviation of draws from the posterior distribution of the linear model.

    Each draw adds random noise to the measured images and a random change to the prior's mean, by their distributions,
    and minimises the model again, over extinctions that are not negative. For linear images and without bounds these
    are samples of the posterior ("randomize then optimize": Papandreou and Yuille 2010; with bounds: Bardsley and
    Fox 2012). Priors without a Gaussian part keep the slope that they have at the estimate.

    Parameters
    ----------
    model : quadratic model at the estimate
    draws : number of draws; the relative error of the result is 1 / sqrt(2 draws)
    seed : seed of the draws

    Returns
    -------
    standard deviations, km^-1, shape (voxels of the mask,)
    """
    random = np.random.default_rng([seed, draws])
    gradient = model.data_slope + model.prior_slope
    without = model.minimum(gradient)
    squares = np.zeros_like(gradient)
    for _ in range(draws):
        force = model.slope_of_noise(random) + model.prior.perturbation(random, model.units)
        squares += (model.minimum(gradient - force) - without) ** 2
    return np.sqrt(squares / draws)


def widening(misfit: float, depth: np.ndarray) -> np.ndarray:
    """The factor from the draws' standard deviations to standard errors of a recovery, shape (voxels,).

    Draws assume a linear model that fits. Where the images are not fitted to their noise, errors are larger in
    proportion to the square root of the misfit (Birge 1932, "The calculation of errors by the method of least
    squares"); and images do not change linearly with deep voxels (docs/measurements/uncertainty.md).

    Parameters
    ----------
    misfit : mean square of the images' residuals over that of noise alone
    depth : optical depth of the voxels along their mean chord, shape (voxels,)
    """
    return WIDENED * np.sqrt(max(misfit, 1.0) * beyond_noise(depth))


def beyond_noise(depth: np.ndarray | float) -> np.ndarray | float:
    """Variance of errors over that by noise alone, in voxels of an optical depth along their mean chord."""
    return 1 + np.square(depth / _HARDLY_TOLD)
