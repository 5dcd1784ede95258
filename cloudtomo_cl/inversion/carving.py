"""Space carving: where the images leave room for cloud.

A voxel is ruled out by a view that sees all of it and no cloud there. What remains is the
part of the domain in which an extinction has to be sought at all.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from cloudtomo_cl.arguments import NUMBER, a, require_kinds
from cloudtomo_cl.errors import DataError
from cloudtomo_cl.opencl.device import Device
from cloudtomo_cl.renamed import renamed_arguments
from cloudtomo_cl.scene.grid import Grid
from cloudtomo_cl.scene.measurements import Measurements
from cloudtomo_cl.scene.pointing import error_in_pixels
from cloudtomo_cl.scene.scene import Scene
from cloudtomo_cl.scene.sensors import AffineView, RayView
from cloudtomo_cl.scene.visibility import footprints, pixels_that_meet, slabs
from cloudtomo_cl.transport.radiance import RadianceOperator

_SCALE_PERCENTILE = 99.0
_QUIET_PERCENTILE = 25.0
# Largest tolerance, in units of the contrast, to which noise may raise it; noisier ground counts as cloudy.
# With 3 a cloud lost 1.4 % of its mass in images of 24x24 pixels and 256 samples.
_LOOSEST = 2.5
# Errors of rendered pixels are pooled over neighbours up to three pixels away, so that clear pixels beside a cloud have
# the cloud's large errors. Here a pixel gets the error that the quietest tenth of such a neighbourhood does not exceed.
# With the errors as they are, twice as many voxels were left; with the least error, a cloud lost 0.6 % of its mass.
_POOLED, _QUIETEST = 7, 10.0

# Paths per pixel of the cloud-free images that carving compares with. Without air only the horizon makes them noisy.
_CLEAR_SAMPLES, _CLEAR_SAMPLES_IN_AIR = 16, 256


def carved_mask(
    scene: Scene, measurements: Measurements, device: Device, progress: Callable[[int], None] | None = None
) -> np.ndarray:
    """The voxels in which the images leave room for cloud: bool, shape of the scene's grid.

    Renders the scene without cloud, and carves (`carve`); progress as in `RadianceOperator.render`.
    """
    # Without cloud there is no forward peak to tame, and roulette would make faint ground noisy.
    operator = RadianceOperator(scene, measurements.views, device, estimator="plain")
    samples = _CLEAR_SAMPLES if scene.air is None else _CLEAR_SAMPLES_IN_AIR
    cloud_free = operator.render(np.zeros(scene.grid.shape, np.float32), samples, progress=progress)
    return carve(scene.grid, measurements, Measurements.rendered(operator, cloud_free))


@renamed_arguments(clear="cloud_free")
def cloudy_pixels(
    measurements: Measurements,
    cloud_free: Measurements,
    contrast: float = 0.02,
    significance: float = 2.0,
    grid: Grid | None = None,
) -> tuple[np.ndarray, ...]:
    """Which pixels of every image may show cloud.

    A pixel is clear only if the images are able to say so: its difference from the cloud-free image
    plus `significance` standard errors must lie within a tolerance. So a pixel too noisy to
    tell counts as cloudy, which matters over bright ground, where parts of a cloud are as
    bright as the ground. The difference counts in both directions, since a cloud is brighter
    than dark ground and may be darker than bright ground.

    The tolerance leaves room for ground that is shaded or lit by the cloud and for the noise
    of clear pixels: three times `significance` standard errors of the quieter pixels (their
    lower quartile), but no less than `contrast` and no more than two and a half times `contrast` of
    the image's own scale, the 99th percentile of the differences. The scale is at least a quarter
    of the median of all images', so that noise does not set the scale of a view with hardly any cloud. (Not of the
    largest: a view towards the sun may be many times as bright as the others.)
    Gaps of a pixel or two and holes are then closed: where the brightness of a cloud's image
    passes through that of the ground, the cloud goes on. (Not in lists of rays, whose pixels
    have no neighbours.) Where a view's pointing is uncertain, pixels beside such ones count as
    cloudy, too, up to `significance` standard errors of it away. Invalid pixels, which are NaN,
    cannot say anything: they count as cloudy.

    Parameters
    ----------
    measurements, cloud_free : images of the same views with and without cloud, W m^-2 sr^-1
    contrast : the least difference that counts, relative to the image's scale
    significance : standard errors of the difference; 0 trusts every pixel
    grid : grid of the domain, if pixels that do not look at it are to count as clear

    Returns
    -------
    whether each pixel may show cloud: bool, one array (rows, columns) per view

    Raises
    ------
    DataError : the views of the two differ; contrast or significance is negative or not finite
    """
    require_kinds("carve", measurements=(measurements, a(Measurements)), cloud_free=(cloud_free, a(Measurements)))
    require_kinds("carve", contrast=(contrast, NUMBER), significance=(significance, NUMBER))
    if cloud_free.views != measurements.views:
        raise DataError("the cloud-free images are not of the measurements' views: render them with the same ones")
    if not (0 <= contrast < np.inf and 0 <= significance < np.inf):
        raise DataError(
            f"contrast is {contrast} and significance {significance}: neither may be negative, and both must be finite"
        )
    differences = [np.abs(image - ground) for image, ground in zip(measurements.images, cloud_free.images)]
    errors = [
        np.hypot(error if isinstance(view, RayView) else _of_the_quietest(error), other)
        for view, error, other in zip(measurements.views, measurements.standard_errors, cloud_free.standard_errors)
    ]
    gains = zip(errors, measurements.images, measurements.calibration_errors)
    errors = [np.hypot(error, image * gain) if gain else error for error, image, gain in gains]
    scales = np.array([np.nanpercentile(difference, _SCALE_PERCENTILE) for difference in differences])
    scales = np.maximum(scales, np.quantile(scales, 0.5, method="lower") / 4)
    cloudy = []
    for index, (view, difference, error, scale) in enumerate(zip(measurements.views, differences, errors, scales)):
        bad = np.isnan(difference)
        noise = 3 * significance * np.percentile(error[~bad], _QUIET_PERCENTILE)
        tolerance = np.clip(noise, contrast * scale, _LOOSEST * contrast * scale)
        differs = difference + significance * error > tolerance
        if grid is not None:
            meets = pixels_that_meet(view, grid)
            differs, bad = differs & meets, bad & meets
            differs = _grown(differs, significance * _pointing_error(measurements, index, grid))
        # Invalid pixels are added after gaps are closed, so that they do not spread to their neighbours.
        cloudy.append((differs if isinstance(view, RayView) else _filled(differs)) | bad)
    return tuple(cloudy)


def _pointing_error(measurements: Measurements, view: int, grid: Grid) -> float:
    """The standard error of where a view's pixels look, in pixels."""
    given = measurements.pointing_errors[view], measurements.position_errors[view]
    return error_in_pixels(measurements.views[view], grid, *given)


