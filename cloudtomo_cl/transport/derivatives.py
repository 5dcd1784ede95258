"""The field of radiance inside a cloud, and the gradient that it gives."""

from __future__ import annotations

from typing import Any

import numpy as np

from cloudtomo_cl.errors import DataError
from cloudtomo_cl.opencl.fixed_point import summed
from cloudtomo_cl.opencl.layout import TABLE_UNIT
from cloudtomo_cl.opencl.memory import Footprint
from cloudtomo_cl.transport.cells import Cells, most_cells
from cloudtomo_cl.transport.directions import BINS, FEATURES, scattering_matrix
from cloudtomo_cl.transport.radiance import FIXED_POINT_SCALE, RadianceOperator, Rendering, largest_adjoint

# A cell with less than so many crossings of a voxel leans on its neighbours'; one without any
# neighbour on the mean of all voxels.
_OWN_CROSSINGS, _NEIGHBOUR_CROSSINGS = 5.0, 0.05
# The table on the device, with what is added to it; on the host, and what smoothing it takes.
_BYTES_PER_CELL, _HOST_BYTES_PER_CELL = 20, 40
# Kernels count the table's entries with signed integers of 32 bits.
_MOST_ENTRIES = 2**31 - 1
# Paths from each voxel that is thinner than this (optical depth along its shortest edge), for the table alone: the
# cameras' paths hardly go from there to what shines on it. Each is worth so little of a crossing that it counts in
# what is pooled with the neighbours: a voxel's own few are noise.
_THIN, _PROBES, _WORTH = 1.0, 32, 0.1
# Of the whole grid that are smoothed together.
_BINS_AT_ONCE = 15
# Whose numbers are worked on together, for the sake of memory.
_CELLS_AT_ONCE = 1 << 12
# After so many gradients the table is made anew, and what it held before fades.
_FADING = 0.7
_REFRESH = 4


def table_footprint(voxels: int) -> Footprint:
    """What a `RadianceTable` of so many voxels takes at most."""
    entries = most_cells(voxels) * BINS
    return Footprint(_BYTES_PER_CELL * entries, 16 * entries, _HOST_BYTES_PER_CELL * entries)


