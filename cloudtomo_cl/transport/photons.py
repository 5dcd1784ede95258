"""Photons that fill the radiance table: from the sun, and where light enters an open domain."""

from __future__ import annotations

import os
from typing import Any

import numpy as np

from cloudtomo_cl.opencl.arrays import DeviceArray
from cloudtomo_cl.opencl.device import Pace
from cloudtomo_cl.opencl.layout import TABLE_UNIT, sun_view_struct
from cloudtomo_cl.scene.scene import Scene
from cloudtomo_cl.transport.medium import FilledMedium
from cloudtomo_cl.transport.radiance import RadianceOperator

# Photons from the sun for each voxel of the mask, at least.
_PER_VOXEL = int(os.environ.get("PERVOX", 64))
# Of photons that start where light enters an open domain, for each from the sun: as many as the surface and the air
# outside send of the sunlight, but no fewer than this share.
_LEAST_ENTERING = 0.125


class Photons:
    """Photons whose flights add up to the radiance in the cells of a table.

    In a periodic domain they start in the sun and go as those of fluxes do. Around an open one surface and air have
    no end: there photons live inside of the domain alone. They start where sunlight enters it, weakened by the air
    outside; and, if there is surface or air, on the faces of the domain, or of a box around all cloud, with the
    diffuse light that a path against them finds. What leaves the domain and comes back is in that light.

    Parameters
    ----------
    operator : with a mask
    features : of the table's kernels
    """

    def __init__(self, operator: RadianceOperator, features: tuple[str, ...]) -> None:
        assert operator.mask is not None
        self._operator, device, scene = operator, operator.device, operator.scene
        self._pace = Pace(device)
        box = _box(scene, operator.mask)
        sun_view, area = sun_view_struct(scene, box)
        self._pixels = int(sun_view["width"]) * int(sun_view["height"])
        # Of every pixel of the sun's view.
        self._samples = -(-_PER_VOXEL * int(operator.mask.sum()) // self._pixels)
        self._power = float(scene.sun.direction[2]) * area / (self._samples * self._pixels)
        self._starts = {
            "sun_view": device.constant(sun_view),
            "pixel_count": self._pixels,
            "box": device.constant((np.array(box) / scene.grid.spacing).astype(np.float32)),
        }
        self._unit = TABLE_UNIT / float(np.mean(scene.grid.spacing))
        self._is_open = is_open = scene.boundary.horizontal == "open"
        has_air_outside = is_open and scene.air is not None and scene.air.is_outside
        self._entering, self._entering_unit = 0, 0.0
        if is_open:
            outside = "CLOUDTOMO_ATMOSPHERE"
            features = tuple(feature for feature in features if feature != outside)
            self._entering = round(_brightness(scene, has_air_outside) * self._samples * self._pixels)
        if self._entering:
            x, y, z = box[1] - box[0]
            self._entering_unit = 2 * np.pi * (x * y + y * z + z * x) / self._entering / self._power
            self._arriving_diffuse = device.kernel("arriving", "arriving_diffuse", operator.features)
        if has_air_outside:
            self._arriving_sunlight = device.kernel("arriving", "arriving_sunlight", operator.features)
        self._weakened = has_air_outside
        self._fill_table = device.kernel("photons", "fill_table", features)
        self._no_weights = device.empty(1, np.float32)

    @property
    def radiance_of_unit(self) -> float:
        """Times 1 km^3 sr: the radiance, for a sun of irradiance 1, that a unit of the sums stands for."""
        return self._power / self._unit

    def fill(self, medium: FilledMedium, seed: int, stream: int, table: dict[str, Any], sums: DeviceArray) -> None:
        """Adds what this rank's photons bring.

        Parameters
        ----------
        medium : the extinction
        seed, stream : by which photons are drawn
        table : the kernel's `column` and `cells`
        sums : int64, shape (cells, bins), units of `radiance_of_unit`
        """
        around = medium.arguments | self._starts | {"seed": seed, "stream": stream}
        arguments = around | table | {"unit": self._unit, "table_sums": sums}
        if self._is_open:
            arguments["scene"] = medium.inside_struct
        for first, count in self._parts(self._samples, self._pixels):
            photons = count * self._pixels
            weights = self._no_weights
            if self._weakened:
                weights = self._operator.device.empty(photons, np.float32)
                self._operator.device.launch(
                    self._arriving_sunlight, photons, **around, first_sample=first, count=photons, weights=weights
                )
            self._pace.launch(
                self._fill_table, photons, **arguments, first_sample=first, photon_count=photons, enters_box=False,
                weighted=self._weakened, weights=weights,
            )  # fmt: skip
        for first, count in self._parts(self._entering, 1):
            weights = self._operator.device.empty(count, np.float32)
            self._operator.device.launch(
                self._arriving_diffuse, count, **around, first_sample=first, count=count, unit=self._entering_unit,
                weights=weights,
            )  # fmt: skip
            self._pace.launch(
                self._fill_table, count, **arguments, first_sample=first, photon_count=count, enters_box=True,
                weighted=True, weights=weights,
            )  # fmt: skip

    def _parts(self, samples: int, pixels: int) -> Any:
        """This rank's samples, as launches take them: the first, and how many."""
        own = self._operator.ranks.part(samples)
        begin = own.start
        while begin < own.stop:
            count = min(max(self._pace.work_items // pixels, 1), own.stop - begin)
            yield begin, count
            begin += count


def _box(scene: Scene, mask: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """What encloses all that scatters in the grid: two corners, km from the grid's lower one."""
    spacing = np.array(scene.grid.spacing)
    if scene.boundary.horizontal == "periodic" or scene.air is not None or not mask.any():
        return np.zeros(3), spacing * mask.shape
    kept = np.argwhere(mask)
    return spacing * kept.min(axis=0), spacing * (kept.max(axis=0) + 1)


def _brightness(scene: Scene, has_air_outside: bool) -> float:
    """What surface and air around an open domain send into it, roughly, as a share of the sunlight; 0: nothing."""
    levels, extinction = scene.air_layers()
    air = float(np.sum(extinction * np.diff(levels))) if has_air_outside else 0.0
    share = scene.surface.albedo + air
    return min(max(share, _LEAST_ENTERING), 1.0) if share > 0 else 0.0
