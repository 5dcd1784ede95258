"""What a recovery refuses before its first path."""

from __future__ import annotations

import json
import zlib
from collections.abc import Sequence
from typing import Any

import numpy as np

from cloudtomo_cl.arguments import CALLABLE, NUMBER, PATH, WHOLE, a, many, require_kinds
from cloudtomo_cl.errors import DataError, DeviceError
from cloudtomo_cl.inversion.bound_priors import unlike_prior
from cloudtomo_cl.inversion.brightness import brightness_text
from cloudtomo_cl.inversion.checkpoint import Checkpoint, identity_of
from cloudtomo_cl.inversion.footprint import deep_growth, stage_footprint
from cloudtomo_cl.inversion.priors import PRIOR, AnyPrior, PatchPrior, Regulariser
from cloudtomo_cl.inversion.run import DIVERGED_DEPTH
from cloudtomo_cl.inversion.solvers.gauss_newton import GaussNewton
from cloudtomo_cl.inversion.solvers.protocol import SOLVER, Solver
from cloudtomo_cl.inversion.stages import Stage, stages_of
from cloudtomo_cl.inversion.stuck_pixels import stuck_text
from cloudtomo_cl.inversion.uncertainty import MOST_DRAWS
from cloudtomo_cl.memory import shape_text
from cloudtomo_cl.opencl.device import Device
from cloudtomo_cl.parallel.ranks import Ranks
from cloudtomo_cl.scene.arrays import as_numbers
from cloudtomo_cl.scene.grid import Grid, mean_chord
from cloudtomo_cl.scene.masks import checked_mask
from cloudtomo_cl.scene.measurements import Measurements, check_wavelength
from cloudtomo_cl.scene.metrics import epsilon
from cloudtomo_cl.scene.scene import Scene
from cloudtomo_cl.scene.seeds import checked_seed
from cloudtomo_cl.scene.visibility import voxels_in_view

# Optical depth along a mean chord of the domain that a start given by the user has at least, and at most: no cloud is
# deeper than that on average, and the first iteration, which no time limit cuts short, takes time in proportion to it.
_LEAST_START, _MOST_START = 1e-3, 1000.0
# Largest share of the voxels that may hold cloud, but are in no image, of which nothing is said.
_LARGEST_UNSEEN = 0.01
# What to do where memory is short.
_FEWER = "choose a coarser [grid] or [[stage]], or fewer samples or pixels"


def check(
    scene: Scene,
    measurements: Measurements,
    stages: Sequence[Stage] | None = None,
    prior: AnyPrior | Regulariser | None = None,
    solver: Solver | None = None,
    *,
    mask: np.ndarray | None = None,
    device: Device,
    seed: int = 0,
    truth: np.ndarray | None = None,
    resume: Checkpoint | None = None,
) -> None:
    """Refuses what `reconstruct` with the same arguments would refuse, without a path.

    What the solver keeps for the voxels of the mask counts as far as that is known: given, or a checkpoint's.

    Raises
    ------
    DataError, DeviceError : as `reconstruct`
    """
    prior, solver = by_default(prior, solver)
    stages = stages_of(scene.grid, stages, solver)
    checked_seed(seed)
    check_wavelength(scene, measurements)
    brightness_text(scene, measurements)  # which refuses what no cloud can be
    unlike_prior(prior, scene.grid)  # which reads its file
    if truth is not None:
        given = as_numbers(truth, "truth").shape
        if given != scene.grid.shape:
            raise DataError(f"truth has shape {given}, the grid {scene.grid.shape}")
        epsilon(np.zeros(scene.grid.shape), truth)  # which refuses what is missing
    if mask is None and resume is not None:
        mask = resume.mask
    if mask is not None:
        mask = checked_mask(mask, scene.grid)
    check_memory(scene, measurements, stages, device, solver, mask)
    _check_start(scene.grid, stages, solver)
    if resume is not None and mask is not None:
        resume.check(identity_of(scene, measurements, stages, prior, solver, mask, truth, seed))


def by_default(prior: AnyPrior | Regulariser | None, solver: Solver | None) -> tuple[AnyPrior | Regulariser, Solver]:
    """What is given, even if it is false in Python (an object of length 0), or what recoveries have by default."""
    return PatchPrior() if prior is None else prior, GaussNewton() if solver is None else solver


def require_one_question(ranks: Ranks, identity: dict[str, Any]) -> None:
    """DataError on all ranks if they were given different things, of which they would make a mixture."""
    # Of a user's prior or solver the text may tell its place in memory, which ranks do not share.
    names = [name for name in identity if name not in ("prior", "solver")]
    asked = ranks.all({name: zlib.crc32(json.dumps(identity[name]).encode()) for name in names})
    differ = [name for name in names if len({one[name] for one in asked}) > 1]
    if differ:
        raise DataError(f"ranks were given different {', '.join(differ)}: all call this with the same arguments")


