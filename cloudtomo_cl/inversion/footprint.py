"""Memory that a stage of a recovery takes."""

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
from cloudtomo_cl.transport.radiance import BRANCHING_G
from cloudtomo_cl.transport.rendering_memory import footprint
from cloudtomo_cl.transport.tiles import about_how_many_entries

# Bytes per voxel of the prior's arrays on the device; and on the host of extinctions, of the stage and the finest grid.
_PRIOR_BYTES_PER_VOXEL, _HOST_BYTES_PER_VOXEL = 56, 40


def deep_growth(stage: Stage, solver: Any, mask: np.ndarray | None) -> Footprint:
    """Memory that a stage may take beyond its footprint, if the cloud is as deep as can be.

    Callers warn, and do not refuse: only the images tell how deep a cloud is. The radiance table may triple, which at
    128^3 voxels is 1.5 GB of 6.5 GB; but a recovery there took 5.1 GB in all, so a refusal would shut out machines of
    8 GB that have enough.

    Parameters
    ----------
    solver : solver, whose optional method `deep_growth(voxels)` gives the memory
    mask : voxels that may hold cloud, bool, on the scene's grid; None: nothing is known
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
    """Memory that a stage takes at its peak.

    Parameters
    ----------
    solver : solver, whose method `footprint(pixels, voxels, longest, entries)` gives what it keeps; `stores_branches`
        False: the paths that it stores do not branch
    mask : voxels that may hold cloud, bool, on the scene's grid; None: all pixels and voxels count, but nothing that
        the solver keeps
    ranks : number of ranks that share the pixels; the result is for one of them

    Raises
    ------
    DataError : there are more voxels or pixels than kernels can count; no pixel sees the mask
    """
    voxels, finest = voxels_of(stage.grid), voxels_of(scene.grid.shape)
    pixels = sum(image.size for image in measurements.images)
    what = f"a reconstruction with {shape_text(stage.grid)} voxels and {pixels} pixels"
    require_countable(max(voxels, finest), pixels, what)
    branches = getattr(solver, "stores_branches", True) and scene.cloud.phase_function.g >= BRANCHING_G
    needed = footprint(voxels, pixels, pixels * (stage.samples or 0) // ranks, branches)
    needed += Footprint(_PRIOR_BYTES_PER_VOXEL * voxels, 8 * voxels, _HOST_BYTES_PER_VOXEL * (voxels + finest))
    if mask is not None and hasattr(solver, "footprint"):
        kept, coarse = coarsened(mask, stage.grid), replace(scene, grid=scene.grid.with_shape(stage.grid))
        active = active_pixels(measurements.at_share(stage.pixels), coarse.grid, kept)
        entries = about_how_many_entries(active.views, active.listed, coarse, kept)
        needed += solver.footprint(-(-len(active) // ranks), int(kept.sum()), max(stage.grid), -(-entries // ranks))
    return needed
