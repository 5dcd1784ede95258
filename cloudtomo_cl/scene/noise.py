"""Noise of cameras: photon noise, read noise, digitisation, calibration."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated

import numpy as np
from pydantic import ConfigDict, Field, model_validator
from pydantic.dataclasses import dataclass

from cloudtomo_cl.arguments import a, require_kinds
from cloudtomo_cl.errors import DataError
from cloudtomo_cl.messages import answering
from cloudtomo_cl.scene.measurements import Measurements
from cloudtomo_cl.scene.scene import NotNegative
from cloudtomo_cl.scene.seeds import checked_seed

# Default ratio of full_radiance to the brightest pixel's radiance: the brightest pixel fills 80 % of its well.
_HEADROOM = 1.25
_MOST_ELECTRONS = 1e12


@answering
@dataclass(frozen=True, kw_only=True, config=ConfigDict(extra="forbid"))
class Noise:
    """The noise that a camera adds to the radiance of its pixels.

    The mean number of a pixel's electrons is proportional to its radiance times its view's gain; the number is a
    Poisson variate; reading adds normal noise. The sum is rounded to a digital number, and converted into radiance as
    if the gain were 1. Pixels with more electrons than the full well are saturated, and become invalid (NaN). Negative
    numbers stay, as after the subtraction of a camera's offset.

    Attributes
    ----------
    full_well : number of electrons of a pixel at `full_radiance`; their noise is its square root. Give this or
        `signal_to_noise`
    signal_to_noise : ratio of signal to photon noise at `full_radiance`, the square root of `full_well`
    full_radiance : radiance at which a pixel is full, W m^-2 sr^-1; by default 1.25 times that of the brightest pixel
    read_noise : root mean square of the read noise, electrons
    bits : number of bits of the digital numbers, from 0 to the full well; by default nothing is rounded
    calibration_error : standard deviation of the views' gains, which are 1 on average
    """

    full_well: Annotated[float, Field(ge=1, le=_MOST_ELECTRONS)] | None = None
    signal_to_noise: Annotated[float, Field(ge=1, le=_MOST_ELECTRONS**0.5)] | None = None
    full_radiance: Annotated[float, Field(ge=1e-15, le=1e15)] | None = None
    read_noise: NotNegative = 0.0
    bits: Annotated[int, Field(ge=1, le=32)] | None = None
    calibration_error: Annotated[float, Field(ge=0, le=0.3)] = 0.0

    @model_validator(mode="after")
    def _one_of_two(self) -> Noise:
        if (self.full_well is None) == (self.signal_to_noise is None):
            raise ValueError("give one of full_well and signal_to_noise")
        return self

    @property
    def electrons(self) -> float:
        """Number of electrons of the full well."""
        return self.full_well if self.full_well is not None else (self.signal_to_noise or 1.0) ** 2

    def added_to(self, measurements: Measurements, seed: int = 0, stream: int = 0) -> Measurements:
        """The images as this camera measures them.

        The standard errors combine those of the given images and of the noise at their radiance; the calibration
        error, which all pixels of a view share, goes to `calibration_errors`. Invalid pixels stay invalid.

        seed, stream : seed and stream of the random numbers; equal ones give equal noise

        Raises
        ------
        DataError : no pixel shows any light, and no full_radiance is given; an image is saturated as a whole; seed or
            stream is no whole number of 32 bits
        """
        require_kinds("Noise.added_to", measurements=(measurements, a(Measurements)))
        seed, stream = checked_seed(seed), checked_seed(stream, "stream")
        full = self.full_radiance
        if full is None:
            full = _HEADROOM * max(float(np.nanmax(image)) for image in measurements.images)
            if not full > 0:
                raise DataError("noise: no pixel shows any light: give noise.full_radiance (W m^-2 sr^-1)")
        unit = full / self.electrons  # radiance of one electron
        step = 0.0 if self.bits is None else self.electrons / 2**self.bits
        images, errors = [], []
        for index, (image, error) in enumerate(zip(measurements.images, measurements.standard_errors)):
            random = np.random.default_rng([seed, index, stream] if stream else [seed, index])
            gain = 1 + self.calibration_error * random.standard_normal()
            light = np.maximum(np.nan_to_num(image), 0.0) / unit
            # Far beyond the full well a pixel is saturated anyway, so the mean can be limited.
            read = random.poisson(np.minimum(max(gain, 0.0) * light, 2 * _MOST_ELECTRONS)).astype(float)
            read += self.read_noise * random.standard_normal(image.shape)
            saturated = read > self.electrons
            if saturated.all():
                raise DataError(f"noise: view {index} is saturated as a whole: raise noise.full_radiance ({full:g})")
            if step:
                read = step * np.round(read / step)
            images.append(np.where(np.isnan(image) | saturated, np.nan, read * unit))
            errors.append(np.sqrt(error**2 + unit**2 * (light + self.read_noise**2 + step**2 / 12)))
        gains = tuple(float(np.hypot(before, self.calibration_error)) for before in measurements.calibration_errors)
        return replace(measurements, images=tuple(images), standard_errors=tuple(errors), calibration_errors=gains)
