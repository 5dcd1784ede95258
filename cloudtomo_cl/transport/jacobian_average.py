"""The average of the derivatives of several renderings."""

from __future__ import annotations

from functools import partial

import numpy as np

from cloudtomo_cl.opencl.arrays import DeviceArray
from cloudtomo_cl.opencl.driver import device_errors
from cloudtomo_cl.opencl.fixed_point import overflow
from cloudtomo_cl.opencl.layout import DERIVATIVE_UNIT
from cloudtomo_cl.transport.directions import FEATURES
from cloudtomo_cl.transport.jacobian import SLOTS_AT_ONCE, Jacobian
from cloudtomo_cl.transport.jacobian_columns import columns_of
from cloudtomo_cl.transport.jacobian_structure import JacobianStructure
from cloudtomo_cl.transport.radiance import RadianceOperator
from cloudtomo_cl.transport.radiance_table import RadianceTable
from cloudtomo_cl.transport.rendering import Rendering
from cloudtomo_cl.transport.table_builder import RadianceTableBuilder
from cloudtomo_cl.transport.table_gradient import rays

# Slots of tiles whose sums are made at a time on a CPU, which is busy with fewer paths: sums take memory.
_SLOTS_ON_CPU = 1 << 20


class JacobianAverage:
    """The average of the derivatives of some renderings; it is changed in place, for it is large.

    Parameters
    ----------
    operator : with a mask

    Attributes
    ----------
    structure : which derivatives are kept
    jacobian : the average so far
    """

    @device_errors("the derivatives")
    def __init__(self, operator: RadianceOperator) -> None:
        self._operator = operator
        self._builder, self.structure = operator.ranks.together(self._prepared)
        self._columns = columns_of(self.structure, self._near, self._far)
        self.jacobian = operator.ranks.together(lambda: Jacobian(self.structure, self._near, self._far, self._columns))

    def _prepared(self) -> tuple[RadianceTableBuilder, JacobianStructure]:
        """What makes tables, and the structure; and room for the values."""
        operator, device = self._operator, self._operator.device
        builder = RadianceTableBuilder(operator)
        structure = JacobianStructure(operator, builder.column)
        rows, blocks = structure.far.row_blocks, structure.far.voxel_blocks
        self._near = device.zeros(max(structure.near.count, 1), np.float32)
        self._far = device.zeros((max(len(rows), 1), len(blocks)), np.float32)
        self._sizes = {
            "block_pixels": device.constant(structure.far.pixel_blocks.sizes[rows]),
            "block_voxels": device.constant(blocks.sizes),
        }
        return builder, structure

    @device_errors("the derivatives")
    def add(self, rendering: Rendering, rate: float) -> None:
        """Changes the average into average + rate (derivatives of a rendering that stored its paths - average).

        Raises
        ------
        AuditError, TransportError : as `RadianceOperator.gradient`
        """
        # The table is nobody's once this is done: products need its memory.
        self._operator.ranks.together(partial(self._add_rows, self._builder.at(rendering), rendering, rate))
        self._columns.refresh()

    def _add_rows(self, table: RadianceTable, rendering: Rendering, rate: float) -> None:
        """The rows of this rank's pixels."""
        structure, operator = self.structure, self._operator
        unit = operator.scene.sun.irradiance / rendering.samples * rate / DERIVATIVE_UNIT
        overflown = operator.device.zeros(1, np.uint32)
        far_sums = operator.device.zeros(self._far.shape, np.int64)
        for first, count in self._rows():
            sums = operator.device.zeros(max(structure.near.tiles.slots(first, count), 1), np.int64)
            self._add_paths(table, rendering, first, count, sums, far_sums)
            operator.device.launch(
                operator.device.kernel("near_field", "average_near"), count, **structure.near.arguments,
                first_pixel=first, row_count=count, near_sums=sums, keep=1 - rate, unit=unit, values=self._near,
                overflown=overflown,
            )  # fmt: skip
        operator.device.launch(
            operator.device.kernel("near_field", "average_far"), self._far.size,
            pixel_block_count=len(structure.far.row_blocks), block_count=len(structure.far.voxel_blocks),
            far_sums=far_sums, **self._sizes, keep=1 - rate, unit=unit, far=self._far, overflown=overflown,
        )  # fmt: skip
        if overflown.get()[0]:
            raise overflow("the Jacobian")

    def _add_paths(
        self,
        table: RadianceTable,
        rendering: Rendering,
        first: int,
        count: int,
        near_sums: DeviceArray,
        far_sums: DeviceArray,
    ) -> None:
        """Adds the derivatives of the paths of so many pixels from one on."""
        near, far = self.structure.near, self.structure.far
        device, features = self._operator.device, (*rendering.path_features, *FEATURES)
        of_paths, of_rays = (device.kernel("jacobian", name, features) for name in ("jacobian_paths", "jacobian_rays"))
        left = rays(rendering)
        weight = rendering.samples / left
        arguments = table.arguments | {
            **near.tiles.arguments, "first_pixel": first, "row_count": count, "place": near.place,
            "block": far.voxel_block, "pixel_block": far.pixel_block, "block_count": len(far.voxel_blocks),
            "near_sums": near_sums, "far_sums": far_sums,
        }  # fmt: skip
        for launch in self._operator.stored_launches(rendering):
            launch.run_rows(of_paths, count, **arguments)
            left -= launch.run_rays(of_rays, count, left, weight=weight, **arguments)

    def _rows(self) -> list[tuple[int, int]]:
        """Pixels whose sums are made at a time: the first, and how many."""
        start, parts, first = self.structure.near.tiles.start_on_host, [], 0
        most = SLOTS_AT_ONCE // self._operator.ranks.size
        if not self._operator.device.regenerates:
            most = min(most, _SLOTS_ON_CPU)
        while first < self.structure.rows:
            last = int(np.searchsorted(start, start[first] + most, side="right")) - 1
            last = min(max(last, first + 1), self.structure.rows)
            parts.append((first, last - first))
            first = last
        return parts
