"""The recovery of a cloud's extinction from images, coarse to fine."""

from __future__ import annotations

import logging
import os
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from cloudtomo_cl.arguments import require_kinds
from cloudtomo_cl.errors import RecoveryWarning
from cloudtomo_cl.inversion.bound_priors import unlike_prior
from cloudtomo_cl.inversion.carving import carved_mask
from cloudtomo_cl.inversion.checkpoint import Checkpoint, Checkpoints, identity_of, read_checkpoint
from cloudtomo_cl.inversion.checks import (
    DEVICE,
    by_default,
    check,
    check_ends,
    check_kinds,
    check_memory,
    doubtful_texts,
    require_one_question,
)
from cloudtomo_cl.inversion.priors import AnyPrior, Regulariser
from cloudtomo_cl.inversion.problem import Problem
from cloudtomo_cl.inversion.records import History, IterationRecord, Reconstruction
from cloudtomo_cl.inversion.run import (
    KeepCheckpoints,
    KeepHistory,
    Run,
    StoppingRule,
    StopRequested,
    TimeLimit,
    Watcher,
    guard_divergence,
    require_same,
    settled,
)
from cloudtomo_cl.inversion.solvers.protocol import Solver
from cloudtomo_cl.inversion.solvers.state import restored
from cloudtomo_cl.inversion.stages import Stage, stages_of
from cloudtomo_cl.inversion.start import uniform_start
from cloudtomo_cl.inversion.uncertainty import DRAWS
from cloudtomo_cl.opencl.device import Device
from cloudtomo_cl.opencl.devices import choose_device
from cloudtomo_cl.opencl.driver import device_errors
from cloudtomo_cl.renamed import renamed_arguments
from cloudtomo_cl.scene.grid import resample_in_mask
from cloudtomo_cl.scene.masks import checked_mask
from cloudtomo_cl.scene.measurements import Measurements
from cloudtomo_cl.scene.scene import Scene

_LOGGER = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False)
class _Question:
    """What is asked of the images, the same in all stages."""

    scene: Scene
    measurements: Measurements
    prior: AnyPrior | Regulariser
    mask: np.ndarray
    device: Device

    def at(self, stage: Stage) -> Problem:
        """The problem of a stage."""
        return Problem.of(
            self.scene,
            self.measurements.at_share(stage.pixels),
            mask=self.mask,
            prior=self.prior,
            grid=stage.grid,
            device=self.device,
            prior_weight=stage.prior_weight,
            samples=stage.samples,
        )


