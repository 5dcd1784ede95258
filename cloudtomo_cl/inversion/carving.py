"""Space carving: where the images leave room for cloud.

A voxel is ruled out by a view that sees all of it and no cloud there. What remains is the
part of the domain in which an extinction has to be sought at all.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from cloudtomo_cl.errors import DataError
from cloudtomo_cl.scene.grid import Grid, resample
from cloudtomo_cl.scene.measurements import Measurements
from cloudtomo_cl.scene.scene import Scene
from cloudtomo_cl.scene.sensors import AffineView, RayView, View, clip_to_box

# Corners of voxels that are projected at once: some 100 MB of temporary arrays.
_CORNERS_AT_ONCE = 1 << 20
# A corner this close to a pixel's edge, in pixels, counts as on it: rounding opens no new pixel.
_EDGE = 1e-6
_SCALE_PERCENTILE = 99.0
_QUIET_PERCENTILE = 25.0
# Up to where noise may raise the tolerance, in contrasts. Beyond, noisy ground counts as cloudy:
# with 3 a cloud lost 1.4 % of its mass in images of 24x24 pixels and 256 samples.
_LOOSEST = 2.5


def cloudy_pixels(
    measurements: Measurements,
    clear: Measurements,
    contrast: float = 0.02,
    significance: float = 2.0,
    grid: Grid | None = None,
) -> tuple[np.ndarray, ...]:
    """Which pixels of every image may show cloud.

    A pixel is clear only if the images are able to say so: its difference from the clear image
    plus `significance` standard errors must lie within a tolerance. So a pixel too noisy to
    tell counts as cloudy, which matters over bright ground, where parts of a cloud are as
    bright as the ground. The difference counts in both directions, since a cloud is brighter
    than dark ground and may be darker than bright ground.

    The tolerance leaves room for ground that is shaded or lit by the cloud and for the noise
    of clear pixels: three times `significance` standard errors of the quieter pixels (their
    lower quartile), but no less than `contrast` and no more than two and a half times `contrast` of
    the image's own scale, the 99th percentile of the differences. The scale is at least a quarter
    of the largest among the images, so that a view of hardly any cloud is not judged by its noise.
    Gaps of a pixel or two and holes are then closed: where the brightness of a cloud's image
    passes through that of the ground, the cloud goes on. (Not in lists of rays, whose pixels
    have no neighbours.) Bad pixels, which are NaN, cannot say anything: they count as cloudy.

    Parameters
    ----------
    measurements, clear : images of the same views with and without cloud, W m^-2 sr^-1
    contrast : the least difference that counts, relative to the image's scale
    significance : standard errors of the difference; 0 trusts every pixel
    grid : of the domain, if pixels that do not look at it are to count as clear

    Returns
    -------
    bool, one array (rows, columns) per view

    Raises
    ------
    DataError : the views of the two differ; contrast or significance is negative
    """
    if clear.views != measurements.views:
        raise DataError("clear images are not of the measurements' views: render them with the same views and pixels")
    if not (contrast >= 0 and significance >= 0):
        raise DataError(f"contrast is {contrast} and significance {significance}: neither may be negative")
    differences = [np.abs(image - ground) for image, ground in zip(measurements.images, clear.images)]
    errors = [np.hypot(*pair) for pair in zip(measurements.standard_errors, clear.standard_errors)]
    gains = zip(errors, measurements.images, measurements.calibration_errors)
    errors = [np.hypot(error, image * gain) if gain else error for error, image, gain in gains]
    scales = np.array([np.nanpercentile(difference, _SCALE_PERCENTILE) for difference in differences])
    scales = np.maximum(scales, scales.max() / 4)
    cloudy = []
    for view, difference, error, scale in zip(measurements.views, differences, errors, scales):
        bad = np.isnan(difference)
        noise = 3 * significance * np.percentile(error[~bad], _QUIET_PERCENTILE)
        tolerance = np.clip(noise, contrast * scale, _LOOSEST * contrast * scale)
        differs = difference + significance * error > tolerance
        if grid is not None:
            meets = pixels_that_meet(view, grid)
            differs, bad = differs & meets, bad & meets
        # Bad pixels open no way to their neighbours.
        cloudy.append((differs if isinstance(view, RayView) else _filled(differs)) | bad)
    return tuple(cloudy)


def _filled(pixels: np.ndarray) -> np.ndarray:
    """Pixels with narrow gaps closed and holes filled; the image's edge opens no gap."""
    from scipy import ndimage  # here: half of the package's import time

    square = np.ones((3, 3), dtype=bool)
    closed = ndimage.binary_closing(np.pad(pixels, 2, mode="edge"), square)[2:-2, 2:-2]
    return ndimage.binary_fill_holes(pixels | closed)


