"""The folders in which drivers keep built kernels, checked before they use them: they do not say what went wrong.

If the folder cannot be written, PoCL finds no device; if its disk is full, PoCL ends the process from inside LLVM.
pyopencl keeps in another one what launches kernels, and launches none if it cannot.
"""

from __future__ import annotations

import atexit
import os
import shutil
import tempfile
from pathlib import Path

from cloudtomo_cl.errors import DeviceError
from cloudtomo_cl.memory import size_text

VARIABLE = "POCL_CACHE_DIR"
_CACHES = "XDG_CACHE_HOME"
# Bytes of disk for all kernels, with the compilers' temporary files; and for one kernel.
_ROOM, _ROOM_FOR_ONE = 64 * 2**20, 4 * 2**20
_state: dict[str, Path] = {}


def prepare() -> None:
    """Makes sure, before the first call of OpenCL, that kernels can be stored.

    Where the usual folder cannot be written, or its disk is full, this process gets a temporary one.

    Raises
    ------
    DeviceError : the temporary folder cannot be written either
    """
    if "folder" in _state:
        return
    folder, of_launchers = usual_folder(), _caches() / "pytools"
    if not _is_fit(folder):
        folder = _in_place_of(folder)
        os.environ[VARIABLE] = str(folder)
    if not _is_fit(of_launchers):
        _keep_launchers(_in_place_of(of_launchers))
    _state["folder"] = folder


def _in_place_of(folder: Path) -> Path:
    """A folder for as long as the process lives. DeviceError if there is no place for it."""
    where, variable = Path(tempfile.gettempdir()), VARIABLE if folder == usual_folder() else _CACHES
    if not _is_fit(where):
        raise DeviceError(
            f"kernels cannot be built: {folder} cannot be written, or its disk is full, and so it is with {where}: "
            f"make room, or name another folder in the environment variable {variable}"
        )
    temporary = Path(tempfile.mkdtemp(prefix="cloudtomo-kernels-"))
    atexit.register(shutil.rmtree, temporary, ignore_errors=True)
    return temporary


def _keep_launchers(folder: Path) -> None:
    """Has pyopencl keep what launches kernels in a folder: it looks for one when the module is imported."""
    before = os.environ.get(_CACHES)
    os.environ[_CACHES] = str(folder)
    try:
        import pyopencl.invoker  # noqa: F401
    finally:
        del os.environ[_CACHES]
        if before is not None:
            os.environ[_CACHES] = before


def check() -> None:
    """Raises DeviceError if the disk has become full since `prepare`: a driver would end the process."""
    folder = _state.get("folder")
    if folder is not None and _free(folder) < _ROOM_FOR_ONE:
        raise DeviceError(
            f"a kernel cannot be built: the disk of {folder}, where drivers keep them, has {size_text(_free(folder))} "
            f"free: make room there, or name another folder in {VARIABLE}"
        )


def usual_folder() -> Path:
    """The folder in which PoCL keeps built kernels by default."""
    if os.environ.get(VARIABLE):
        return Path(os.environ[VARIABLE])
    return _caches() / "pocl" / "kcache"


def _caches() -> Path:
    """The folder of this user's caches."""
    return Path(os.environ[_CACHES]) if os.environ.get(_CACHES) else Path.home() / ".cache"


def _is_fit(folder: Path) -> bool:
    """Whether the folder, or the nearest parent that exists, can be written and has room."""
    try:
        there = _there(folder)
        if not there.is_dir() or _free(folder) < _ROOM:
            return False
        with tempfile.TemporaryFile(dir=there):
            return True
    except OSError:
        return False


def _there(folder: Path) -> Path:
    return next((parent for parent in (folder, *folder.parents) if parent.exists()), Path("."))


def _free(folder: Path) -> float:
    """Free bytes on the folder's disk; infinite if that is not known."""
    try:
        return shutil.disk_usage(_there(folder)).free
    except OSError:
        return float("inf")
