"""Where a file comes from: package, versions, device, command; what every output keeps."""

from __future__ import annotations

import hashlib
import platform
from typing import TYPE_CHECKING

import numpy as np

from cloudtomo_cl.versions import PACKAGE, version_of

if TYPE_CHECKING:
    from cloudtomo_cl.opencl.device import Device

_PACKAGES = (PACKAGE, "numpy", "scipy", "pyopencl", "pydantic", "xarray", "netCDF4", "matplotlib")


def source() -> str:
    """This package and its version."""
    return f"{PACKAGE} {version_of()}"


def versions() -> dict[str, str]:
    """Of Python and of the packages that numbers depend on."""
    return {"python": platform.python_version(), **{package: version_of(package) for package in _PACKAGES}}


def digest(array: np.ndarray) -> str:
    """Of an array's numbers in double precision, by which to know them again."""
    return hashlib.sha256(np.ascontiguousarray(array, np.float64).data).hexdigest()


def describe_device(device: Device) -> dict[str, str]:
    """Name, driver and the way in which it sums."""
    return {
        "name": device.name,
        "platform": device.opencl.platform.name.strip(),
        "version": device.opencl.version.strip(),
        "accumulation": device.accumulation,
    }
