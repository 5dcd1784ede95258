"""The recovery of a cloud's extinction: stochastic descent in coarse-to-fine stages."""

from __future__ import annotations

import logging
import os
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from cloudtomo_cl.errors import DataError, TransportError
from cloudtomo_cl.inversion.checkpoint import Checkpoint, Checkpoints, identity_of, read_checkpoint, rows
from cloudtomo_cl.inversion.pixels import seen_pixels
from cloudtomo_cl.inversion.priors import Prior
from cloudtomo_cl.inversion.solvers.gauss_newton import GaussNewton
from cloudtomo_cl.inversion.solvers.method import Method, Progress
from cloudtomo_cl.inversion.solvers.optimizer import Optimizer
from cloudtomo_cl.inversion.solvers.stochastic_descent import PATHS_PER_ITERATION, StochasticDescent
from cloudtomo_cl.inversion.stages import Stage, has_settled, stages_of
from cloudtomo_cl.memory import require_jacobian, require_reconstruction
from cloudtomo_cl.opencl.device import Device, choose_device, device_errors
from cloudtomo_cl.scene.grid import Grid, coarsened, resample_in_mask
from cloudtomo_cl.scene.measurements import Measurements
from cloudtomo_cl.scene.metrics import delta, epsilon
from cloudtomo_cl.scene.scene import Scene
from cloudtomo_cl.transport.radiance import RadianceOperator

_LOGGER = logging.getLogger(__name__)

_METHODS: dict[str, type[GaussNewton] | type[StochasticDescent]] = {
    "gauss-newton": GaussNewton,
    "adam": StochasticDescent,
    "sgd": StochasticDescent,
}
# Beyond any cloud: the optical depth across a voxel at which a descent has diverged.
_LARGEST_VOXEL_DEPTH = 1000.0


@dataclass(frozen=True)
class IterationRecord:
    """What one iteration did; a line of the history.

    Attributes
    ----------
    stage, iteration : counted from 0; `stages` and `iterations` (at most) say of how many
    seconds, photons : since the start of the run
    cost, cost_standard_error : data term over the stage's pixels, without dimension
    prior : its value times the stage's weight
    epsilon, delta : of the estimate on the finest grid, if the truth is known
    """

    stage: int
    stages: int
    iteration: int
    iterations: int
    seconds: float
    photons: int
    cost: float
    cost_standard_error: float
    prior: float
    epsilon: float | None = None
    delta: float | None = None


@dataclass(frozen=True)
class Reconstruction:
    """A recovered cloud.

    Attributes
    ----------
    grid, extinction : km^-1, float32, shape of the grid
    mask : bool, where extinction was sought
    history : one record per iteration
    stage_ends : seconds since the start of the run
    standard_error : of the extinction, km^-1, float32, shape of the grid (docs/estimators.md says of what); none
        if it was not asked for, or is not known
    timed_out : whether its time limit ended it
    """

    grid: Grid
    extinction: np.ndarray
    mask: np.ndarray
    history: list[IterationRecord]
    stage_ends: list[float]
    standard_error: np.ndarray | None = None
    timed_out: bool = False

    def __repr__(self) -> str:
        text = f"{self.grid.text}, extinction up to {self.extinction.max():.4g} km^-1"
        if self.history:
            last = self.history[-1]
            text += f", {len(self.history)} iterations in {last.seconds:.0f} s"
            text += "" if last.epsilon is None else f", eps {last.epsilon:.3f}"
        return f"Reconstruction({text})"


