"""The cloud that a recovery begins with: as deep as the images say, everywhere alike."""

from __future__ import annotations

import numpy as np

from cloudtomo_cl.inversion.objective import AveragedImage
from cloudtomo_cl.inversion.problem import Problem
from cloudtomo_cl.scene.grid import Grid, mean_chord

# Optical depth along a mean chord of the box around the mask that is tried first; halved at most so many times.
_DEEPEST, _HALVINGS = 1.0, 12
# A cost is higher than another by more than its noise if it is by so many standard errors.
_SIGNIFICANCE = 2.0
# Random numbers of their own: those of a render have stream 0, those of iterations count from 1.
_STREAM = 2**32 - 1


def uniform_start(problem: Problem, box: np.ndarray, grid: Grid, seed: int) -> float:
    """The extinction that a recovery begins with in every voxel that may hold cloud, km^-1.

    An optical depth of 1 along a mean chord of the box around these voxels, halved as long as the images of a cloud
    that is everywhere alike then fit better. Beside a cloud that is much thinner, or over bright ground, where a thin
    cloud makes little difference, images of a deeper start would say by their derivatives that there is no cloud.

    Parameters
    ----------
    problem : of the first stage
    box : bool, shape of `grid`: which voxels may hold cloud
    grid : the finest
    seed : of the recovery
    """
    voxels = np.argwhere(box)
    edges = (voxels.max(axis=0) - voxels.min(axis=0) + 1) * grid.spacing
    extinction = best = _DEEPEST / mean_chord(edges)
    least, error = _cost(problem, extinction, seed)
    for _ in range(_HALVINGS):
        extinction /= 2
        cost, other = _cost(problem, extinction, seed)
        if cost > least + _SIGNIFICANCE * np.hypot(error, other):
            break
        if cost < least:
            best, least, error = extinction, cost, other
    return float(best)


def _cost(problem: Problem, extinction: float, seed: int) -> tuple[float, float]:
    """The data term of a uniform cloud, and its standard error."""
    samples = problem.default_samples if problem.samples is None else problem.samples
    uniform = problem.on_grid(np.full(len(problem.voxels), extinction))
    halves = problem.operator.render(uniform, samples, seed, _STREAM).halves
    image = AveragedImage.empty(len(problem.active))
    return image.cost(halves, problem.radiance, problem.weights, problem.active.calibration)
