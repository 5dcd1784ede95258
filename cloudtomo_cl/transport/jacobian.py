"""Derivatives of pixels with respect to voxels: a sparse near field, a far field by blocks, and products with both.

Of several ranks each makes the rows of its pixels, and products with the columns of its voxels
(jacobian_columns.py): those with the transpose are each rank's own numbers, which whoever adds to them hands out
(`Gathering`).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.sparse.linalg import LinearOperator

from cloudtomo_cl.errors import DataError
from cloudtomo_cl.opencl.arrays import DeviceArray
from cloudtomo_cl.opencl.device import Device
from cloudtomo_cl.opencl.driver import device_errors
from cloudtomo_cl.opencl.gathering import Gathering
from cloudtomo_cl.opencl.layout import TILE_WIDTH
from cloudtomo_cl.opencl.memory import Footprint
from cloudtomo_cl.parallel.ranks import Shares
from cloudtomo_cl.scene.arrays import real_numbers
from cloudtomo_cl.transport.blocks import MOST_PAIRS, Blocks
from cloudtomo_cl.transport.jacobian_columns import COLUMNS_AT_ONCE, FAR_PART, PRODUCT_FEATURES, JacobianColumns
from cloudtomo_cl.transport.jacobian_structure import JacobianStructure

# Slots of tiles whose sums are made at a time.
SLOTS_AT_ONCE = 1 << 24


def jacobian_footprint(pixels: int, voxels: int, longest: int, entries: int) -> Footprint:
    """What the derivatives of so many pixels and voxels take, on a grid with so many voxels along an axis.

    entries : of the near field (`about_how_many_entries`)
    """
    sums = 8.0 * min(pixels * longest * TILE_WIDTH**2, SLOTS_AT_ONCE + longest * TILE_WIDTH**2)
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
    columns : the same of this rank's voxels, by columns
    """

    def __init__(
        self, structure: JacobianStructure, near: DeviceArray, far: DeviceArray, columns: JacobianColumns
    ) -> None:
        super().__init__(np.dtype(np.float32), (structure.pixels, structure.voxels))
        self._structure, self._near, self._far, self._columns = structure, near, far, columns
        self._pixel_members, self._voxel_members = (
            self._members(blocks) for blocks in (structure.far.pixel_blocks, structure.far.voxel_blocks)
        )
        self._work: dict[tuple[str, int], DeviceArray] = {}
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
        given.set(np.ascontiguousarray(real_numbers(vector, "the vector"), np.float32).reshape(-1))
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

        Raises
        ------
        DataError : weights of another shape, or that are no numbers (InvalidArgumentError)
        """
        weights = real_numbers(weights, "weights")
        if weights.shape != (self.shape[0],):
            raise DataError(f"weights have shape {weights.shape}: it must be ({self.shape[0]},), the pixels")
        structure, columns = self._structure, self._columns
        given, result = self._array("given", structure.pixels), self._array("result", structure.voxels)
        given.set(np.ascontiguousarray(weights, np.float32))
        far = self._far_transposed(given, squares=True)
        self._launch(
            "jacobian_curvature", structure.voxels, **self._by_column, pixel_block=columns.pixel_block,
            block_count=len(columns.blocks), far=columns.far, of_blocks=far, y=given, result=result,
        )  # fmt: skip
        self._of_voxels.complete(result)
        return result.get().astype(float)

    @device_errors("a product with the derivatives")
    def times(self, x: DeviceArray, result: DeviceArray) -> None:
        """Makes `result`, shape (pixels,), J x; both on the device, float32."""
        structure = self._structure
        blocks, row_blocks, rows = len(structure.far.voxel_blocks), len(structure.far.row_blocks), structure.rows
        sums = self._sum_members(self._voxel_members, x)
        counts = {"pixel_block_count": row_blocks, "block_count": blocks}
        far = self._in_parts("far_times", blocks, row_blocks, row_blocks, **counts, far=self._far, x=sums)
        part = result if structure.shares.owner is None else self._array("part", rows)
        self._launch(
            "jacobian_times", rows, pixel_count=rows, row_start=structure.near.start, columns=structure.near.columns,
            values=self._near, pixel_block=structure.far.pixel_block, of_blocks=far, x=x, result=part,
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
        rows, blocks = len(self._structure.far.pixel_blocks), len(self._columns.blocks)
        sums = self._sum_members(self._pixel_members, y)
        return self._in_parts(
            "far_transposed", rows, blocks, -(-blocks // COLUMNS_AT_ONCE), pixel_block_count=rows,
            block_count=blocks, far=self._columns.far, squares=squares, y=sums,
        )  # fmt: skip

    @property
    def _by_column(self) -> dict[str, Any]:
        """The near field as kernels take it that go through its columns."""
        columns = self._columns
        return {
            "voxel_count": self._structure.voxels, "column_start": columns.start, "rows": columns.rows,
            "values": columns.near, "block": columns.block,
        }  # fmt: skip

    def _members(self, blocks: Blocks) -> dict[str, Any]:
        """Of blocks, as kernels take them."""
        constant = self._structure.device.constant
        return {
            "block_count": len(blocks), "member_start": constant(blocks.start), "members": constant(blocks.members),
        }  # fmt: skip

    def _sum_members(self, members: dict[str, Any], given: DeviceArray) -> DeviceArray:
        """The sums of a vector over the members of blocks."""
        sums = self._array("sums", members["block_count"])
        self._launch("sum_members", members["block_count"], **members, x=given, result=sums)
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
        if key not in self._work:
            self._work[key] = self._structure.device.empty(max(length, 1), np.float32)
        return self._work[key]

    def _launch(self, name: str, work_items: int, **arguments: Any) -> None:
        if work_items:
            device: Device = self._structure.device
            device.launch(device.kernel("products", name, PRODUCT_FEATURES), work_items, **arguments)
