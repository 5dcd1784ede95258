"""Gradients that kernels deposit in fixed point, voxel by voxel, and what makes floating-point numbers of them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np

from cloudtomo_cl.errors import DataError
from cloudtomo_cl.opencl.arrays import DeviceArray
from cloudtomo_cl.opencl.device import Device
from cloudtomo_cl.opencl.fixed_point import summed
from cloudtomo_cl.parallel.ranks import Shares
from cloudtomo_cl.scene.scene import Scene

_Result = TypeVar("_Result")
# Units of the fixed-point gradient per sr^-1 km deposited under the largest adjoint: rounding is
# far below the deposits that matter (about 1e-6), and a voxel's sum of them over all paths of a
# gradient may reach 2^31 before it overflows.
FIXED_POINT_SCALE = 2.0**32
# Of adjoints: beyond, a voxel's sum, which has up to 2^31 of them, may be more than single precision holds.
_LARGEST_ADJOINT = 1e28


def deposited(
    scene: Scene,
    device: Device,
    shares: Shares,
    adjoint: np.ndarray,
    samples: int,
    deposit: Callable[[Any, DeviceArray], _Result],
) -> tuple[DeviceArray, _Result]:
    """A gradient that paths deposit, and what else depositing them gives.

    Parameters
    ----------
    scene : whose voxels
    device : where to compute
    shares : which rank has which pixels
    adjoint : derivative of the cost with respect to the halves of a rendering, shape (pixels, 2)
    samples : paths per pixel
    deposit : given the adjoint of this rank's pixels, in shares of the largest and units of the sums, float32, shape
        (pixels, 2), and the sums, int64, shape of the grid, both on the device: adds what this rank's paths deposit.
        It must not wait for other ranks

    Returns
    -------
    gradient : on the device, float32, shape of the grid, cost per km^-1
    what `deposit` has returned

    Raises
    ------
    DataError : the adjoint is not finite, or too large
    TransportError : a voxel's sum has overflowed
    """
    ranks, largest = device.ranks, largest_adjoint(adjoint)

    def work() -> tuple[DeviceArray, np.ndarray, _Result]:
        total = device.zeros(scene.grid.shape, np.int64)
        relative = adjoint / largest if largest > 0 else np.zeros_like(adjoint)
        factors = device.constant((shares.taken(relative) * FIXED_POINT_SCALE).astype(np.float32))
        result = deposit(factors, total)
        return total, total.get(), result

    total, sums, result = ranks.together(work)
    sums = summed(sums, ranks, "the gradient", "voxel")
    unit = largest / FIXED_POINT_SCALE * scene.sun.irradiance / (samples // 2)

    def converted() -> DeviceArray:
        if ranks.size > 1:
            total.set(sums)
        with device.lock:  # pyopencl's own kernels, too, are shared by threads
            return total.astype(np.float32) * np.float32(unit)

    return ranks.together(converted), result


def largest_adjoint(adjoint: np.ndarray) -> float:
    """The largest absolute value. DataError if a gradient in single precision could not hold what it makes of them."""
    largest = float(np.abs(adjoint).max(initial=0.0))
    if not np.isfinite(largest):
        raise DataError("adjoint is not finite")
    if largest > _LARGEST_ADJOINT:
        raise DataError(
            f"adjoint has {largest:.3g} as its largest value: it must be at most {_LARGEST_ADJOINT:g}, for gradients "
            "are in single precision: scale the cost"
        )
    return largest
