"""The radiance table inside a cloud, and the gradient that it gives."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np

from cloudtomo_cl.errors import DataError
from cloudtomo_cl.opencl.arrays import DeviceArray
from cloudtomo_cl.opencl.device import Device
from cloudtomo_cl.opencl.fixed_point import overflow, summed
from cloudtomo_cl.opencl.memory import Footprint
from cloudtomo_cl.scene.phase import TabulatedPhaseFunction
from cloudtomo_cl.scene.scene import Cloud
from cloudtomo_cl.transport.cells import Cells, depth_within, largest_beside, most_cells
from cloudtomo_cl.transport.directions import BINS, FEATURES, scattering_matrix, solid_angles
from cloudtomo_cl.transport.gradient import deposited
from cloudtomo_cl.transport.medium import FilledMedium
from cloudtomo_cl.transport.photons import Photons
from cloudtomo_cl.transport.radiance import RadianceOperator, Rendering

# Photons from the sun for each path of the rendering whose derivatives are wanted.
_PHOTONS_PER_PATH = 1
# Of them for each ray along which the derivatives of first flights are made.
_PATHS_PER_RAY = 4
# In which ranks add up their sums.
_SUMMED_PARTS = 32
# Bytes of a table entry: on the device the 64-bit sum, later two floats in its place; on the host one part of the sums,
# where ranks add them up.
_BYTES_PER_ENTRY, _HOST_BYTES = 8, 24 / _SUMMED_PARTS
# Kernels count the table's entries with signed integers of 32 bits.
_MOST_ENTRIES = 2**31 - 1


def table_footprint(cells: int) -> Footprint:
    """What a `RadianceTable` of so many cells takes; voxels have one each at least, and up to `most_cells`."""
    entries = cells * BINS
    return Footprint(_BYTES_PER_ENTRY * entries, _BYTES_PER_ENTRY * entries, _HOST_BYTES * entries)


def table_growth(voxels: int) -> Footprint:
    """What the table of so many voxels may take beyond a cell each, if they are as deep as can be."""
    least, most = table_footprint(voxels), table_footprint(most_cells(voxels))
    return Footprint(most.device - least.device, most.largest, most.host - least.host)


class RadianceTable:
    """A table of the diffuse radiance by cell and bin of directions, and gradients by it.

    Voxels that are optically deep are divided into cells (cells.py), for light changes inside. Photons from the sun
    fill it (photons.py), as many as the rendering has paths: it is a function of a rendering's extinction, seed and
    stream, and nothing of it is kept from one to the next. Its noise falls where derivatives are averaged.

    Parameters
    ----------
    operator : with a mask, whose voxels the table covers

    Raises
    ------
    DataError : the operator has no mask, or there is not memory enough

    Source: the derivative of the equation of transfer with respect to the extinction is a source
    of (source function - radiance), weighted with the adjoint (Martin, Cairns and Bal 2014, "Adjoint
    methods for adjusting three-dimensional atmosphere and surface properties to fit multi-angle/
    multi-pixel polarimetric measurements"; Levis et al. 2020 drop a part of it); here the adjoint is
    sampled by the cameras' paths, exactly, and the radiance by photons.
    """

    def __init__(self, operator: RadianceOperator) -> None:
        if operator.mask is None:
            raise DataError("a radiance table needs the mask of its operator: give one, for instance of ones")
        self._operator = operator
        device, mask = operator.device, operator.mask
        self._mask = mask
        self.columns = int(mask.sum())
        _require_room(self.columns, device)
        column = np.full(mask.shape, -1, np.int32)
        column[mask] = np.arange(self.columns)
        self.column = device.constant(column)
        self._voxel = device.constant(np.flatnonzero(mask).astype(np.int32))
        self._diffuse: Any = None
        self._sunlight: Any = None
        features = (*operator.features, *FEATURES)
        self._gradient_paths = device.kernel("derivatives", "gradient_paths", features)
        self._direct_sunlight = device.kernel("derivatives", "direct_sunlight", features)
        self._tabulate = device.kernel("photons", "tabulate", features)
        self._photons = Photons(operator, features)
        self.features = features
        cloud = operator.scene.cloud
        self._albedo = _albedo(cloud)
        droplets = self._albedo * scattering_matrix(cloud.phase_function)
        self._scattering = device.constant((droplets / solid_angles()).T.astype(np.float32))
        self._solid_angle = device.constant(solid_angles().astype(np.float32))
        self._gradient_rays = device.kernel("derivatives", "gradient_rays", features)

    def gradient(self, rendering: Rendering, adjoint: np.ndarray, change: Any) -> tuple[Any, np.ndarray]:
        """The gradient of a cost with respect to extinction; as `RadianceOperator.gradient`.

        Parameters
        ----------
        change : of the extinction, km^-1, shape of the grid, on the device

        Returns
        -------
        gradient : on the device, float32, shape of the grid, cost per km^-1; 0 outside of the mask
        tangent : derivative of each pixel's radiance along the change, W m^-2 sr^-1, shape (pixels,)

        Raises
        ------
        AuditError, TransportError : as `RadianceOperator.gradient`
        """
        self.prepare(rendering)
        return self._walk(rendering, adjoint, change)

    def prepare(self, rendering: Rendering) -> None:
        """Makes the table at a rendering's extinction, for kernels that take it by `buffers`.

        Raises
        ------
        TransportError : a sum has overflowed
        DataError, DeviceError : voxels that are deep now have more cells than there is memory for
        """
        ranks = self._operator.ranks
        divided, sums = ranks.together(lambda: self._divided(rendering))
        unit = ranks.together(lambda: self._filled(rendering, sums))
        if ranks.size > 1:
            self._add_ranks(sums)
        ranks.together(lambda: self._tabulated(rendering._medium, divided, sums, unit))

    def _divided(self, rendering: Rendering) -> tuple[Cells, DeviceArray]:
        """The cells at a rendering's extinction, and room for their sums."""
        device, scene = self._operator.device, self._operator.scene
        extinction, spacing = rendering._medium.extinction.get(), scene.grid.spacing
        is_periodic = scene.boundary.horizontal == "periodic"
        around = (depth_within(extinction, spacing, is_periodic), largest_beside(extinction, is_periodic))
        within, beside = (field[self._mask] for field in around)
        photons = self._photons_of(rendering) / max(self.columns, 1)
        asymmetry = scene.cloud.phase_function.g
        divided = Cells.of(extinction[self._mask], spacing, asymmetry, within, beside, photons)
        self.cells = len(divided)
        self.release()
        _require_room(self.cells, device)
        self._places = device.constant(divided.places)
        return divided, device.zeros((self.cells, BINS), np.int64)

    def _tabulated(self, medium: FilledMedium, divided: Cells, sums: DeviceArray, unit: float) -> None:
        """Makes the table of all ranks' sums, in their place, and the direct sunlight in its cells."""
        device, scene = self._operator.device, self._operator.scene
        cell_column = device.constant(divided.voxel.astype(np.int32))
        overflown = device.zeros(1, np.uint32)
        device.launch(
            self._tabulate, self.cells, table_sums=sums, scattering=self._scattering, cells=self._places,
            cell_column=cell_column, count=self.cells, unit=unit / float(np.prod(scene.grid.spacing)),
            solid_angle=self._solid_angle, overflown=overflown,
        )  # fmt: skip
        self._diffuse = sums.view(np.float32)
        if overflown.get()[0]:
            raise overflow("the radiance table")
        self._sunlight = device.empty(self.cells, np.float32)
        device.launch(
            self._direct_sunlight, self.cells, **medium.arguments, voxel=self._voxel, cells=self._places,
            cell_column=cell_column, count=self.cells, sunlight=self._sunlight,
        )  # fmt: skip
        self._sunlight *= np.float32(self._albedo)

    def release(self) -> None:
        """Frees the device's memory of the last table."""
        self._diffuse = self._sunlight = None

    def _add_ranks(self, sums: DeviceArray) -> None:
        """Makes the sums those of all ranks, some cells at a time: the host has no room for as much as devices."""
        device, ranks = self._operator.device, self._operator.ranks
        at_once = -(-self.cells // _SUMMED_PARTS)
        for begin in range(0, self.cells, at_once):
            offset = begin * BINS * sums.dtype.itemsize

            def own(count: int = min(at_once, self.cells - begin), offset: int = offset) -> np.ndarray:
                part = np.empty((count, BINS), sums.dtype)
                device.read(sums.data, part, offset)
                return part

            part = summed(ranks.together(own), ranks, "the radiance table", "cell and direction")
            device.write(sums.data, part, offset)

    def _filled(self, rendering: Rendering, sums: DeviceArray) -> float:
        """Adds what this rank's photons bring; returns what `Photons.fill` does."""
        places = {"column": self.column, "cells": self._places}
        photons = self._photons_of(rendering)
        return self._photons.fill(rendering._medium, photons, rendering.seed, rendering.stream, places, sums)

    def _photons_of(self, rendering: Rendering) -> int:
        """From the sun, of all ranks."""
        return _PHOTONS_PER_PATH * rendering.samples * len(self._operator.pixels)

    def rays(self, rendering: Rendering) -> int:
        """Of each pixel, along which the derivatives of first flights are made: an even number."""
        return max(2, 2 * round(rendering.samples / 2 / _PATHS_PER_RAY))

    @property
    def buffers(self) -> dict[str, Any]:
        """The table as kernels take it."""
        return {
            "column": self.column, "cells": self._places, "diffuse": self._diffuse, "sunlight": self._sunlight,
        }  # fmt: skip

    def _walk(self, rendering: Rendering, adjoint: np.ndarray, change: Any) -> tuple[Any, np.ndarray]:
        """The gradient by the table as it is; as `gradient`."""
        operator, samples = self._operator, rendering.samples
        gradient, tangent = deposited(operator, adjoint, samples, partial(self._deposit, rendering, change))
        return gradient, operator.shares.gathered(tangent) * operator.scene.sun.irradiance / samples

    def _deposit(self, rendering: Rendering, change: Any, factors: DeviceArray, total: DeviceArray) -> np.ndarray:
        """Adds what this rank's paths deposit (`deposited`); returns the sums of its pixels' tangents."""
        operator = self._operator
        tangent, rays = np.zeros(len(operator.shares)), self.rays(rendering)
        weight, pixels = rendering.samples / rays, len(tangent)
        for launch in operator.stored_launches(rendering):
            paths = operator.device.empty(launch.paths, np.float32)
            launch.run(
                self._gradient_paths, **self.buffers, adjoint=factors, change=change, gradient=total,
                path_tangent=paths,
            )  # fmt: skip
            tangent = _added_in_order(tangent, paths.get().reshape(-1, pixels))
            of_rays = operator.device.empty(launch.paths, np.float32)
            done = launch.run_rays(
                self._gradient_rays, pixels, rays, **self.buffers, adjoint=factors, change=change, gradient=total,
                ray_tangent=of_rays, weight=weight,
            )  # fmt: skip
            tangent = _added_in_order(tangent, of_rays.get()[: done * pixels].reshape(-1, pixels))
            rays -= done
        return tangent


def _require_room(cells: int, device: Device) -> None:
    """DataError or DeviceError if a table of so many cells is more than memory has, or kernels count."""
    what = f"the radiance table of {cells} voxels and parts of such"
    advice = 'choose a smaller mask or grid, or solver type "adam" with gradient = "replay"'
    if cells * BINS > _MOST_ENTRIES:
        raise DataError(f"{what} is more than kernels count: {advice}")
    table_footprint(cells).require(device, what, advice)


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


def _added_in_order(sums: np.ndarray, paths: np.ndarray) -> np.ndarray:
    """Sums of shape (pixels,) and what paths add, shape (paths, pixels), one after the other.

    So the bits follow neither from how launches are cut nor from which pixels are in them: NumPy would add a single
    column in pairs.
    """
    rows = np.vstack([sums, paths])
    return np.hstack([rows, rows]).sum(axis=0)[: len(sums)] if len(sums) == 1 else rows.sum(axis=0)
