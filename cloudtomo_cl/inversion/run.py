"""A run of a recovery: its state, the watchers called after every iteration, and the rules that end it."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np

from cloudtomo_cl.errors import DataError, TransportError
from cloudtomo_cl.inversion.checkpoint import Checkpoint, Checkpoints, rows
from cloudtomo_cl.inversion.problem import Problem
from cloudtomo_cl.inversion.records import IterationRecord
from cloudtomo_cl.inversion.solvers.protocol import Progress
from cloudtomo_cl.inversion.solvers.state import arrays_of
from cloudtomo_cl.inversion.stages import Stage, has_settled
from cloudtomo_cl.parallel.ranks import ALONE, Ranks
from cloudtomo_cl.scene.grid import resample_in_mask
from cloudtomo_cl.scene.metrics import delta, epsilon

# Optical depth across a voxel's longest edge, larger than any cloud's, at which a solver has diverged. (The limit of
# transport/medium.py is far larger, and across the shortest edge: it finds wrong units.)
DIVERGED_DEPTH = 1000.0


@dataclass(eq=False)
class Run:
    """The state of a run that goes on from stage to stage.

    Attributes
    ----------
    stages : all stages
    mask : voxels that may hold cloud, bool, on the finest grid
    stage : number of the present stage, counted from 0
    iteration : number of iterations done in it
    history, stage_ends : as in `Reconstruction`
    start : time of `time.perf_counter` at the start of the run, s; pauses before resumes are taken out
    """

    stages: Sequence[Stage]
    mask: np.ndarray
    stage: int = 0
    iteration: int = 0
    history: list[IterationRecord] = field(default_factory=list)
    stage_ends: list[float] = field(default_factory=list)
    start: float = field(default_factory=time.perf_counter)

    @classmethod
    def resumed(cls, stages: Sequence[Stage], mask: np.ndarray, checkpoint: Checkpoint) -> Run:
        """The run as a checkpoint has it."""
        return cls(
            stages,
            mask,
            checkpoint.stage,
            checkpoint.iterations,
            records(checkpoint),
            list(checkpoint.stage_ends),
            time.perf_counter() - checkpoint.seconds,
        )

    @property
    def seconds(self) -> float:
        """Time since the start, s, without the pauses before resumes."""
        return time.perf_counter() - self.start

    @property
    def paths(self) -> int:
        """Number of paths of all iterations so far."""
        return self.history[-1].paths if self.history else 0

    def on_finest_grid(self, extinction: np.ndarray) -> np.ndarray:
        """An extinction on any grid of the domain, on the finest one, float32; 0 outside of the mask."""
        return resample_in_mask(extinction, self.mask).astype(np.float32)


class Watcher(Protocol):
    """A function called after every iteration. `KeepHistory` counts the iteration in `run`: later watchers see that."""

    def __call__(self, run: Run, problem: Problem, state: Any, progress: Progress) -> None: ...


class StoppingRule(Protocol):
    """A function that says whether the run ends here. It is asked only where another iteration would follow."""

    def __call__(self, run: Run) -> bool: ...


def require_same(run: Run, problem: Problem, state: Any, progress: Progress) -> None:
    """Raises TransportError if ranks' results differ in any bit: they would soon wait for each other for ever."""
    problem.operator.ranks.require_same(np.asarray(state.extinction), "the extinction")


def guard_divergence(run: Run, problem: Problem, state: Any, progress: Progress, solver: Any = None) -> None:
    """Stops a solver that has diverged, before rendering its result takes for ever.

    solver : solver, for advice on its settings in the error

    Raises
    ------
    TransportError : a voxel of the next extinction is deeper than any cloud's, or the cost is not finite
    """
    depth = np.asarray(state.extinction) * max(problem.grid.spacing)
    wrong = np.flatnonzero(~(depth < DIVERGED_DEPTH))
    where = f"in stage {run.stage}, iteration {run.iteration}"
    if len(wrong):
        voxel = tuple(int(i) for i in np.argwhere(problem.mask)[wrong[0]])
        raise TransportError(
            f"the extinction diverged {where}: voxel {voxel} of the grid {problem.grid.shape} has the optical depth "
            f"{depth[wrong[0]]:.3g}; {_advice(solver)}"
        )
    if not np.isfinite(progress.cost + progress.prior):
        raise TransportError(f"the cost is not finite {where}")