def reconstruct(
    scene: Scene,
    measurements: Measurements,
    stages: Sequence[Stage] | None = None,
    prior: Prior | None = None,
    optimizer: Optimizer | None = None,
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
    uncertainty: int = 0,
) -> Reconstruction:
    """Recovers extinction from images.

    Parameters
    ----------
    scene : what is known: grid, optics, sun, air, surface, boundary
    measurements : images and views
    stages, prior, optimizer : by default `Prior()`, `Optimizer()`, and
        `automatic_stages` for the scene's grid and the optimizer
    mask : bool on the scene's grid, where cloud may be (see `carving.carve`); all by default
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
    uncertainty : draws that the standard error is made of, at the end; 0: none. Known with Gauss-Newton,
        when the last stage was reached, the images' noise is known, and nobody asked to stop

    Raises
    ------
    DataError : an array does not fit the scene's grid, no pixel sees the mask, the checkpoint
        is of another run (the error names what differs) or cannot be written
    TransportError : a radiance, a gradient or an extinction is not finite, or diverged
    DeviceError : the device failed or has not enough memory
    """
    device, prior, optimizer = device or choose_device(), prior or Prior(), optimizer or Optimizer()
    stages = stages_of(scene.grid, stages, optimizer)
    mask = np.ones(scene.grid.shape, bool) if mask is None else np.asarray(mask, bool)
    for name, array in (("mask", mask), ("truth", truth)):
        if array is not None and array.shape != scene.grid.shape:
            raise DataError(f"{name} has shape {array.shape}, the grid {scene.grid.shape}")
    if not mask.any():
        raise DataError("the mask is empty: no voxel may hold cloud; are images, views and surface right?")
    _check_start(scene, stages, optimizer)
    check_memory(scene, measurements, stages, device)
    if optimizer.type == "gauss-newton":
        for stage in stages:
            voxels = coarsened(mask, stage.grid)
            seen = seen_pixels(measurements.at_share(stage.pixels), scene.grid.with_shape(stage.grid), voxels)
            require_jacobian(len(seen.pixels), int(voxels.sum()))
    identity = identity_of(scene, measurements, stages, prior, optimizer, mask, truth, seed)
    run = _Run(scene, stages, mask, truth, seed, time_limit, callback, stop, identity, device.name)
    run.checkpoints = Checkpoints(checkpoint, checkpoint_interval)
    extinction = np.full(stages[0].grid, optimizer.start)
    error: np.ndarray | None = None
    first = 0
    if resume is not None:
        first = run.restore(resume if isinstance(resume, Checkpoint) else read_checkpoint(resume))
    for index in range(first, len(stages)):
        draws = uncertainty if index == len(stages) - 1 else 0
        extinction, error = run.descend(index, extinction, measurements, prior, optimizer, device, draws)
        if index + 1 < len(stages) and run.is_over:
            break
    error = None if error is None else run.on_finest_grid(error)
    extinction = run.on_finest_grid(extinction)
    return Reconstruction(scene.grid, extinction, mask, run.history, run.stage_ends, error, run.timed_out)


def _check_start(scene: Scene, stages: Sequence[Stage], optimizer: Optimizer) -> None:
    """DataError if the first render would be of something that light never leaves."""
    edge = max(max(scene.grid.with_shape(stage.grid).spacing) for stage in stages)
    for name in ("start", "floor"):
        value = getattr(optimizer, name)
        if not value * edge < _LARGEST_VOXEL_DEPTH:
            raise DataError(
                f"optimizer.{name} is {value:g} km^-1, an optical depth of {value * edge:.3g} across a voxel of "
                f"{edge:g} km: it must be below {_LARGEST_VOXEL_DEPTH / edge:.3g} km^-1"
            )


