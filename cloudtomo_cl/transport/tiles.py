"""Tiles: the voxels around pixels' lines of sight, whose derivatives are kept one by one."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cloudtomo_cl.opencl.layout import STRUCTS, TILE_WIDTH
from cloudtomo_cl.scene.scene import Scene
from cloudtomo_cl.scene.sensors import RayView, View

# Pixels whose entries are counted to know about how many there are.
_COUNTED = 1000


def lines_of_sight(views: Sequence[View], pixels: np.ndarray, scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    """The rays through the middle of pixels.

    Parameters
    ----------
    pixels : (view, row * width + column), shape (pixels, 2)

    Returns
    -------
    origins, directions : in voxels from the domain's lower corner, shape (pixels, 3); directions of any length
    """
    grid = scene.grid
    origins, directions = np.empty((2, len(pixels), 3))
    for index, view in enumerate(views):
        chosen = pixels[:, 0] == index
        numbers = pixels[chosen, 1].astype(int)
        if isinstance(view, RayView):
            origins[chosen], directions[chosen] = view.starts(scene)[numbers], view.directions[numbers]
            continue
        origin, direction = view.rays(grid, scene.top)
        width, height = view.pixels
        place = np.column_stack(
            [np.ones(len(numbers)), (numbers % width + 0.5) / width, (numbers // width + 0.5) / height]
        )
        origins[chosen], directions[chosen] = place @ origin, place @ direction
    spacing = np.asarray(grid.spacing)
    return (origins - grid.origin) / spacing, directions / spacing


def tiles_of(views: Sequence[View], pixels: np.ndarray, scene: Scene, mask: np.ndarray) -> np.ndarray:
    """The kernels' Tile of every pixel, shape (pixels,): a line of sight, as far as it is near voxels of the mask."""
    origins, directions = lines_of_sight(views, pixels, scene)
    steepness = np.abs(directions)
    if scene.boundary.horizontal == "periodic":
        # Along the vertical a line is in every layer once, whatever copies of the domain it goes through.
        steepness[:, :2] *= directions[:, 2:] == 0
    axis = np.argmax(steepness, axis=1)
    rows = np.arange(len(pixels))
    across = (axis[:, None] + np.array([1, 2])) % 3
    along = directions[rows, axis]
    tiles = np.zeros(len(pixels), STRUCTS["Tile"])
    tiles["axis"] = axis
    slope = directions[rows[:, None], across] / along[:, None]
    tiles["slope"] = slope
    tiles["centre"] = origins[rows[:, None], across] + (0.5 - origins[rows, axis])[:, None] * slope
    first, last = _slabs_near(tiles, mask, scene.boundary.horizontal == "periodic")
    tiles["first_slab"], tiles["slabs"] = first, np.maximum(last - first + 1, 0)
    return tiles


def about_how_many_entries(views: Sequence[View], pixels: np.ndarray, scene: Scene, mask: np.ndarray) -> int:
    """Voxels of the mask in all pixels' tiles, from those of some pixels.

    Parameters
    ----------
    pixels : (view, row * width + column), shape (pixels, 2)
    """
    if not len(pixels):
        return 0
    # At random: every so many-th might be all of one column.
    some = np.sort(np.random.default_rng(0).permutation(len(pixels))[:_COUNTED])
    tiles = tiles_of(views, pixels[some], scene, mask)
    periodic = scene.boundary.horizontal == "periodic"
    return round(sum(_voxels_in(tile, mask, periodic) for tile in tiles) / len(tiles) * len(pixels))


def _voxels_in(tile: np.void, mask: np.ndarray, periodic: bool) -> int:
    """How many voxels of the mask are in a tile; as `slot_index` in kernels/near_field.h has them."""
    slabs = tile["first_slab"] + np.arange(tile["slabs"])
    corners = np.floor(tile["centre"] + slabs[:, None] * tile["slope"]).astype(int) - TILE_WIDTH // 2
    around = corners[:, :, None] + np.arange(TILE_WIDTH)
    places: list[np.ndarray] = [slabs] * 3
    inside = np.ones((len(slabs), TILE_WIDTH, TILE_WIDTH), bool)
    for axis, along in (
        (int(tile["axis"]), slabs[:, None, None]),
        ((int(tile["axis"]) + 1) % 3, around[:, 0, :, None]),
        ((int(tile["axis"]) + 2) % 3, around[:, 1, None, :]),
    ):
        wraps = periodic and axis < 2 and axis != tile["axis"]
        place = along % mask.shape[axis] if wraps else along
        inside &= (place >= 0) & (place < mask.shape[axis])
        places[axis] = np.clip(place, 0, mask.shape[axis] - 1)
    return int(np.count_nonzero(mask[tuple(places)] & inside))


def _slabs_near(tiles: np.ndarray, mask: np.ndarray, periodic: bool) -> tuple[np.ndarray, np.ndarray]:
    """The first and the last slab in which a tile may hold a voxel of the mask's bounding box."""
    kept = np.argwhere(mask)
    lower, upper = kept.min(axis=0), kept.max(axis=0)
    axis = tiles["axis"]
    first, last = lower[axis].astype(float), upper[axis].astype(float)
    margin = TILE_WIDTH // 2 + 1  # and a voxel for rounding
    for n in range(2):
        other = (axis + 1 + n) % 3
        bounded = ~(periodic & (other < 2))
        centre, slope = tiles["centre"][:, n].astype(float), tiles["slope"][:, n].astype(float)
        low, high = lower[other] - margin, upper[other] + 1 + margin
        with np.errstate(divide="ignore", invalid="ignore"):
            ends = np.sort([(low - centre) / slope, (high - centre) / slope], axis=0)
        level = slope == 0
        outside = level & ((centre < low) | (centre > high))
        enter, leave = np.where(level, -np.inf, ends[0]), np.where(level, np.inf, ends[1])
        first = np.where(bounded, np.maximum(first, np.floor(enter)), first)
        last = np.where(bounded, np.minimum(last, np.ceil(leave)), last)
        last = np.where(bounded & outside, first - 1, last)
    return first.astype(int), last.astype(int)
