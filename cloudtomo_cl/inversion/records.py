"""The records of a recovery's iterations, and its result."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from cloudtomo_cl.files.extinction import WRITTEN_AXES, extinction_dataset
from cloudtomo_cl.inversion.outliers import Outlier
from cloudtomo_cl.renamed import renamed_attributes
from cloudtomo_cl.scene.cards import card, table
from cloudtomo_cl.scene.grid import Grid
from cloudtomo_cl.scene.sensors import View


@renamed_attributes(photons="paths")
@dataclass(frozen=True)
class IterationRecord:
    """One iteration; a line of the history.

    Attributes
    ----------
    stage, iteration : numbers of stage and iteration, counted from 0
    stages, iterations : number of stages, and largest number of the stage's iterations
    seconds, paths : time, and number of paths, since the start of the run
    cost, cost_standard_error : data term over the stage's pixels, and its standard error, without unit
    prior : value of the prior times the stage's weight
    epsilon, delta : errors of the estimate on the finest grid (`scene.metrics`), if the truth is known
    expected_cost : mean cost of the true cloud, by the measured images' noise alone; None if the noise is not known
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
    expected_cost: float | None = None

    @property
    def is_fitted(self) -> bool:
        """Whether the images' noise nearly explains the cost; true, too, if the noise is not known."""
        if self.expected_cost is None:
            return True
        return self.cost - _SIGNIFICANCE * self.cost_standard_error <= _FITTED * self.expected_cost


# A history's columns: unit and meaning.
COLUMNS = {
    "stage": ("1", "which stage"),
    "stages": ("1", "of how many stages"),
    "iteration": ("1", "which iteration of the stage"),
    "iterations": ("1", "of at most how many iterations"),
    "seconds": ("s", "time since the start of the run, over all resumes"),
    "paths": ("1", "paths since the start of the run"),
    "cost": ("1", "data term over the stage's pixels"),
    "cost_standard_error": ("1", "standard error of the cost"),
    "prior": ("1", "value of the prior, times the stage's weight"),
    "epsilon": ("1", "sum of absolute errors over the sum of the true extinction"),
    "delta": ("1", "relative error of the sum of the extinction"),
    "expected_cost": ("1", "cost of the true cloud by noise of the measured images alone, on average"),
}
MASK, STANDARD_ERROR = "mask", "extinction_standard_error"
# Variables of a result besides its extinction, in files and datasets: unit and meaning.
VARIABLES = {
    MASK: ("1", "voxels that the recovery could fill: 1, others 0"),
    STANDARD_ERROR: ("km-1", "standard error of extinction, from noise and what the prior leaves open"),
}
# Noise explains a cost that is at most _FITTED times the expected one, or exceeds that by _SIGNIFICANCE standard errors
# or less.
_FITTED, _SIGNIFICANCE = 3.0, 2.0
# Number of lines of a history that are shown from its beginning, and from its end.
_SHOWN = 5


class History(list[IterationRecord]):
    """The records of a recovery: a list that is shown as a table, and gives its columns."""

    @property
    def columns(self) -> dict[str, np.ndarray]:
        """One array for each field of `IterationRecord`; NaN where nothing is known. For `pandas.DataFrame(...)`."""
        names = [field.name for field in fields(IterationRecord)]
        values = {name: [getattr(record, name) for record in self] for name in names}
        return {name: np.array([np.nan if one is None else one for one in column]) for name, column in values.items()}

    def _rows(self) -> list[list[str]]:
        rows = [
            [
                f"{record.stage + 1} of {record.stages}",
                str(record.iteration + 1),
                f"{record.seconds:.1f}",
                f"{record.paths:.3g}",
                f"{record.cost:.4g}",
                f"{record.cost_standard_error:.1g}",
                "" if record.expected_cost is None else f"{record.expected_cost:.3g}",
                "" if record.epsilon is None else f"{record.epsilon:.3f}",
                "" if record.delta is None else f"{record.delta:+.1%}",
            ]
            for record in self
        ]
        middle = [["..."] + [""] * (len(_COLUMNS) - 1)]
        return rows if len(rows) <= 2 * _SHOWN + 1 else rows[:_SHOWN] + middle + rows[-_SHOWN:]

    def __repr__(self) -> str:
        lines = [list(_COLUMNS), *self._rows()]
        widths = [max(map(len, column)) for column in zip(*lines)]
        return "\n".join("  ".join(cell.rjust(width) for cell, width in zip(line, widths)) for line in lines)

    def _repr_html_(self) -> str:
        return table(_COLUMNS, self._rows())


