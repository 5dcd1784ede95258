"""Outliers: pixels whose residuals are so far from all others that no cloud explains them, as of a broken sensor."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

# A pixel is an outlier beyond this multiple of the root mean square of all weighted residuals, none of which counts for
# more than as much; and rounds in which that is found (each outlier in a hundred pixels slows them down).
_FAR, _ROUNDS = 10.0, 100
# ... and beyond this multiple of those of the pixels that touch it; so many outliers may lie together.
_APART, _TOGETHER = 3.0, 3
# ... and beyond so many standard errors of itself.
_SIGNIFICANT = 5.0
# Number of outliers that are named in a message.
_NAMED = 3


@dataclass(frozen=True)
class Outlier:
    """A pixel that no cloud explains: a broken one of the camera, or something that the model lacks.

    Attributes
    ----------
    view, row, column : where it is, counted from 0
    measured, modelled : its radiances, W m^-2 sr^-1
    """

    view: int
    row: int
    column: int
    measured: float
    modelled: float

    def __str__(self) -> str:
        where = f"row {self.row}, column {self.column} of view {self.view}"
        return f"{where} (measured {self.measured:.3g}, modelled {self.modelled:.3g} W m^-2 sr^-1)"


def outlier_factors(square: np.ndarray, noise: np.ndarray, touching: np.ndarray) -> np.ndarray:
    """Factors of pixels' weights, by which outliers hardly count: min(1, L / r^2), shape (pixels,).

    r^2 is a pixel's weighted squared residual. L is the largest of three:

    - the square of ten times the root mean square of all r, of which none counts for more than that itself, so that
      outliers have no part in what they are compared with;
    - nine times the third largest r^2 of the pixels that touch it, for a small cloud that is not found yet is seen by
      several pixels that lie together;
    - 25 times the mean r^2 that noise alone makes in it.

    An outlier's pull falls with its distance, as that of Cauchy's distribution does (Huber and Ronchetti 2009, Robust
    Statistics, chapter 4).

    Parameters
    ----------
    square : r^2, shape (pixels,)
    noise : mean of r^2 by the noise of measured and modelled images alone, shape (pixels,)
    touching : pixels that touch each one, and itself, as `scene.pixels.touching` has them, shape (pixels, 9)
    """
    limit = np.inf
    for _ in range(_ROUNDS):
        limit = _FAR**2 * float(np.mean(np.minimum(square, limit)))
    # The largest is as a rule the pixel's own.
    around = np.sort(np.where(touching >= 0, square[touching], 0.0), axis=1)
    alone = np.count_nonzero(touching >= 0, axis=1) == 1
    limits = np.maximum(np.maximum(limit, _SIGNIFICANT**2 * noise), _APART**2 * around[:, -1 - _TOGETHER])
    return np.divide(limits, square, out=np.ones_like(square), where=(square > limits) & ~alone)


def outlier_text(outliers: Sequence[Outlier]) -> str:
    """What to know about outliers, in words; empty if there are none."""
    if not outliers:
        return ""
    named = ", ".join(str(outlier) for outlier in outliers[:_NAMED])
    more = f" and {len(outliers) - _NAMED} more" if len(outliers) > _NAMED else ""
    which, they = ("1 pixel is", "it") if len(outliers) == 1 else (f"{len(outliers)} pixels are", "they")
    return (
        f"{which} far from what any cloud explains, and {they} hardly counted: {named}{more}. Set the radiance of "
        "broken pixels to NaN; where several lie together, the images show something that the scene has not"
    )
