"""How much memory there is, against what a computation needs: said before it is taken."""

from __future__ import annotations

from collections.abc import Iterator
from math import prod
from pathlib import Path

from cloudtomo_cl.errors import DataError

# Kernels count voxels with signed and pixels with unsigned integers of 32 bits.
MOST_VOXELS, MOST_PIXELS = 2**31 - 1, 2**32 - 1
# Control groups, which limit containers and batch jobs, and the file that says in which this process is.
_CONTROL_GROUPS, _OWN_GROUPS = Path("/sys/fs/cgroup"), Path("/proc/self/cgroup")
# Of version 2 and 1: their files of what may be taken and what is, and the line of memory.stat that counts what of the
# latter are copies of files, which go when memory is needed.
_VERSION_2 = ("memory.max", "memory.current", "inactive_file")
_VERSION_1 = ("memory.limit_in_bytes", "memory.usage_in_bytes", "total_inactive_file")


def free_memory() -> int:
    """Bytes that this process may still take: of the machine, its control group and its limits (`ulimit -v`)."""
    import psutil

    return min([psutil.virtual_memory().available, *_left_by_control_groups(), *_left_by_limits()])


def _left_by_control_groups() -> Iterator[int]:
    for folder, (most, taken, idle) in _control_groups():
        try:
            # Without a limit the file says "max", or a number beyond any memory.
            limit, used = (int((folder / name).read_text()) for name in (most, taken))
        except (OSError, ValueError):
            continue
        yield max(limit - used + _counted(folder / "memory.stat", idle), 0)


def _control_groups() -> Iterator[tuple[Path, tuple[str, str, str]]]:
    """The folders of the groups that this process is in, up to the root; all of their limits hold."""
    try:
        lines = _OWN_GROUPS.read_text().splitlines()
    except OSError:
        lines = []
    # In a container its own group may be shown as the root, whatever path the line has.
    for line in dict.fromkeys(["0::/", "0:memory:/", *lines]):
        _, controllers, path = line.split(":", 2)
        if controllers and "memory" not in controllers.split(","):
            continue
        root = _CONTROL_GROUPS / controllers if controllers else _CONTROL_GROUPS
        folder = root / path.lstrip("/")
        for group in (folder, *folder.parents):
            yield group, _VERSION_1 if controllers else _VERSION_2
            if group == root:
                break


def _counted(path: Path, name: str) -> int:
    """A line of a file of names and numbers; 0 where there is none."""
    try:
        numbers = dict(line.split(maxsplit=1) for line in path.read_text().splitlines())
        return int(numbers.get(name, 0))
    except (OSError, ValueError):
        return 0


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
    number = min(number, 1e300)  # integers may be beyond floats
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
