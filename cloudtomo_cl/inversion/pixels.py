"""The active pixels of a problem, and what was measured there."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from cloudtomo_cl.errors import DataError
from cloudtomo_cl.inversion.calibration import Calibration
from cloudtomo_cl.inversion.objective import noise_of, pixel_weights, variance_of
from cloudtomo_cl.inversion.outliers import Outlier, outlier_factors
from cloudtomo_cl.scene.grid import Grid
from cloudtomo_cl.scene.measurements import Measurements
from cloudtomo_cl.scene.pixels import neighbours, touching
from cloudtomo_cl.scene.pointing import MOTIONS, image_motions
from cloudtomo_cl.scene.sensors import View
from cloudtomo_cl.scene.visibility import pixels_that_see

# A radiance counts in the weights as no more than this multiple of this percentile of all.
_BRIGHTEST, _BRIGHT_PERCENTILE = 3.0, 99.0


@dataclass(frozen=True, eq=False)
class ActivePixels:
    """The valid pixels that look at voxels of a mask, and what was measured there.

    Attributes
    ----------
    views : views of the measurements
    listed : pixels as (view, row * width + column), uint32, shape (pixels, 2)
    radiance, standard_error : measured radiances and their standard errors, W m^-2 sr^-1, shape (pixels,); errors are 0
        where unknown
    calibration_errors : standard errors of the views' gains
    motions : change of each pixel per unit of its view's motions (`scene.pointing`), shape (pixels, 3); None: no motion
        is possible
    motion_errors : standard errors of the views' motions, shape (views, 3)
    factors : factors of the weights (`outliers`), shape (pixels,); None: all 1
    """

    views: tuple[View, ...]
    listed: np.ndarray
    radiance: np.ndarray
    standard_error: np.ndarray
    calibration_errors: tuple[float, ...]
    motions: np.ndarray | None = None
    motion_errors: np.ndarray | None = None
    factors: np.ndarray | None = None

    def __len__(self) -> int:
        return len(self.listed)

    @cached_property
    def level(self) -> np.ndarray:
        """Mean radiance of a pixel and its neighbours, W m^-2 sr^-1, shape (pixels,): for weights.

        Weights from the radiance of the pixel alone would be largest where noise has made it dark. A broken pixel, far
        brighter than nearly all others, counts as no more than a bright one.
        """
        bright = float(np.percentile(self.radiance, _BRIGHT_PERCENTILE))
        radiance = np.minimum(self.radiance, _BRIGHTEST * bright) if bright > 0 else self.radiance
        return neighbours(self.views, self.listed) @ radiance

    @cached_property
    def error(self) -> np.ndarray:
        """Root mean square of the standard errors of a pixel and its neighbours, where they are known, shape (pixels,).

        The error of the pixel alone, from the same few paths or electrons as its radiance, is smallest where that is
        too dark.
        """
        around, known = neighbours(self.views, self.listed), self.standard_error > 0
        mean, share = around @ self.standard_error**2, around @ known.astype(np.float64)
        return np.sqrt(np.divide(mean, share, out=np.zeros(len(self)), where=known))

    @cached_property
    def weights(self) -> np.ndarray:
        """Weights of the squared residuals in the data term, shape (pixels,)."""
        weights = pixel_weights(self.level, self.error)
        return weights if self.factors is None else weights * self.factors

    @cached_property
    def variance(self) -> np.ndarray:
        """Variance of the measured radiances' noise, estimated where it is unknown, shape (pixels,)."""
        return variance_of(self.level, self.standard_error)

    @cached_property
    def touching(self) -> np.ndarray:
        """Pixels that touch each one, see `scene.pixels.touching`; shape (pixels, 9)."""
        return touching(self.views, self.listed)

    def without_outliers(self, residual: np.ndarray, variance: np.ndarray) -> ActivePixels:
        """The same pixels, of which those hardly count that are far from the model; see `outlier_factors`.

        residual : modelled minus measured radiances, W m^-2 sr^-1, shape (pixels,)
        variance : variance of the modelled radiances' noise, (W m^-2 sr^-1)^2, shape (pixels,)
        """
        factors = self._outlier_factors(residual, variance)
        return self if (factors == 1).all() else replace(self, factors=factors)

    def outliers(self, residual: np.ndarray, variance: np.ndarray) -> tuple[Outlier, ...]:
        """The pixels that are far from the model, the farthest first; parameters as of `without_outliers`."""
        factors = self._outlier_factors(residual, variance)
        found = np.flatnonzero(factors < 1)
        return tuple(self._outlier(int(pixel), float(residual[pixel])) for pixel in found[np.argsort(factors[found])])

    def _outlier_factors(self, residual: np.ndarray, variance: np.ndarray) -> np.ndarray:
        noise = self.weights * (self.variance + variance)
        return outlier_factors(self.weights * residual**2, noise, self.touching)

    def _outlier(self, pixel: int, residual: float) -> Outlier:
        view, number = (int(index) for index in self.listed[pixel])
        measured = float(self.radiance[pixel])
        return Outlier(view, *divmod(number, self.views[view].pixels[0]), measured, measured + residual)

    @property
    def unit(self) -> float:
        """The data term's unit, n of the prior: the mean over pixels of weight times noise variance."""
        return 2 * noise_of(self.variance, self.weights) / len(self)

    @cached_property
    def expected_cost(self) -> float | None:
        """Mean data term of the true cloud, by the measured images' noise alone; None if that is unknown."""
        return noise_of(self.variance, self.weights) if self.standard_error.any() else None

    @cached_property
    def calibration(self) -> Calibration:
        """The unknown gains and motions of the views."""
        view = self.listed[:, 0]
        return Calibration(self.weights, view, self.calibration_errors, self.unit, self.motions, self.motion_errors)


def active_pixels(measurements: Measurements, grid: Grid, mask: np.ndarray) -> ActivePixels:
    """The valid pixels that look at voxels of the mask; the others tell little and cost as much time.

    Raises
    ------
    DataError : there are no such pixels, or no light in them
    """
    pixels, radiance, errors, motions = [], [], [], []
    motion_errors = measurements.motion_errors(grid)
    for index, (view, image) in enumerate(zip(measurements.views, measurements.images)):
        chosen = np.flatnonzero(pixels_that_see(view, grid, mask) & measurements.valid[index])
        pixels.append(np.column_stack([np.full(len(chosen), index), chosen]))
        radiance.append(image.ravel()[chosen])
        errors.append(measurements.standard_errors[index].ravel()[chosen])
        if motion_errors[index].any():
            motions.append(image_motions(view, image, grid).reshape(-1, MOTIONS)[chosen])
        else:
            motions.append(np.zeros((len(chosen), MOTIONS)))
    if not any(map(len, radiance)):
        raise DataError("no valid pixel of any view looks at the mask: check the views' positions and targets")
    if not any((values > 0).any() for values in radiance):
        raise DataError("no pixel that looks at the mask has a radiance above 0: there is no light to see a cloud by")
    return ActivePixels(
        measurements.views,
        np.concatenate(pixels).astype(np.uint32),
        np.concatenate(radiance),
        np.concatenate(errors),
        measurements.calibration_errors,
        np.concatenate(motions) if motion_errors.any() else None,
        motion_errors,
    )
