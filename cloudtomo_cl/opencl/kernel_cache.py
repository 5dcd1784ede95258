"""Where drivers keep the kernels that they have built, looked at before they try: they do not say what went wrong.

PoCL whose folder cannot be written finds no device, and one whose disk is full ends the process from inside LLVM.
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
# What all kernels take, with what compilers write on the way; and one of them.
_ROOM, _ROOM_FOR_ONE = 64 * 2**20, 4 * 2**20
_state: dict[str, Path] = {}


def prepare() -> None:
    """Sees to a folder that can be written, before the first call of OpenCL: another one, for this process, where
    the usual one cannot be, or its disk is full.

    Raises
    ------
    DeviceError : there is none
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
    """DeviceError if the disk has become full since: a driver that builds a kernel then would end the process."""
    folder = _state.get("folder")
    if folder is not None and _free(folder) < _ROOM_FOR_ONE:
        raise DeviceError(
            f"a kernel cannot be built: the disk of {folder}, where drivers keep them, has {size_text(_free(folder))} "
            f"free: make room there, or name another folder in {VARIABLE}"
        )


def usual_folder() -> Path:
    """Where PoCL keeps kernels."""
    if os.environ.get(VARIABLE):
        return Path(os.environ[VARIABLE])
    if os.environ.get("XDG_CACHE_HOME"):
        return Path(os.environ["XDG_CACHE_HOME"]) / "pocl" / "kcache"
    return Path.home() / ".cache" / "pocl" / "kcache"


def _is_fit(folder: Path) -> bool:
    """Whether it, or the nearest folder above that is there, can be written and has room."""
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
    """Bytes; without limit where nobody can tell."""
    try:
        return shutil.disk_usage(_there(folder)).free
    except OSError:
        return float("inf")
