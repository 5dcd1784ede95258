"""The folder of a reconstruction: settings, history, result, figures.

files.json           names of the files here that runs have written: no others are ever removed or replaced
settings.json        all settings, versions of the packages, device, seed
history.csv          one line for each iteration, written as it goes
checkpoint.npz       what a resumed run goes on from
reconstruction.nc    extinction(z, y, x) in km^-1, its standard error and the mask, and what repeats the run:
                     images, views, settings
modelled.nc          images of the recovered cloud
report.html
figures/*.png, *.pdf
.lock                while a run is at work here (folder_lock.py)
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from cloudtomo_cl.commands.folder_lock import held
from cloudtomo_cl.commands.history_file import HistoryFile
from cloudtomo_cl.errors import DataError
from cloudtomo_cl.files.extinction import WRITTEN_AXES, read_extinction, write_extinction
from cloudtomo_cl.files.measurements import write_measurements
from cloudtomo_cl.files.netcdf import AXES, netcdf_errors
from cloudtomo_cl.files.whole import reason, remove_abandoned, written_whole
from cloudtomo_cl.inversion.checkpoint import Checkpoint, read_checkpoint
from cloudtomo_cl.inversion.records import MASK, STANDARD_ERROR, VARIABLES
from cloudtomo_cl.report.plots import FIGURES
from cloudtomo_cl.scene.grid import Grid
from cloudtomo_cl.scene.measurements import Measurements

if TYPE_CHECKING:
    from cloudtomo_cl.inversion.records import IterationRecord


class RunFolder:
    """Reads and writes the folder of one reconstruction.

    Nothing is written before the first iteration, so that a run which cannot start leaves no
    folder behind, and with `overwrite` an older run stays until then.

    Parameters
    ----------
    overwrite : whether a new run takes the place of an older one, and of other files with the names it needs
    """

    def __init__(self, path: str | Path, overwrite: bool = False) -> None:
        self.path = Path(path)
        self.overwrite = overwrite
        self.list_file = self.path / "files.json"
        self.settings_file = self.path / "settings.json"
        self.history_file = self.path / "history.csv"
        self.checkpoint_file = self.path / "checkpoint.npz"
        self.reconstruction_file = self.path / "reconstruction.nc"
        self.modelled_file = self.path / "modelled.nc"
        self.report_file = self.path / "report.html"
        self.figures = self.path / "figures"
        self._history = HistoryFile(self.history_file)
        self._settings: Mapping[str, Any] = {}
        self._before: Sequence[IterationRecord] | None = None
        self.started = False

    @property
    def outputs(self) -> tuple[Path, ...]:
        """All files that a run may write."""
        pictures = [self.figures / f"{name}.{suffix}" for name in FIGURES for suffix in ("png", "pdf")]
        return (*self._of_the_run, self.modelled_file, self.report_file, *pictures)

    @property
    def _of_the_run(self) -> tuple[Path, ...]:
        return self.settings_file, self.history_file, self.checkpoint_file, self.reconstruction_file

    def held(self) -> AbstractContextManager[None]:
        """Keeps other runs out of the folder while in this context; see `folder_lock.held`."""
        self._check_folder()
        return held(self.path)

    def check_new(self) -> None:
        """DataError if the folder holds a run already, or a file that one would replace, or is no folder."""
        self._check_folder()
        if self.overwrite:
            return
        if any(file.exists() for file in self._of_the_run):
            hint = ", or go on with it: --resume" if self.checkpoint_file.exists() else ""
            raise DataError(f"{self.path}: holds a run already: choose another folder, or add --overwrite{hint}")
        self._refuse([file for file in self.outputs if os.path.lexists(file)])

    def check_finished(self) -> None:
        """DataError if there is no result of a run here."""
        if not self.reconstruction_file.is_file():
            raise DataError(f"{self.path}: holds no {self.reconstruction_file.name}: no run was finished here")

    def check_own(self) -> None:
        """DataError if a file stands in a run's place that no run has written."""
        self._check_folder()
        self._refuse(self._foreign(self.outputs))

    def _refuse(self, foreign: Sequence[Path]) -> None:
        if foreign:
            raise DataError(f"{foreign[0]}: no run has written it, and it is not replaced: move it away")

    def _foreign(self, paths: Sequence[Path]) -> list[Path]:
        """Those that are there, and not ours."""
        listed = self._listed()
        return [path for path in paths if os.path.lexists(path) and path not in listed]

    def _listed(self) -> set[Path]:
        """What runs have written here. Earlier versions kept no list: what has our names beside a run is theirs."""
        if not self.list_file.exists():
            return set(self.outputs) if self.settings_file.exists() else set()
        try:
            names = json.loads(self.list_file.read_text(encoding="utf-8"))
        except (OSError, ValueError, RecursionError) as error:
            raise DataError(f"{self.list_file}: is no list of a run's files ({error})") from None
        # Whatever a list says, nothing but a run's files is touched.
        return {path for path in self.outputs if path.relative_to(self.path).as_posix() in names}

    def claim(self, *paths: Path) -> None:
        """Takes files to the list, before they are written.

        Raises
        ------
        DataError : one is there already that no run has written; the list cannot be written
        """
        if not self.overwrite:
            self._refuse(self._foreign(paths))
        listed = self._listed() if self.list_file.exists() else set()
        if self.list_file.exists() and listed.issuperset(paths):
            return
        names = sorted(path.relative_to(self.path).as_posix() for path in listed.union(paths))
        with written_whole(self.list_file) as partial:
            partial.write_text(json.dumps(names, indent=1) + "\n", encoding="utf-8")

    def _check_folder(self) -> None:
        if self.path.exists() and not self.path.is_dir():
            raise DataError(f"{self.path}: is a file: choose another folder")

    def read_checkpoint(self) -> Checkpoint | None:
        """What to go on from; None if no run was begun here, or none got as far as a checkpoint.

        Raises
        ------
        DataError : the checkpoint is damaged, or there is none beside the result of a run
        """
        self._check_folder()
        if self.checkpoint_file.exists():
            return read_checkpoint(self.checkpoint_file)
        if self.reconstruction_file.exists():
            raise DataError(f"{self.path}: holds the result of a run, but no checkpoint to go on from")
        return None

    def begin(self, settings: Mapping[str, Any], before: Sequence[IterationRecord] | None = None) -> None:
        """Takes the settings (types of JSON), to be written with the first iteration.

        before : the iterations up to the checkpoint that this run goes on from
        """
        self._settings = settings
        self._before = before
        self.started = False

    def append(self, record: IterationRecord) -> None:
        """One more iteration: a line of the history, on the disk at once."""
        with self._writing():
            if not self.started:
                self._start([field.name for field in fields(record)])
            self._history.append(record)

    @contextmanager
    def _writing(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            raise DataError(f"{self.path}: could not be written ({reason(error, self.path)})") from None

    def _start(self, names: list[str]) -> None:
        self.figures.mkdir(parents=True, exist_ok=True)
        # What a killed run was writing.
        for folder in (self.path, self.figures):
            remove_abandoned(folder)
        if self.overwrite:
            for file in self._listed().union(self._of_the_run) - {self.settings_file}:
                file.unlink(missing_ok=True)
        self.claim(*self._of_the_run)
        with written_whole(self.settings_file) as partial:
            partial.write_text(json.dumps(self._settings, indent=2) + "\n", encoding="utf-8")
        # A run may have been killed after its checkpoint: the history is that of the checkpoint.
        self._history.begin(names, self._before or ())
        self.started = True

    def close(self) -> None:
        """Closes the history."""
        self._history.close()

    def write_reconstruction(
        self,
        grid: Grid,
        extinction: np.ndarray,
        mask: np.ndarray,
        attributes: Mapping[str, Any],
        measurements: Measurements | None = None,
        settings: Mapping[str, Any] | None = None,
        standard_error: np.ndarray | None = None,
    ) -> None:
        """The result, with the measurements and settings that repeat it: whole, or not at all."""
        import netCDF4

        if self._before and not self.started:
            # Resumed where nothing was left to do.
            with self._writing():
                self._start([field.name for field in fields(self._before[0])])
            self.close()
        self.claim(self.reconstruction_file)
        with written_whole(self.reconstruction_file) as partial:
            if measurements is None:
                write_extinction(partial, grid, extinction, attributes)
            else:
                write_measurements(partial, measurements, attributes, settings, (grid, extinction, None))
            with netcdf_errors(), netCDF4.Dataset(partial, "a") as dataset:
                for name, kind, array in ((MASK, "i1", mask), (STANDARD_ERROR, "f4", standard_error)):
                    if array is not None:
                        variable = dataset.createVariable(name, kind, WRITTEN_AXES, zlib=True)
                        variable.units, variable.long_name = VARIABLES[name]
                        variable[:] = array.T
                if standard_error is not None:
                    dataset["extinction"].ancillary_variables = STANDARD_ERROR

    def read_reconstruction(self) -> tuple[Grid, np.ndarray, np.ndarray]:
        """Grid, extinction in km^-1, mask. DataError if the run has not come to its end."""
        import netCDF4

        self.check_finished()
        grid, extinction = read_extinction(self.reconstruction_file)
        try:
            with netCDF4.Dataset(self.reconstruction_file) as dataset:
                stored = dataset[MASK]
                mask = np.asarray(stored[:]).astype(bool).transpose([stored.dimensions.index(name) for name in AXES])
        except (OSError, RuntimeError, IndexError, ValueError, TypeError) as error:
            raise DataError(f"{self.reconstruction_file}: has no mask that can be read ({error})") from None
        if mask.shape != grid.shape:
            raise DataError(f"{self.reconstruction_file}: mask has shape {mask.shape}, the grid {grid.shape}")
        return grid, extinction, mask

    def read_history(self) -> dict[str, np.ndarray]:
        """A column for each field of an iteration; NaN where nothing is known."""
        return self._history.read()

    def read_settings(self) -> dict[str, Any]:
        """What `begin` took."""
        try:
            settings = json.loads(self.settings_file.read_text(encoding="utf-8"))
        except (OSError, ValueError, RecursionError) as error:
            raise DataError(f"{self.settings_file}: are no settings of a run ({error})") from None
        files = settings.get("files", {}) if isinstance(settings, dict) else None
        if not isinstance(files, dict) or not all(isinstance(name, str) for name in files.values()):
            raise DataError(f"{self.settings_file}: are no settings of a run (they must be a table, files among it)")
        return settings
