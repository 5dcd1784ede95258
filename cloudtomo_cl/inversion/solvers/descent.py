"""Stochastic gradient descent on the misfit of images and the prior: Adam, and plain steps (SGD)."""

from __future__ import annotations

from dataclasses import dataclass as plain_dataclass
from dataclasses import replace
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import ConfigDict, Field
from pydantic.dataclasses import dataclass

from cloudtomo_cl.arguments import a, require_kinds
from cloudtomo_cl.blas import with_one_blas_thread
from cloudtomo_cl.inversion.objective import AveragedImage
from cloudtomo_cl.inversion.problem import Problem
from cloudtomo_cl.inversion.solvers.protocol import Progress, check_gradient, start_of
from cloudtomo_cl.inversion.solvers.state import not_saved
from cloudtomo_cl.messages import answering
from cloudtomo_cl.opencl.device import Device
from cloudtomo_cl.opencl.driver import device_errors
from cloudtomo_cl.opencl.memory import Footprint
from cloudtomo_cl.scene.grid import Count
from cloudtomo_cl.scene.scene import NotNegative, Positive
from cloudtomo_cl.transport.radiance_table import table_footprint, table_growth
from cloudtomo_cl.transport.rendering import Rendering
from cloudtomo_cl.transport.table_gradient import TableGradient

PATHS_PER_ITERATION = 60_000
Decay = Annotated[float, Field(ge=0, lt=1)]


@plain_dataclass(frozen=True, eq=False)
class DescentState:
    """The state of a descent. Arrays are float32, shape (voxels,).

    Attributes
    ----------
    extinction : extinction of the mask's voxels, km^-1
    before : extinction before the last step, km^-1
    estimate : running mean of the extinction, km^-1
    first_moment, second_moment : running means of the gradient and of its square, used by Adam alone
    steps : number of steps done so far
    image : modelled image, averaged over iterations
    by_table : gradients by the radiance table, which carry nothing from step to step; None with replay
    """

    extinction: np.ndarray
    before: np.ndarray
    estimate: np.ndarray
    first_moment: np.ndarray
    second_moment: np.ndarray
    steps: int
    image: AveragedImage
    by_table: TableGradient | None = not_saved(default=None)


