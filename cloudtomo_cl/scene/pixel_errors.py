"""Standard errors of rendered pixels, pooled over neighbours so that they are valid error bars.

The scatter of a single pixel's few paths is an unbiased variance, but useless as an error bar: most of a pixel's light
comes by rare bright paths, and where none of these has come yet, the mean is too small and its error far too small.
Weights by the inverse squares of such errors prefer pixels that are too dark. The pixels around one see nearly the
same, and have together ten to a hundred times the paths. docs/explanation/uncertainty.md measures how often the pooled
errors hold. Their drawback: beside a cloud's edge, errors of clear and dark pixels are too large.
"""

from __future__ import annotations

import numpy as np

from cloudtomo_cl.errors import DataError

# Reach, in pixels, of the two means of a path's variance: touching pixels tell a cloud from the ground beside it; a
# wider neighbourhood has seen rare bright paths at 16 paths a pixel.
_NEAR, _WIDE = 1, 3
# Number of a pixel's paths up to which the wider mean counts in full; with more paths its factor is this number over
# theirs. At 1024 paths the touching pixels suffice, and the wider mean would make errors 40 % too large, on average
# over a cloud's image.
_FEW_PATHS = 64.0
# Lower bound of a pixel's error, as a share of that by its own paths: a rare bright path may be the first one in a dark
# neighbourhood. A share of a third or more would make weights prefer pixels that are dark by chance.
_LEAST_SHARE = 0.2
_ROUNDING = 1e-9


def pooled_standard_errors(standard_error: np.ndarray, samples: np.ndarray | float) -> np.ndarray:
    """Standard errors from the scatter of the paths of a pixel and of those around it in its image.

    A pixel's error comes from the larger of two means of a path's variance: over the pixels that touch it, and, with
    few paths, over those up to three pixels away. Every path has the same weight. The pixel's own paths are left out,
    so that its error does not depend on its noise, and weights do not prefer pixels that are dark by chance; but the
    error is at least a fifth of that by its own paths. In a single row or column of pixels the pixel's own paths count,
    too, since the rays of a list may have nothing in common; rays that form an image have its neighbours. A pixel
    without neighbours keeps its error.

    Parameters
    ----------
    standard_error : standard error by each pixel's own paths, shape (rows, columns), any unit; NaN: no pixel
    samples : number of each pixel's paths, one number or the same shape

    Returns
    -------
    standard errors in the same unit and shape; 0 only where all paths of the neighbourhood have the same radiance

    Raises
    ------
    DataError : shapes that do not belong together, errors that are negative or infinite, no samples
    """
    given = np.asarray(standard_error, dtype=np.float64)
    try:
        paths = np.broadcast_to(np.asarray(samples, dtype=np.float64), given.shape)
    except ValueError:
        paths = np.empty(0)
    if given.ndim != 2 or paths.shape != given.shape:
        shapes = f"standard_error has shape {given.shape}, samples {np.shape(samples)}"
        raise DataError(f"{shapes}: both must be (rows, columns), or samples one number")
    there = ~np.isnan(given)
    possible = np.isfinite(given) & (given >= 0) & np.isfinite(paths) & (paths > 0)
    if not possible[there].all():
        raise DataError("standard_error must be finite and at least 0, and samples above 0, in every pixel")
    weight = np.where(there, paths, 0.0)
    scatter = np.where(there, given * weight, 0.0) ** 2
    # Independent of the pixel's own paths; see above.
    left_out = min(given.shape) > 1
    largest = _LEAST_SHARE**2 * np.divide(scatter, weight, out=np.zeros(given.shape), where=there)
    few = np.minimum(1.0, _FEW_PATHS / np.where(there, paths, 1.0))
    for reach, share in ((_NEAR, 1.0), (_WIDE, few)):
        around, paths_around = _sum_around(scatter, reach), _sum_around(weight, reach)
        others = left_out & (paths_around > weight * (1 + _ROUNDING))
        around = np.where(others, np.maximum(around - scatter, 0.0), around)
        paths_around = np.where(others, paths_around - weight, paths_around)
        largest = np.maximum(largest, share * np.divide(around, paths_around, out=np.zeros(given.shape), where=there))
    return np.sqrt(np.divide(largest, paths, out=np.full(given.shape, np.nan), where=there))


def _sum_around(values: np.ndarray, reach: int) -> np.ndarray:
    """The sum over pixels up to `reach` away, along rows and columns."""
    for axis in range(2):
        padded = np.pad(values, [(reach, reach) if axis == other else (0, 0) for other in range(2)])
        total = np.zeros(values.shape)
        for start in range(2 * reach + 1):
            total += padded.take(range(start, start + values.shape[axis]), axis)
        values = total
    return values
