"""Visibility: which pixels look at the domain or at voxels of a mask, and where a voxel appears in an image."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from cloudtomo_cl.errors import DataError
from cloudtomo_cl.scene.box import clip_to_box
from cloudtomo_cl.scene.grid import Grid
from cloudtomo_cl.scene.scene import Scene
from cloudtomo_cl.scene.sensors import AffineView, RayView, View

# Number of voxel corners that are projected at once: some 100 MB of temporary arrays.
_CORNERS_AT_ONCE = 1 << 20
# A corner this close to a pixel's edge, in pixels, counts as on it: rounding opens no new pixel.
_EDGE = 1e-6


def check_views(scene: Scene, views: Sequence[View]) -> None:
    """Raises DataError for a view that can see nothing: all of its pixels look past cloud, air and ground."""
    if scene.surface.albedo > 0 or scene.air is not None or scene.boundary.horizontal == "periodic":
        return
    for index, view in enumerate(views):
        if not pixels_that_meet(view, scene.grid).any():
            lower, upper = scene.grid.origin, np.add(scene.grid.origin, scene.grid.extent)
            box = ", ".join(f"{axis} {a:g} to {b:g}" for axis, a, b in zip("xyz", lower, upper))
            raise DataError(
                f"view {index} looks past the domain ({box} km) with every pixel: check its position, target, zenith "
                "and azimuth, and their units (km, degrees)"
            )


def pixels_that_meet(view: View, grid: Grid) -> np.ndarray:
    """Which pixels of a view look at the domain: bool, shape (rows, columns).

    A pixel counts if the ray through its centre or one of its corners meets the domain; in a list
    of rays, if its ray does.
    """
    width, height = view.pixels
    if isinstance(view, RayView):
        lower = np.asarray(grid.origin)
        near, far = clip_to_box(view.origins, view.directions, lower, lower + grid.extent)
        return (near <= far).reshape(height, width)
    corners = _rays_meet(view, grid, np.arange(width + 1) / width, np.arange(height + 1) / height)
    centres = _rays_meet(view, grid, (np.arange(width) + 0.5) / width, (np.arange(height) + 0.5) / height)
    return centres | corners[:-1, :-1] | corners[1:, :-1] | corners[:-1, 1:] | corners[1:, 1:]


def _rays_meet(view: AffineView, grid: Grid, u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Which rays cross the domain, shape (len(v), len(u))."""
    origin, axes = view.rays(grid)
    image = np.stack(np.broadcast_arrays(1.0, u[None, :], v[:, None]), axis=-1)
    start, step = image @ origin, image @ axes
    lower = np.asarray(grid.origin)
    near, far = clip_to_box(start, step, lower, lower + grid.extent)
    return near <= far


def pixels_that_see(view: View, grid: Grid, mask: np.ndarray) -> np.ndarray:
    """Which pixels of a view may look at a voxel of a mask: bool, shape (rows, columns).

    A pixel counts if it lies in the bounding box of the projection of a voxel of the mask. In a list
    of rays it counts if its ray meets the bounding box of all these voxels.
    """
    width, height = view.pixels
    if isinstance(view, RayView):
        if not mask.any():
            return np.zeros((height, width), dtype=bool)
        kept_voxels = np.argwhere(mask)
        lower, upper = (
            np.asarray(grid.origin) + corner * np.asarray(grid.spacing)
            for corner in (kept_voxels.min(axis=0), kept_voxels.max(axis=0) + 1)
        )
        near, far = clip_to_box(view.origins, view.directions, lower, upper)
        return (near <= far).reshape(height, width)
    changes = np.zeros((height + 1, width + 1), dtype=np.int64)
    for first, last in slabs(grid):
        box = footprints(view, grid, first, last)
        kept = mask[first:last]
        if (kept & ~box.in_front).any():
            return pixels_that_meet(view, grid)  # beside or around the sensor: no bounding box
        seen = kept & (box.left < box.right) & (box.top < box.bottom)
        for rows, columns, sign in (
            (box.top, box.left, 1),
            (box.bottom, box.left, -1),
            (box.top, box.right, -1),
            (box.bottom, box.right, 1),
        ):
            np.add.at(changes, (rows[seen], columns[seen]), sign)
    return changes.cumsum(axis=0).cumsum(axis=1)[:height, :width] > 0


