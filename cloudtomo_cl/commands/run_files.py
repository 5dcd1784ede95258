"""The files of a reconstruction's folder.

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
from collections.abc import Iterable, Sequence
from pathlib import Path

from cloudtomo_cl.errors import DataError
from cloudtomo_cl.files.whole import check_apart, written_whole
from cloudtomo_cl.report.plots import FIGURES


class RunFiles:
    """Where a run's files are, and which of those that are there runs have written.

    Parameters
    ----------
    folder : of the run

    Attributes
    ----------
    folder : as given
    list_file : of the names of all that runs have written
    settings, history, checkpoint, reconstruction : what a recovery writes
    modelled, report : what is made of its result
    figures : the folder of pictures
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.list_file = folder / "files.json"
        self.settings = folder / "settings.json"
        self.history = folder / "history.csv"
        self.checkpoint = folder / "checkpoint.npz"
        self.reconstruction = folder / "reconstruction.nc"
        self.modelled = folder / "modelled.nc"
        self.report = folder / "report.html"
        self.figures = folder / "figures"

    @property
    def of_recovery(self) -> tuple[Path, ...]:
        """Those that a recovery itself writes."""
        return self.settings, self.history, self.checkpoint, self.reconstruction

    @property
    def outputs(self) -> tuple[Path, ...]:
        """All that a run may write."""
        return (*self.of_recovery, self.modelled, self.report, *self.pictures(FIGURES))

    def pictures(self, figures: Iterable[str]) -> list[Path]:
        """Those of some figures."""
        return [self.figures / f"{name}.{suffix}" for name in figures for suffix in ("png", "pdf")]

    def own(self) -> set[Path]:
        """What runs have written here. Earlier versions kept no list: what has our names beside a run is theirs.

        Raises
        ------
        DataError : the list is damaged
        """
        if not self.list_file.exists():
            return set(self.outputs) if self.settings.exists() else set()
        try:
            names = json.loads(self.list_file.read_text(encoding="utf-8"))
        except (OSError, ValueError, RecursionError) as error:
            raise DataError(f"{self.list_file}: is no list of a run's files ({error})") from None
        # Whatever a list says, nothing but a run's files is touched.
        return {path for path in self.outputs if path.relative_to(self.folder).as_posix() in names}

    def require_own(self, paths: Sequence[Path]) -> None:
        """DataError if one is there that no run has written, or the list of these is damaged."""
        own = self.own()
        self.require_absent([path for path in paths if path not in own])

    def require_absent(self, paths: Sequence[Path]) -> None:
        """DataError if one is there."""
        for path in paths:
            if os.path.lexists(path):
                raise DataError(f"{path}: no run has written it, and it is not replaced: move it away")

    def require_apart(self, inputs: Iterable[Path]) -> None:
        """DataError if a run would replace one of the files that it reads."""
        inputs = list(inputs)
        for path in (*self.outputs, self.list_file):
            check_apart(path, inputs)

    def claim(self, *paths: Path) -> None:
        """Takes files to the list of those that runs have written, before they are. DataError if it cannot be."""
        own = self.own() if self.list_file.exists() else set()
        if self.list_file.exists() and own.issuperset(paths):
            return
        names = sorted(path.relative_to(self.folder).as_posix() for path in own.union(paths))
        with written_whole(self.list_file) as partial:
            partial.write_text(json.dumps(names, indent=1) + "\n", encoding="utf-8")