def _grown(pixels: np.ndarray, by: float) -> np.ndarray:
    """Pixels and all that lie up to `by` pixels away along rows and columns, rounded up."""
    from scipy.ndimage import binary_dilation

    reach = int(np.ceil(by))
    return binary_dilation(pixels, np.ones((2 * reach + 1, 2 * reach + 1), bool)) if reach else pixels


def _of_the_quietest(error: np.ndarray) -> np.ndarray:
    """The errors of pixels without the share of noisier neighbours in them; infinite where unknown.

    An error that is far above those of all touching pixels does not come from them, and stays.
    """
    from scipy.ndimage import maximum_filter, percentile_filter

    error = np.where(np.isnan(error), np.inf, error)
    touching = np.ones((3, 3), bool)
    touching[1, 1] = False
    alone = error > 2 * maximum_filter(error, footprint=touching)
    return np.where(alone, error, percentile_filter(error, _QUIETEST, size=_POOLED))


def _filled(pixels: np.ndarray) -> np.ndarray:
    """Pixels with narrow gaps closed and holes filled; the image's edge opens no gap."""
    from scipy import ndimage  # here: half of the package's import time

    square = np.ones((3, 3), dtype=bool)
    closed = ndimage.binary_closing(np.pad(pixels, 2, mode="edge"), square)[2:-2, 2:-2]
    return ndimage.binary_fill_holes(pixels | closed)


@renamed_arguments(clear="cloud_free")
def carve(
    grid: Grid,
    measurements: Measurements,
    cloud_free: Measurements,
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
    grid : grid of the domain
    measurements : images, their standard errors and views
    cloud_free : the same images without cloud, for instance rendered from an extinction of zeros
        under the same sun, with the same surface and air, and with so many samples that they
        are less noisy than the measurements
    contrast, significance : see `cloudy_pixels`

    Returns
    -------
    whether a voxel may hold cloud: bool, shape of the grid

    Raises
    ------
    DataError : as `cloudy_pixels`
    """
    require_kinds("carve", grid=(grid, a(Grid)))
    cloudy = cloudy_pixels(measurements, cloud_free, contrast, significance, grid)
    mask = np.ones(grid.shape, dtype=bool)
    for view, pixels in zip(measurements.views, cloudy):
        if isinstance(view, RayView):
            continue
        table = np.zeros((pixels.shape[0] + 1, pixels.shape[1] + 1), dtype=np.int64)
        table[1:, 1:] = pixels.cumsum(axis=0).cumsum(axis=1)
        for first, last in slabs(grid):
            mask[first:last] &= ~_seen_clear(view, grid, first, last, table)
    return mask


def _seen_clear(view: AffineView, grid: Grid, first: int, last: int, table: np.ndarray) -> np.ndarray:
    """Which voxels of the slab first <= x < last a view sees completely and without cloud.

    `table` is the summed-area table of the cloudy pixels: their number above and to the left.
    """
    box = footprints(view, grid, first, last)
    number = (
        table[box.bottom, box.right]
        - table[box.top, box.right]
        - table[box.bottom, box.left]
        + table[box.top, box.left]
    )
    return box.whole & (number == 0)
