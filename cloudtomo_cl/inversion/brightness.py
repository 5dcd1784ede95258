"""Whether images are as bright as clouds can be: if not, their unit is wrong, or the sun's irradiance."""

from __future__ import annotations

import numpy as np

from cloudtomo_cl.errors import DataError
from cloudtomo_cl.scene.measurements import Measurements
from cloudtomo_cl.scene.scene import Scene
from cloudtomo_cl.scene.sights import towards_sensor

# Radiance over the sun's irradiance, sr^-1: clouds and ground that reflect all light have some 1 / pi. More than the
# first is doubtful, more than the second impossible. Of views that look nearer to the sun than so many degrees, where
# phase functions have peaks, nothing is said.
_BRIGHT, _BRIGHTEST, _NEAREST_TO_SUN = 1.0, 3.0, 60.0
# That of an image is a percentile, so that broken pixels do not count.
_PERCENTILE = 95.0
# An optical depth of 1e-4 has some 1e-6; what is far below even that has no cloud, and squares that single precision
# does not hold.
_FAINT, _FAINTEST = 1e-6, 1e-9
_LEAST = 1e-15  # W m^-2 sr^-1, for any sun: its square is still a number in single precision
_HINT = "check the radiances' unit, W m^-2 sr^-1, and sun.irradiance, W m^-2 (at which the images were taken)"


def brightness_text(scene: Scene, measurements: Measurements) -> str:
    """A text that says that the images are too bright or too dark for a cloud; empty if they are not.

    Raises
    ------
    DataError : no cloud under this sun makes such radiances: they are far above it, or nearly nothing
    """
    sun = scene.sun.irradiance
    away = [
        float(np.nanpercentile(image, _PERCENTILE))
        for view, image in zip(measurements.views, measurements.images)
        if -towards_sensor(view, scene.grid) @ scene.sun.direction <= np.cos(np.radians(_NEAREST_TO_SUN))
    ]
    if away and (typical := float(np.median(away))) > _BRIGHT * sun:
        text = (
            f"the images have radiances of {typical:.3g} W m^-2 sr^-1, {typical / sun:.3g} times the sun's irradiance "
            f"of {sun:g} W m^-2: a cloud that reflects all light has some 0.3 times: {_HINT}"
        )
        if typical > _BRIGHTEST * sun:
            raise DataError(text)
        return text
    brightest = max(float(np.nanmax(image)) for image in measurements.images)
    if not 0 < brightest < max(_FAINT * sun, _LEAST):
        return ""  # images without a radiance above 0 are refused elsewhere
    text = (
        f"the images' largest radiance is {brightest:.3g} W m^-2 sr^-1, {brightest / sun:.3g} times the sun's "
        f"irradiance of {sun:g} W m^-2, and no cloud that can be seen is so dark: {_HINT}"
    )
    if brightest < max(_FAINTEST * sun, _LEAST):
        raise DataError(text)
    return text