def voxels_in_view(views: Sequence[View], grid: Grid) -> np.ndarray:
    """Which voxels have their centre in the image of any view: bool, shape of the grid.

    Lists of rays may see any voxel.
    """
    if any(isinstance(view, RayView) for view in views):
        return np.ones(grid.shape, bool)
    middles = [grid.origin[axis] + grid.spacing[axis] * (np.arange(grid.shape[axis]) + 0.5) for axis in range(3)]
    seen = np.zeros(grid.shape, bool)
    for view in views:
        for first, last in slabs(grid):
            points = np.stack(np.meshgrid(middles[0][first:last], *middles[1:], indexing="ij"), axis=-1)
            u, v, depth = view.project(grid, points)  # type: ignore[union-attr]
            # The image plane of parallel rays may lie in the domain's top.
            in_front = depth > -_EDGE * min(grid.spacing)
            seen[first:last] |= in_front & (u >= 0) & (u <= 1) & (v >= 0) & (v <= 1)
    return seen


@dataclass(frozen=True, eq=False)
class Footprints:
    """Bounding boxes of voxels in an image, clipped to its frame: columns [left, right), rows [top, bottom).

    All arrays have the shape (x, y, z) of the voxels.
    """

    whole: np.ndarray  # whether the voxel lies in front of the sensor and inside the frame
    in_front: np.ndarray  # whether it lies in front of the sensor
    left: np.ndarray
    right: np.ndarray
    top: np.ndarray
    bottom: np.ndarray


def footprints(view: AffineView, grid: Grid, first: int, last: int) -> Footprints:
    """The bounding boxes of the voxels of the slab first <= x < last."""
    edges = [grid.origin[axis] + grid.spacing[axis] * np.arange(grid.shape[axis] + 1) for axis in range(3)]
    edges[0] = edges[0][first : last + 1]
    corners = np.stack(np.meshgrid(*edges, indexing="ij"), axis=-1)
    u, v, depth = view.project(grid, corners)
    # The image plane of parallel rays may lie in the top of the domain. For a camera a corner
    # so close to its own plane projects far outside of the frame.
    in_front = _over_corners(depth, np.minimum) > -_EDGE * min(grid.spacing)
    whole = in_front.copy()
    ranges = []
    for image, count in zip((u, v), view.pixels):
        lower, upper = _over_corners(image, np.minimum) * count, _over_corners(image, np.maximum) * count
        whole &= (lower >= -_EDGE) & (upper <= count + _EDGE)
        start = np.floor(np.nan_to_num(lower, posinf=0.0, neginf=0.0) + _EDGE)
        stop = np.ceil(np.nan_to_num(upper, posinf=0.0, neginf=0.0) - _EDGE)
        ranges.append([np.clip(edge, 0, count).astype(np.intp) for edge in (start, stop)])
    (left, right), (top, bottom) = ranges
    return Footprints(whole, in_front, left, right, top, bottom)


def slabs(grid: Grid) -> Iterator[tuple[int, int]]:
    """Ranges along x, each with as many voxels as are projected at once."""
    slab = max(1, _CORNERS_AT_ONCE // ((grid.shape[1] + 1) * (grid.shape[2] + 1)) - 1)
    for first in range(0, grid.shape[0], slab):
        yield first, min(first + slab, grid.shape[0])


def _over_corners(values: np.ndarray, extreme: np.ufunc) -> np.ndarray:
    """The minimum or maximum over the eight corners of every voxel."""
    for axis in range(3):
        count = values.shape[axis] - 1
        values = extreme(values.take(range(count), axis), values.take(range(1, count + 1), axis))
    return values
