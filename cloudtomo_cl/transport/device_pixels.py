"""What the kernels know of pixels: their sensors and rays, on the device, dealt out among ranks."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from typing import Any

import numpy as np

from cloudtomo_cl.opencl.device import Device
from cloudtomo_cl.opencl.layout import ray_array, view_structs
from cloudtomo_cl.scene.pixels import all_pixels, checked_pixels
from cloudtomo_cl.scene.scene import Scene
from cloudtomo_cl.scene.sensors import View
from cloudtomo_cl.transport.blocks import pixel_blocks
from cloudtomo_cl.transport.medium import Medium


class DevicePixels:
    """Pixels whose paths are walked; each rank has a part of them on its device.

    Parameters
    ----------
    scene : what the views look at
    views : the sensors
    device : where to compute
    pixels : an integer array (pixels, 2) of (view, row * width + column); all by default

    Attributes
    ----------
    views : the sensors
    listed : all ranks' pixels, uint32, shape (pixels, 2)
    shares : which rank has which of them

    Raises
    ------
    DataError : a pixel is not there
    """

    def __init__(self, scene: Scene, views: Sequence[View], device: Device, pixels: np.ndarray | None = None) -> None:
        self._scene, self._device = scene, device
        self._look_by(views)
        self._deal(all_pixels(self.views) if pixels is None else checked_pixels(self.views, pixels))

    def _look_by(self, views: Sequence[View]) -> None:
        self.views = tuple(views)
        # Views from afar look through all of the atmosphere.
        structs = view_structs(self.views, self._scene.grid, self._scene.top)
        rays = ray_array(self.views, self._scene)
        self._sensors = {"views": self._device.constant(structs), "rays": self._device.constant(rays)}

    def _deal(self, pixels: np.ndarray) -> None:
        """Deals pixels out among the ranks, in blocks, of which Jacobians have sums (blocks.py)."""
        self.listed, ranks = np.ascontiguousarray(pixels, np.uint32), self._device.ranks
        self.shares = ranks.dealt(self.listed if ranks.size == 1 else pixel_blocks(self.views, self.listed).of)
        self._own = self._arguments(self.shares.taken(self.listed))

    def _arguments(self, pixels: np.ndarray) -> dict[str, Any]:
        return {"pixels": self._device.constant(pixels), "pixel_count": len(pixels)}

    def of_pixels(self, pixels: np.ndarray) -> DevicePixels:
        """Other pixels of the same views; see the class. DataError if one is not there."""
        other = copy.copy(self)
        other._deal(checked_pixels(self.views, pixels))
        return other

    def of_views(self, views: Sequence[View]) -> DevicePixels:
        """The same pixels of other views; see the class."""
        other = copy.copy(self)
        other._look_by(views)
        return other

    def paths(
        self, medium: Medium, first_sample: int, count: int, seed: int, stream: int, pixels: np.ndarray | None = None
    ) -> dict[str, Any]:
        """What every kernel that walks paths of pixels takes, by name (parameters.py).

        Parameters
        ----------
        medium : what they go through
        first_sample : number of each pixel's first path
        count : of all paths
        seed, stream : by which they are drawn
        pixels : of the list, uint32, shape (pixels, 2); by default those of this rank
        """
        numbers = {"first_sample": first_sample, "path_count": count, "seed": seed, "stream": stream}
        own = self._own if pixels is None else self._arguments(pixels)
        return medium.arguments | self._sensors | own | numbers
