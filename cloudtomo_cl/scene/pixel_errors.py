"""Standard errors of rendered pixels that hold: pooled over neighbours.

What a pixel's own few paths say of their scatter is unbiased as a variance and useless as an error bar: most of a
pixel's light comes by rare bright paths, and where none of them has come yet, the mean is too small and its error far
too small, together. Weights by the inverse squares of such errors prefer what is too dark. Pixels that lie side by
side see nearly the same, and have some ten to a hundred times the paths. How often these errors hold is measured in
docs/explanation/uncertainty.md. What they cost: beside a cloud's edge, errors of clear and dark pixels are too large.
"""

from __future__ import annotations

import numpy as np

from cloudtomo_cl.errors import DataError

# Pixels each way that a path's variance is the mean over: those that touch tell a cloud from the ground beside it, the
# wider ones have seen rare bright paths at 16 paths a pixel.
_NEAR, _WIDE = 1, 3
# Paths of a pixel up to which the wider ones count in full; with more, by so many over theirs. At 1024 paths those that
# touch know all, and the wider ones would make errors 40 % too large, on average over a cloud's image.
_FEW_PATHS = 64.0
# Share of what a pixel's own paths say that its error is at least: where a rare bright path is the first of a dark
# neighbourhood, nobody else knows of it. Shares of a third and more would make weights prefer what is dark by chance.
_LEAST_SHARE = 0.2
_ROUNDING = 1e-9


def pooled_standard_errors(standard_error: np.ndarray, samples: np.ndarray | float) -> np.ndarray:
    """Standard errors from the scatter of the paths of a pixel and of those around it in its image.

    The larger of two means of a path's variance: over the pixels that touch it, and, with few paths, over those up to
    three away. Every path counts the same, wherever there are more of them. The pixel's own paths are left out, so
    that its error has nothing to do with its own noise, and weights do not prefer what is dark by chance; but it is no
    less than a fifth of what they say. In a single row or column of pixels they count, too, for rays of a list may
    have nothing to do with each other; otherwise rays are neighbours that are so in their image. A pixel alone has its
    own error.

    Parameters
    ----------
    standard_error : of each pixel's own paths, shape (rows, columns), any unit; NaN where there is no pixel
    samples : paths of each pixel, one number or of that shape

    Returns
    -------
    standard errors of the same unit and shape; zero only where no path of the neighbourhood scatters

    Raises
    ------
    DataError : shapes that do not belong together, errors that are negative or infinite, no samples
    """
    own = np.asarray(standard_error, dtype=np.float64)
    try:
        paths = np.broadcast_to(np.asarray(samples, dtype=np.float64), own.shape)
    except ValueError:
        paths = np.empty(0)
    if own.ndim != 2 or paths.shape != own.shape:
        shapes = f"standard_error has shape {own.shape}, samples {np.shape(samples)}"
        raise DataError(f"{shapes}: both must be (rows, columns), or samples one number")
    there = ~np.isnan(own)
    possible = np.isfinite(own) & (own >= 0) & np.isfinite(paths) & (paths > 0)
    if not possible[there].all():
        raise DataError("standard_error must be finite and at least 0, and samples above 0, in every pixel")
    weight = np.where(there, paths, 0.0)
    scatter = np.where(there, own * weight, 0.0) ** 2
    # Independent of the pixel's own paths; see above.
    left_out = min(own.shape) > 1
    largest = _LEAST_SHARE**2 * np.divide(scatter, weight, out=np.zeros(own.shape), where=there)
    few = np.minimum(1.0, _FEW_PATHS / np.where(there, paths, 1.0))
    for reach, share in ((_NEAR, 1.0), (_WIDE, few)):
        around, paths_around = _sum_around(scatter, reach), _sum_around(weight, reach)
        others = left_out & (paths_around > weight * (1 + _ROUNDING))
        around = np.where(others, np.maximum(around - scatter, 0.0), around)
        paths_around = np.where(others, paths_around - weight, paths_around)
        largest = np.maximum(largest, share * np.divide(around, paths_around, out=np.zeros(own.shape), where=there))
    return np.sqrt(np.divide(largest, paths, out=np.full(own.shape, np.nan), where=there))


def _sum_around(values: np.ndarray, reach: int) -> np.ndarray:
    """The sum over pixels up to `reach` away, along rows and columns."""
    for axis in range(2):
        padded = np.pad(values, [(reach, reach) if axis == other else (0, 0) for other in range(2)])
        total = np.zeros(values.shape)
        for start in range(2 * reach + 1):
            total += padded.take(range(start, start + values.shape[axis]), axis)
        values = total
    return values