def check_memory(scene: Scene, measurements: Measurements, stages: Sequence[Stage], device: Device) -> None:
    """DataError or DeviceError if a stage would not fit into the memory of machine and device."""
    pixels = sum(image.size for image in measurements.images)
    # Stages that do not say have as many paths in an iteration, whatever their pixels.
    samples = max(stage.samples or -(-PATHS_PER_ITERATION // pixels) for stage in stages)
    require_reconstruction(device, scene.grid.shape, [stage.grid for stage in stages], pixels, samples)


def records(checkpoint: Checkpoint) -> list[IterationRecord]:
    """The history of a checkpoint. DataError if another version made it."""
    try:
        return [IterationRecord(**row) for row in checkpoint.history]
    except TypeError:
        raise DataError("the checkpoint was made by another version: go on with that, or start a new run") from None


class _Run:
    """What goes on from stage to stage."""

    def __init__(
        self,
        scene: Scene,
        stages: Sequence[Stage],
        mask: np.ndarray,
        truth: np.ndarray | None,
        seed: int,
        time_limit: float | None,
        callback: Callable[[IterationRecord], None] | None,
        stop: Callable[[], bool] | None,
        identity: dict[str, Any],
        device_name: str,
    ) -> None:
        self.scene = scene
        self.stages = stages
        self.mask = mask
        self.truth = truth
        self.seed = seed
        self.time_limit = time_limit
        self.callback = callback
        self.stop = stop
        self.identity = identity
        self.device_name = device_name
        self.checkpoints = Checkpoints(None, 0.0)
        self.resumed: Checkpoint | None = None
        self._stopped = False
        self.timed_out = False
        self.history: list[IterationRecord] = []
        self.stage_ends: list[float] = []
        self.photons = 0
        self.start = time.perf_counter()

    @property
    def seconds(self) -> float:
        return time.perf_counter() - self.start

    @property
    def is_over(self) -> bool:
        """Whether no iteration may follow. Asked only where one would."""
        self._stopped = self._stopped or (self.stop is not None and self.stop())
        last = self.history[-1].seconds - self.history[-2].seconds if len(self.history) > 1 else 0.0
        if self.time_limit is not None and self.seconds + last >= self.time_limit:
            self.timed_out = True
        return self._stopped or self.timed_out

    def restore(self, checkpoint: Checkpoint) -> int:
        """Goes on from a checkpoint; returns its stage."""
        checkpoint.check(self.identity)
        self.history = records(checkpoint)
        self.resumed = checkpoint
        self.stage_ends = list(checkpoint.stage_ends)
        self.photons = self.history[-1].photons if self.history else 0
        self.start = time.perf_counter() - checkpoint.seconds
        return checkpoint.stage

    def on_finest_grid(self, extinction: np.ndarray) -> np.ndarray:
        return resample_in_mask(extinction, self.mask).astype(np.float32)

    @device_errors("the reconstruction")
    def descend(
        self,
        index: int,
        extinction: np.ndarray,
        measurements: Measurements,
        prior: Prior,
        optimizer: Optimizer,
        device: Device,
        draws: int,
    ) -> tuple[np.ndarray, np.ndarray | None]:
        """One stage, from an extinction on any grid; returns that on the stage's own, and its standard error."""
        stage = self.stages[index]
        mask = coarsened(self.mask, stage.grid)
        scene = replace(self.scene, grid=self.scene.grid.with_shape(stage.grid))
        seen = seen_pixels(measurements.at_share(stage.pixels), scene.grid, mask)
        operator = RadianceOperator(scene, seen.views, device, seen.pixels, mask=mask)
        start = resample_in_mask(extinction, mask)
        method: Method = _METHODS[optimizer.type](optimizer, prior, stage, operator, seen, start, mask, self.seed)
        costs: list[float] = []
        errors: list[float] = []
        iteration = 0
        resumed, self.resumed = self.resumed, None
        if resumed is not None:
            method.restore(resumed.state)
            records = [record for record in self.history if record.stage == index]
            costs = [record.cost + record.prior for record in records]
            errors = [record.cost_standard_error for record in records]
            iteration = resumed.iterations

        def checkpoint() -> Checkpoint:
            return Checkpoint(
                identity=self.identity,
                device=self.device_name,
                stage=index,
                iterations=iteration,
                seconds=self.seconds,
                stage_ends=list(self.stage_ends),
                history=rows(self.history),
                state={**method.state(), "mask": self.mask},
            )

        while iteration < stage.iterations and not has_settled(costs, errors, stage.window):
            if self.history and self.is_over:
                break
            # Never the same random numbers twice in a run, nor those of a render, which has key 0.
            where = f"stage {index}, iteration {iteration} (seed {self.seed})"
            progress = method.iterate(len(self.history) + 1, where)
            self._check_step(index, iteration, method.extinction, scene.grid)
            self.photons += progress.photons
            costs.append(progress.cost + progress.prior)
            errors.append(progress.cost_standard_error)
            self._record(index, iteration, progress, method)
            iteration += 1
            self.checkpoints.take(len(self.history) == 1, index, iteration, checkpoint)
        self.checkpoints.take(True, index, iteration, checkpoint)
        self.stage_ends.append(self.seconds)
        _LOGGER.info("stage %d of %d ended after %.1f s", index + 1, len(self.stages), self.seconds)
        # Who asks to stop may not wait for it.
        wanted = draws > 0 and not (self.stop is not None and self.stop())
        return method.estimate(), method.standard_error(draws) if wanted else None

    def _check_step(self, index: int, iteration: int, extinction: np.ndarray, grid: Grid) -> None:
        """Stops a descent that runs away, before a render of it takes for ever."""
        depth = extinction * max(grid.spacing)
        wrong = ~(depth < _LARGEST_VOXEL_DEPTH)
        if wrong.any():
            voxel = tuple(int(i) for i in np.argwhere(wrong)[0])
            raise TransportError(
                f"the extinction diverged in stage {index}, iteration {iteration}: voxel {voxel} of the grid "
                f"{grid.shape} has the optical depth {depth[voxel]:.3g}; choose a smaller step of the optimizer"
            )

    def _record(self, index: int, iteration: int, progress: Progress, method: Method) -> None:
        stage = self.stages[index]
        if not np.isfinite(progress.cost + progress.prior):
            raise TransportError(f"the cost is not finite in stage {index}, iteration {iteration} (seed {self.seed})")
        errors: dict[str, float] = {}
        if self.truth is not None:
            estimate = self.on_finest_grid(method.estimate())
            errors = {"epsilon": epsilon(estimate, self.truth), "delta": delta(estimate, self.truth)}
        record = IterationRecord(
            stage=index,
            stages=len(self.stages),
            iteration=iteration,
            iterations=stage.iterations,
            seconds=self.seconds,
            photons=self.photons,
            cost=progress.cost,
            cost_standard_error=progress.cost_standard_error,
            prior=progress.prior,
            **errors,
        )
        self.history.append(record)
        if self.callback:
            self.callback(record)

