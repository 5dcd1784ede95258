"""Photons from the sun that fill the radiance table."""

from __future__ import annotations

import os
from typing import Any

import numpy as np

from cloudtomo_cl.opencl.arrays import DeviceArray
from cloudtomo_cl.opencl.device import Pace
from cloudtomo_cl.opencl.layout import TABLE_UNIT, sun_view_struct
from cloudtomo_cl.transport.medium import FilledMedium
from cloudtomo_cl.transport.radiance import RadianceOperator

# Photons for each voxel of the mask.
_PER_VOXEL = float(os.environ.get("PERVOX", 64))


class Photons:
    """Photons that start in the sun, and leave in every cell of a table what it takes to know the radiance there."""

    def __init__(self, operator: RadianceOperator, features: tuple[str, ...]) -> None:
        assert operator.mask is not None
        self._operator = operator
        scene, device = operator.scene, operator.device
        self._kernel = device.kernel("photons", "fill_table", features)
        self._pace = Pace(device)
        box = None
        if scene.surface.albedo == 0 and scene.air is None:
            kept = np.argwhere(operator.mask)
            box = kept.min(axis=0) * np.array(scene.grid.spacing), (kept.max(axis=0) + 1) * np.array(scene.grid.spacing)
        view, self._area = sun_view_struct(scene, box)
        self._pixels = int(view["width"]) * int(view["height"])
        self._sun_view = device.constant(view)
        self._samples = max(1, round(_PER_VOXEL * operator.mask.sum() / self._pixels))
        self._unit = TABLE_UNIT / float(np.mean(scene.grid.spacing))

    @property
    def radiance_of_unit(self) -> float:
        """Times 1 km^3 sr: the radiance, for a sun of irradiance 1, that a unit of the sums stands for."""
        power = float(self._operator.scene.sun.direction[2]) * self._area / (self._samples * self._pixels)
        return power / self._unit

    def fill(self, medium: FilledMedium, seed: int, stream: int, table: dict[str, Any], sums: DeviceArray) -> None:
        """Adds what this rank's photons bring.

        Parameters
        ----------
        table : the kernel's column and cells
        sums : int64, shape (cells, bins)
        """
        own = self._operator.ranks.part(self._samples)
        begin = own.start
        while begin < own.stop:
            number = int(np.clip(self._pace.work_items // self._pixels, 1, own.stop - begin))
            self._pace.launch(
                self._kernel, number * self._pixels, **medium.arguments, **table, sun_view=self._sun_view,
                pixel_count=self._pixels, first_sample=begin, photon_count=number * self._pixels, seed=seed,
                stream=stream, unit=self._unit, table_sums=sums,
            )  # fmt: skip
            begin += number