@answering
@dataclass(frozen=True, config=ConfigDict(extra="forbid"))
class _Descent:
    """The settings and steps that both descents share.

    Attributes
    ----------
    iterations : largest number of iterations on the finest of the automatic stages; by default 600. A run that has done
        them goes on with more by `--resume`, unless its cost has settled
    start : extinction inside the mask before the first stage, km^-1
    floor : least extinction inside the mask, km^-1. Gradients do not need it, but a descent in the square root cannot
        leave 0
    gradient : "adjoint", by the radiance that all paths together find in a voxel (little noise, no 1 / extinction),
        or "replay", by each path alone (without bias)
    parametrisation : descend in the "extinction" (km^-1), or in its "square-root" (km^-1/2), in which thin voxels
        take smaller steps
    step_size : length of a step in the parametrisation (Adam); factor of the gradient (SGD)
    step_half_life : iterations of a stage after which the step is half of what it began with
        (step_size / (1 + iteration / step_half_life)); none: constant
    iterate_average_window : approximate number of iterations in the running mean of the extinction, the estimate
    image_average_window : number of iterations over which modelled images are averaged for the residual; 1: each half
        of an iteration's paths is used with the other half's residual. With gradient "adjoint" the images are carried
        along with the extinction; with "replay" they lag behind, and 20 is better
    """

    iterations: Count | None = None
    start: Positive = 2.0
    floor: NotNegative = 0.01
    gradient: Literal["adjoint", "replay"] = "adjoint"
    parametrisation: Literal["extinction", "square-root"] = "square-root"
    step_size: Positive = 0.3
    step_half_life: Positive | None = 100.0
    iterate_average_window: Count = 20
    image_average_window: Count = 100

    def stage_limits(self, last: bool) -> tuple[int, int]:
        """Largest number of iterations, and window, of an automatic stage.

        The last stage has to find details, which change the cost little: it does not end early.
        """
        return (self.iterations or 600, 200) if last else (100, 20)

    def footprint(self, pixels: int, voxels: int, longest: int, entries: int) -> Footprint:
        """Memory of the step's arrays and the radiance table."""
        arrays = Footprint(20 * voxels, 4 * voxels, 24 * voxels)
        return arrays + table_footprint(voxels) if self.gradient == "adjoint" else arrays

    def deep_growth(self, voxels: int) -> Footprint:
        """Memory beyond the footprint, at most, if the voxels are optically deep."""
        return table_growth(voxels) if self.gradient == "adjoint" else Footprint()

    def init(self, problem: Problem, extinction: np.ndarray) -> DescentState:
        """The state before the first iteration; see `Solver`."""
        start = np.maximum(start_of(self, problem, extinction), np.float32(self.floor), dtype=np.float32)
        nothing = np.zeros_like(start)
        image = AveragedImage.empty(len(problem.active))
        by_table = TableGradient(problem.operator) if self.gradient == "adjoint" else None
        return DescentState(start, start, start, nothing, nothing, 0, image, by_table)

    @with_one_blas_thread
    def step(self, problem: Problem, state: DescentState, *, seed: int, stream: int) -> tuple[DescentState, Progress]:
        """One iteration; see `Solver`.

        Raises
        ------
        TransportError : the gradient is not finite
        """
        require_kinds("step", problem=(problem, a(Problem)), state=(state, a(DescentState)))
        samples = problem.samples
        if samples is None:
            samples = max(2, 2 * round(PATHS_PER_ITERATION / len(problem.active) / 2))
        values = problem.on_grid(state.extinction)
        rendering = problem.operator.render(values, samples, seed, stream, store_paths=True)
        window = self.image_average_window
        data = (rendering.halves, problem.radiance, problem.weights, problem.active.calibration, window)
        cost, error = state.image.cost(*data)
        gradient, change = self._gradient(problem, state, rendering, state.image.adjoint(*data))
        image = state.image.with_halves(rendering.halves, window)
        if change is not None:
            image = image.moved(change, window)
        # Iteration 0 always: later in a stage the patch prior is sharper, too stiff for steps along a gradient.
        prior, prior_gradient = problem.prior.frozen(state.extinction, 0).value_and_gradient(
            state.extinction, problem.units(image.noise(problem.weights))
        )
        gradient = gradient + prior_gradient.astype(np.float32)
        check_gradient(gradient, problem, stream)
        state = self.moved(replace(state, image=image), gradient, problem.operator.device)
        return state, Progress(cost, error, prior, samples * len(problem.active))

    def _gradient(
        self, problem: Problem, state: DescentState, rendering: Rendering, adjoint: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray | None]:
        """The data term's gradient, and the change of radiances by the last step; None with replay."""
        if state.by_table is None:
            return problem.operator.gradient(rendering, adjoint).get()[problem.mask], None
        change = problem.operator.device.array(problem.on_grid(state.extinction - state.before))
        gradient, tangent = state.by_table.gradient(rendering, adjoint, change)
        return gradient.get()[problem.mask], tangent

    @device_errors("the descent's step")
    def moved(self, state: DescentState, gradient: np.ndarray, device: Device) -> DescentState:
        """The state after a step against a gradient, cost per km^-1, shape (voxels,)."""
        length = self.step_length(state.steps)
        steps = state.steps + 1
        arrays = [
            device.array(np.asarray(array, np.float32))
            for array in (state.extinction, gradient, state.first_moment, state.second_moment)
        ]
        extinction, slope, *moments = arrays
        everywhere = device.array(np.ones(gradient.size, np.uint8))
        device.launch(
            device.kernel("optimizer", self._kernel),
            gradient.size,
            gradient.size,
            extinction,
            everywhere,
            slope,
            length,
            self.parametrisation == "square-root",
            self.floor,
            *self._of_moments(moments, steps),
        )
        moved = extinction.get()
        rate = np.float32(1 / min(steps, self.iterate_average_window))
        return replace(
            state,
            extinction=moved,
            before=state.extinction,
            estimate=state.estimate + (moved - state.estimate) * rate,
            first_moment=moments[0].get(),
            second_moment=moments[1].get(),
            steps=steps,
        )

    def step_length(self, steps: int) -> float:
        """The length of the step that follows `steps` others."""
        return self.step_size / (1 + steps / self.step_half_life) if self.step_half_life else self.step_size

    @property
    def _kernel(self) -> str:
        raise NotImplementedError

    def _of_moments(self, moments: list[Any], steps: int) -> tuple[Any, ...]:
        return ()


@answering
@dataclass(frozen=True, config=ConfigDict(extra="forbid"))
class Adam(_Descent):
    """Descends by Adam (Kingma and Ba 2015).

    Attributes
    ----------
    beta1, beta2 : decay rates of the gradient's first and second moment
    """

    type: Literal["adam"] = "adam"
    beta1: Decay = 0.9
    beta2: Decay = 0.999

    @property
    def _kernel(self) -> str:
        return "adam_step"

    def _of_moments(self, moments: list[Any], steps: int) -> tuple[Any, ...]:
        betas = (self.beta1, self.beta2)
        corrections = (1 / (1 - beta**steps) for beta in betas)
        return (*moments, *betas, *corrections)


@answering
@dataclass(frozen=True, config=ConfigDict(extra="forbid"))
class SGD(_Descent):
    """Descends by plain steps against the gradient."""

    type: Literal["sgd"] = "sgd"

    @property
    def _kernel(self) -> str:
        return "sgd_step"