def pixels_that_meet(view: View, grid: Grid) -> np.ndarray:
    """Which pixels of a view look at the domain: bool, shape (rows, columns).

    A pixel counts if the ray through its centre or through one of its corners does; in a list
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


def carve(
    grid: Grid,
    measurements: Measurements,
    clear: Measurements,
    contrast: float = 0.02,
    significance: float = 2.0,
) -> np.ndarray:
    """The voxels that may hold cloud.

    A voxel is removed only if some view has its whole projection inside the frame and no
    cloudy pixel in the projection's bounding box. Rays that miss the domain never count: they
    see cloud neither in the domain nor, with open boundaries, anywhere else. Lists of rays rule
    out nothing: a voxel may lie between their rays.

    For a coarser grid of the same domain, carve the fine grid and coarsen its mask
    (`coarsened`): the bounding boxes of small voxels fit more tightly.

    Parameters
    ----------
    grid : of the domain
    measurements : images, their standard errors and views
    clear : the same images without cloud, for instance rendered from an extinction of zeros
        under the same sun, with the same surface and air; with samples enough that they are
        less noisy than the measurements
    contrast, significance : see `cloudy_pixels`

    Returns
    -------
    bool, shape of the grid

    Raises
    ------
    DataError : as `cloudy_pixels`
    """
    cloudy = cloudy_pixels(measurements, clear, contrast, significance, grid)
    mask = np.ones(grid.shape, dtype=bool)
    for view, pixels in zip(measurements.views, cloudy):
        if isinstance(view, RayView):
            continue
        table = np.zeros((pixels.shape[0] + 1, pixels.shape[1] + 1), dtype=np.int64)
        table[1:, 1:] = pixels.cumsum(axis=0).cumsum(axis=1)
        for first, last in _slabs(grid):
            mask[first:last] &= ~_seen_clear(view, grid, first, last, table)
    return mask


@dataclass(frozen=True)
class _Footprints:
    """Bounding boxes of voxels in an image, clipped to its frame: pixel ranges [start, stop)."""

    whole: np.ndarray  # the voxel lies in front of the sensor and inside the frame
    in_front: np.ndarray
    left: np.ndarray
    right: np.ndarray
    top: np.ndarray
    bottom: np.ndarray


def _footprints(view: AffineView, grid: Grid, first: int, last: int) -> _Footprints:
    """Of the voxels of the slab first <= x < last."""
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
    return _Footprints(whole, in_front, left, right, top, bottom)


def _slabs(grid: Grid) -> Iterator[tuple[int, int]]:
    """Ranges along x of as many voxels as are projected at once."""
    slab = max(1, _CORNERS_AT_ONCE // ((grid.shape[1] + 1) * (grid.shape[2] + 1)) - 1)
    for first in range(0, grid.shape[0], slab):
        yield first, min(first + slab, grid.shape[0])


def _seen_clear(
    view: AffineView, grid: Grid, first: int, last: int, table: np.ndarray
) -> np.ndarray:
    """Which voxels of the slab first <= x < last a view sees whole, and free of cloud.

    `table` is the summed-area table of the cloudy pixels: the number of them above and left.
    """
    box = _footprints(view, grid, first, last)
    number = (
        table[box.bottom, box.right]
        - table[box.top, box.right]
        - table[box.bottom, box.left]
        + table[box.top, box.left]
    )
    return box.whole & (number == 0)


def pixels_that_see(view: View, grid: Grid, mask: np.ndarray) -> np.ndarray:
    """Which pixels of a view may look at a voxel of a mask: bool, shape (rows, columns).

    A pixel counts if it lies in the bounding box of the projection of a kept voxel. In a list of
    rays it counts if its ray meets the bounding box of all kept voxels.
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
    for first, last in _slabs(grid):
        box = _footprints(view, grid, first, last)
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


def _over_corners(values: np.ndarray, extreme: np.ufunc) -> np.ndarray:
    """The extreme over the eight corners of every voxel."""
    for axis in range(3):
        count = values.shape[axis] - 1
        values = extreme(values.take(range(count), axis), values.take(range(1, count + 1), axis))
    return values


def coarsened(mask: np.ndarray, shape: Sequence[int]) -> np.ndarray:
    """The mask on other voxels of the same domain: those that overlap a kept voxel.

    Parameters
    ----------
    mask : bool
    shape : of the other grid

    Returns
    -------
    bool, of that shape
    """
    # Edges that coincide up to rounding are no overlap.
    return resample(mask, shape) > 1e-9


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
