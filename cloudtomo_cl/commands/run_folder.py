"""The folder of a reconstruction: settings, history, result, figures (run_files.py)."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from cloudtomo_cl.commands.folder_lock import held
from cloudtomo_cl.commands.history_file import HistoryFile
from cloudtomo_cl.commands.run_files import RunFiles
from cloudtomo_cl.errors import DataError
from cloudtomo_cl.files.extinction import WRITTEN_AXES, read_extinction, write_extinction
from cloudtomo_cl.files.measurements import write_measurements
from cloudtomo_cl.files.netcdf import AXES, name_for_netcdf, netcdf_errors
from cloudtomo_cl.files.whole import reason, remove_abandoned, written_whole
from cloudtomo_cl.inversion.checkpoint import Checkpoint, read_checkpoint
from cloudtomo_cl.inversion.records import MASK, STANDARD_ERROR, VARIABLES
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
    path : of the folder
    overwrite : whether a new run takes the place of an older one, and of other files with the names it needs

    Attributes
    ----------
    files : where they are, and which of them runs have written
    history : a line for each iteration
    started : whether this run has written anything
    """

    def __init__(self, path: str | Path, overwrite: bool = False) -> None:
        self.overwrite = overwrite
        self.files = RunFiles(Path(path))
        self.history = HistoryFile(self.files.history)
        self._settings: Mapping[str, Any] = {}
        self._before: Sequence[IterationRecord] | None = None
        self.started = False

    @property
    def path(self) -> Path:
        """Of the folder."""
        return self.files.folder

    def held(self) -> AbstractContextManager[None]:
        """Keeps other runs out of the folder while in this context; see `folder_lock.held`."""
        self._check_folder()
        return held(self.path)

    def check_new(self, inputs: Iterable[Path] = ()) -> None:
        """DataError if the folder holds a run already, or a file that one would replace, or is no folder.

        inputs : files that the run reads, of which it may replace none
        """
        self._check_folder()
        self.files.require_apart(inputs)
        if self.overwrite:
            return
        if any(file.exists() for file in self.files.of_recovery):
            hint = ", or go on with it: --resume" if self.files.checkpoint.exists() else ""
            raise DataError(f"{self.path}: holds a run already: choose another folder, or add --overwrite{hint}")
        self.files.require_absent(self.files.outputs)

    def check_finished(self) -> None:
        """DataError if there is no result of a run here."""
        if not self.files.reconstruction.is_file():
            raise DataError(f"{self.path}: holds no {self.files.reconstruction.name}: no run was finished here")

    def check_own(self, inputs: Iterable[Path] = ()) -> None:
        """DataError if a file stands in a run's place that no run has written.

        inputs : as of `check_new`
        """
        self._check_folder()
        self.files.require_apart(inputs)
        self.files.require_own(self.files.outputs)

    def claim(self, *paths: Path) -> None:
        """Takes files to the list of those that runs have written, before they are.

        Raises
        ------
        DataError : one is there already that no run has written; the list cannot be written
        """
        if not self.overwrite:
            self.files.require_own(paths)
        self.files.claim(*paths)

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
        if self.files.checkpoint.exists():
            return read_checkpoint(self.files.checkpoint)
        if self.files.reconstruction.exists():
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
            self.history.append(record)

    @contextmanager
    def _writing(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            raise DataError(f"{self.path}: could not be written ({reason(error, self.path)})") from None

    def _start(self, names: list[str]) -> None:
        self.files.figures.mkdir(parents=True, exist_ok=True)
        # What a killed run was writing.
        for folder in (self.path, self.files.figures):
            remove_abandoned(folder)
        if self.overwrite:
            for file in self.files.own().union(self.files.of_recovery) - {self.files.settings}:
                file.unlink(missing_ok=True)
        self.claim(*self.files.of_recovery)
        with written_whole(self.files.settings) as partial:
            partial.write_text(json.dumps(self._settings, indent=2) + "\n", encoding="utf-8")
        # A run may have been killed after its checkpoint: the history is that of the checkpoint.
        self.history.begin(names, self._before or ())
        self.started = True

    def close(self) -> None:
        """Closes the history."""
        self.history.close()

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
        self.claim(self.files.reconstruction)
        with written_whole(self.files.reconstruction) as partial:
            if measurements is None:
                write_extinction(partial, grid, extinction, attributes)
            else:
                write_measurements(partial, measurements, attributes, settings, (grid, extinction, None))
            with netcdf_errors(), name_for_netcdf(partial) as name, netCDF4.Dataset(name, "a") as dataset:
                for variable_name, kind, array in ((MASK, "i1", mask), (STANDARD_ERROR, "f4", standard_error)):
                    if array is not None:
                        variable = dataset.createVariable(variable_name, kind, WRITTEN_AXES, zlib=True)
                        variable.units, variable.long_name = VARIABLES[variable_name]
                        variable[:] = array.T
                if standard_error is not None:
                    dataset["extinction"].ancillary_variables = STANDARD_ERROR

    def read_reconstruction(self) -> tuple[Grid, np.ndarray, np.ndarray]:
        """Grid, extinction in km^-1, mask. DataError if the run has not come to its end."""
        import netCDF4

        self.check_finished()
        grid, extinction = read_extinction(self.files.reconstruction)
        try:
            with name_for_netcdf(self.files.reconstruction) as name, netCDF4.Dataset(name) as dataset:
                stored = dataset[MASK]
                mask = np.asarray(stored[:]).astype(bool).transpose([stored.dimensions.index(axis) for axis in AXES])
        except (OSError, RuntimeError, IndexError, ValueError, TypeError) as error:
            raise DataError(f"{self.files.reconstruction}: has no mask that can be read ({error})") from None
        if mask.shape != grid.shape:
            raise DataError(f"{self.files.reconstruction}: mask has shape {mask.shape}, the grid {grid.shape}")
        return grid, extinction, mask

    def read_settings(self) -> dict[str, Any]:
        """What `begin` took."""
        try:
            settings = json.loads(self.files.settings.read_text(encoding="utf-8"))
        except (OSError, ValueError, RecursionError) as error:
            raise DataError(f"{self.files.settings}: are no settings of a run ({error})") from None
        files = settings.get("files", {}) if isinstance(settings, dict) else None
        if not isinstance(files, dict) or not all(isinstance(name, str) for name in files.values()):
            raise DataError(f"{self.files.settings}: are no settings of a run (they must be a table, files among it)")
        return settings
