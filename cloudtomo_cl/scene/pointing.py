"""Small errors in where cameras point: views that are turned or shifted, and the change of their images."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from cloudtomo_cl.errors import DataError
from cloudtomo_cl.scene.arrays import as_numbers
from cloudtomo_cl.scene.grid import Grid
from cloudtomo_cl.scene.sensors import OrthographicView, PerspectiveView, RayView, View, image_axes, line_of_sight

# Number of a view's motions. In this order: the image's centre looks farther to the right, farther up, and the camera
# rolls clockwise about its line of sight. The first two are angles (radians) for cameras, whose rays come from one
# point, and shifts (km) for views with parallel rays; the third is an angle (radians).
MOTIONS = 3
# A motion, radians or km, that is small against a pixel and large against rounding.
_SMALL = 1e-5
# Standard deviation, in pixels, of the Gaussian blur of an image before its slope is taken, against noise.
_BLUR = 1.0


def motion_errors(view: View, grid: Grid, pointing_error: float, position_error: float) -> np.ndarray:
    """Standard errors of a view's motions, shape (3,).

    A camera at another position sees the domain's centre in another direction, and counts as turned by that angle.
    Further effects of its position are left out.

    Parameters
    ----------
    pointing_error : standard error of a camera's direction and of an image's rotation, degrees
    position_error : standard error of a camera's position, or of an orthographic image's, km

    Raises
    ------
    DataError : the view is neither a camera nor orthographic
    """
    if not pointing_error and not position_error:
        return np.zeros(MOTIONS)
    angle = np.radians(pointing_error)
    if isinstance(view, OrthographicView):
        return np.array([position_error, position_error, angle])
    away = float(np.linalg.norm(_place(view) - grid.centre))
    turn = float(np.hypot(angle, position_error / away))
    return np.array([turn, turn, angle])


def checked_motions(motions: Any, views: int) -> np.ndarray:
    """Motions of so many views, shape (views, 3). DataError if they are of another shape, not finite or no numbers."""
    motions = as_numbers(motions, "motions")
    if motions.shape != (views, 3) or not np.isfinite(motions).all():
        raise DataError(f"motions have shape {motions.shape}: they must be ({views}, 3), and finite")
    return motions


def moved(view: View, motion: np.ndarray, grid: Grid) -> View:
    """A view after small motions, shape (3,); the same object if they are 0.

    Raises
    ------
    DataError : the view is neither a camera nor orthographic
    """
    if not np.any(motion):
        return view
    if isinstance(view, OrthographicView):
        sight = view.sight()
        right, up = image_axes(sight, view.up)
        shift = motion[0] * right + motion[1] * up
        target = np.asarray(grid.centre if view.target is None else view.target) + shift
        turned = _turned(sight, right, up, np.array([0.0, 0.0, motion[2]]))
        position = None if view.position is None else _triple(view.position + shift)
        return replace(view, target=_triple(target), up=_triple(turned @ up), position=position)
    place = _place(view)
    if isinstance(view, PerspectiveView):
        sight = line_of_sight(view.position, view.target)
        right, up = image_axes(sight, view.up)
        turned = _turned(sight, right, up, motion)
        target = place + turned @ np.subtract(view.target, view.position)
        return replace(view, target=_triple(target), up=_triple(turned @ up))
    assert isinstance(view, RayView)
    width, height = view.pixels
    directions = view.directions.reshape(height, width, 3)
    sight = _unit(view.directions.mean(axis=0))
    across = (directions[:, -1] - directions[:, 0]).mean(axis=0)
    right = _unit(across - (across @ sight) * sight)
    turned = _turned(sight, right, np.cross(right, sight), motion)
    return RayView(view.origins, view.directions @ turned.T, view.pixels)


def pixel_motions(view: View, grid: Grid) -> np.ndarray:
    """Shift of pixels to the right and down, in pixels, per unit of each motion, shape (rows, columns, 2, 3)."""
    places = _places(view, grid)
    along = np.stack([_slope(places, axis) for axis in (1, 0)], axis=-1)  # (rows, columns, 3, 2)
    inverse = np.linalg.pinv(np.swapaxes(along, -1, -2) @ along) @ np.swapaxes(along, -1, -2)
    moves = [_places(moved(view, motion, grid), grid) - places for motion in _SMALL * np.eye(MOTIONS)]
    return inverse @ np.stack(moves, axis=-1) / _SMALL


def image_motions(view: View, image: np.ndarray, grid: Grid) -> np.ndarray:
    """The change of a view's image per unit of each motion, shape (rows, columns, 3).

    Parameters
    ----------
    image : measured image, shape (rows, columns); NaN in invalid pixels. Its slope is taken after a little blur
    """
    from scipy.ndimage import gaussian_filter

    whole = _without_gaps(image)
    slopes = np.stack([gaussian_filter(whole, _BLUR, order=order) for order in ((0, 1), (1, 0))], axis=-1)
    return (slopes[..., None, :] @ pixel_motions(view, grid))[..., 0, :]


def error_in_pixels(view: View, grid: Grid, pointing_error: float, position_error: float) -> float:
    """The standard error of where a pixel looks, in pixels: the largest in an image."""
    errors = motion_errors(view, grid, pointing_error, position_error)
    if not errors.any():
        return 0.0
    return float(np.sqrt(np.square(pixel_motions(view, grid) * errors).sum(axis=(-1, -2))).max())


def _place(view: View) -> np.ndarray:
    """The position of a camera, km. Raises DataError if the view is no camera."""
    if isinstance(view, PerspectiveView):
        return np.asarray(view.position)
    if isinstance(view, RayView) and (view.origins == view.origins[0]).all() and min(view.pixels) > 1:
        return view.origins[0]
    kind = (
        "list of rays from several points, or in a single line," if isinstance(view, RayView) else f"{view.type} view"
    )
    raise DataError(
        f"a {kind} has no pointing_error or position_error: they are for cameras, whose rays come from one point, and "
        "for orthographic views: set them to 0"
    )


def _turned(sight: np.ndarray, right: np.ndarray, up: np.ndarray, motion: np.ndarray) -> np.ndarray:
    """The rotation, shape (3, 3), of a camera that turns to the right, up, and clockwise, by angles in radians."""
    from scipy.spatial.transform import Rotation

    return Rotation.from_rotvec(-motion[0] * up + motion[1] * right + motion[2] * sight).as_matrix()


def _places(view: View, grid: Grid) -> np.ndarray:
    """Unit directions of the pixels' rays, or origins if the rays are parallel; shape (rows, columns, 3)."""
    width, height = view.pixels
    if isinstance(view, RayView):
        return view.directions.reshape(height, width, 3)
    u, v = np.meshgrid((np.arange(width) + 0.5) / width, (np.arange(height) + 0.5) / height)
    image = np.stack([np.ones_like(u), u, v], axis=-1)
    origin, axes = view.rays(grid)
    if isinstance(view, OrthographicView):
        return image @ origin
    directions = image @ axes
    return directions / np.linalg.norm(directions, axis=-1, keepdims=True)


def _slope(values: np.ndarray, axis: int) -> np.ndarray:
    return np.gradient(values, axis=axis) if values.shape[axis] > 1 else np.zeros_like(values)


def _without_gaps(image: np.ndarray) -> np.ndarray:
    """The image with the nearest valid pixels in place of invalid ones."""
    from scipy.ndimage import distance_transform_edt

    bad = np.isnan(image)
    if not bad.any():
        return image
    nearest = distance_transform_edt(bad, return_distances=False, return_indices=True)
    return image[tuple(nearest)]


def _unit(vector: np.ndarray) -> np.ndarray:
    return vector / np.linalg.norm(vector)


def _triple(values: np.ndarray) -> tuple[float, float, float]:
    x, y, z = map(float, values)
    return x, y, z
