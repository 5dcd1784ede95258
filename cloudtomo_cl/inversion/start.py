"""The uniform cloud with which a recovery begins, as deep as the images say."""

from __future__ import annotations

import numpy as np

from cloudtomo_cl.inversion.objective import AveragedImage, noise_of
from cloudtomo_cl.inversion.problem import Problem
from cloudtomo_cl.scene.grid import Grid, mean_chord

# Optical depth along a mean chord of the box around the mask that is tried first, and largest number of halvings.
_DEEPEST, _HALVINGS = 1.0, 12
# Standard errors by which a cost must exceed another one to be higher by more than noise.
_SIGNIFICANCE = 2.0
# Cost, as a multiple of that by noise alone, up to which a uniform cloud fits.
_FITTING = 2.5
# Stream of random numbers that nothing else uses: renders have 0, iterations count from 1.
_STREAM = 2**32 - 1


def uniform_start(problem: Problem, mask: np.ndarray, grid: Grid, seed: int) -> float:
    """The extinction with which a recovery begins in every voxel that may hold cloud, km^-1.

    It is an optical depth of 1 along a mean chord of the box around these voxels, halved as long as images of a uniform
    cloud then fit better. If the true cloud is much thinner, or thin over bright ground where it makes little
    difference, the derivatives at a deeper start would say that there is no cloud. But images that are fitted best by
    next to nothing, and not by that either, say nothing of the depth: their radiances are too low everywhere, for
    instance by a wrong dark level. Then it is 1.

    Parameters
    ----------
    problem : problem of the first stage
    mask : voxels that may hold cloud, bool, shape of `grid`
    grid : finest grid
    seed : seed of the recovery
    """
    voxels = np.argwhere(mask)
    edges = (voxels.max(axis=0) - voxels.min(axis=0) + 1) * grid.spacing
    deepest = extinction = best = _DEEPEST / mean_chord(edges)
    least, error = _cost(problem, extinction, seed)
    for _ in range(_HALVINGS):
        extinction /= 2
        cost, other = _cost(problem, extinction, seed)
        if cost > least + _SIGNIFICANCE * np.hypot(error, other):
            break
        if cost < least:
            best, least, error = extinction, cost, other
    noise = noise_of(problem.active.variance, problem.weights)
    if best == deepest / 2**_HALVINGS and least - _SIGNIFICANCE * error > _FITTING * noise:
        return float(deepest)
    return float(best)


def _cost(problem: Problem, extinction: float, seed: int) -> tuple[float, float]:
    """The data term of a uniform cloud, and its standard error."""
    samples = problem.paths_per_pixel()
    uniform = problem.on_grid(np.full(len(problem.voxels), extinction))
    halves = problem.operator.render(uniform, samples, seed, _STREAM).halves
    image = AveragedImage.empty(len(problem.active))
    return image.cost(halves, problem.radiance, problem.weights, problem.active.calibration)
