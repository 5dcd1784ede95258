"""Coarse to fine: what a stage is, when it ends, and what the next one starts from."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any

import numpy as np
from pydantic import ConfigDict, Field
from pydantic.dataclasses import dataclass

from cloudtomo_cl.arguments import a, require_kinds
from cloudtomo_cl.errors import DataError
from cloudtomo_cl.inversion.solvers.protocol import SOLVER
from cloudtomo_cl.messages import answering
from cloudtomo_cl.renamed import renamed_arguments
from cloudtomo_cl.scene.grid import Count, Grid
from cloudtomo_cl.scene.scene import NotNegative

# Voxels of the first stage along the axis that has most, if the grid's are cubes, and otherwise at most; and along any
# axis at least. By what they shrink from stage to stage.
_COARSEST, _MOST, _FEWEST = 6, 12, 4
_SHRINKAGE = 1.8
# Two windows' mean costs differ if they do by more standard errors than this. As images are averaged
# over iterations, the costs of a window are correlated, so that noise passes for progress more often
# than the 2.5 % of independent costs: a stage then ends later.
_SIGNIFICANCE = 2.0


@answering
@dataclass(frozen=True, config=ConfigDict(extra="forbid"))
class Stage:
    """The iterations on one grid, from coarse to fine.

    Attributes
    ----------
    grid : numbers of voxels along x, y, z
    pixels : width and height of the images, as a share of the measured images'
    samples : paths per pixel and iteration for derivatives, even. By default Gauss-Newton takes 90 for each voxel
        that may hold cloud, but no more than 180 for each pixel, and at least 50,000 in all; a descent takes 60,000
    iterations : largest number of iterations; the stage ends earlier when its cost has stopped falling
    window : least number of iterations whose mean cost is compared with that of as many iterations before
    prior_weight : factor of the prior
    """

    grid: tuple[Count, Count, Count]
    pixels: Annotated[float, Field(gt=0, le=1)] = 1.0
    samples: Annotated[int, Field(ge=2, multiple_of=2)] | None = None
    iterations: Count = 100
    window: Annotated[int, Field(ge=2)] = 20
    prior_weight: NotNegative = 1.0


@renamed_arguments(method="solver: a GaussNewton, Adam or SGD", iterations="iterations of the solver")
def automatic_stages(grid: Grid, solver: Any = None) -> tuple[Stage, ...]:
    """Stages whose voxels shrink by a factor of about 1.8, from 6 to 12 along the domain's longest side.

    Coarse voxels are cubes also where the grid's own are not, as far as the grid allows
    (docs/decisions/coarse-voxels.md): no axis has more than its own voxels, and none fewer than 4 unless it has fewer.
    Images have about two pixels per voxel, up to all that were measured. The solver says how many iterations a stage
    has (`GaussNewton`, the default, needs few, a descent many).
    """
    require_kinds("automatic_stages", grid=(grid, a(Grid)), solver=(solver, SOLVER.or_none()))
    limits = getattr(solver, "stage_limits", _stage_limits)
    shortest = min(grid.spacing)
    first = max(max(grid.shape) / _COARSEST, max(grid.extent) / shortest / _MOST, 1.0)
    *coarse, _ = np.geomspace(first, 1, max(0, round(np.log(first) / np.log(_SHRINKAGE))) + 1)
    stages = []
    for side in coarse:  # of a cube, in units of the shortest side of a voxel
        cubes = (round(length / (side * shortest)) for length in grid.extent)
        nx, ny, nz = (min(voxels, max(_FEWEST, count)) for voxels, count in zip(grid.shape, cubes))
        iterations, window = limits(False)
        stages.append(Stage(grid=(nx, ny, nz), pixels=min(1.0, 2 / side), iterations=iterations, window=window))
    iterations, window = limits(True)
    return (*stages, Stage(grid=grid.shape, iterations=iterations, window=window))


def _stage_limits(last: bool) -> tuple[int, int]:
    from cloudtomo_cl.inversion.solvers.gauss_newton import GaussNewton

    return GaussNewton().stage_limits(last)


def stages_of(grid: Grid, stages: Sequence[Stage] | None, solver: Any) -> tuple[Stage, ...]:
    """The given stages, or automatic ones. Raises DataError for none, or if it is not clear which iterations count."""
    if stages is None:
        return automatic_stages(grid, solver)
    if not len(stages):
        raise DataError("stages is empty: give at least one Stage, or None for automatic ones")
    if getattr(solver, "iterations", None) is not None:
        raise DataError("solver.iterations is for automatic stages: give those of each [[stage]], or no [[stage]]")
    return tuple(stages)


def has_settled(costs: Sequence[float], standard_errors: Sequence[float], window: int) -> bool:
    """Whether the cost has stopped falling beyond its noise.

    Compares the mean of the last costs with the mean of as many before: settled if it is not
    lower by two standard errors of the difference. The means are over `window` costs, or over
    a third of all if that is more: slow progress shows late.
    """
    if len(costs) < 2 * window:
        return False
    window = max(window, len(costs) // 3)
    before, now = np.mean(costs[-2 * window : -window]), np.mean(costs[-window:])
    noise = np.sqrt(np.sum(np.square(standard_errors[-2 * window :]))) / window
    return bool(before - now < _SIGNIFICANCE * noise)
