"""Derivatives of pixels with respect to voxels: a sparse near field, a far field by blocks, and products with both."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.sparse.linalg import LinearOperator

from cloudtomo_cl.errors import DataError, TransportError
from cloudtomo_cl.opencl.arrays import DeviceArray
from cloudtomo_cl.opencl.device import Device, device_errors
from cloudtomo_cl.opencl.layout import DERIVATIVE_UNIT, TILE_WIDTH
from cloudtomo_cl.opencl.memory import Footprint
from cloudtomo_cl.transport.derivatives import RadianceTable
from cloudtomo_cl.transport.near_field import Blocks, pixel_blocks, tiles_of, voxel_blocks
from cloudtomo_cl.transport.radiance import RadianceOperator, Rendering

# Slots of tiles whose sums are made at a time.
_SLOTS_AT_ONCE = 1 << 24
# Vectors that a product with several takes at a time.
_VECTORS = 8
_MOST_ENTRIES = 2**32 - 1


class NearField:
    """Which entries of a Jacobian are kept one by one, and the blocks of the others; on a device.

    Parameters
    ----------
    operator : with a mask
    column : of every voxel of the grid, or -1, on the device

    Attributes
    ----------
    pixels, voxels : numbers of rows and columns
    entries : of the near field
    """

    @device_errors("the structure of the derivatives")
    def __init__(self, operator: RadianceOperator, column: Any) -> None:
        assert operator.mask is not None
        self.device, self.column = operator.device, column
        self.scene_struct = operator.scene_struct
        self.pixels, self.voxels = len(operator.pixels), int(operator.mask.sum())
        tiles = tiles_of(operator.views, operator.pixels, operator.scene, operator.mask)
        slots = tiles["slabs"].astype(np.int64) * TILE_WIDTH**2
        self.slot_start_on_host = np.concatenate([[0], np.cumsum(slots)])
        if self.slot_start_on_host[-1] > _MOST_ENTRIES:
            raise DataError(
                f"the near field of {self.pixels} pixels and {self.voxels} voxels has more entries than kernels count: "
                "choose fewer pixels or a coarser grid"
            )
        constant = self.device.constant
        self.tiles = constant(tiles)
        self.slot_start = constant(self.slot_start_on_host.astype(np.uint32))
        self.pixel_blocks = pixel_blocks(operator.views, operator.pixels)
        self.voxel_blocks = voxel_blocks(operator.mask, len(self.pixel_blocks))
        self.pixel_block = constant(self.pixel_blocks.of.astype(np.uint32))
        self.block = constant(self.voxel_blocks.of)
        places = np.zeros((self.voxels, 4), np.uint16)
        places[:, :3] = np.argwhere(operator.mask)
        self.place = constant(places)
        counts = self.device.zeros(self.pixels, np.uint32)
        self._launch("near_count", self.pixels, counts=counts)
        row_start = np.concatenate([[0], np.cumsum(counts.get(), dtype=np.int64)])
        self.entries = int(row_start[-1])
        self.row_start = constant(row_start.astype(np.uint32))
        self.columns = self.device.empty(max(self.entries, 1), np.int32)
        self._launch("near_fill", self.pixels, row_start=self.row_start, columns=self.columns)
        self._transpose(row_start)

    def _launch(self, name: str, work_items: int, **arguments: Any) -> None:
        kernel = self.device.kernel("near_field", name)
        self.device.launch(
            kernel, work_items, scene=self.scene_struct, tiles=self.tiles, column=self.column, pixel_count=self.pixels,
            **arguments,
        )  # fmt: skip

    def _transpose(self, row_start: np.ndarray) -> None:
        """The entries of every column, in the order of their rows."""
        import scipy.sparse

        shape = (self.pixels, self.voxels)
        columns = self.columns.get()[: self.entries]
        by_row = scipy.sparse.csr_matrix((np.arange(self.entries, dtype=np.uint32), columns, row_start), shape)
        by_column = by_row.tocsc()
        constant = self.device.constant
        self.column_start = constant(by_column.indptr.astype(np.uint32))
        # A buffer has at least one number.
        self.column_entries = constant(np.append(by_column.data, np.uint32(0)))
        self.column_rows = constant(np.append(by_column.indices.astype(np.uint32), np.uint32(0)))


def jacobian_footprint(pixels: int, voxels: int, longest: int) -> Footprint:
    """What the derivatives of so many pixels and voxels take at most, on a grid with so many voxels along an axis."""
    slots = pixels * longest * TILE_WIDTH**2
    entries = min(slots, pixels * voxels)
    sums = 8.0 * min(slots, _SLOTS_AT_ONCE + longest * TILE_WIDTH**2)
    far = 12.0 * (1 << 25)
    return Footprint(16.0 * entries + sums + far, max(4.0 * entries, sums, far), 16.0 * entries)


class Jacobian(LinearOperator):
    """Derivatives of pixels' radiances with respect to voxels' extinctions, W m^-2 sr^-1 km.

    Near a pixel's line of sight every voxel has an entry of its own; elsewhere blocks of pixels and voxels share one.
    Products, `jacobian @ x` and `jacobian.T @ y`, are made on the device in single precision, in an order that
    nothing changes; they change nothing themselves.

    Parameters
    ----------
    structure : which entries there are
    near, far : their values on the device, float32
    """

    def __init__(self, structure: NearField, near: DeviceArray, far: DeviceArray) -> None:
        super().__init__(np.dtype(np.float32), (structure.pixels, structure.voxels))
        self._structure, self._near, self._far = structure, near, far
        self._buffers: dict[Any, Any] = {}

    def _matvec(self, x: np.ndarray) -> np.ndarray:
        return self._times(np.asarray(x, np.float32).reshape(-1, 1))[:, 0]

    def _rmatvec(self, y: np.ndarray) -> np.ndarray:
        return self._transposed(np.asarray(y, np.float32).reshape(-1, 1))[:, 0]

    def _matmat(self, x: np.ndarray) -> np.ndarray:
        return _by_columns(self._times, np.asarray(x, np.float32))

    def _rmatmat(self, y: np.ndarray) -> np.ndarray:
        return _by_columns(self._transposed, np.asarray(y, np.float32))

    def curvature(self, weights: np.ndarray) -> np.ndarray:
        """The diagonal of J^T W J, about: sum_d w_d (near_dv^2 + far_dv^2), for scaling.

        Parameters
        ----------
        weights : w, shape (pixels,)

        Returns
        -------
        shape (voxels,), float64
        """
        return self._transposed(np.asarray(weights, np.float32)[:, None], squares=True)[:, 0].astype(float)

    @device_errors("a product with the derivatives")
    def _times(self, x: np.ndarray) -> np.ndarray:
        """J x for vectors, shape (voxels, vectors)."""
        own, vectors = self._structure, x.shape[1]
        given, sums, far, result = self._arrays(
            vectors, own.voxels, len(own.voxel_blocks), len(own.pixel_blocks), own.pixels
        )
        given.set(np.ascontiguousarray(x))
        blocks, pixel_blocks = own.voxel_blocks, own.pixel_blocks
        self._sum_members(vectors, "voxels", blocks, given, sums)
        counts = {"pixel_block_count": len(pixel_blocks), "block_count": len(blocks)}
        self._launch(vectors, "far_times", len(pixel_blocks), **counts, far=self._far, x=sums, result=far)
        self._launch(
            vectors, "jacobian_times", own.pixels, pixel_count=own.pixels, row_start=own.row_start,
            columns=own.columns, values=self._near, pixel_block=own.pixel_block, of_blocks=far, x=given, result=result,
        )  # fmt: skip
        return result.get()

    @device_errors("a product with the derivatives")
    def _transposed(self, y: np.ndarray, squares: bool = False) -> np.ndarray:
        """J^T y for vectors, shape (pixels, vectors); of squared entries for a curvature."""
        own, vectors = self._structure, y.shape[1]
        given, sums, far, result = self._arrays(
            vectors, own.pixels, len(own.pixel_blocks), len(own.voxel_blocks), own.voxels
        )
        given.set(np.ascontiguousarray(y))
        blocks, pixel_blocks = own.voxel_blocks, own.pixel_blocks
        self._sum_members(vectors, "pixels", pixel_blocks, given, sums)
        counts = {"pixel_block_count": len(pixel_blocks), "block_count": len(blocks)}
        self._launch(
            vectors, "far_transposed", len(blocks), **counts, far=self._far, squares=squares, y=sums, result=far
        )
        self._launch(
            vectors, "jacobian_transposed", own.voxels, voxel_count=own.voxels, column_start=own.column_start,
            entries=own.column_entries, rows=own.column_rows, values=self._near, squares=squares, block=own.block,
            of_blocks=far, y=given, result=result,
        )  # fmt: skip
        return result.get()

    def _sum_members(self, vectors: int, name: str, blocks: Blocks, given: DeviceArray, result: DeviceArray) -> None:
        if name not in self._buffers:
            constant = self._structure.device.constant
            self._buffers[name] = {"member_start": constant(blocks.start), "members": constant(blocks.members)}
        self._launch(
            vectors, "sum_members", len(blocks), block_count=len(blocks), **self._buffers[name], x=given, result=result
        )

    def _arrays(self, vectors: int, *lengths: int) -> list[DeviceArray]:
        """Arrays on the device for so many vectors of these lengths; made once."""
        key = (vectors, *lengths)
        if key not in self._buffers:
            device = self._structure.device
            self._buffers[key] = [device.empty((length, vectors), np.float32) for length in lengths]
        return self._buffers[key]

    def _launch(self, vectors: int, name: str, work_items: int, **arguments: Any) -> None:
        device: Device = self._structure.device
        features = ("NUMBERS float",) if vectors == 1 else (f"NUMBERS float{_VECTORS}",)
        device.launch(device.kernel("products", name, features), work_items, **arguments)


def _by_columns(product: Any, columns: np.ndarray) -> np.ndarray:
    """A product with the columns of a matrix, so many at a time as kernels take."""
    results = []
    for first in range(0, columns.shape[1], _VECTORS):
        part = columns[:, first : first + _VECTORS]
        padded = np.zeros((len(columns), _VECTORS), np.float32)
        padded[:, : part.shape[1]] = part
        results.append(product(padded)[:, : part.shape[1]])
    return np.hstack(results)


class JacobianSums:
    """The average of the derivatives of some renderings; it is changed in place, for it is large.

    Parameters
    ----------
    operator : with a mask
    """

    @device_errors("the derivatives")
    def __init__(self, operator: RadianceOperator) -> None:
        self._operator = operator
        self._table = RadianceTable(operator)
        self.structure = NearField(operator, self._table.column)
        device, own = operator.device, self.structure
        self._near = device.zeros(max(own.entries, 1), np.float32)
        self._far = device.zeros((len(own.pixel_blocks), len(own.voxel_blocks)), np.float32)
        self._far_sums = device.zeros(self._far.shape, np.int64)
        constant = operator.device.constant
        self._sizes = {
            "block_pixels": constant(own.pixel_blocks.sizes), "block_voxels": constant(own.voxel_blocks.sizes)
        }  # fmt: skip

    @property
    def jacobian(self) -> Jacobian:
        """The average so far."""
        return Jacobian(self.structure, self._near, self._far)

    @device_errors("the derivatives")
    def add(self, rendering: Rendering, rate: float) -> None:
        """Changes the average into average + rate (derivatives of a rendering that stored its paths - average).

        Raises
        ------
        AuditError, TransportError : as `RadianceOperator.gradient`
        """
        self._table.prepare(rendering)
        own, operator = self.structure, self._operator
        unit = operator.scene.sun.irradiance / rendering.samples * rate / DERIVATIVE_UNIT
        overflown = operator.device.zeros(1, np.uint32)
        self._far_sums.fill(0)
        for first, count in self._rows():
            slots = int(own.slot_start_on_host[first + count] - own.slot_start_on_host[first])
            sums = operator.device.zeros(max(slots, 1), np.int64)
            self._add_paths(rendering, first, count, sums)
            operator.device.launch(
                operator.device.kernel("near_field", "average_near"), count, scene=own.scene_struct, column=own.column,
                tiles=own.tiles, slot_start=own.slot_start, first_pixel=first, row_count=count,
                row_start=own.row_start, near_sums=sums, keep=1 - rate, unit=unit, values=self._near,
                overflown=overflown,
            )  # fmt: skip
        operator.device.launch(
            operator.device.kernel("near_field", "average_far"), self._far.size,
            pixel_block_count=len(own.pixel_blocks), block_count=len(own.voxel_blocks), far_sums=self._far_sums,
            **self._sizes, keep=1 - rate, unit=unit, far=self._far, overflown=overflown,
        )  # fmt: skip
        if overflown.get()[0]:
            raise TransportError(
                "the derivatives have left the range of their 64-bit sums, or something that is no number was added: "
                "the optics are extreme, or the device is at fault; use fewer paths at a time, or another device"
            )

    def _add_paths(self, rendering: Rendering, first: int, count: int, sums: DeviceArray) -> None:
        own = self.structure
        kernel = self._operator.device.kernel("jacobian", "jacobian_paths", self._table.features)
        for launch in self._operator.stored_launches(rendering):
            launch.run_rows(
                kernel, count, **self._table.buffers, tiles=own.tiles, slot_start=own.slot_start, first_pixel=first,
                row_count=count, place=own.place, block=own.block, pixel_block=own.pixel_block,
                block_count=len(own.voxel_blocks), near_sums=sums, far_sums=self._far_sums,
            )  # fmt: skip

    def _rows(self) -> list[tuple[int, int]]:
        """Pixels whose sums are made at a time: the first, and how many."""
        start, parts, first = self.structure.slot_start_on_host, [], 0
        while first < self.structure.pixels:
            last = int(np.searchsorted(start, start[first] + _SLOTS_AT_ONCE, side="right")) - 1
            last = min(max(last, first + 1), self.structure.pixels)
            parts.append((first, last - first))
            first = last
        return parts