class RadianceTable:
    """A table of the diffuse radiance by voxel and direction, and gradients by it.

    Voxels that are optically deep are divided into cells (cells.py), for light changes inside.

    Parameters
    ----------
    operator : with a mask, whose voxels the field covers

    Raises
    ------
    DataError : the operator has no mask, or there is not memory enough

    Source: the derivative of the equation of transfer with respect to the extinction is a source
    of (source function - radiance), weighted with the adjoint (Martin, Cairns and Bal 2014, "Adjoint
    methods for adjusting three-dimensional atmosphere and surface properties to fit multi-angle/
    multi-pixel polarimetric measurements"; Levis et al. 2020 drop a part of it); here the adjoint is
    sampled by the cameras' paths, exactly, and the radiance by the table they fill.
    """

    def __init__(self, operator: RadianceOperator) -> None:
        if operator.mask is None:
            raise DataError("a radiance table needs the mask of its operator: give one, for instance of ones")
        self._operator = operator
        device, mask = operator.device, operator.mask
        self._mask = mask
        self.columns = int(mask.sum())
        table_footprint(self.columns).require(
            device,
            f"the radiance table of {self.columns} voxels",
            'choose a smaller mask or grid, or solver.gradient = "replay"',
        )
        if 2 * most_cells(self.columns) * BINS > _MOST_ENTRIES:
            raise DataError(
                f"the radiance table of {self.columns} voxels is more than kernels count: choose a smaller mask or "
                'grid, or solver.gradient = "replay"'
            )
        column = np.full(mask.shape, -1, np.int32)
        column[mask] = np.arange(self.columns)
        self.column = device.constant(column)
        self._voxel = device.constant(np.flatnonzero(mask).astype(np.int32))
        features = (*operator.features, *FEATURES)
        self._gradient_paths = device.kernel("derivatives", "gradient_paths", features)
        self._direct_sunlight = device.kernel("derivatives", "direct_sunlight", features)
        self._probe_paths = device.kernel("probes", "probe_paths", features)
        self.features = features
        cloud = operator.scene.cloud
        # Of a phase table the middle row stands for all: it is what flights to the sun are drawn from.
        albedos = getattr(cloud.phase_function, "single_scattering_albedo", None) or (cloud.single_scattering_albedo,)
        self._albedo = albedos[len(albedos) // 2]
        self._scattering = scattering_matrix(cloud.phase_function)
        self._cells = Cells.whole(self.columns)
        self._table = np.zeros((self.columns, BINS, 2), np.float32)  # km, sr^-1 km
        self._allocate()
        self._gradients = 0

    def _allocate(self) -> None:
        """Arrays on the device for the cells, all 0."""
        device, cells = self._operator.device, len(self._cells)
        self._places = device.constant(self._cells.places)
        self._field = device.zeros((cells, BINS, 2), np.int64)
        self._scattered = device.zeros((cells, BINS), np.float32)
        self._sunlight = device.zeros(cells, np.float32)

    def _divide(self, rendering: Rendering) -> None:
        """Divides the voxels as a rendering's extinction asks for; nothing may be in the device's sums."""
        scene = self._operator.scene
        extinction = rendering._medium.extinction.get()[self._mask]
        cells = Cells.of(extinction, scene.grid.spacing, scene.cloud.phase_function.g)
        if not np.array_equal(cells.parts, self._cells.parts):
            self._table = self._cells.changed(self._table, cells)
            self._cells = cells
            self._allocate()

    def gradient(self, rendering: Rendering, adjoint: np.ndarray, change: Any) -> tuple[Any, np.ndarray]:
        """The gradient of a cost with respect to extinction; as `RadianceOperator.gradient`.

        Parameters
        ----------
        change : of the extinction, km^-1, shape of the grid, on the device

        Returns
        -------
        gradient : on the device, float32, shape of the grid, cost per km^-1; 0 outside of the mask
        tangent : derivative of each pixel's radiance along the change, W m^-2 sr^-1, shape (pixels,)

        The rendering's paths go into the table for the gradients after
        this one; before the first, they fill it.

        Raises
        ------
        AuditError, TransportError : as `RadianceOperator.gradient`
        """
        if self._gradients == 0:
            self._divide(rendering)
            self._walk(rendering, np.zeros_like(adjoint), change)
        if self._gradients % _REFRESH == 0:
            self._refresh(rendering)
        self._gradients += 1
        return self._walk(rendering, adjoint, change)

    def prepare(self, rendering: Rendering) -> None:
        """Makes the table at a rendering's extinction, for kernels that take it by `buffers`.

        It is made of the paths that went into it before; the first time the rendering's own fill it.
        """
        operator = self._operator
        if self._gradients == 0:
            nothing = operator.device.zeros(operator.scene.grid.shape, np.float32)
            self._divide(rendering)
            self._walk(rendering, np.zeros((len(operator.pixels), 2)), nothing)
        self._refresh(rendering)
        self._gradients += 1

    def arrays(self) -> dict[str, np.ndarray]:
        """All that a gradient changes, as arrays on the host."""
        arrays = {"scattered": self._scattered, "sunlight": self._sunlight}
        own = {"table": self._table.copy(), "gradients": np.array(self._gradients), "parts": self._cells.parts}
        own["field"] = self._all_sums()
        return own | {name: array.get() for name, array in arrays.items()}

    def restore(self, state: dict[str, np.ndarray]) -> None:
        """Goes on from what `arrays` gave."""
        self._cells = Cells(state["parts"].copy())
        self._table = state["table"].copy()
        self._allocate()
        self._gradients = int(state["gradients"])
        for name, array in (("scattered", self._scattered), ("sunlight", self._sunlight)):
            array.set(state[name])
        if self._operator.ranks.is_first:  # what all ranks have brought
            self._field.set(state["field"])

    def _all_sums(self) -> np.ndarray:
        """What paths of all ranks have brought since the table was made, int64, shape (cells, bins, 2)."""
        return summed(self._field.get(), self._operator.ranks, "the radiance table", "cell, direction and kind")

    @property
    def buffers(self) -> dict[str, Any]:
        """The table as kernels take it."""
        return {
            "column": self.column, "cells": self._places, "scattered": self._scattered, "sunlight": self._sunlight,
            "table_sums": self._field,
        }  # fmt: skip

    def _walk(self, rendering: Rendering, adjoint: np.ndarray, change: Any) -> tuple[Any, np.ndarray]:
        operator = self._operator
        total = operator.device.zeros(operator.scene.grid.shape, np.int64)
        largest = largest_adjoint(adjoint)
        shares = adjoint / largest if largest > 0 else np.zeros_like(adjoint)
        factors = operator.device.constant((operator.shares.taken(shares) * FIXED_POINT_SCALE).astype(np.float32))

        def walk() -> np.ndarray:
            tangent = np.zeros(len(operator.shares))
            for launch in operator.stored_launches(rendering):
                paths = operator.device.empty(launch.paths, np.float32)
                launch.run(
                    self._gradient_paths, **self.buffers, adjoint=factors, change=change, gradient=total,
                    path_tangent=paths,
                )  # fmt: skip
                tangent = _added_in_order(tangent, paths.get().reshape(-1, len(tangent)))
            return tangent

        tangent = operator.shares.gathered(operator.ranks.together(walk))
        operator.make_total(total)
        irradiance = operator.scene.sun.irradiance
        unit = largest / FIXED_POINT_SCALE * irradiance / (rendering.samples // 2)
        with operator.device.lock:  # pyopencl's own kernels, too, are shared by threads
            gradient = total.astype(np.float32) * np.float32(unit)
        return gradient, tangent * irradiance / rendering.samples

    def _probe(self, rendering: Rendering) -> None:
        """Sends paths from thin voxels for the table."""
        spacing, device = self._operator.scene.grid.spacing, self._operator.device
        extinction = rendering._medium.extinction.get()
        listed = np.flatnonzero(self._mask & (extinction * min(spacing) < _THIN)).astype(np.int32)
        listed = np.ascontiguousarray(listed[self._operator.ranks.rank :: self._operator.ranks.size])
        if not len(listed):
            return
        device.launch(
            self._probe_paths, len(listed) * _PROBES, **rendering._medium.arguments, **self.buffers,
            seed=rendering.seed, stream=rendering.stream, listed=device.constant(listed), count=len(listed),
            samples=_PROBES, length=_WORTH * float(np.mean(spacing)),
        )  # fmt: skip

    def _refresh(self, rendering: Rendering) -> None:
        """Makes source and radiance anew from what paths have brought, at a rendering's extinction."""
        self._operator.ranks.together(lambda: self._probe(rendering))
        self._table *= _FADING
        brought = self._all_sums()
        # Places that are worked on together are few: arrays on the way would be larger than the table.
        for first in range(0, len(brought), _CELLS_AT_ONCE):
            part = slice(first, first + _CELLS_AT_ONCE)
            self._table[part] += brought[part] / np.float32(TABLE_UNIT)
        del brought
        self._operator.device.clear(self._field)
        self._divide(rendering)
        radiance = self._radiance()
        scattered = self._albedo * (radiance @ self._scattering.T) - radiance
        self._scattered.set(scattered.astype(np.float32))
        medium, cells = rendering._medium, len(self._cells)
        self._operator.device.launch(
            self._direct_sunlight, cells, **medium.arguments, voxel=self._voxel, cells=self._places,
            cell_column=self._operator.device.constant(self._cells.voxel.astype(np.int32)), count=cells,
            sunlight=self._sunlight,
        )  # fmt: skip
        self._sunlight *= np.float32(self._albedo)

    def _radiance(self) -> np.ndarray:
        """Radiance by cell and direction, sr^-1: its own, as far as it is known, else its voxel's."""
        cells, edge = self._cells, float(np.mean(self._operator.scene.grid.spacing))
        sums = cells.summed(self._table)
        everywhere = sums[..., 1].sum(axis=0) / np.maximum(sums[..., 0].sum(axis=0), 1e-30)
        near = [np.empty(sums.shape[:-1], np.float32) for _ in range(2)]
        for first in range(0, BINS, _BINS_AT_ONCE):  # some after the others, for the sake of memory
            bins = slice(first, min(first + _BINS_AT_ONCE, BINS))
            for kind, found in enumerate(near):
                full = np.zeros((*self._mask.shape, bins.stop - first), np.float32)
                full[self._mask] = sums[:, bins, kind]
                found[:, bins] = _with_neighbours(full)[self._mask]
        least = _NEIGHBOUR_CROSSINGS * edge
        neighbours = (near[1] + least * everywhere) / (near[0] + least)
        radiance = _leaning(sums, neighbours, np.full(len(sums), edge))
        if len(cells) > len(sums):
            edges = edge / np.cbrt(cells.counts)
            whole = cells.counts == 1
            radiance = np.where(
                whole[cells.voxel, None],
                radiance[cells.voxel],
                _leaning(self._table, radiance[cells.voxel], edges[cells.voxel]),
            )
        return radiance


def _added_in_order(sums: np.ndarray, paths: np.ndarray) -> np.ndarray:
    """Sums of shape (pixels,) and what paths add, shape (paths, pixels), one after the other.

    So the bits follow neither from how launches are cut nor from which pixels are in them: NumPy would add a single
    column in pairs.
    """
    rows = np.vstack([sums, paths])
    return np.hstack([rows, rows]).sum(axis=0)[: len(sums)] if len(sums) == 1 else rows.sum(axis=0)


def _leaning(sums: np.ndarray, others: np.ndarray, edge: np.ndarray) -> np.ndarray:
    """Radiance of places that lean on what others have, as far as too little crosses them.

    Parameters
    ----------
    sums : km and sr^-1 km, shape (places, bins, 2)
    others : sr^-1, shape (places, bins)
    edge : of the places, km, shape (places,)
    """
    length, brought = sums[..., 0], sums[..., 1]
    # A place's own brightness, which others need not have.
    parts = [slice(first, first + _CELLS_AT_ONCE) for first in range(0, len(sums), _CELLS_AT_ONCE)]
    expected = np.concatenate([(length[part] * others[part]).sum(axis=1) for part in parts])
    found = brought.sum(axis=1)
    lit = expected[expected > 0]
    level = 0.3 * np.median(lit) if len(lit) else 1.0
    ratio = np.clip((found + level) / (expected + level), 0.05, 10.0)[:, None]
    own = (_OWN_CROSSINGS * edge)[:, None]
    radiance = np.empty(length.shape)
    for part in parts:
        radiance[part] = (brought[part] + own[part] * ratio[part] * others[part]) / (length[part] + own[part])
    return radiance


def _with_neighbours(values: np.ndarray) -> np.ndarray:
    """Sums over a voxel and the 26 around it, shape (x, y, z, ...).

    SciPy's uniform_filter takes twice the time, much of the host's in an iteration.
    """
    for axis in range(3):
        before = np.moveaxis(values, axis, 0)
        total = before.copy()
        total[1:] += before[:-1]
        total[:-1] += before[1:]
        values = np.moveaxis(total, 0, axis)
    return values
