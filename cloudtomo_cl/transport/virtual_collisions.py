"""Virtual droplets, which make gradients right where there are few real ones or none (kernels/replay.cl)."""

from __future__ import annotations

from typing import Any

import numpy as np

from cloudtomo_cl.opencl.arrays import DeviceArray
from cloudtomo_cl.opencl.fixed_point import require_sums
from cloudtomo_cl.opencl.layout import STRUCTS
from cloudtomo_cl.transport.device_scene import DeviceScene
from cloudtomo_cl.transport.launches import Launch, StoredLaunch

# Virtual collisions per path. The mean of gradients does not depend on it, their noise and time do: more make cloudy
# voxels noisier, fewer empty ones (docs/measurements/derivatives.md).
_COLLISIONS_PER_PATH = 0.1
# Paths by whose lengths that is set, and the sums' unit: a share of a voxel's shortest edge.
FEW_PATHS, _UNIT = 1 << 11, 2.0**-20
# Paths that are replayed together, of so large a launch at most: each may leave a virtual collision behind. Where
# launches are larger, as many times as many.
_PART, _LAUNCH = 1 << 20, 1 << 24


class VirtualCollisions:
    """What the kernels of a gradient leave to each other.

    Parameters
    ----------
    scene : where they fly
    """

    def __init__(self, scene: DeviceScene) -> None:
        self._device_scene, self._device = scene, scene.device

    def _kernel(self, file: str, name: str) -> Any:
        """One of its kernels: most operators never replay a path, and need not have them."""
        return self._device.kernel(file, name, self._device_scene.features)

    def run(self, launch: StoredLaunch, features: tuple[str, ...], **arguments: Any) -> None:
        """Replays the paths of a launch, and walks those from their virtual collisions.

        features : macros of kernels that walk the launch's paths
        arguments : adjoint, virtual_extinction, gradient; of both kernels
        """
        replay = self._device.kernel("replay", "replay_paths", features)
        part = _PART * max(self._device.largest_launch // _LAUNCH, 1)
        size = min(part, launch.paths) * STRUCTS["VirtualCollision"].itemsize
        collisions = self._device.buffer(size)
        for begin in range(0, launch.paths, part):
            count = self._device.zeros(1, np.uint32)
            launch.run_part(
                replay, begin, min(begin + part, launch.paths), **arguments, virtual_collisions=collisions,
                virtual_collision_count=count,
            )  # fmt: skip
            found = int(count.get()[0])
            if found:
                kernel = self._kernel("virtual", "virtual_paths")
                launch.walk(kernel, found, **arguments, virtual_collisions=collisions, count=found)

    def limit(self, extinction: np.ndarray, few: Launch) -> float:
        """The extinction up to which virtual droplets add to a voxel's own for a path to meet a tenth of one, km^-1.

        extinction : of the cloud, km^-1, shape of the grid
        few : about `FEW_PATHS` paths, by whose lengths it is set
        """
        mask, lengths = self._device_scene.mask, self._lengths(few)
        if mask is not None:
            lengths = lengths * mask
        limit = virtual_limit(extinction, lengths, _COLLISIONS_PER_PATH)
        if limit == 0.0:  # these paths have met nothing of the mask; the others may
            limit = _COLLISIONS_PER_PATH / float(np.linalg.norm(self._device_scene.scene.grid.extent))
        return limit

    def extinction(self, extinction: np.ndarray, limit: float) -> DeviceArray:
        """Of the virtual droplets, km^-1, on the device, float32, shape of the grid; -1 outside of the mask.

        Together with the cloud's droplets, km^-1, shape of the grid, it is at least `limit` (km^-1) in every voxel.
        """
        virtual = np.maximum(np.float32(limit) - extinction, np.float32(0))
        if self._device_scene.mask is not None:
            virtual[~self._device_scene.mask] = -1
        return self._device.array(virtual)

    def _lengths(self, few: Launch) -> np.ndarray:
        """km that a path flies through every voxel, on average over some paths of other random numbers."""
        grid = self._device_scene.scene.grid
        lengths = self._device.zeros(grid.shape, np.int64)
        unit = 1.0 / (_UNIT * min(grid.spacing))
        few.walk(self._kernel("lengths", "path_lengths"), few.paths, unit=unit, lengths=lengths)
        sums = lengths.get()
        require_sums(sums, "the lengths of paths", "voxel")
        return sums / (unit * few.paths)


def virtual_limit(extinction: np.ndarray, lengths: np.ndarray, collisions: float) -> float:
    """The extinction, km^-1, up to which virtual droplets must add to a voxel's own for so many collisions with them.

    Parameters
    ----------
    extinction : km^-1, any shape
    lengths : of a path through each voxel, km, same shape
    collisions : wanted per path: the sum of (limit - extinction) x length where the extinction is below the limit

    Returns 0 if no path crosses anything.
    """
    crossed = lengths > 0
    if not crossed.any():
        return 0.0
    beta, length = extinction[crossed].astype(float), lengths[crossed].astype(float)
    order = np.argsort(beta, kind="stable")
    beta, length = beta[order], length[order]
    # With the n thinnest brought to a limit there are limit x their length - their depth collisions.
    total, depth = np.cumsum(length), np.cumsum(beta * length)
    limits = (collisions + depth) / total
    above = np.append(beta[1:], np.inf)
    return float(limits[np.argmax(limits <= above)])
