"""The unknowns of a recovery: the extinction of the voxels that may hold cloud."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cloudtomo_cl.arguments import a, require_kinds
from cloudtomo_cl.errors import DataError
from cloudtomo_cl.scene.arrays import real_numbers
from cloudtomo_cl.scene.grid import Grid
from cloudtomo_cl.scene.masks import checked_mask


@dataclass(frozen=True, eq=False)
class Voxels:
    """The voxels of a mask, in the order of `array[mask]`.

    Attributes
    ----------
    grid : grid of the voxels
    mask : voxels that may hold cloud, shape of the grid; bool, into which 0 and 1 are converted

    Raises
    ------
    DataError : the mask does not fit the grid (`checked_mask`)
    """

    grid: Grid
    mask: np.ndarray

    def __post_init__(self) -> None:
        require_kinds("Voxels", grid=(self.grid, a(Grid)))
        object.__setattr__(self, "mask", checked_mask(self.mask, self.grid))

    def __len__(self) -> int:
        return int(np.count_nonzero(self.mask))

    def __repr__(self) -> str:
        return f"Voxels({len(self)} of {self.grid.text})"

    def on_grid(self, values: np.ndarray) -> np.ndarray:
        """Values of the voxels, shape (voxels,), or one for all, on the grid, float32; 0 outside of the mask.

        Raises
        ------
        DataError : values of another shape, or that are no numbers (InvalidArgumentError)
        """
        values = real_numbers(values, "values")
        if values.shape not in ((), (1,), (len(self),)):
            raise DataError(f"values have shape {values.shape}: it must be ({len(self)},), the voxels of the mask")
        array = np.zeros(self.mask.shape, np.float32)
        array[self.mask] = values
        return array
