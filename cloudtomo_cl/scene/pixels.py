"""Lists of pixels: an array (pixels, 2) of (view, row * width + column)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from cloudtomo_cl.errors import DataError
from cloudtomo_cl.scene.arrays import unmasked
from cloudtomo_cl.scene.sensors import RayView, View

if TYPE_CHECKING:
    import scipy.sparse

# A pixel and those that touch it form a square of so many pixels a side.
_AROUND = 3


def all_pixels(views: Sequence[View]) -> np.ndarray:
    """Every pixel of every view: an array (pixels, 2) of (view, row * width + column)."""
    counts = [view.pixels[0] * view.pixels[1] for view in views]
    return np.column_stack(
        [np.repeat(np.arange(len(views)), counts), np.concatenate([np.arange(count) for count in counts])]
    ).astype(np.uint32)


def checked_pixels(views: Sequence[View], pixels: Any) -> np.ndarray:
    """A list of pixels as kernels take it: uint32, shape (pixels, 2).

    Parameters
    ----------
    views : the sensors
    pixels : integers (view, row * width + column), both counted from 0, shape (pixels, 2)

    Raises
    ------
    DataError : the list has another shape, is empty or not of integers, or names a view or pixel that does not exist
    """
    given = unmasked(pixels, "pixels")
    if given.size == 0:
        raise DataError("the list of pixels is empty: give at least one (view, row * width + column)")
    if given.ndim != 2 or given.shape[1] != 2:
        raise DataError(f"pixels has shape {given.shape}: it must be (pixels, 2), of (view, row * width + column)")
    if given.dtype.kind not in "iu":
        raise DataError(f"pixels is of type {given.dtype}: it must be integers (view, row * width + column)")
    view, pixel = given.T.astype(np.int64)
    counts = np.array([view.pixels[0] * view.pixels[1] for view in views])
    wrong = (view < 0) | (view >= len(counts))
    if wrong.any():
        number = int(np.argmax(wrong))
        raise DataError(f"pixels[{number}] is of view {view[number]}: there are views 0 to {len(counts) - 1}")
    wrong = (pixel < 0) | (pixel >= counts[view])
    if wrong.any():
        number = int(np.argmax(wrong))
        last = counts[view[number]] - 1
        raise DataError(
            f"pixels[{number}] is pixel {pixel[number]} of view {view[number]}, which has pixels 0 to {last} "
            "(row * width + column)"
        )
    return np.ascontiguousarray(given, np.uint32)


def touching(views: Sequence[View], pixels: np.ndarray) -> np.ndarray:
    """The listed pixels that touch each one in its image, and it itself: numbers in the list, int, shape (pixels, 9).

    Row by row of the image, so that the pixel itself is in the middle; -1 where there is none. Rays of a `RayView`
    touch no others.
    """
    numbers = np.full((len(pixels), _AROUND**2), -1)
    for index, view in enumerate(views):
        chosen = np.flatnonzero(pixels[:, 0] == index)
        width, height = view.pixels
        place = np.full((height + 2, width + 2), -1)
        row, column = np.divmod(pixels[chosen, 1].astype(int), width)
        place[row + 1, column + 1] = chosen
        if isinstance(view, RayView):
            numbers[chosen, _AROUND**2 // 2] = chosen
            continue
        for offset in range(_AROUND**2):
            down, right = divmod(offset, _AROUND)
            numbers[chosen, offset] = place[row + down, column + right]
    return numbers


def neighbours(views: Sequence[View], pixels: np.ndarray) -> scipy.sparse.csr_matrix:
    """The matrix that takes the mean over each pixel and the listed pixels that touch it in its image.

    Its shape is (pixels, pixels), float32. Rays of a `RayView` have no neighbours.
    """
    import scipy.sparse

    around = touching(views, pixels).T  # in the order of offsets, in which a row's entries are added up
    column = around[around >= 0]
    row = np.broadcast_to(np.arange(len(pixels)), around.shape)[around >= 0]
    share = (1 / np.bincount(row, minlength=len(pixels)))[row].astype(np.float32)
    return scipy.sparse.csr_matrix((share, (row, column)), (len(pixels), len(pixels)))