@renamed_arguments(optimizer="solver: a GaussNewton, Adam or SGD, whose arguments were those of Optimizer")
def reconstruct(
    scene: Scene,
    measurements: Measurements,
    stages: Sequence[Stage] | None = None,
    prior: AnyPrior | Regulariser | None = None,
    solver: Solver | None = None,
    *,
    mask: np.ndarray | None = None,
    device: Device | None = None,
    seed: int = 0,
    time_limit: float | None = None,
    truth: np.ndarray | None = None,
    callback: Callable[[IterationRecord], None] | None = None,
    checkpoint: str | os.PathLike[str] | Callable[[Checkpoint], None] | None = None,
    checkpoint_interval: float = 60.0,
    resume: str | os.PathLike[str] | Checkpoint | None = None,
    stop: Callable[[], bool] | None = None,
    uncertainty: int = DRAWS,
) -> Reconstruction:
    """Recovers extinction from images.

    Parameters
    ----------
    scene : what is known: grid, optics, sun, air, surface, boundary
    measurements : images and views
    stages : by default `automatic_stages` for the scene's grid and the solver
    prior : by default `PatchPrior()`; or an object of your own, see `Regulariser`
    solver : by default `GaussNewton()`; or `Adam`, `SGD`, or an object of your own, see `Solver`
    mask : bool, or 0 and 1, on the scene's grid, where cloud may be; by default what carving leaves (`carve`), or the
        checkpoint's
    device : by default `choose_device()`; one that was chosen with a communicator shares the work with its other ranks,
        which all call this with the same arguments: history and result are on all, callback and checkpoint are the
        first rank's, and one that asks to stop stops all
    time_limit : seconds after which the run ends with what it has, before an iteration that would take longer,
        if it is as long as the last one; those before a resume count
    truth : extinction in km^-1 on the scene's grid, for the history's errors only
    callback : called after every iteration
    checkpoint : a file (.npz) that is kept up to date, or a function that takes each checkpoint:
        after the first iteration, at the ends of stages and of the run, and in between
    checkpoint_interval : seconds between checkpoints within a stage
    resume : a checkpoint of a run with the same arguments, to go on from. The result has the same bits as if the
        run had never been stopped, but for the history's seconds. Only the last stage may have more iterations: they
        are done unless its cost has settled; with fewer than were done already nothing more is
    stop : asked after every iteration; True ends the run with what it has, checkpoint included
    uncertainty : draws that the standard error is made of, at the end, in the time of an iteration or two; 0: none.
        Known with Gauss-Newton, when the last stage was reached, the images' noise is known, and nobody asked to stop

    Warns of voxels of a shape that the patch prior was not learnt from, of memory that a deep cloud may not find, of
    images too bright or too dark for a cloud, of pixels that seem to be saturated or stuck, and of voxels that may hold
    cloud and are in no image (RecoveryWarning).

    Raises
    ------
    DataError : an array does not fit the scene's grid, no pixel sees the mask, a number is out of range, the
        images are far brighter or darker than clouds can be, the checkpoint is of another run (the error names what
        differs) or cannot be written; an argument is of another kind (InvalidArgumentError)
    TransportError : a radiance, a gradient or an extinction is not finite, or diverged
    DeviceError : the device failed or has not enough memory
    """
    require_kinds("reconstruct", device=(device, DEVICE))
    device = device or choose_device()
    ranks = device.ranks

    def checked() -> Checkpoint | None:
        check_kinds(scene, measurements, stages, prior, solver, callback, checkpoint, resume, stop)
        check_ends(time_limit, checkpoint_interval, uncertainty)
        own = resume if isinstance(resume, Checkpoint) or resume is None else read_checkpoint(resume)
        check(scene, measurements, stages, prior, solver, mask=mask, device=device, seed=seed, truth=truth, resume=own)
        return own

    resumed = ranks.together(checked)
    prior, solver = by_default(prior, solver)
    stages = stages_of(scene.grid, stages, solver)
    given = np.empty(0) if mask is None else checked_mask(mask, scene.grid)
    require_one_question(ranks, identity_of(scene, measurements, stages, prior, solver, given, truth, seed))
    if ranks.is_first and (unlike := unlike_prior(prior, scene.grid)):
        warnings.warn(unlike, RecoveryWarning, stacklevel=3)  # of who calls, by way of `renamed_arguments`
    if mask is None:
        mask = carved_mask(scene, measurements, device) if resumed is None else resumed.mask
    question = _Question(scene, measurements, prior, checked_mask(mask, scene.grid), device)
    tight = ranks.together(lambda: check_memory(scene, measurements, stages, device, solver, question.mask))
    for text in (tight, *doubtful_texts(scene, measurements, question.mask)):
        if ranks.is_first and text:
            warnings.warn(text, RecoveryWarning, stacklevel=3)
    identity = identity_of(scene, measurements, stages, prior, solver, question.mask, truth, seed)
    run = Run(stages, question.mask) if resumed is None else Run.resumed(stages, question.mask, resumed)
    keeper = KeepCheckpoints(Checkpoints(checkpoint, checkpoint_interval, ranks), identity, device.name)
    limit, asked = TimeLimit(time_limit, ranks), StopRequested(stop, ranks)
    guard = partial(guard_divergence, solver=solver)
    watchers = (require_same, guard, KeepHistory(truth, callback), keeper)
    problem, state = _iterated(question, solver, run, resumed, watchers, keeper, (limit, asked), seed)
    error, absent = _standard_error(problem, solver, state, run, uncertainty, seed, asked(run))
    extinction = run.on_finest_grid(problem.on_grid(state.estimate))
    views = measurements.moved(getattr(state, "motions", None), scene.grid).views
    history = History(run.history)
    outliers = solver.outliers(problem, state) if hasattr(solver, "outliers") else ()
    return Reconstruction(
        scene.grid, extinction, question.mask, history, run.stage_ends, error, limit.reached, absent, views, outliers
    )