DEVICE = a(Device, hint="choose_device gives one").or_none()
# Of the other arguments of `reconstruct`.
_KINDS = {
    "scene": a(Scene),
    "measurements": a(Measurements, hint="read_measurements reads one from a file"),
    "stages": many(Stage).or_none(),
    "prior": PRIOR.or_none(),
    "solver": SOLVER.or_none(),
    "callback": CALLABLE.or_none(),
    "checkpoint": PATH.or_(CALLABLE).or_none(),
    "resume": PATH.or_(a(Checkpoint)).or_none(),
    "stop": CALLABLE.or_none(),
}


def check_kinds(*values: Any) -> None:
    """InvalidArgumentError for arguments that `reconstruct` can make nothing of; they are in the order of _KINDS."""
    named = zip(_KINDS.items(), values, strict=True)
    require_kinds("reconstruct", **{name: (value, kind) for (name, kind), value in named})


def check_ends(time_limit: Any, checkpoint_interval: Any, uncertainty: Any) -> None:
    """DataError for what would be found wrong only after an iteration, or when the recovery is done."""
    seconds = {"time_limit": time_limit, "checkpoint_interval": checkpoint_interval}
    for name, value in seconds.items():
        if not (NUMBER.fits(value) and float(value) >= 0) and not (name == "time_limit" and value is None):
            raise DataError(f"{name} is {value!r}: it must be a number of seconds, at least 0")
    if not (WHOLE.fits(uncertainty) and 0 <= uncertainty <= MOST_DRAWS):
        raise DataError(
            f"uncertainty is {uncertainty!r}: it must be a whole number of draws, at least 0 and at most {MOST_DRAWS}"
        )


def _check_start(grid: Grid, stages: Sequence[Stage], solver: Any) -> None:
    """DataError if the first render would be of something that light never leaves, or of next to nothing.

    From that no step comes away: its images say nothing, and a prior that is measured by it forbids everything else.
    """
    start, chord = getattr(solver, "start", None), mean_chord(grid.extent)
    if start is not None and not _LEAST_START <= start * chord <= _MOST_START:
        raise DataError(
            f"solver.start is {start:g} km^-1, an optical depth of {start * chord:.3g} across the domain: it must be "
            f"{_LEAST_START / chord:.3g} to {_MOST_START / chord:.3g} km^-1; "
            "without it recoveries begin with what the images say"
        )
    edge = max(max(grid.with_shape(stage.grid).spacing) for stage in stages)
    for name in ("start", "floor"):
        value = getattr(solver, name, None) or 0.0
        if not value * edge < DIVERGED_DEPTH:
            raise DataError(
                f"solver.{name} is {value:g} km^-1, an optical depth of {value * edge:.3g} across a voxel of "
                f"{edge:g} km: it must be below {DIVERGED_DEPTH / edge:.3g} km^-1"
            )


def doubtful_texts(scene: Scene, measurements: Measurements, mask: np.ndarray) -> tuple[str, ...]:
    """What to know about images before a recovery, in words: each of them empty if there is nothing.

    mask : voxels that may hold cloud, bool, shape of the scene's grid
    """
    of_images = brightness_text(scene, measurements), stuck_text(scene, measurements)
    return (*of_images, unseen_text(scene, measurements, mask))


def unseen_text(scene: Scene, measurements: Measurements, mask: np.ndarray) -> str:
    """A text that says how much of what may hold cloud is in no image; empty if that is little.

    A periodic domain is seen in its copies, too: of that nothing is said.

    mask : voxels that may hold cloud, bool, shape of the scene's grid
    """
    if scene.boundary.horizontal == "periodic" or not mask.any():
        return ""
    share = np.count_nonzero(mask & ~voxels_in_view(measurements.views, scene.grid)) / np.count_nonzero(mask)
    if share <= _LARGEST_UNSEEN:
        return ""
    return (
        f"{share:.0%} of the voxels that may hold cloud are in no view's image: what is recovered there follows from "
        "the prior and from light that comes out elsewhere. Take a smaller [grid], or a mask"
    )


def check_memory(
    scene: Scene,
    measurements: Measurements,
    stages: Sequence[Stage],
    device: Device,
    solver: Any = None,
    mask: np.ndarray | None = None,
) -> str:
    """DataError or DeviceError if a stage would not fit into the memory of machine and device.

    mask : bool, on the scene's grid; without one all voxels count, and what solvers keep does not

    Returns a warning if one would not fit where it recovers a cloud as deep as can be; otherwise nothing.
    """
    tight = ""
    for stage in stages:
        pixels = sum(image.size for image in measurements.images)
        what = f"a reconstruction with {shape_text(stage.grid)} voxels and {pixels} pixels"
        needed = stage_footprint(scene, measurements, stage, solver, mask, device.ranks.size)
        needed.require(device, what, _FEWER)
        try:
            (needed + deep_growth(stage, solver, mask)).require(device, f"{what}, of a very deep cloud,", _FEWER)
        except (DataError, DeviceError) as error:
            tight = f"{error}. It begins, and ends with an error if the cloud turns out so deep"
    return tight
