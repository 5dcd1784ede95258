"""Files that are whole: written beside their place, and moved there once they are complete."""

from __future__ import annotations

import errno
import hashlib
import os
import platform
import re
import secrets
import shutil
import stat
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from cloudtomo_cl.arguments import PATH, require_kinds
from cloudtomo_cl.errors import DataError
from cloudtomo_cl.memory import size_text

# A disk with less room than this is full: no file of ours is smaller than a block or a few of a file system.
_FULL = 64 * 1024
_NO_ROOM = (errno.ENOSPC, errno.EDQUOT)
_NEW_FILE = 0o666  # less what the umask takes
_WRITABLE = 0o222
# Temporary names: of which file, by which process of which machine, and what nobody can guess.
_PARTIAL = re.compile(r"\.(?P<name>.+)\.(?P<machine>[0-9a-f]{8})-(?P<process>\d+)-[0-9a-f]{16}\.partial")
_being_written: set[Path] = set()


@contextmanager
def written_whole(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Gives a name in the same folder to write to, and moves that file to `path` in the end.

    Whatever happens (an exception, a full disk, SIGKILL, a power cut), there is then at `path` either the file that
    was there before or the whole new one, with the old one's permissions. A link stays: what it points to is replaced.
    What a process that died was writing here is removed.

    Raises
    ------
    DataError : the folder does not exist, cannot be written, or its disk is full; `path` is no plain file (a device,
        a pipe, a folder), or protected against writing
    """
    require_kinds("writing", path=(path, PATH))
    path = Path(path)
    target, partial = path, None
    try:
        target = check_target(path)
        remove_abandoned(target.parent, target.name)
        partial = target.with_name(f".{target.name}.{_machine()}-{os.getpid()}-{secrets.token_hex(8)}.partial")
        os.close(os.open(partial, os.O_WRONLY | os.O_CREAT | os.O_EXCL, _NEW_FILE))
        _being_written.add(partial)
        yield partial
        _keep_permissions(target, partial)
        _flush(partial)
        os.replace(partial, target)
        # The new name, too, must survive a power cut. Not every system lets a folder be flushed.
        with suppress(OSError):
            _flush(target.parent)
    except OSError as error:
        raise DataError(f"{path}: could not be written ({reason(error, target.parent)})") from None
    finally:
        # On a read-only disk this fails even where there is nothing to remove.
        if partial is not None:
            with suppress(OSError):
                partial.unlink(missing_ok=True)
            _being_written.discard(partial)


def check_target(path: str | os.PathLike[str]) -> Path:
    """The plain file that a path stands for, there already or not; links are followed.

    Raises
    ------
    DataError : its folder does not exist; it is a folder, a device, a pipe or a socket; it is protected against writing
    """
    target = Path(os.path.realpath(path))
    named = str(path) if target == Path(os.path.abspath(path)) else f"{path} (a link to {target})"
    if not target.parent.is_dir():
        raise DataError(f"{named}: the folder {target.parent} does not exist: make it first")
    try:
        mode = target.stat().st_mode
    except FileNotFoundError:
        return target
    except OSError as error:
        raise DataError(f"{named}: could not be looked at ({error.strerror}): check its folder") from None
    if not stat.S_ISREG(mode):
        kind = "a folder" if stat.S_ISDIR(mode) else "no plain file (but a device, a pipe or a socket)"
        raise DataError(f"{named}: is {kind}: choose the name of a file")
    # To root all files are open; a protected one was meant to stay all the same.
    if not mode & _WRITABLE or not os.access(target, os.W_OK):
        raise DataError(f"{named}: is protected against writing: choose another name, or chmod u+w")
    return target


def check_apart(path: Path, inputs: Iterable[Path], option: str = "--output") -> None:
    """Checks that a file to be written is none of those that are read, by whatever name or link. DataError if it is.

    option : of the command line, that the path is from
    """
    for file in inputs:
        with suppress(OSError):
            if os.path.samefile(path, file):
                also = "" if path == file else f" as {file}"
                raise DataError(
                    f"{path}: this command reads it{also}, and would write over it: choose another {option}"
                )


def remove_abandoned(folder: Path, name: str | None = None) -> None:
    """Removes what processes of this machine were writing into a folder when they died.

    name : of the only file that is looked for; by default of any
    """
    with suppress(OSError):
        for entry in list(os.scandir(folder)):
            match = _PARTIAL.fullmatch(entry.name)
            if match and name in (None, match["name"]) and match["machine"] == _machine():
                if not is_alive(int(match["process"])):
                    with suppress(OSError):
                        os.unlink(entry.path)


def remove_unfinished() -> None:
    """Removes what this process is writing: for one that ends at once, from whatever thread."""
    for partial in list(_being_written):
        with suppress(OSError):
            os.unlink(partial)


def is_alive(process: int) -> bool:
    """Whether a process of this machine is there; its own process is."""
    import psutil

    return process == os.getpid() or psutil.pid_exists(process)


def reason(error: OSError, folder: Path) -> str:
    """Why a file could not be written into a folder, and what to do."""
    free = None
    with suppress(OSError):
        free = shutil.disk_usage(folder).free
    # The netCDF library tells of any failure as of one in the file's format.
    if free is not None and free < _FULL:
        return f"the disk of {disk_of(folder)} is full, {size_text(free)} are free: make room, or choose another folder"
    if error.errno in _NO_ROOM:
        return f"{error.strerror} for us on the disk of {disk_of(folder)}: make room, or choose another folder"
    return f"{error.strerror or error}: check its folder, permissions and disk"


def disk_of(folder: Path) -> Path:
    """Where the disk of a folder is mounted."""
    folder = folder.absolute()
    return next((parent for parent in (folder, *folder.parents) if os.path.ismount(parent)), folder)


def _machine() -> str:
    """Of several machines that share a disk, which this is."""
    return hashlib.sha256(platform.node().encode()).hexdigest()[:8]


def _keep_permissions(old: Path, new: Path) -> None:
    """Gives a file the mode, and where that is allowed the owner, of the one that it replaces."""
    try:
        before = old.stat()
    except FileNotFoundError:
        return
    if hasattr(os, "chown"):
        with suppress(OSError):
            os.chown(new, before.st_uid, before.st_gid)
    os.chmod(new, stat.S_IMODE(before.st_mode))


def _flush(path: Path) -> None:
    """From the operating system's memory to the disk."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
