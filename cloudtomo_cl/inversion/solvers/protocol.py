"""What a solver is: two functions of a problem and of a state of the iterations."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from cloudtomo_cl.arguments import a, able, require_kinds
from cloudtomo_cl.errors import TransportError
from cloudtomo_cl.inversion.problem import Problem


@dataclass(frozen=True)
class Progress:
    """Results of an iteration: the data term at its start, its standard error, the prior, and the number of paths."""

    cost: float
    cost_standard_error: float
    prior: float
    paths: int


class State(Protocol):
    """The state of iterations: a frozen dataclass whose fields are kept in checkpoints (`state.py`)."""

    @property
    def extinction(self) -> np.ndarray:
        """The extinction that the next iteration renders, km^-1, shape (voxels,)."""
        ...

    @property
    def estimate(self) -> np.ndarray:
        """The extinction to report, km^-1, shape (voxels,): often a mean over the last iterations."""
        ...


class Solver(Protocol):
    """How a stage's iterations find the extinction.

    An optional method `standard_error(problem, state, draws, seed)` gives the standard error of the estimate, km^-1,
    shape (voxels,), or None if it is not known. An optional method `outliers(problem, state)` gives the pixels that
    hardly counted (`outliers.Outlier`).
    """

    def init(self, problem: Problem, extinction: np.ndarray) -> Any:
        """The state before the first iteration of a stage, from an extinction in km^-1, shape (voxels,)."""
        ...

    def step(self, problem: Problem, state: Any, *, seed: int, stream: int) -> tuple[Any, Progress]:
        """The state after one more iteration, whose random numbers are those of (seed, stream).

        A state may be used for one step only: arrays too large to be copied are passed on to the next state.
        """
        ...


# What `solver` may be in functions' arguments.
SOLVER = able("a solver, for instance GaussNewton() or Adam(), or an object with init and step", "init", "step")


def start_of(solver: Any, problem: Problem, extinction: np.ndarray) -> np.ndarray:
    """The extinction that a solver starts a problem from, checked: km^-1, shape (voxels,), double precision.

    Raises
    ------
    DataError : extinction of another shape; an argument of `init` is of another kind (InvalidArgumentError)
    """
    require_kinds(f"{type(solver).__name__}.init", problem=(problem, a(Problem)))
    return problem.checked(extinction, "extinction")


def check_gradient(gradient: np.ndarray, problem: Problem, stream: int) -> None:
    """Raises TransportError if a gradient, shape (voxels,), is not finite: bounds would silently clear the voxel."""
    wrong = np.flatnonzero(~np.isfinite(gradient))
    if len(wrong):
        voxel = tuple(int(i) for i in np.argwhere(problem.mask)[wrong[0]])
        raise TransportError(
            f"the gradient is not finite at voxel {voxel} of the grid {problem.grid.shape} (stream {stream}): "
            "the device or its driver is at fault, or the optics are extreme; try another device"
        )
