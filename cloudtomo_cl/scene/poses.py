"""Cameras from their poses, as photogrammetry and computer vision give them: rotation, translation, camera matrix."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cloudtomo_cl.arguments import WHOLE, require_kinds, several
from cloudtomo_cl.errors import DataError
from cloudtomo_cl.memory import require, shape_text, voxels_of
from cloudtomo_cl.scene.arrays import as_numbers
from cloudtomo_cl.scene.sensors import BYTES_PER_RAY, PerspectiveView, Pixels, RayView

# Allowed rounding error of a rotation, for matrices in single precision.
_ROUNDING = 1e-5
# Distance, in pixels, up to which a principal point counts as the image's centre.
_CENTRED = 1e-6
_MOST_COEFFICIENTS = 5
# Of an image.
_BYTES_PER_PIXEL = 8
# Largest number of fixed-point iterations that undo a distortion, and the residual, in pixels, at which they end.
_ITERATIONS, _UNDONE = 100, 1e-8


def camera_from_pose(
    rotation: np.ndarray,
    translation: np.ndarray,
    matrix: np.ndarray,
    pixels: Pixels,
    distortion: Sequence[float] = (),
) -> PerspectiveView | RayView:
    """A pinhole camera by its pose: a point X of the scene (km) lies at R X + t in the camera's frame.

    The camera's frame has x to the right of the image, y down, and z along the line of sight; pixel (column c, row r)
    has its centre at image coordinates (c, r), as in OpenCV.

    Parameters
    ----------
    rotation : rotation R from the scene's axes (east, north, up) to the camera's, shape (3, 3)
    translation : translation t, km, shape (3,); the camera stands at -R^T t
    matrix : camera matrix K = [[fx, skew, cx], [0, fy, cy], [0, 0, 1]], pixels
    pixels : numbers of pixels (width, height)
    distortion : coefficients k1, k2, p1, p2, k3 of the lens; missing ones are 0

    Returns
    -------
    view : a `PerspectiveView`; with a distortion, a skew, or a principal point (cx, cy) off the image's centre a
        `RayView` with one ray through the centre of each pixel, which a reconstruction never resamples

    Raises
    ------
    DataError : arrays of other shapes, no rotation, no focal length, a distortion that cannot be undone in a pixel; an
        argument is of another kind (InvalidArgumentError)
    InvalidSettingError : a camera below the ground, or too far away

    Source: Brown 1971, "Close-range camera calibration"; OpenCV's documentation, "Camera Calibration and 3D
    Reconstruction".
    """
    require_kinds("camera_from_pose", pixels=(pixels, several(2, WHOLE)))
    _require_memory(_BYTES_PER_PIXEL, pixels)
    r, t, k = _checked(rotation, translation, matrix)
    coefficients = np.zeros(_MOST_COEFFICIENTS)
    lens = as_numbers(distortion, "distortion")
    if lens.ndim != 1 or len(lens) > _MOST_COEFFICIENTS or not np.isfinite(lens).all():
        raise DataError(f"distortion is {lens.tolist()}: it must have at most 5 numbers, k1, k2, p1, p2, k3")
    coefficients[: len(lens)] = lens
    position, (width, height) = -r.T @ t, pixels
    middle = np.array([width - 1, height - 1]) / 2
    if not coefficients.any() and k[0, 1] == 0 and np.abs(k[:2, 2] - middle).max() < _CENTRED:
        field_of_view = 2 * np.degrees(np.arctan(width / (2 * k[0, 0])))
        aspect = (height / k[1, 1]) / (width / k[0, 0])
        return PerspectiveView(
            position=_triple(position),
            target=_triple(position + r[2] * max(float(np.linalg.norm(position)), 1.0)),
            up=_triple(-r[1]),
            field_of_view=float(field_of_view),
            pixels=pixels,
            aspect=float(aspect),
        )
    _require_memory(BYTES_PER_RAY, pixels)
    columns, rows = np.meshgrid(np.arange(width), np.arange(height))
    plane = _undistorted(columns.ravel(), rows.ravel(), k, coefficients)
    directions = np.column_stack([*plane, np.ones(width * height)]) @ r
    return RayView(np.broadcast_to(position, directions.shape), directions, pixels)


def _require_memory(bytes_per_pixel: int, pixels: Pixels) -> None:
    """DataError if there is not memory enough for a camera's image, or its rays."""
    require(bytes_per_pixel * voxels_of(pixels), f"a camera of {shape_text(pixels)} pixels", "use fewer")


def _checked(rotation: np.ndarray, translation: np.ndarray, matrix: np.ndarray) -> tuple[np.ndarray, ...]:
    """The arrays in double precision; raises DataError if they are no pose or no camera matrix."""
    given = {"rotation": rotation, "translation": translation, "matrix": matrix}
    r, t, k = (as_numbers(array, name) for name, array in given.items())
    for name, array, shape in (("rotation", r, (3, 3)), ("translation", t.ravel(), (3,)), ("matrix", k, (3, 3))):
        if array.shape != shape or not np.isfinite(array).all():
            raise DataError(f"{name} has shape {array.shape}: it must have {shape}, and finite numbers")
    if not np.allclose(r @ r.T, np.eye(3), atol=_ROUNDING) or np.linalg.det(r) < 0:
        raise DataError(
            f"rotation is none (R R^T must be 1, its determinant {np.linalg.det(r):.3g} must be +1): if it turns "
            "a frame with y up, or a left-handed one, change the signs of its rows first"
        )
    if not (k[0, 0] > 0 and k[1, 1] > 0) or k[1, 0] or k[2, 0] or k[2, 1] or k[2, 2] != 1:
        raise DataError(f"matrix is {k.tolist()}: it must be [[fx, skew, cx], [0, fy, cy], [0, 0, 1]], fx, fy above 0")
    return r, t.ravel(), k


def _triple(values: np.ndarray) -> tuple[float, float, float]:
    return float(values[0]), float(values[1]), float(values[2])


def _distorted(x: np.ndarray, y: np.ndarray, coefficients: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The point of the plane z = 1 at which a lens shows the point (x, y) of this plane."""
    k1, k2, p1, p2, k3 = coefficients
    square = x**2 + y**2
    radial = 1 + square * (k1 + square * (k2 + square * k3))
    return (
        x * radial + 2 * p1 * x * y + p2 * (square + 2 * x**2),
        y * radial + p1 * (square + 2 * y**2) + 2 * p2 * x * y,
    )


def _undistorted(
    column: np.ndarray, row: np.ndarray, k: np.ndarray, coefficients: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Points of the plane z = 1 that appear in pixels, by fixed-point iteration."""
    seen_y = (row - k[1, 2]) / k[1, 1]
    seen_x = (column - k[0, 2] - k[0, 1] * seen_y) / k[0, 0]
    x, y = seen_x.copy(), seen_y.copy()
    off = np.zeros(len(x))
    with np.errstate(over="ignore", invalid="ignore"):
        for _ in range(_ITERATIONS):
            there_x, there_y = _distorted(x, y, coefficients)
            error_x, error_y = seen_x - there_x, seen_y - there_y
            off = np.hypot(error_x * k[0, 0], error_y * k[1, 1])
            if (off < _UNDONE).all():
                return x, y
            x, y = x + error_x, y + error_y
    worst = int(np.argmax(np.where(np.isfinite(off), off, np.inf)))
    raise DataError(
        f"distortion {coefficients.tolist()} cannot be undone at column {column[worst]}, row {row[worst]}: check the "
        "order k1, k2, p1, p2, k3, or leave the image's edges out"
    )
