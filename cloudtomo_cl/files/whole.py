"""Files that are whole: written beside their place, and moved there once they are complete."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from cloudtomo_cl.errors import DataError


@contextmanager
def written_whole(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Gives a name in the same folder to write to, and moves that file to `path` in the end.

    Whatever happens (an exception, a full disk, SIGKILL, a power cut), there is then at `path`
    either the file that was there before or the whole new one.

    Raises
    ------
    DataError : the folder does not exist, cannot be written, or its disk is full
    """
    path = Path(path)
    partial = path.with_name(f".{path.name}.{os.getpid()}.partial")
    try:
        if not path.parent.is_dir():
            raise DataError(f"{path}: the folder {path.parent} does not exist: make it first")
        yield partial
        _flush(partial)
        os.replace(partial, path)
        # The new name, too, must survive a power cut. Not every system lets a folder be flushed.
        with suppress(OSError):
            _flush(path.parent)
    except OSError as error:
        raise DataError(
            f"{path}: could not be written ({error.strerror or error}): check its folder, permissions and disk"
        ) from None
    finally:
        # On a read-only disk this fails even where there is nothing to remove.
        with suppress(OSError):
            partial.unlink(missing_ok=True)


def _flush(path: Path) -> None:
    """From the operating system's memory to the disk."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
