"""The photons that fill radiance tables, and what is made of what they bring."""

from __future__ import annotations

import numpy as np

from cloudtomo_cl.errors import DataError
from cloudtomo_cl.opencl.arrays import DeviceArray
from cloudtomo_cl.opencl.fixed_point import overflow, summed
from cloudtomo_cl.scene.phase import TabulatedPhaseFunction
from cloudtomo_cl.scene.scene import Cloud
from cloudtomo_cl.transport.cells import Cells, depth_within, largest_beside
from cloudtomo_cl.transport.directions import BINS, FEATURES, scattering_matrix, solid_angles
from cloudtomo_cl.transport.medium import Medium
from cloudtomo_cl.transport.photons import Photons
from cloudtomo_cl.transport.radiance import RadianceOperator
from cloudtomo_cl.transport.radiance_table import SUMMED_PARTS, RadianceTable, require_room
from cloudtomo_cl.transport.rendering import Rendering

# Photons from the sun for each path of the rendering whose derivatives are wanted.
_PHOTONS_PER_PATH = 1


class RadianceTableBuilder:
    """Makes tables of the diffuse radiance, each at the extinction of a rendering; it keeps none of them.

    Voxels that are optically deep are divided into cells (cells.py), for light changes inside. Photons from the sun
    fill a table (photons.py), as many as the rendering has paths: it is a function of a rendering's extinction, seed
    and stream, and nothing of it is kept from one to the next. Its noise falls where derivatives are averaged.

    Parameters
    ----------
    operator : with a mask, whose voxels the tables cover

    Attributes
    ----------
    column : of every voxel of the grid, its number among those of the mask, or -1; int32, on the device
    columns : number of voxels of the mask
    features : macros of kernels that take a table

    Raises
    ------
    DataError : the operator has no mask, or there is not memory enough
    """

    def __init__(self, operator: RadianceOperator) -> None:
        if operator.mask is None:
            raise DataError("a radiance table needs the mask of its operator: give one, for instance of ones")
        self._operator = operator
        device, mask = operator.device, operator.mask
        self._mask = mask
        self.columns = int(mask.sum())
        require_room(self.columns, device)
        column = np.full(mask.shape, -1, np.int32)
        column[mask] = np.arange(self.columns)
        self.column = device.constant(column)
        self._voxel = device.constant(np.flatnonzero(mask).astype(np.int32))
        self.features = (*operator.features, *FEATURES)
        self._direct_sunlight = device.kernel("derivatives", "direct_sunlight", self.features)
        self._tabulate = device.kernel("photons", "tabulate", self.features)
        self._photons = Photons(operator, self.features)
        cloud = operator.scene.cloud
        self._albedo = _albedo(cloud)
        droplets = self._albedo * scattering_matrix(cloud.phase_function)
        self._scattering = device.constant((droplets / solid_angles()).T.astype(np.float32))
        self._solid_angle = device.constant(solid_angles().astype(np.float32))

    def at(self, rendering: Rendering) -> RadianceTable:
        """The table at a rendering's extinction. Whoever holds an older one drops it before: both take much memory.

        Raises
        ------
        TransportError : a sum has overflowed
        DataError, DeviceError : voxels that are deep now have more cells than there is memory for
        """
        ranks = self._operator.ranks
        divided, places, sums = ranks.together(lambda: self._divided(rendering))
        unit = ranks.together(lambda: self._filled(rendering, places, sums))
        if ranks.size > 1:
            self._add_ranks(sums)
        return ranks.together(lambda: self._tabulated(rendering._medium, divided, places, sums, unit))

    def _divided(self, rendering: Rendering) -> tuple[Cells, DeviceArray, DeviceArray]:
        """The cells at a rendering's extinction, the same as kernels take them, and room for their sums."""
        device, scene = self._operator.device, self._operator.scene
        extinction, spacing = rendering._medium.extinction.get(), scene.grid.spacing
        is_periodic = scene.boundary.horizontal == "periodic"
        around = (depth_within(extinction, spacing, is_periodic), largest_beside(extinction, is_periodic))
        within, beside = (field[self._mask] for field in around)
        photons = self._photons_of(rendering) / max(self.columns, 1)
        asymmetry = scene.cloud.phase_function.g
        divided = Cells.of(extinction[self._mask], spacing, asymmetry, within, beside, photons)
        require_room(len(divided), device)
        return divided, device.constant(divided.places), device.zeros((len(divided), BINS), np.int64)

    def _filled(self, rendering: Rendering, places: DeviceArray, sums: DeviceArray) -> float:
        """Adds what this rank's photons bring; returns what `Photons.fill` does."""
        table = {"column": self.column, "cells": places}
        photons = self._photons_of(rendering)
        return self._photons.fill(rendering._medium, photons, rendering.seed, rendering.stream, table, sums)

    def _photons_of(self, rendering: Rendering) -> int:
        """From the sun, of all ranks."""
        return _PHOTONS_PER_PATH * rendering.samples * len(self._operator.pixels)

    def _add_ranks(self, sums: DeviceArray) -> None:
        """Makes the sums those of all ranks, some cells at a time: the host has no room for as much as devices."""
        device, ranks, cells = self._operator.device, self._operator.ranks, sums.shape[0]
        at_once = -(-cells // SUMMED_PARTS)
        for begin in range(0, cells, at_once):
            offset = begin * BINS * sums.dtype.itemsize

            def own(count: int = min(at_once, cells - begin), offset: int = offset) -> np.ndarray:
                part = np.empty((count, BINS), sums.dtype)
                device.read(sums.data, part, offset)
                return part

            part = summed(ranks.together(own), ranks, "the radiance table", "cell and direction")
            device.write(sums.data, part, offset)

    def _tabulated(
        self, medium: Medium, divided: Cells, places: DeviceArray, sums: DeviceArray, unit: float
    ) -> RadianceTable:
        """The table of all ranks' sums, in their place, and the direct sunlight in its cells."""
        device, scene = self._operator.device, self._operator.scene
        of_cells = {
            "cells": places, "cell_column": device.constant(divided.voxel.astype(np.int32)), "count": len(divided),
        }  # fmt: skip
        overflown = device.zeros(1, np.uint32)
        device.launch(
            self._tabulate, len(divided), table_sums=sums, scattering=self._scattering,
            unit=unit / float(np.prod(scene.grid.spacing)), solid_angle=self._solid_angle, overflown=overflown,
            **of_cells,
        )  # fmt: skip
        if overflown.get()[0]:
            raise overflow("the radiance table")
        sunlight = device.empty(len(divided), np.float32)
        device.launch(
            self._direct_sunlight, len(divided), **medium.arguments, voxel=self._voxel, sunlight=sunlight, **of_cells
        )
        sunlight *= np.float32(self._albedo)
        return RadianceTable(self.column, places, sums.view(np.float32), sunlight)


def _albedo(cloud: Cloud) -> float:
    """Of the droplets; of a phase table where their radius differs by voxel that of its middle row, as everything else
    of it: it is what flights to the sun are drawn from."""
    phase = cloud.phase_function
    if not isinstance(phase, TabulatedPhaseFunction) or phase.single_scattering_albedo is None:
        return cloud.single_scattering_albedo
    albedos = phase.single_scattering_albedo
    if len(albedos) > 1 and cloud.effective_radius is not None:
        return float(np.interp(cloud.effective_radius, phase.effective_radius, albedos))
    return float(albedos[len(albedos) // 2])
