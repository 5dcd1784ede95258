"""The recovery of a cloud's extinction: stochastic descent in coarse-to-fine stages."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from cloudtomo_cl.carving import coarsened, pixels_that_see
from cloudtomo_cl.device import Device, choose_device
from cloudtomo_cl.errors import DataError, TransportError
from cloudtomo_cl.grid import Grid, resample_in_mask
from cloudtomo_cl.measurements import Measurements
from cloudtomo_cl.metrics import delta, epsilon
from cloudtomo_cl.objective import LaggedResidual, relative_weights
from cloudtomo_cl.optimizer import Descent, Optimizer
from cloudtomo_cl.prior import Prior, PriorOperator
from cloudtomo_cl.scene import Scene
from cloudtomo_cl.stages import Stage, automatic_stages, has_settled
from cloudtomo_cl.transport import RadianceOperator

_PATHS_PER_ITERATION = 200_000
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
    """

    grid: Grid
    extinction: np.ndarray
    mask: np.ndarray
    history: list[IterationRecord]
    stage_ends: list[float]


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
) -> Reconstruction:
    """Recovers extinction from images.

    Parameters
    ----------
    scene : what is known: grid, optics, sun, air, surface, boundary
    measurements : images and views
    stages, prior, optimizer : by default `automatic_stages(scene.grid)`, `Prior()`, `Optimizer()`
    mask : bool on the scene's grid, where cloud may be (see `carving.carve`); all by default
    time_limit : seconds after which the run ends with what it has
    truth : extinction in km^-1 on the scene's grid, for the history's errors only
    callback : called after every iteration

    Raises
    ------
    DataError : an array does not fit the scene's grid, or no pixel sees the mask
    TransportError : a radiance or a gradient is not finite
    """
    device, prior, optimizer = device or choose_device(), prior or Prior(), optimizer or Optimizer()
    stages = tuple(stages or automatic_stages(scene.grid))
    mask = np.ones(scene.grid.shape, bool) if mask is None else np.asarray(mask, bool)
    for name, array in (("mask", mask), ("truth", truth)):
        if array is not None and array.shape != scene.grid.shape:
            raise DataError(f"{name} has shape {array.shape}, the grid {scene.grid.shape}")
    if not mask.any():
        raise DataError("the mask is empty: no voxel may hold cloud; are images, views and surface right?")
    run = _Run(scene, stages, mask, truth, seed, time_limit, callback)
    extinction = np.full(stages[0].grid, optimizer.start)
    for index in range(len(stages)):
        extinction = run.descend(index, extinction, measurements, prior, optimizer, device)
        if run.is_over:
            break
    return Reconstruction(scene.grid, run.on_finest_grid(extinction), mask, run.history, run.stage_ends)


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
    ) -> None:
        self.scene = scene
        self.stages = stages
        self.mask = mask
        self.truth = truth
        self.seed = seed
        self.time_limit = time_limit
        self.callback = callback
        self.history: list[IterationRecord] = []
        self.stage_ends: list[float] = []
        self.photons = 0
        self.start = time.perf_counter()

    @property
    def seconds(self) -> float:
        return time.perf_counter() - self.start

    @property
    def is_over(self) -> bool:
        return self.time_limit is not None and self.seconds >= self.time_limit

    def on_finest_grid(self, extinction: np.ndarray) -> np.ndarray:
        return resample_in_mask(extinction, self.mask).astype(np.float32)

    def descend(
        self,
        index: int,
        extinction: np.ndarray,
        measurements: Measurements,
        prior: Prior,
        optimizer: Optimizer,
        device: Device,
    ) -> np.ndarray:
        """One stage, from an extinction on any grid; returns that on the stage's own."""
        stage = self.stages[index]
        mask = coarsened(self.mask, stage.grid)
        scene = replace(self.scene, grid=self.scene.grid.with_shape(stage.grid))
        seen = _seen_pixels(measurements.at_share(stage.pixels), scene.grid, mask)
        operator = RadianceOperator(scene, seen.views, device, seen.pixels)
        samples = stage.samples or max(2, 2 * round(_PATHS_PER_ITERATION / len(seen.pixels) / 2))
        residual = LaggedResidual(seen.radiance, relative_weights(seen.radiance), optimizer.image_memory)
        prior_operator = PriorOperator(prior, stage.grid, device)
        descent = Descent(optimizer, resample_in_mask(extinction, mask), mask, device)
        costs: list[float] = []
        errors: list[float] = []
        for iteration in range(stage.iterations):
            # Never the same random numbers twice in a run, nor those of a render, which has key 0.
            key = len(self.history) + 1
            rendering = operator.render(descent.extinction, samples, self.seed, key, keep_paths=True)
            cost, error = residual.cost(rendering.halves)
            gradient = operator.gradient(rendering, residual.adjoint(rendering.halves))
            prior_value, prior_gradient = prior_operator.value_and_gradient(descent.extinction, stage.prior_weight)
            descent.step(gradient + prior_gradient)
            self._check_step(index, iteration, descent, scene.grid)
            self.photons += samples * len(seen.pixels)
            costs.append(cost + prior_value)
            errors.append(error)
            self._record(index, iteration, cost, error, prior_value, descent)
            if self.is_over or has_settled(costs, errors, stage.window):
                break
        self.stage_ends.append(self.seconds)
        return descent.estimate()

    def _check_step(self, index: int, iteration: int, descent: Descent, grid: Grid) -> None:
        """Stops a descent that runs away, before a render of it takes for ever."""
        depth = descent.largest() * max(grid.spacing)
        if not depth < _LARGEST_VOXEL_DEPTH:
            raise TransportError(
                f"the extinction diverged in stage {index}, iteration {iteration}: a voxel has the optical depth "
                f"{depth:.3g}; choose a smaller step of the optimizer"
            )

    def _record(
        self, index: int, iteration: int, cost: float, error: float, prior_value: float, descent: Descent
    ) -> None:
        stage = self.stages[index]
        if not np.isfinite(cost + prior_value):
            raise TransportError(f"the cost is not finite in stage {index}, iteration {iteration} (seed {self.seed})")
        errors: dict[str, float] = {}
        if self.truth is not None:
            estimate = self.on_finest_grid(descent.estimate())
            errors = {"epsilon": epsilon(estimate, self.truth), "delta": delta(estimate, self.truth)}
        record = IterationRecord(
            stage=index,
            stages=len(self.stages),
            iteration=iteration,
            iterations=stage.iterations,
            seconds=self.seconds,
            photons=self.photons,
            cost=cost,
            cost_standard_error=error,
            prior=prior_value,
            **errors,
        )
        self.history.append(record)
        if self.callback:
            self.callback(record)


@dataclass(frozen=True)
class _SeenPixels:
    """The pixels of a stage: (view, row * width + column), and what was measured there."""

    views: tuple
    pixels: np.ndarray
    radiance: np.ndarray


def _seen_pixels(measurements: Measurements, grid: Grid, mask: np.ndarray) -> _SeenPixels:
    """Pixels that look at voxels of the mask; the others teach little and cost as much."""
    pixels, radiance = [], []
    for index, (view, image) in enumerate(zip(measurements.views, measurements.images)):
        chosen = np.flatnonzero(pixels_that_see(view, grid, mask))
        pixels.append(np.column_stack([np.full(len(chosen), index), chosen]))
        radiance.append(image.ravel()[chosen])
    if not any(map(len, radiance)):
        raise DataError("no pixel of any view looks at the mask: check the views' positions and targets")
    return _SeenPixels(measurements.views, np.concatenate(pixels).astype(np.uint32), np.concatenate(radiance))
