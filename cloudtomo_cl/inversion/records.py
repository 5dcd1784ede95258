"""What a recovery tells of its iterations, and what it ends with."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cloudtomo_cl.renamed import renamed_attributes
from cloudtomo_cl.scene.grid import Grid


@renamed_attributes(photons="paths")
@dataclass(frozen=True)
class IterationRecord:
    """What one iteration did; a line of the history.

    Attributes
    ----------
    stage, iteration : counted from 0; `stages` and `iterations` (at most) say of how many
    seconds, paths : since the start of the run
    cost, cost_standard_error : data term over the stage's pixels, without dimension
    prior : its value times the stage's weight
    epsilon, delta : of the estimate on the finest grid, if the truth is known
    """

    stage: int
    stages: int
    iteration: int
    iterations: int
    seconds: float
    paths: int
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
    standard_error : of the extinction, km^-1, float32, shape of the grid (docs/explanation/uncertainty.md says of
        what); none if it was not asked for, or is not known
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
