"""How much memory a stage of a recovery takes."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from cloudtomo_cl.inversion.pixels import active_pixels
from cloudtomo_cl.inversion.stages import Stage
from cloudtomo_cl.memory import require_countable, shape_text, voxels_of
from cloudtomo_cl.opencl.memory import Footprint
from cloudtomo_cl.scene.grid import coarsened
from cloudtomo_cl.scene.measurements import Measurements
from cloudtomo_cl.scene.scene import Scene
from cloudtomo_cl.transport.radiance import footprint
from cloudtomo_cl.transport.tiles import about_how_many_entries

# On the device: the prior's arrays. On the host: extinctions of the stage and of the finest grid.
_PRIOR_BYTES_PER_VOXEL, _HOST_BYTES_PER_VOXEL = 56, 40


def deep_growth(stage: Stage, solver: Any, mask: np.ndarray | None) -> Footprint:
    """What a stage may take beyond its footprint, if the cloud is as deep as can be.

    A warning is made of it, no refusal: how deep a cloud is, images tell. The radiance table may triple, which at 128^3
    is 1.5 GB of 6.5 GB, but a recovery there has taken 5.1 GB in all: machines of 8 GB would be refused what they hold.

    Parameters
    ----------
    solver : whose method `deep_growth(voxels)`, if there is one, says what it takes
    mask : bool, on the scene's grid; without one nothing is known
    """
    if mask is None or not hasattr(solver, "deep_growth"):
        return Footprint()
    return solver.deep_growth(int(coarsened(mask, stage.grid).sum()))


def stage_footprint(
    scene: Scene,
    measurements: Measurements,
    stage: Stage,
    solver: Any = None,
    mask: np.ndarray | None = None,
    ranks: int = 1,
) -> Footprint:
    """What a stage takes at its largest.

    Parameters
    ----------
    solver : whose method `footprint(pixels, voxels, longest, entries)` says what it keeps
    mask : bool, on the scene's grid; without one all pixels and voxels count, and what solvers keep does not
    ranks : that share the pixels: what one of them takes

    Raises
    ------
    DataError : there are more voxels or pixels than kernels count; no pixel sees the mask
    """
    voxels, finest = voxels_of(stage.grid), voxels_of(scene.grid.shape)
    pixels = sum(image.size for image in measurements.images)
    what = f"a reconstruction with {shape_text(stage.grid)} voxels and {pixels} pixels"
    require_countable(max(voxels, finest), pixels, what)
    needed = footprint(voxels, pixels, pixels * (stage.samples or 0) // ranks)
    needed += Footprint(_PRIOR_BYTES_PER_VOXEL * voxels, 8 * voxels, _HOST_BYTES_PER_VOXEL * (voxels + finest))
    if mask is not None and hasattr(solver, "footprint"):
        kept, coarse = coarsened(mask, stage.grid), replace(scene, grid=scene.grid.with_shape(stage.grid))
        active = active_pixels(measurements.at_share(stage.pixels), coarse.grid, kept)
        entries = about_how_many_entries(active.views, active.listed, coarse, kept)
        needed += solver.footprint(-(-len(active) // ranks), int(kept.sum()), max(stage.grid), -(-entries // ranks))
    return needed