_COLUMNS = ("stage", "iteration", "time (s)", "paths", "cost", "± s.e.", "by noise", "eps", "delta")


@dataclass(frozen=True, eq=False)
class Reconstruction:
    """A recovered cloud.

    Attributes
    ----------
    grid : the scene's grid
    extinction : recovered extinction, km^-1, float32, shape of the grid
    mask : voxels in which extinction was sought, bool, shape of the grid
    history : one record per iteration; `history.columns` has them as arrays
    stage_ends : ends of the stages, seconds since the start of the run
    standard_error : standard error of the extinction, km^-1, float32, shape of the grid
        (docs/explanation/uncertainty.md says what it includes); None if it was not asked for, or is not known
    timed_out : whether the time limit ended the run
    no_standard_error : text that says why there is no standard error
    views : views of the measurements, moved where their pointing was uncertain
    outliers : pixels of the last stage's images that no cloud explains, the farthest first: they hardly counted
    """

    grid: Grid
    extinction: np.ndarray
    mask: np.ndarray
    history: History
    stage_ends: list[float]
    standard_error: np.ndarray | None = None
    timed_out: bool = False
    no_standard_error: str = ""
    views: tuple[View, ...] = ()
    outliers: tuple[Outlier, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "history", History(self.history))

    def to_dataset(self) -> Any:
        """An xarray Dataset: extinction(z, y, x), mask, standard error where known, and the history as history_*(step).

        Names, units, descriptions and coordinates are those of the files that the command line writes.
        """
        dataset = extinction_dataset(self.grid, self.extinction)
        arrays = {MASK: self.mask.astype(np.int8), STANDARD_ERROR: self.standard_error}
        for name, array in arrays.items():
            if array is not None:
                dataset[name] = (WRITTEN_AXES, array.T, _described(VARIABLES[name]))
        if self.standard_error is not None:
            dataset["extinction"].attrs["ancillary_variables"] = STANDARD_ERROR
        for name, column in self.history.columns.items():
            dataset[f"history_{name}"] = ("step", column, _described(COLUMNS[name]))
        return dataset

    def _repr_html_(self) -> str:
        facts = {"voxels": self.grid.text, "largest extinction": f"{self.extinction.max():.4g} km^-1"}
        if self.history:
            last = self.history[-1]
            facts["iterations"] = f"{len(self.history)} in {last.seconds:.0f} s"
            if not last.is_fitted:
                facts["images"] = "not fitted"
            if last.epsilon is not None:
                facts["error"] = f"eps {last.epsilon:.3f}"
        depths = self.extinction.sum(axis=2, dtype=float) * self.grid.spacing[2]
        return card("Reconstruction", facts, [("optical depth from above", depths.T[::-1])])

    def __repr__(self) -> str:
        text = f"{self.grid.text}, extinction up to {self.extinction.max():.4g} km^-1"
        if self.history:
            last = self.history[-1]
            text += f", {len(self.history)} iterations in {last.seconds:.0f} s"
            text += "" if last.is_fitted else ", images not fitted"
            text += "" if last.epsilon is None else f", eps {last.epsilon:.3f}"
        return f"Reconstruction({text})"


def _described(described: tuple[str, str]) -> dict[str, str]:
    """The attributes of a variable from its unit and meaning."""
    units, long_name = described
    return {"long_name": long_name, "units": units}
