"""Measured images beside those of a recovered cloud: what is left, in per cent and in standard errors."""

from __future__ import annotations

import numpy as np

from cloudtomo_cl.scene.measurements import Measurements


def per_cent(measured: Measurements, modelled: Measurements) -> list[np.ndarray]:
    """Modelled minus measured radiance, in per cent of the measured mean of the view; NaN in bad pixels."""
    pairs = zip(measured.images, modelled.images)
    return [100 * (model - image) / max(abs(float(np.nanmean(image))), 1e-300) for image, model in pairs]


def standard_errors(measured: Measurements, modelled: Measurements) -> list[np.ndarray]:
    """Of the differences, W m^-2 sr^-1: measured noise, the gain's error, and the modelled paths' noise; 0: unknown.

    Errors of rendered images are pooled over neighbours already (`Measurements.rendered`).
    """
    errors = []
    for index, error in enumerate(measured.calibration_errors):
        gain = error * np.nan_to_num(measured.images[index])
        errors.append(np.sqrt(measured.standard_errors[index] ** 2 + gain**2 + modelled.standard_errors[index] ** 2))
    return errors


def in_standard_errors(measured: Measurements, modelled: Measurements) -> list[np.ndarray]:
    """Modelled minus measured radiance over its standard error; NaN where that is unknown, and in bad pixels."""
    differences = []
    for image, model, error in zip(measured.images, modelled.images, standard_errors(measured, modelled)):
        nothing = np.full(image.shape, np.nan)
        differences.append(np.divide(model - image, error, out=nothing, where=error > 0))
    return differences
