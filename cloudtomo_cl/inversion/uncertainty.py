"""Standard errors of a recovered extinction, by random draws from the linear model at the end of a recovery."""

from __future__ import annotations

import numpy as np

from cloudtomo_cl.inversion.noisy_model import NoisyModel

# Of a standard error where nobody says otherwise, in Python as on the command line.
DRAWS = 24
# The draws' deviation times this is a recovery's standard error where images are fitted and voxels thin (`widening`),
# for draws know nothing of the prior's bias, nor of the derivatives' (docs/measurements/uncertainty.md).
WIDENED = 2.0
# Optical depth of a voxel, along its mean chord, beyond which errors outgrow noise: light hardly tells it from deeper.
_HARDLY_TOLD = 3.0
# Least curvature in scaling, of the mean one: voxels that no pixel feels.
LEAST_CURVATURE = 1e-3


def standard_errors(model: NoisyModel, draws: int, seed: int) -> np.ndarray:
    """Root mean square over draws from the posterior distribution of the linear model.

    Each draw changes the measured images by their noise, and the prior's mean by what it allows, and
    minimises the model again, over extinctions that are not negative. For linear images and without bounds these
    are samples of the posterior ("randomize then optimize": Papandreou and Yuille 2010; with bounds: Bardsley and
    Fox 2012). Other priors keep the slope that they have at the estimate.

    Parameters
    ----------
    model : at the estimate
    draws : how many: the result is good to 1 / sqrt(2 draws)
    seed : of the draws

    Returns
    -------
    km^-1, shape (voxels of the mask,)
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
    """What draws' deviations are multiplied with to be standard errors of a recovery, shape (voxels,).

    Draws are of a linear model that fits. Where the images are not fitted to their noise, errors are larger in
    proportion to the misfit's root (Birge 1932, "The calculation of errors by the method of least squares"); and where
    voxels are deep, images are no linear function of them (docs/measurements/uncertainty.md).

    Parameters
    ----------
    misfit : mean square of the images' residuals, in that of noise alone
    depth : optical, of voxels along their mean chord, shape (voxels,)
    """
    return WIDENED * np.sqrt(max(misfit, 1.0) * beyond_noise(depth))


def beyond_noise(depth: np.ndarray | float) -> np.ndarray | float:
    """Variances of errors in voxels of an optical depth along their mean chord, in those that noise makes."""
    return 1 + np.square(depth / _HARDLY_TOLD)
