"""Derivatives of pixels with respect to voxels: a sparse near field, a far field by blocks, and products with both.

Of several ranks each makes the rows of its pixels, and products with the columns of its voxels (by_voxel.py): those
with the transpose are each rank's own numbers, which whoever adds to them hands out (`Gathering`).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.sparse.linalg import LinearOperator

from cloudtomo_cl.errors import DataError, TransportError
from cloudtomo_cl.opencl.arrays import DeviceArray
from cloudtomo_cl.opencl.device import Device, device_errors
from cloudtomo_cl.opencl.gathering import Gathering
from cloudtomo_cl.opencl.layout import DERIVATIVE_UNIT, TILE_WIDTH
from cloudtomo_cl.opencl.memory import Footprint
from cloudtomo_cl.parallel.ranks import Shares
from cloudtomo_cl.transport.by_voxel import COLUMNS_AT_ONCE, FAR_PART, PRODUCT_FEATURES, ByVoxel, by_voxel
from cloudtomo_cl.transport.derivatives import RadianceTable
from cloudtomo_cl.transport.near_field import MOST_PAIRS, Blocks, pixel_blocks, tiles_of, voxel_blocks
from cloudtomo_cl.transport.radiance import RadianceOperator, Rendering
from cloudtomo_cl.transport.voxel_shares import voxel_shares

# Slots of tiles whose sums are made at a time; a CPU is busy with fewer paths, and they take memory.
_SLOTS_AT_ONCE, _SLOTS_ON_CPU = 1 << 24, 1 << 20
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
    voxel_shares : which rank has which of these
    """

    @device_errors("the structure of the derivatives")
    def __init__(self, operator: RadianceOperator, column: Any) -> None:
        assert operator.mask is not None
        self.device, self.column = operator.device, column
        self.scene_struct = operator.scene_struct
        row_start, columns = self.device.ranks.together(lambda: self._find(operator))
        self.by_voxel: ByVoxel = by_voxel(self, row_start, columns)

    def _find(self, operator: RadianceOperator) -> tuple[np.ndarray, np.ndarray]:
        """Finds this rank's entries: where its rows begin, and their columns."""
        assert operator.mask is not None
        self.pixels, self.voxels = len(operator.pixels), int(operator.mask.sum())
        self.shares = operator.shares
        self.voxel_shares = voxel_shares(operator.mask, self.device.ranks)
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
        return row_start, self.device.copied(self.columns)[: self.entries]

    def _launch(self, name: str, **arguments: Any) -> None:
        if self.rows:
            self.device.launch(
                self.device.kernel("near_field", name), self.rows, scene=self.scene_struct, tiles=self.tiles,
                column=self.column, pixel_count=self.rows, **arguments,
            )  # fmt: skip