@device_errors("the reconstruction")
def _iterated(
    question: _Question,
    solver: Solver,
    run: Run,
    resumed: Checkpoint | None,
    watchers: Sequence[Watcher],
    keeper: KeepCheckpoints,
    rules: Sequence[StoppingRule],
    seed: int,
) -> tuple[Problem, Any]:
    """All stages, from where the run stands; returns the last problem, and the state that it ended with."""
    estimate, motions = None, None
    while True:
        stage = run.stages[run.stage]
        _LOGGER.info("stage %d of %d: building its kernels", run.stage + 1, len(run.stages))
        problem = replace(question.device.ranks.together(partial(question.at, stage)), motions=motions)
        _LOGGER.info("stage %d of %d: its first iteration", run.stage + 1, len(run.stages))
        if estimate is None:
            start = _start(solver, problem, question, seed) if resumed is None else 0.0
            estimate = np.full(stage.grid, start)
        state = solver.init(problem, resample_in_mask(estimate, problem.mask)[problem.mask])
        if resumed is not None:
            state, resumed = restored(state, resumed.solver_state), None
        while run.iteration < stage.iterations and not settled(run):
            if run.history and _is_over(run, rules):
                break
            # Never the same random numbers twice in a run, nor those of a render, which has stream 0.
            state, progress = solver.step(problem, state, seed=seed, stream=len(run.history) + 1)
            for watch in watchers:
                watch(run, problem, state, progress)
        keeper.take(True, run, state)
        run.stage_ends.append(run.seconds)
        _LOGGER.info("stage %d of %d ended after %.1f s", run.stage + 1, len(run.stages), run.seconds)
        if run.stage + 1 == len(run.stages) or _is_over(run, rules):
            return problem, state
        estimate, motions = problem.on_grid(state.estimate), getattr(state, "motions", None)
        run.stage, run.iteration = run.stage + 1, 0


def _start(solver: Any, problem: Problem, question: _Question, seed: int) -> float:
    """The extinction inside the mask before the first stage, km^-1: the solver's, or as the images say."""
    given = getattr(solver, "start", None)
    return uniform_start(problem, question.mask, question.scene.grid, seed) if given is None else float(given)


def _is_over(run: Run, rules: Sequence[StoppingRule]) -> bool:
    return any([rule(run) for rule in rules])  # all are asked: they remember


def _no_standard_error(problem: Problem, solver: Any, run: Run, draws: int, stopped: bool) -> str:
    """Why no standard error is known at the end of a run, in words; empty if one is."""
    if not draws:
        return "it was not asked for"
    if not hasattr(solver, "standard_error"):
        return f"{type(solver).__name__} does not tell it, GaussNewton does"
    if run.stage < len(run.stages) - 1:
        return "the run ended before its last stage"
    if not run.iteration:
        return "the last stage had no iteration"
    if stopped:
        return "the run was asked to stop"
    if not problem.active.standard_error.any():
        return "the standard errors of the images are not known"
    return ""


@device_errors("the standard errors")
def _standard_error(
    problem: Problem, solver: Any, state: Any, run: Run, draws: int, seed: int, stopped: bool
) -> tuple[np.ndarray | None, str]:
    """Of the estimate, km^-1, on the finest grid; or none, and why."""
    if absent := _no_standard_error(problem, solver, run, draws, stopped):
        return None, absent
    error: np.ndarray | None = solver.standard_error(problem, state, draws, seed)
    if error is None:
        return None, "the solver does not know it"
    return run.on_finest_grid(problem.on_grid(error)), ""
