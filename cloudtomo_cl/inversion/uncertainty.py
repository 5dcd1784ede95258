"""Standard errors of a recovered extinction, by random draws from the linear model at the end of a recovery."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from cloudtomo_cl.inversion.bound_prior import FrozenPrior, NoiseUnits
from cloudtomo_cl.transport.jacobian import Jacobian

# Of a standard error where nobody says otherwise, in Python as on the command line.
DRAWS = 24
# Of the conjugate gradients between two looks at the bounds: at most, and the residual relative to the right side
# at which they end. And how often the bounds are looked at.
_ITERATIONS = 30
_TOLERANCE = 1e-2
_LOOKS = 4
# The draws' deviation times this is a recovery's standard error, for draws know nothing of the prior's bias, nor of the
# derivatives': with it about 68 % of the voxels of whole recoveries lie within it (docs/measurements/uncertainty.md).
WIDENED = 2.0
# Least curvature in scaling, of the mean one: voxels that no pixel feels.
LEAST_CURVATURE = 1e-3


def standard_errors(
    jacobian: Jacobian,
    weights: np.ndarray,
    noise: Callable[[np.random.Generator], np.ndarray],
    correct: Callable[[np.ndarray], np.ndarray],
    prior: FrozenPrior,
    units: NoiseUnits,
    estimate: np.ndarray,
    gradient: np.ndarray,
    draws: int,
    seed: int,
) -> np.ndarray:
    """Root mean square over draws from the posterior distribution of the linear model.

    Each draw changes the measured images by their noise, and the prior's mean by what it allows, and
    minimises the model again, over extinctions that are not negative. For linear images and without bounds these
    are samples of the posterior ("randomize then optimize": Papandreou and Yuille 2010; with bounds: Bardsley and
    Fox 2012). Other priors keep the slope that they have at the estimate.

    Parameters
    ----------
    jacobian : shape (pixels, voxels of the mask)
    weights : of the squared residuals, shape (pixels,)
    noise : draws noise of the images, shape (pixels,)
    correct : what is left of residuals, `Calibration`, shape (pixels,)
    prior : whose Gaussian part counts
    units : what it is multiplied with
    estimate : km^-1, shape (voxels of the mask,)
    gradient : of the cost there, with all priors, same shape
    draws : how many: the result is good to 1 / sqrt(2 draws)
    seed : of the draws

    Returns
    -------
    km^-1, shape (voxels of the mask,)
    """
    random = np.random.default_rng([seed, draws])
    curvature = jacobian.curvature(weights)
    scale = 1 / (curvature + prior.curvature(estimate, units) + LEAST_CURVATURE * curvature.mean())

    def product(values: np.ndarray) -> np.ndarray:
        """The model's second derivative times the columns."""
        changed = jacobian.matmat(values)
        force = np.column_stack([weights * correct(column) for column in changed.T])
        return jacobian.rmatmat(force) + prior.stiffness(values, units)

    right = np.zeros((len(curvature), draws + 1))  # the last one has no noise
    for draw in range(draws):
        force = weights * correct(noise(random))
        right[:, draw] = jacobian.rmatvec(force) + prior.perturbation(random, units)
    found = bounded_minimum(product, right - gradient[:, None], scale[:, None], -estimate[:, None])
    return np.sqrt(np.mean((found[:, :-1] - found[:, -1:]) ** 2, axis=1))


def bounded_minimum(
    product: Callable[[np.ndarray], np.ndarray], right: np.ndarray, scale: np.ndarray, lower: np.ndarray
) -> np.ndarray:
    """The minimum of 1/2 x H x - right x over x >= lower, for all columns at once.

    One matrix product serves all columns. Conjugate gradients on what is free, preconditioned; then what has
    crossed a bound is put on it, and what is pulled off one is free again (as Moré and Toraldo 1991).

    product : H times columns; scale : about the inverse of H's diagonal; lower : at most 0
    """
    found = np.maximum(np.zeros_like(right), lower)
    for _ in range(_LOOKS):
        residual = right - product(found) if found.any() else right.copy()
        free = (found > lower) | (residual > 0)
        residual *= free
        direction = scale * residual
        square = size = np.sum(residual * direction, axis=0)
        for _ in range(_ITERATIONS):
            if (square <= _TOLERANCE**2 * size).all():
                break
            image = product(direction) * free
            length = square / np.maximum(np.sum(direction * image, axis=0), 1e-300)
            found += length * direction
            residual -= length * image
            before, square = square, np.sum(residual * scale * residual, axis=0)
            direction = scale * residual + square / np.maximum(before, 1e-300) * direction
        np.maximum(found, lower, out=found)
    return found
