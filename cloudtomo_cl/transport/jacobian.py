"""Derivatives of pixels with respect to voxels: a sparse near field, a far field by blocks, and products with both.

Of several ranks each makes the rows of its pixels, and products with the columns of its voxels (by_voxel.py).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.sparse.linalg import LinearOperator

from cloudtomo_cl.errors import DataError, TransportError
from cloudtomo_cl.opencl.arrays import DeviceArray
from cloudtomo_cl.opencl.device import Device, device_errors
from cloudtomo_cl.opencl.layout import DERIVATIVE_UNIT, TILE_WIDTH
from cloudtomo_cl.opencl.memory import Footprint
from cloudtomo_cl.transport.by_voxel import ByVoxel, by_voxel
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
    shares : which rank has which pixels: what follows is of this one's
    rows : number of its pixels
    entries : of the near field
    row_blocks : its pixel blocks
    by_voxel : the entries by columns
    """

    @device_errors("the structure of the derivatives")
    def __init__(self, operator: RadianceOperator, column: Any) -> None:
        assert operator.mask is not None
        self.device, self.column = operator.device, column
        self.scene_struct = operator.scene_struct
        self.pixels, self.voxels = len(operator.pixels), int(operator.mask.sum())
        self.shares = operator.shares
        self.rows = len(self.shares)
        tiles = tiles_of(operator.views, self.shares.taken(operator.pixels), operator.scene, operator.mask)
        slots = tiles["slabs"].astype(np.int64) * TILE_WIDTH**2
        self.slot_start_on_host = np.concatenate([[0], np.cumsum(slots)])
        if self.slot_start_on_host[-1] > _MOST_ENTRIES:
            raise DataError(
                f"the near field of {self.rows} pixels and {self.voxels} voxels has more entries than kernels count: "
                "choose fewer pixels or a coarser grid"
            )
        constant = self.device.constant
        self.tiles = constant(tiles)
        self.slot_start = constant(self.slot_start_on_host.astype(np.uint32))
        self.pixel_blocks = pixel_blocks(operator.views, operator.pixels)
        self.voxel_blocks = voxel_blocks(operator.mask, len(self.pixel_blocks))
        # Blocks are dealt out whole.
        self.row_blocks, row_block = np.unique(self.shares.taken(self.pixel_blocks.of), return_inverse=True)
        self.pixel_block = constant(row_block.astype(np.uint32))
        self.block = constant(self.voxel_blocks.of)
        places = np.zeros((self.voxels, 4), np.uint16)
        places[:, :3] = np.argwhere(operator.mask)
        self.place = constant(places)
        counts = self.device.zeros(max(self.rows, 1), np.uint32)
        self._launch("near_count", counts=counts)
        row_start = np.concatenate([[0], np.cumsum(counts.get()[: self.rows], dtype=np.int64)])
        self.entries = int(row_start[-1])
        self.row_start = constant(row_start.astype(np.uint32))
        self.columns = self.device.empty(max(self.entries, 1), np.int32)
        self._launch("near_fill", row_start=self.row_start, columns=self.columns)
        self.by_voxel: ByVoxel = by_voxel(self, row_start, self.columns.get()[: self.entries])

    def _launch(self, name: str, **arguments: Any) -> None:
        if self.rows:
            self.device.launch(
                self.device.kernel("near_field", name), self.rows, scene=self.scene_struct, tiles=self.tiles,
                column=self.column, pixel_count=self.rows, **arguments,
            )  # fmt: skip


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
    near, far : their values on the device, float32; of this rank's pixels, by rows
    by_voxel : the same of this rank's voxels, by columns
    """

    def __init__(
        self, structure: NearField, near: DeviceArray, far: DeviceArray, by_voxel: tuple[DeviceArray, DeviceArray]
    ) -> None:
        super().__init__(np.dtype(np.float32), (structure.pixels, structure.voxels))
        self._structure, self._near, self._far = structure, near, far
        self._near_by_voxel, self._far_by_voxel = by_voxel
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
        """The diagonal of J^T W J: sum_d w_d J_dv^2.

        Parameters
        ----------
        weights : w, shape (pixels,)

        Returns
        -------
        shape (voxels,), float64
        """
        own = self._structure.by_voxel
        far, given, result = self._far_transposed(np.asarray(weights, np.float32)[:, None], squares=True)
        self._launch(
            1, "jacobian_curvature", len(own.shares), **self._by_column, pixel_block=own.pixel_block,
            block_count=len(own.blocks), far=self._far_by_voxel, of_blocks=far, y=given, result=result,
        )  # fmt: skip
        return own.shares.gathered(result.get()[: len(own.shares)])[:, 0].astype(float)

    @device_errors("a product with the derivatives")
    def _times(self, x: np.ndarray) -> np.ndarray:
        """J x for vectors, shape (voxels, vectors)."""
        own, vectors = self._structure, x.shape[1]
        given, sums, far, result = self._arrays(
            vectors, own.voxels, len(own.voxel_blocks), len(own.row_blocks), own.rows
        )
        given.set(np.ascontiguousarray(x))
        blocks, rows = own.voxel_blocks, len(own.row_blocks)
        self._sum_members(vectors, "voxels", blocks, given, sums)
        counts = {"pixel_block_count": rows, "block_count": len(blocks)}
        self._launch(vectors, "far_times", rows, **counts, far=self._far, x=sums, result=far)
        self._launch(
            vectors, "jacobian_times", own.rows, pixel_count=own.rows, row_start=own.row_start,
            columns=own.columns, values=self._near, pixel_block=own.pixel_block, of_blocks=far, x=given, result=result,
        )  # fmt: skip
        return own.shares.gathered(result.get()[: own.rows])

    @device_errors("a product with the derivatives")
    def _transposed(self, y: np.ndarray) -> np.ndarray:
        """J^T y for vectors, shape (pixels, vectors)."""
        vectors, own = y.shape[1], self._structure.by_voxel
        far, given, result = self._far_transposed(y, squares=False)
        self._launch(
            vectors, "jacobian_transposed", len(own.shares), **self._by_column, of_blocks=far, y=given, result=result
        )
        return own.shares.gathered(result.get()[: len(own.shares)])

    def _far_transposed(self, y: np.ndarray, squares: bool) -> tuple[DeviceArray, DeviceArray, DeviceArray]:
        """The far field's part, y on the device, and where the result is to go; of this rank's voxels."""
        own, vectors = self._structure, y.shape[1]
        blocks, voxels = len(own.by_voxel.blocks), len(own.by_voxel.shares)
        given, sums, far, result = self._arrays(vectors, own.pixels, len(own.pixel_blocks), blocks, voxels)
        given.set(np.ascontiguousarray(y))
        self._sum_members(vectors, "pixels", own.pixel_blocks, given, sums)
        self._launch(
            vectors, "far_transposed", blocks, pixel_block_count=len(own.pixel_blocks), block_count=blocks,
            far=self._far_by_voxel, squares=squares, y=sums, result=far,
        )  # fmt: skip
        return far, given, result

    @property
    def _by_column(self) -> dict[str, Any]:
        """The near field as kernels take it that go through its columns."""
        own = self._structure.by_voxel
        return {
            "voxel_count": len(own.shares), "column_start": own.start, "entries": own.entries, "rows": own.rows,
            "values": self._near_by_voxel, "block": own.block,
        }  # fmt: skip

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
            self._buffers[key] = [device.empty((max(length, 1), vectors), np.float32) for length in lengths]
        return self._buffers[key]

    def _launch(self, vectors: int, name: str, work_items: int, **arguments: Any) -> None:
        device: Device = self._structure.device
        features = ("NUMBERS float",) if vectors == 1 else (f"NUMBERS float{_VECTORS}",)
        if work_items:
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
        self._table = operator.ranks.together(lambda: RadianceTable(operator))
        self.structure = NearField(operator, self._table.column)
        device, own = operator.device, self.structure
        self._near = device.zeros(max(own.entries, 1), np.float32)
        self._far = device.zeros((max(len(own.row_blocks), 1), len(own.voxel_blocks)), np.float32)
        self._by_voxel = own.by_voxel.arrays(self._near, self._far)
        constant = operator.device.constant
        self._sizes = {
            "block_pixels": constant(own.pixel_blocks.sizes[own.row_blocks]),
            "block_voxels": constant(own.voxel_blocks.sizes),
        }

    @property
    def jacobian(self) -> Jacobian:
        """The average so far."""
        return Jacobian(self.structure, self._near, self._far, self._by_voxel)

    @device_errors("the derivatives")
    def add(self, rendering: Rendering, rate: float) -> None:
        """Changes the average into average + rate (derivatives of a rendering that stored its paths - average).

        Raises
        ------
        AuditError, TransportError : as `RadianceOperator.gradient`
        """
        self._table.prepare(rendering)
        self._operator.ranks.together(lambda: self._add_rows(rendering, rate))
        self.structure.by_voxel.refresh(self._near, self._far, self._by_voxel)

    def _add_rows(self, rendering: Rendering, rate: float) -> None:
        """The rows of this rank's pixels."""
        own, operator = self.structure, self._operator
        unit = operator.scene.sun.irradiance / rendering.samples * rate / DERIVATIVE_UNIT
        overflown = operator.device.zeros(1, np.uint32)
        far_sums = operator.device.zeros(self._far.shape, np.int64)
        for first, count in self._rows():
            slots = int(own.slot_start_on_host[first + count] - own.slot_start_on_host[first])
            sums = operator.device.zeros(max(slots, 1), np.int64)
            self._add_paths(rendering, first, count, sums, far_sums)
            operator.device.launch(
                operator.device.kernel("near_field", "average_near"), count, scene=own.scene_struct, column=own.column,
                tiles=own.tiles, slot_start=own.slot_start, first_pixel=first, row_count=count,
                row_start=own.row_start, near_sums=sums, keep=1 - rate, unit=unit, values=self._near,
                overflown=overflown,
            )  # fmt: skip
        operator.device.launch(
            operator.device.kernel("near_field", "average_far"), self._far.size,
            pixel_block_count=len(own.row_blocks), block_count=len(own.voxel_blocks), far_sums=far_sums,
            **self._sizes, keep=1 - rate, unit=unit, far=self._far, overflown=overflown,
        )  # fmt: skip
        if overflown.get()[0]:
            raise TransportError(
                "the derivatives have left the range of their 64-bit sums, or something that is no number was added: "
                "the optics are extreme, or the device is at fault; use fewer paths at a time, or another device"
            )

    def _add_paths(
        self, rendering: Rendering, first: int, count: int, near_sums: DeviceArray, far_sums: DeviceArray
    ) -> None:
        own = self.structure
        kernel = self._operator.device.kernel("jacobian", "jacobian_paths", self._table.features)
        for launch in self._operator.stored_launches(rendering):
            launch.run_rows(
                kernel, count, **self._table.buffers, tiles=own.tiles, slot_start=own.slot_start, first_pixel=first,
                row_count=count, place=own.place, block=own.block, pixel_block=own.pixel_block,
                block_count=len(own.voxel_blocks), near_sums=near_sums, far_sums=far_sums,
            )  # fmt: skip

    def _rows(self) -> list[tuple[int, int]]:
        """Pixels whose sums are made at a time: the first, and how many."""
        start, parts, first = self.structure.slot_start_on_host, [], 0
        most = _SLOTS_AT_ONCE // self._operator.ranks.size
        while first < self.structure.rows:
            last = int(np.searchsorted(start, start[first] + most, side="right")) - 1
            last = min(max(last, first + 1), self.structure.rows)
            parts.append((first, last - first))
            first = last
        return parts
