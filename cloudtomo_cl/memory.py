"""How much memory there is, against what a computation needs: said before it is taken."""

from __future__ import annotations

from collections.abc import Iterator
from math import prod
from pathlib import Path

from cloudtomo_cl.errors import DataError

# Kernels count voxels with signed and pixels with unsigned integers of 32 bits.
MOST_VOXELS, MOST_PIXELS = 2**31 - 1, 2**32 - 1
# Where control groups of version 2 and 1 say what a container or a batch job may take, and has taken.
_CONTROL_GROUPS = (
    ("/sys/fs/cgroup/memory.max", "/sys/fs/cgroup/memory.current"),
    ("/sys/fs/cgroup/memory/memory.limit_in_bytes", "/sys/fs/cgroup/memory/memory.usage_in_bytes"),
)


def free_memory() -> int:
    """Bytes that this process may still take: of the machine, its control group and its limits (`ulimit -v`)."""
    import psutil

    return min([psutil.virtual_memory().available, *_left_by_control_groups(), *_left_by_limits()])


def _left_by_control_groups() -> Iterator[int]:
    for most, taken in _CONTROL_GROUPS:
        try:
            # Without a limit the file says "max", or a number beyond any memory.
            yield max(int(Path(most).read_text()) - int(Path(taken).read_text()), 0)
        except (OSError, ValueError):
            continue


def _left_by_limits() -> Iterator[int]:
    import psutil

    try:
        import resource
    except ImportError:  # Windows
        return
    most, _ = resource.getrlimit(resource.RLIMIT_AS)
    if most != resource.RLIM_INFINITY:
        yield max(most - psutil.Process().memory_info().vms, 0)


def size_text(number: float) -> str:
    """Bytes as a person says them."""
    for unit in ("bytes", "kB", "MB", "GB", "TB"):
        if number < 1000 or unit == "TB":
            return f"{number:.0f} {unit}" if unit == "bytes" else f"{number:.3g} {unit}"
        number /= 1000
    raise AssertionError


def shape_text(shape: tuple[int, ...]) -> str:
    """A grid's numbers of voxels as a person says them."""
    return " x ".join(map(str, shape))


def require(needed: float, what: str, advice: str) -> None:
    """Checks that this machine has memory free.

    Parameters
    ----------
    needed : bytes
    what : begins the message, for instance "reading cloud.nc"
    advice : ends it

    Raises
    ------
    DataError : there is less
    """
    free = free_memory()
    if needed > free:
        raise DataError(
            f"{what} needs about {size_text(needed)} of memory, this machine has {size_text(free)} free: {advice}"
        )


def require_countable(voxels: int, pixels: int, what: str) -> None:
    """DataError if there are more voxels or pixels than kernels count."""
    if voxels > MOST_VOXELS or pixels > MOST_PIXELS:
        raise DataError(f"{what} is more than kernels count ({MOST_PIXELS} pixels, {MOST_VOXELS} voxels): use fewer")


def voxels_of(shape: tuple[int, ...]) -> int:
    """Voxels of a grid; Python's integers do not overflow."""
    return prod(int(count) for count in shape)
