"""The folder in which drivers keep built kernels, checked before they use it: they do not say what went wrong.

If the folder cannot be written, PoCL finds no device; if its disk is full, PoCL ends the process from inside LLVM.
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
    folder = usual_folder()
    if not _is_fit(folder):
        where = Path(tempfile.gettempdir())
        if not _is_fit(where):
            raise DeviceError(
                f"kernels cannot be built: {folder} cannot be written, or its disk is full, and so it is with {where}: "
                f"make room, or name another folder in the environment variable {VARIABLE}"
            )
        folder = Path(tempfile.mkdtemp(prefix="cloudtomo-kernels-"))
        atexit.register(shutil.rmtree, folder, ignore_errors=True)
        os.environ[VARIABLE] = str(folder)
    _state["folder"] = folder


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
    if os.environ.get("XDG_CACHE_HOME"):
        return Path(os.environ["XDG_CACHE_HOME"]) / "pocl" / "kcache"
    return Path.home() / ".cache" / "pocl" / "kcache"


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