def _advice(solver: Any) -> str:
    """Advice about a solver that diverges, by the settings that it has."""
    if hasattr(solver, "step_size"):
        return "choose a smaller step_size of the solver"
    if hasattr(solver, "damping"):
        return "choose a larger damping of the solver or a stronger prior; are sun, views and images right?"
    return "let the solver take shorter steps"


@dataclass(frozen=True, eq=False)
class KeepHistory:
    """Adds a record to the history, with the errors if the truth is known, and calls the user's callback.

    Attributes
    ----------
    truth : true extinction, km^-1, on the finest grid, if it is known
    callback : function that the first rank calls with each record
    """

    truth: np.ndarray | None = None
    callback: Callable[[IterationRecord], None] | None = None

    def __call__(self, run: Run, problem: Problem, state: Any, progress: Progress) -> None:
        errors: dict[str, float] = {}
        if self.truth is not None:
            estimate = run.on_finest_grid(problem.on_grid(state.estimate))
            errors = {"epsilon": epsilon(estimate, self.truth), "delta": delta(estimate, self.truth)}
        record = IterationRecord(
            stage=run.stage,
            stages=len(run.stages),
            iteration=run.iteration,
            iterations=run.stages[run.stage].iterations,
            seconds=problem.operator.ranks.first(run.seconds),
            paths=run.paths + progress.paths,
            cost=progress.cost,
            cost_standard_error=progress.cost_standard_error,
            prior=progress.prior,
            expected_cost=problem.active.expected_cost,
            **errors,
        )
        run.history.append(record)
        run.iteration += 1
        problem.operator.ranks.together(lambda: self._tell(record, problem))

    def _tell(self, record: IterationRecord, problem: Problem) -> None:
        if self.callback and problem.operator.ranks.is_first:
            self.callback(record)


@dataclass(frozen=True)
class KeepCheckpoints:
    """Takes checkpoints after the first iteration, and whenever the interval is over; `now` at the end of a stage."""

    checkpoints: Checkpoints
    identity: dict[str, Any]
    device_name: str

    def __call__(self, run: Run, problem: Problem, state: Any, progress: Progress) -> None:
        self.take(len(run.history) == 1, run, state)

    def take(self, now: bool, run: Run, state: Any) -> None:
        """Takes a checkpoint if it is due, or `now` is true."""

        def checkpoint() -> Checkpoint:
            return Checkpoint(
                identity=self.identity,
                device=self.device_name,
                stage=run.stage,
                iterations=run.iteration,
                seconds=run.seconds,
                stage_ends=list(run.stage_ends),
                history=rows(run.history),
                state={**arrays_of(state), "mask": run.mask},
            )

        self.checkpoints.take(now, run.stage, run.iteration, checkpoint)


@dataclass
class TimeLimit:
    """Ends a run before an iteration that would end after the limit, if it is as long as the last one.

    Attributes
    ----------
    seconds : largest time of the run, s, over all resumes; None: no limit
    reached : whether the limit has ended the run
    """

    seconds: float | None
    ranks: Ranks = ALONE
    reached: bool = False

    def __call__(self, run: Run) -> bool:
        times = [record.seconds for record in run.history[-2:]]
        last = times[1] - times[0] if len(times) > 1 else 0.0
        if self.seconds is not None and self.ranks.first(run.seconds + last >= self.seconds):
            self.reached = True
        return self.reached


@dataclass
class StopRequested:
    """Ends a run when `asked` returns true on any rank; after that the answer stays true."""

    asked: Callable[[], bool] | None
    ranks: Ranks = ALONE
    stopped: bool = False

    def __call__(self, run: Run) -> bool:
        self.stopped = self.stopped or self.ranks.any(self.asked is not None and self.asked())
        return self.stopped


def settled(run: Run) -> bool:
    """Whether the stage's cost has stopped falling (`has_settled`)."""
    here = [record for record in run.history if record.stage == run.stage]
    costs = [record.cost + record.prior for record in here]
    return has_settled(costs, [record.cost_standard_error for record in here], run.stages[run.stage].window)


def records(checkpoint: Checkpoint) -> list[IterationRecord]:
    """The history of a checkpoint. Raises DataError if another version made it."""
    try:
        return [IterationRecord(**row) for row in checkpoint.history]
    except TypeError:
        raise DataError("the checkpoint was made by another version: go on with that, or start a new run") from None
