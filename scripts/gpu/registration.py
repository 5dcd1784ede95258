"""OpenCL on a machine that has NVIDIA's driver, but has not registered its OpenCL library."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

# Where containers and distributions have the driver's libraries; the whole disk is not looked through.
_FOLDERS = ("/usr/local/nvidia", "/usr/lib", "/usr/lib64", "/usr/local/lib", "/usr/local/cuda", "/opt", "/run")
_LIBRARY = "libnvidia-opencl.so*"
_VENDORS = "OCL_ICD_VENDORS"


def libraries() -> Iterator[Path]:
    """The driver's OpenCL libraries."""
    for folder in map(Path, _FOLDERS):
        if folder.is_dir():
            yield from sorted(folder.rglob(_LIBRARY))


def environment(folder: Path) -> dict[str, str]:
    """Variables by which the loader finds NVIDIA's library; none if it is registered, or is not there.

    Parameters
    ----------
    folder : empty; the registration goes there
    """
    registered = Path(os.environ.get(_VENDORS, "/etc/OpenCL/vendors"))
    known = [registered] if registered.is_file() else sorted(registered.glob("*.icd")) if registered.is_dir() else []
    if any("nvidia" in file.read_text(errors="replace").lower() for file in known):
        return {}
    library = next(libraries(), None)
    if library is None:
        return {}
    for file in known:  # those that are registered stay so
        (folder / file.name).write_text(file.read_text())
    (folder / "nvidia.icd").write_text(f"{library}\n")
    path = os.pathsep.join(filter(None, [str(library.parent), os.environ.get("LD_LIBRARY_PATH", "")]))
    return {_VENDORS: str(folder), "LD_LIBRARY_PATH": path}
