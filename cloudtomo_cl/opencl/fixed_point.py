"""Checks, on the host, of the sums that kernels make in fixed point (kernels/walk/accumulate.h)."""

from __future__ import annotations

import numpy as np

from cloudtomo_cl.errors import TransportError
from cloudtomo_cl.opencl.layout import LARGEST_SUM
from cloudtomo_cl.parallel.ranks import Ranks


def first_overflow(sums: np.ndarray) -> tuple[int, ...] | None:
    """The index of the first sum that left the range of its 64 bits; None if none did."""
    if sums.size == 0 or (sums.max() < LARGEST_SUM and sums.min() >= -LARGEST_SUM):
        return None
    wrong = (sums >= LARGEST_SUM) | (sums < -LARGEST_SUM)
    return tuple(int(i) for i in np.argwhere(wrong)[0])


def overflow(what: str, where: str = "") -> TransportError:
    """The error of a sum that has overflowed, to be raised.

    Parameters
    ----------
    what : name of the sum, in the singular, for instance "the gradient"
    where : index of the sum, for instance ", at voxel (0, 1, 2)", if it is known
    """
    return TransportError(
        f"{what} has left the range of its 64-bit sums, or something that is no number was added to it{where}: "
        "the optics are extreme (extinction near 0 where light scatters, a very sharp phase function), "
        "or the device is at fault; use fewer paths at a time, a larger solver.floor, or another device"
    )


def require_sums(sums: np.ndarray, what: str, axes: str) -> None:
    """Raises TransportError if a sum has overflowed.

    Parameters
    ----------
    sums : fixed-point sums as the device left them, int64
    what : name of the sums, for instance "the gradient"
    axes : what an index stands for, for instance "voxel"
    """
    place = first_overflow(sums)
    if place is not None:
        raise overflow(what, f", at {axes} {place}")


def summed(sums: np.ndarray, ranks: Ranks, what: str, axes: str) -> np.ndarray:
    """The fixed-point sums of all ranks added up.

    Parameters
    ----------
    sums : fixed-point sums of this rank, int64
    what, axes : as in `require_sums`

    Raises
    ------
    TransportError : a sum has overflowed
    """
    ranks.together(lambda: require_sums(sums, what, axes))
    if ranks.size > 1:
        sums = ranks.sum(sums)
        require_sums(sums, what, axes)
    return sums
