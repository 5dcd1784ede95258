"""The voxel grid of a domain, and conservative resampling between grids."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

import numpy as np
from pydantic import ConfigDict, Field
from pydantic.dataclasses import dataclass

from cloudtomo_cl.arguments import WHOLE, place, require_kinds, several
from cloudtomo_cl.errors import DataError
from cloudtomo_cl.messages import answering

Count = Annotated[int, Field(ge=1)]
Length = Annotated[float, Field(gt=0, allow_inf_nan=False)]
Coordinate = Annotated[float, Field(allow_inf_nan=False)]
Triple = tuple[Coordinate, Coordinate, Coordinate]


def _times(numbers: Sequence[float]) -> str:
    return " x ".join(f"{number:.6g}" for number in numbers)


@answering
@dataclass(frozen=True, config=ConfigDict(extra="forbid"))
class Grid:
    """A box of voxels; extinction is constant inside a voxel.

    Attributes
    ----------
    shape : numbers of voxels along x (east), y (north), z (up)
    spacing : edges of a voxel along x, y, z, km
    origin : lower corner of the domain, km; the ground is z = 0
    """

    shape: tuple[Count, Count, Count]
    spacing: tuple[Length, Length, Length]
    origin: tuple[Coordinate, Coordinate, Annotated[float, Field(ge=0, allow_inf_nan=False)]] = (0.0, 0.0, 0.0)

    @property
    def text(self) -> str:
        """Numbers of voxels and their size, as text."""
        return f"{_times(self.shape)} voxels of {_times(self.spacing)} km"

    @property
    def extent(self) -> Triple:
        """Edges of the domain in km."""
        return tuple(n * d for n, d in zip(self.shape, self.spacing))  # type: ignore[return-value]

    @property
    def centre(self) -> Triple:
        """The domain's centre in km."""
        return tuple(o + e / 2 for o, e in zip(self.origin, self.extent))  # type: ignore[return-value]

    @property
    def voxel_volume(self) -> float:
        """Volume of a voxel, km^3."""
        return float(np.prod(self.spacing))

    @property
    def mean_chord(self) -> float:
        """Mean chord of a voxel, km."""
        return mean_chord(self.spacing)

    def centres(self, axis: int) -> np.ndarray:
        """Coordinates of the voxels' centres along an axis (0, 1, 2), km. InvalidArgumentError for another axis."""
        require_kinds("Grid.centres", axis=(axis, place(3)))
        return self.origin[axis] + (np.arange(self.shape[axis]) + 0.5) * self.spacing[axis]

    def with_shape(self, shape: Sequence[int]) -> Grid:
        """A grid of the same domain with other numbers of voxels.

        Raises
        ------
        DataError : shape is no three whole numbers (InvalidArgumentError), or one of them below 1
        """
        require_kinds("Grid.with_shape", shape=(shape, several(3, WHOLE)))
        if min(shape) < 1:
            raise DataError(f"Grid.with_shape: shape is {tuple(shape)}: there must be at least 1 voxel along each axis")
        nx, ny, nz = shape
        width, depth, height = self.extent
        return Grid(shape=(nx, ny, nz), spacing=(width / nx, depth / ny, height / nz), origin=self.origin)


def mean_chord(edges: Triple) -> float:
    """Mean chord of a box, in the unit of its edges: 4 volume / surface, as for every convex body (Cauchy 1850)."""
    x, y, z = edges
    return 4 * x * y * z / (2 * (x * y + y * z + z * x))


def overlap_matrix(count: int, count_new: int) -> np.ndarray:
    """Share of each new cell that lies in each old cell of the same interval.

    Returns an array of shape (count_new, count) whose rows sum to 1.
    """
    edges = np.linspace(0.0, 1.0, count + 1)
    edges_new = np.linspace(0.0, 1.0, count_new + 1)
    lower = np.maximum(edges_new[:-1, None], edges[None, :-1])
    upper = np.minimum(edges_new[1:, None], edges[None, 1:])
    return np.maximum(upper - lower, 0.0) * count_new


def resample(values: np.ndarray, shape: Sequence[int]) -> np.ndarray:
    """Averages over the cells of another grid of the same domain (any dimension).

    The mean over the domain is kept: so are the optical mass of an extinction and the flux of an image.
    """
    result = np.asarray(values, dtype=np.float64)
    for axis, count_new in enumerate(shape):
        if result.shape[axis] != count_new:
            matrix = overlap_matrix(result.shape[axis], count_new)
            result = np.moveaxis(np.tensordot(matrix, result, axes=(1, axis)), 0, axis)
    return result


def resample_in_mask(values: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """Resamples `values` to the grid of `mask`, with nothing outside of the mask.

    The content of an old cell goes into the part of the cell inside the mask, so that the optical mass
    is conserved and cells at the mask's edge are not diluted. The content of old cells completely
    outside of the mask is lost.
    """
    inside = resample(mask, values.shape)
    concentrated = np.divide(values, inside, out=np.zeros(values.shape), where=inside > 0)
    return resample(concentrated, mask.shape) * mask


def coarsened(mask: np.ndarray, shape: Sequence[int]) -> np.ndarray:
    """The mask on another grid of the same domain: voxels that overlap a voxel of the mask.

    Parameters
    ----------
    mask : mask, bool
    shape : numbers of voxels of the other grid

    Returns
    -------
    mask on the other grid, bool
    """
    # Edges that coincide up to rounding are no overlap.
    return resample(mask, shape) > 1e-9
