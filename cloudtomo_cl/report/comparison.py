"""Measured images beside those of a recovered cloud: what is left, in per cent and in standard errors."""

from __future__ import annotations

import numpy as np

from cloudtomo_cl.scene.measurements import Measurements
from cloudtomo_cl.scene.sensors import RayView

# The noise of modelled pixels is taken from so many of them each way: a pixel's own few bright paths make it bright
# and its error large, or are missed and leave both small, so that dark ones would seem certain.
_WINDOW = 7


def per_cent(measured: Measurements, modelled: Measurements) -> list[np.ndarray]:
    """Modelled minus measured radiance, in per cent of the measured mean of the view; NaN in bad pixels."""
    pairs = zip(measured.images, modelled.images)
    return [100 * (model - image) / max(abs(float(np.nanmean(image))), 1e-300) for image, model in pairs]


def standard_errors(measured: Measurements, modelled: Measurements) -> list[np.ndarray]:
    """Of the differences, W m^-2 sr^-1: measured noise, the gain's error, and the modelled paths' noise; 0: unknown."""
    errors = []
    for index, view in enumerate(measured.views):
        gain = measured.calibration_errors[index] * np.nan_to_num(measured.images[index])
        rendered = modelled.standard_errors[index]
        if not isinstance(view, RayView):
            rendered = _of_neighbours(rendered)
        errors.append(np.sqrt(measured.standard_errors[index] ** 2 + gain**2 + rendered**2))
    return errors


def in_standard_errors(measured: Measurements, modelled: Measurements) -> list[np.ndarray]:
    """Modelled minus measured radiance over its standard error; NaN where that is unknown, and in bad pixels."""
    differences = []
    for image, model, error in zip(measured.images, modelled.images, standard_errors(measured, modelled)):
        nothing = np.full(image.shape, np.nan)
        differences.append(np.divide(model - image, error, out=nothing, where=error > 0))
    return differences


def _of_neighbours(error: np.ndarray) -> np.ndarray:
    """The root mean square over windows of neighbours."""
    from scipy.ndimage import uniform_filter

    # The filter's running sums leave rounding where there is nothing.
    return np.sqrt(np.maximum(uniform_filter(error**2, _WINDOW, mode="nearest"), 0.0))
