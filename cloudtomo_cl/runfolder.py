"""The folder of a reconstruction: settings, history, result, figures.

    settings.json        all settings, versions of the packages, device, seed
    history.csv          one line for each iteration, written as it goes
    reconstruction.nc    extinction(x, y, z) in km^-1 and the mask
    figures/*.png
"""

from __future__ import annotations

import csv
import json
import os
from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, TextIO

import numpy as np

from cloudtomo_cl.errors import DataError
from cloudtomo_cl.grid import Grid
from cloudtomo_cl.io import read_extinction, write_extinction

if TYPE_CHECKING:
    from cloudtomo_cl.inversion import IterationRecord



class RunFolder:
    """Reads and writes the folder of one reconstruction.

    Nothing is written before the first iteration, so that a run which cannot start leaves no
    folder behind, and with `overwrite` an older run stays until then.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self.settings_file = self.path / "settings.json"
        self.history_file = self.path / "history.csv"
        self.reconstruction_file = self.path / "reconstruction.nc"
        self.figures = self.path / "figures"
        self._history: TextIO | None = None
        self._settings: Mapping[str, Any] = {}

    def check_new(self, overwrite: bool = False) -> None:
        """DataError if the folder holds a run already, or is no folder."""
        if self.path.exists() and not self.path.is_dir():
            raise DataError(f"{self.path}: is a file: choose another folder")
        files = (self.settings_file, self.history_file, self.reconstruction_file)
        if not overwrite and any(file.exists() for file in files):
            raise DataError(f"{self.path}: holds a run already: choose another folder, or add --overwrite")

    def begin(self, settings: Mapping[str, Any]) -> None:
        """Takes the settings (types of JSON), to be written with the first iteration."""
        self._settings = settings

    def append(self, record: IterationRecord) -> None:
        """One more iteration: a line of the history, on the disk at once."""
        names = [field.name for field in fields(record)]
        if self._history is None:
            self._start(names)
        assert self._history is not None
        values = (getattr(record, name) for name in names)
        csv.writer(self._history).writerow("" if value is None else value for value in values)
        self._history.flush()

    def _start(self, names: list[str]) -> None:
        try:
            self.figures.mkdir(parents=True, exist_ok=True)
            for stale in (self.reconstruction_file, *self.figures.glob("*.png")):
                stale.unlink(missing_ok=True)
            self.settings_file.write_text(json.dumps(self._settings, indent=2) + "\n", encoding="utf-8")
            self._history = open(self.history_file, "w", newline="", encoding="utf-8")
        except OSError as error:
            raise DataError(f"{self.path}: cannot be written ({error.strerror})") from None
        csv.writer(self._history).writerow(names)

    def close(self) -> None:
        """Closes the history."""
        if self._history is not None:
            self._history.close()
            self._history = None

    def write_reconstruction(
        self, grid: Grid, extinction: np.ndarray, mask: np.ndarray, attributes: Mapping[str, Any]
    ) -> None:
        """The result: whole, or not at all."""
        import netCDF4

        partial = self.path / f".{self.reconstruction_file.name}.partial"
        try:
            write_extinction(partial, grid, extinction, attributes)
            with netCDF4.Dataset(partial, "a") as dataset:
                variable = dataset.createVariable("mask", "i1", ("x", "y", "z"), zlib=True)
                variable.long_name = "voxels that the recovery could fill: 1, others 0"
                variable[:] = mask
            os.replace(partial, self.reconstruction_file)
        finally:
            partial.unlink(missing_ok=True)

    def read_reconstruction(self) -> tuple[Grid, np.ndarray, np.ndarray]:
        """Grid, extinction in km^-1, mask. DataError if the run has not come to its end."""
        import netCDF4

        if not self.reconstruction_file.is_file():
            raise DataError(f"{self.path}: holds no {self.reconstruction_file.name}: no run was finished here")
        grid, extinction = read_extinction(self.reconstruction_file)
        with netCDF4.Dataset(self.reconstruction_file) as dataset:
            mask = np.asarray(dataset["mask"][:]).astype(bool)
        return grid, extinction, mask

    def read_history(self) -> dict[str, np.ndarray]:
        """A column for each field of an iteration; NaN where nothing is known."""
        try:
            with open(self.history_file, newline="", encoding="utf-8") as file:
                names, *lines = csv.reader(file)
            table = np.array([[float(value or "nan") for value in line] for line in lines])
            return dict(zip(names, table.reshape(-1, len(names)).T))
        except (OSError, ValueError) as error:
            raise DataError(f"{self.history_file}: is no history of a run ({error})") from None

    def read_settings(self) -> dict[str, Any]:
        """What `begin` took."""
        try:
            return json.loads(self.settings_file.read_text(encoding="utf-8"))
        except (OSError, ValueError) as error:
            raise DataError(f"{self.settings_file}: are no settings of a run ({error})") from None
