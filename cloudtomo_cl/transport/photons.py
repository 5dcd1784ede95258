"""Photons that fill the radiance table: from the sun, and where light enters an open domain."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from cloudtomo_cl.errors import DataError
from cloudtomo_cl.opencl.arrays import DeviceArray
from cloudtomo_cl.opencl.layout import MOST_SAMPLES, TABLE_UNIT, sun_view_struct
from cloudtomo_cl.opencl.pace import Pace
from cloudtomo_cl.scene.scene import Scene
from cloudtomo_cl.transport.medium import Medium
from cloudtomo_cl.transport.radiance import RadianceOperator

# Where light enters an open domain photons start, for each from the sun so many times what surface and air outside
# send of the sunlight: it is smooth and hardly changes what derivatives are made of, but its noise would. At least, at
# most.
_ENTERING, _LEAST_ENTERING, _MOST_ENTERING = 3.0, 0.125, 1.0


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
        lower, upper = box = _box(scene, operator.mask)
        sun_view, area = sun_view_struct(scene, box)
        self._pixels = int(sun_view["width"]) * int(sun_view["height"])
        self._starts = {
            "sun_view": device.constant(sun_view),
            "pixel_count": self._pixels,
            "box": device.constant((np.array(box) / scene.grid.spacing).astype(np.float32)),
        }
        x, y, z = upper - lower
        self._sun_power = float(scene.sun.direction[2]) * area
        self._face_power = 2 * np.pi * (x * y + y * z + z * x)  # of light of radiance 1 sr^-1
        self._unit = TABLE_UNIT / float(np.mean(scene.grid.spacing))
        self._is_open = scene.boundary.horizontal == "open"
        self._is_weakened = self._is_open and scene.air is not None and scene.air.is_outside
        self._entering = _entering_share(scene, self._is_weakened) if self._is_open else 0.0
        self._kernels = {
            name: device.kernel("arriving", name, operator.features)
            for name, wanted in (("arriving_sunlight", self._is_weakened), ("arriving_diffuse", self._entering > 0))
            if wanted
        }
        if self._is_open:  # what photons inside of the domain have nothing to do with
            features = tuple(feature for feature in features if feature != "CLOUDTOMO_ATMOSPHERE")
        self._kernels["fill_table"] = device.kernel("photons", "fill_table", features)
        self._no_weights = device.empty(1, np.float32)

    def fill(
        self, medium: Medium, photons: int, seed: int, stream: int, table: dict[str, Any], sums: DeviceArray
    ) -> float:
        """Adds what this rank's photons bring.

        Parameters
        ----------
        medium : the extinction
        photons : from the sun, at least, of all ranks; rounded up to a multiple of the columns that the sun sees
        seed, stream : by which they are drawn
        table : the kernel's `column` and `cells`
        sums : int64, shape (cells, bins)

        Returns
        -------
        What a unit of the sums of all ranks is of the radiance of a bin of 1 sr in a cell of 1 km^3, sr^-1, for a sun
        of irradiance 1

        Raises
        ------
        DataError : there are not so many photons
        """
        samples = -(-photons // self._pixels)
        entering = round(self._entering * samples * self._pixels)
        if max(samples, entering) > MOST_SAMPLES:
            raise DataError(
                f"the radiance table would take {samples} photons for each column of the sun's view, and {entering} "
                f"that enter the domain: there are at most {MOST_SAMPLES} of each; use fewer paths per pixel, or fewer "
                "pixels"
            )
        power = self._sun_power / (samples * self._pixels)  # of a photon of weight 1
        starts = medium.arguments | self._starts | {"seed": seed, "stream": stream}
        photon = starts | table | {"unit": self._unit, "table_sums": sums}
        if self._is_open:
            photon["scene"] = medium.inside_struct
        for first, count in self._parts(samples, self._pixels):
            self._trace(starts, photon, first, count * self._pixels)
        for first, count in self._parts(entering, 1):
            self._trace(starts, photon, first, count, self._face_power / entering / power)
        return power / self._unit

    def _trace(
        self, starts: dict[str, Any], photon: dict[str, Any], first: int, count: int, weight: float | None = None
    ) -> None:
        """Traces photons from the sun, or those that enter; `weight`: of one that enters with a radiance of 1 sr^-1."""
        device, weights = self._operator.device, self._no_weights
        enters = weight is not None
        is_weighted = enters or self._is_weakened
        if is_weighted:
            weights = device.empty(count, np.float32)
            own: dict[str, Any] = {"first_sample": first, "count": count, "weights": weights}
            if enters:
                device.launch(self._kernels["arriving_diffuse"], count, **starts, **own, unit=weight)
            else:
                device.launch(self._kernels["arriving_sunlight"], count, **starts, **own)
        self._pace.launch(
            self._kernels["fill_table"], count, **photon, first_sample=first, photon_count=count, enters_box=enters,
            weighted=is_weighted, weights=weights,
        )  # fmt: skip

    def _parts(self, samples: int, pixels: int) -> Iterator[tuple[int, int]]:
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


def _entering_share(scene: Scene, has_air_outside: bool) -> float:
    """Photons that start where light enters an open domain, for each from the sun; 0 where nothing sends light."""
    levels, extinction = scene.air_layers()
    air = float(np.sum(extinction * np.diff(levels))) if has_air_outside else 0.0
    sent = scene.surface.albedo + air
    return min(max(_ENTERING * sent, _LEAST_ENTERING), _MOST_ENTERING) if sent > 0 else 0.0
