"""The lock of a run folder: one run at a time, and whoever comes second is told who was first."""

from __future__ import annotations

import errno
import json
import os
import platform
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from datetime import datetime
from pathlib import Path
from typing import Any

from cloudtomo_cl.errors import DataError
from cloudtomo_cl.files.whole import is_alive

NAME = ".lock"
# What a file system answers that knows no locks (some network drives).
_NO_LOCKS = (errno.ENOSYS, errno.EOPNOTSUPP, errno.ENOLCK, errno.EINVAL)


@contextmanager
def held(folder: Path) -> Iterator[None]:
    """Holds a folder, which is made, and removed again if nothing was written into it.

    The system keeps the lock as long as the process lives: one that was killed leaves a file, and no lock. Where file
    systems know no locks, what the file says of its owner decides.

    Raises
    ------
    DataError : another process holds it; it is no folder, or cannot be written
    """
    path = folder / NAME
    made = [parent for parent in (folder, *folder.parents) if not parent.exists()]
    try:
        folder.mkdir(parents=True, exist_ok=True)
        descriptor = _locked(path)
    except OSError as error:
        _remove_empty(made)
        raise DataError(f"{folder}: could not be written ({error.strerror}): check its permissions and disk") from None
    try:
        yield
    finally:
        # First the name, then the lock: nobody else gets the lock of a file that is about to vanish, and keeps it.
        with suppress(OSError):
            path.unlink(missing_ok=True)
        os.close(descriptor)
        _remove_empty(made)


def _locked(path: Path) -> int:
    """A descriptor that holds the lock."""
    while True:
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
        try:
            _lock(descriptor, path)
            if not _is_file(path, descriptor):
                # Its owner has ended, and removed the name, just now.
                os.close(descriptor)
                continue
            # A full disk does not keep a run from holding its folder; it ends soon enough.
            with suppress(OSError):
                os.ftruncate(descriptor, 0)
                os.pwrite(descriptor, json.dumps(_owner()).encode(), 0)
            return descriptor
        except BaseException:
            with suppress(OSError):
                os.close(descriptor)
            raise


def _lock(descriptor: int, path: Path) -> None:
    try:
        import fcntl
    except ImportError:  # Windows
        return _check_owner(path)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise _refused(path, _read_owner(path)) from None
    except OSError as error:
        if error.errno not in _NO_LOCKS:
            raise
        _check_owner(path)


def _check_owner(path: Path) -> None:
    """DataError if the process that wrote a lock file is alive, or of another machine, where nobody can tell."""
    owner = _read_owner(path)
    process = owner.get("process")
    if owner and (owner.get("host") != platform.node() or (isinstance(process, int) and is_alive(process))):
        raise _refused(path, owner)


def _refused(path: Path, owner: dict[str, Any]) -> DataError:
    known = {"process": "?", "host": "?", "since": "?"} | owner
    who = "process {process} on {host}, since {since}".format(**known)
    return DataError(
        f"{path.parent}: another run is at work in this folder ({who}): wait for it, or choose another folder; if "
        f"there is no such process any more, remove {path}"
    )


def _owner() -> dict[str, Any]:
    now = datetime.now().astimezone().isoformat(timespec="seconds")
    return {"process": os.getpid(), "host": platform.node(), "since": now}


def _read_owner(path: Path) -> dict[str, Any]:
    try:
        owner = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return owner if isinstance(owner, dict) else {}


def _is_file(path: Path, descriptor: int) -> bool:
    """Whether a name still stands for an open file."""
    try:
        return os.path.samestat(os.stat(path), os.fstat(descriptor))
    except FileNotFoundError:
        return False


def _remove_empty(folders: list[Path]) -> None:
    """Removes folders, the innermost first, as long as there is nothing in them."""
    with suppress(OSError):
        for folder in folders:
            folder.rmdir()