def jacobian_footprint(pixels: int, voxels: int, longest: int, entries: int) -> Footprint:
    """What the derivatives of so many pixels and voxels take, on a grid with so many voxels along an axis.

    entries : of the near field (`about_how_many_entries`)
    """
    sums = 8.0 * min(pixels * longest * TILE_WIDTH**2, _SLOTS_AT_ONCE + longest * TILE_WIDTH**2)
    far = 12.0 * min(MOST_PAIRS, pixels * voxels)
    return Footprint(20.0 * entries + sums + far, max(4.0 * entries, sums, far), 16.0 * entries)


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
        self._of_pixels = Gathering(structure.device, structure.shares)
        self._of_voxels = Gathering(structure.device, structure.voxel_shares)

    @property
    def voxel_shares(self) -> Shares:
        """Which rank makes which numbers of a product with the transpose."""
        return self._structure.voxel_shares

    def _matvec(self, x: np.ndarray) -> np.ndarray:
        return self._of_host(self.times, x, self.shape[0])

    def _rmatvec(self, y: np.ndarray) -> np.ndarray:
        def transposed(given: DeviceArray, result: DeviceArray) -> None:
            self.transposed(given, result)
            self._of_voxels.complete(result)

        return self._of_host(transposed, y, self.shape[1])

    def _of_host(self, product: Any, vector: np.ndarray, length: int) -> np.ndarray:
        """A product with a vector of the host."""
        given, result = self._array("given", vector.size), self._array("result", length)
        given.set(np.ascontiguousarray(vector, np.float32).reshape(-1))
        product(given, result)
        return result.get()

    def curvature(self, weights: np.ndarray) -> np.ndarray:
        """The diagonal of J^T W J: sum_d w_d J_dv^2.

        Parameters
        ----------
        weights : w, shape (pixels,)

        Returns
        -------
        shape (voxels,), float64
        """
        own, structure = self._structure.by_voxel, self._structure
        given, result = self._array("given", structure.pixels), self._array("result", structure.voxels)
        given.set(np.ascontiguousarray(weights, np.float32))
        far = self._far_transposed(given, squares=True)
        self._launch(
            "jacobian_curvature", structure.voxels, **self._by_column, pixel_block=own.pixel_block,
            block_count=len(own.blocks), far=self._far_by_voxel, of_blocks=far, y=given, result=result,
        )  # fmt: skip
        self._of_voxels.complete(result)
        return result.get().astype(float)

    @device_errors("a product with the derivatives")
    def times(self, x: DeviceArray, result: DeviceArray) -> None:
        """Makes `result`, shape (pixels,), J x; both on the device, float32."""
        own = self._structure
        blocks, rows = own.voxel_blocks, len(own.row_blocks)
        sums = self._sum_members("voxels", blocks, x)
        counts = {"pixel_block_count": rows, "block_count": len(blocks)}
        far = self._in_parts("far_times", len(blocks), rows, rows, **counts, far=self._far, x=sums)
        part = result if own.shares.owner is None else self._array("part", own.rows)
        self._launch(
            "jacobian_times", own.rows, pixel_count=own.rows, row_start=own.row_start, columns=own.columns,
            values=self._near, pixel_block=own.pixel_block, of_blocks=far, x=x, result=part,
        )  # fmt: skip
        self._of_pixels.join(part, result)

    @device_errors("a product with the derivatives")
    def transposed(self, y: DeviceArray, result: DeviceArray) -> None:
        """Makes `result`, shape (voxels,), J^T y; both on the device, float32.

        Of several ranks each makes the numbers of its voxels (`voxel_shares`); the others' are any.
        """
        far = self._far_transposed(y, squares=False)
        self._launch(
            "jacobian_transposed", self._structure.voxels, **self._by_column, of_blocks=far, y=y, result=result
        )

    def _far_transposed(self, y: DeviceArray, squares: bool) -> DeviceArray:
        """The far field's part for this rank's blocks of voxels."""
        own = self._structure
        rows, blocks = len(own.pixel_blocks), len(own.by_voxel.blocks)
        sums = self._sum_members("pixels", own.pixel_blocks, y)
        return self._in_parts(
            "far_transposed", rows, blocks, -(-blocks // COLUMNS_AT_ONCE), pixel_block_count=rows,
            block_count=blocks, far=self._far_by_voxel, squares=squares, y=sums,
        )  # fmt: skip

    @property
    def _by_column(self) -> dict[str, Any]:
        """The near field as kernels take it that go through its columns."""
        own = self._structure.by_voxel
        return {
            "voxel_count": self._structure.voxels, "column_start": own.start, "rows": own.rows,
            "values": self._near_by_voxel, "block": own.block,
        }  # fmt: skip

    def _sum_members(self, name: str, blocks: Blocks, given: DeviceArray) -> DeviceArray:
        """The sums of a vector over the members of blocks."""
        if name not in self._buffers:
            constant = self._structure.device.constant
            self._buffers[name] = {"member_start": constant(blocks.start), "members": constant(blocks.members)}
        sums = self._array("sums", len(blocks))
        self._launch("sum_members", len(blocks), block_count=len(blocks), **self._buffers[name], x=given, result=sums)
        return sums

    def _in_parts(self, name: str, summed: int, count: int, work_items: int, **arguments: Any) -> DeviceArray:
        """A product whose sums of so many numbers are made in parts, each by so many work items; `count` results."""
        parts = -(-summed // FAR_PART)
        of_parts, result = self._array("parts", parts * count), self._array("far", count)
        self._launch(name, parts * work_items, **arguments, result=of_parts)
        self._launch("sum_parts", count, count=count, part_count=parts, parts=of_parts, result=result)
        return result

    def _array(self, use: str, length: int) -> DeviceArray:
        """An array on the device for one use, made once."""
        key = (use, length)
        if key not in self._buffers:
            self._buffers[key] = self._structure.device.empty(max(length, 1), np.float32)
        return self._buffers[key]

    def _launch(self, name: str, work_items: int, **arguments: Any) -> None:
        if work_items:
            device: Device = self._structure.device
            device.launch(device.kernel("products", name, PRODUCT_FEATURES), work_items, **arguments)


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
        operator.ranks.together(self._make_room)

    def _make_room(self) -> None:
        device, own = self._operator.device, self.structure
        self._near = device.zeros(max(own.entries, 1), np.float32)
        self._far = device.zeros((max(len(own.row_blocks), 1), len(own.voxel_blocks)), np.float32)
        self._by_voxel = own.by_voxel.arrays(self._near, self._far)
        constant = device.constant
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
        self._table.release()
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
        device, features = self._operator.device, self._table.features
        paths, rays = (device.kernel("jacobian", name, features) for name in ("jacobian_paths", "jacobian_rays"))
        left = self._table.rays(rendering)
        weight = rendering.samples / left
        arguments = self._table.buffers | {
            "tiles": own.tiles, "slot_start": own.slot_start, "first_pixel": first, "row_count": count,
            "place": own.place, "block": own.block, "pixel_block": own.pixel_block,
            "block_count": len(own.voxel_blocks), "near_sums": near_sums, "far_sums": far_sums,
        }  # fmt: skip
        for launch in self._operator.stored_launches(rendering):
            launch.run_rows(paths, count, **arguments)
            left -= launch.run_rays(rays, count, left, weight=weight, **arguments)

    def _rows(self) -> list[tuple[int, int]]:
        """Pixels whose sums are made at a time: the first, and how many."""
        start, parts, first = self.structure.slot_start_on_host, [], 0
        most = _SLOTS_AT_ONCE // self._operator.ranks.size
        if not self._operator.device.regenerates:
            most = min(most, _SLOTS_ON_CPU)
        while first < self.structure.rows:
            last = int(np.searchsorted(start, start[first] + most, side="right")) - 1
            last = min(max(last, first + 1), self.structure.rows)
            parts.append((first, last - first))
            first = last
        return parts
