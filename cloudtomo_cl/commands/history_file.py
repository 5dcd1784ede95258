"""The history of a run: history.csv, a line for each iteration, written as it goes."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, TextIO

import numpy as np

from cloudtomo_cl.errors import DataError
from cloudtomo_cl.files.whole import written_whole

if TYPE_CHECKING:
    from cloudtomo_cl.inversion.records import IterationRecord


class HistoryFile:
    """Writes and reads a table of iterations, with the names of their fields as its first line."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._file: TextIO | None = None

    def begin(self, names: Sequence[str], before: Iterable[IterationRecord]) -> None:
        """Puts a table of the iterations so far into the place of an older one, whole, to append to.

        Raises
        ------
        DataError, OSError : the file cannot be written
        """
        with written_whole(self.path) as partial, open(partial, "w", newline="", encoding="utf-8") as table:
            csv.writer(table).writerows([names, *map(_line, before)])
        self._file = open(self.path, "a", newline="", encoding="utf-8")

    def append(self, record: IterationRecord) -> None:
        """One more line, on the disk at once, after `begin`. OSError if it cannot be written."""
        assert self._file is not None
        csv.writer(self._file).writerow(_line(record))
        self._file.flush()

    def close(self) -> None:
        """After the last line; also where none was written."""
        if self._file is not None:
            # On a full disk it fails to write what append has reported already.
            with suppress(OSError):
                self._file.close()
            self._file = None

    def read(self) -> dict[str, np.ndarray]:
        """A column for each field of an iteration, shape (iterations,); NaN where nothing is known.

        Raises
        ------
        DataError : there is no such file, or it is no history
        """
        try:
            with open(self.path, newline="", encoding="utf-8") as file:
                names, *lines = csv.reader(file)
            table = np.array([[float(value or "nan") for value in line] for line in lines])
            return dict(zip(names, table.reshape(-1, len(names)).T))
        except (OSError, ValueError, csv.Error) as error:
            raise DataError(f"{self.path}: is no history of a run ({error})") from None


def _line(record: IterationRecord) -> list[Any]:
    """A record as the history has it: stages and iterations count from 1, as on the screen."""
    values = {field.name: getattr(record, field.name) for field in fields(record)}
    values.update({name: values[name] + 1 for name in ("stage", "iteration") if name in values})
    return ["" if value is None else value for value in values.values()]
