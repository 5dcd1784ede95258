"""Pixels of a camera that are saturated, or stuck at a bright value: they repeat one radiance where others differ.

Dead columns, of radiance 0, are not looked for: over black ground they look as a gap between two clouds does.
"""

from __future__ import annotations

import numpy as np

from cloudtomo_cl.scene.measurements import Measurements
from cloudtomo_cl.scene.scene import Scene
from cloudtomo_cl.scene.sensors import RayView

# Least number of saturated pixels; of radiances that an image resolves above half of the largest; and the factor by
# which saturated pixels are more than those of any other of these radiances.
_SATURATED, _LEVELS, _MORE = 10, 20, 5.0
# Least number of pixels of a stuck column or row that are brighter than those beside them, by so many standard errors.
_LINE, _SIGNIFICANT = 8, 5.0
# Share by which a radiance may exceed that of the lit ground to count as it.
_GROUND = 0.01
_NAMED = 3


def stuck_text(scene: Scene, measurements: Measurements) -> str:
    """A text that says which views seem to have saturated pixels, or bright columns or rows; empty if none does.

    The ground in full light has one radiance, too: of what is no brighter nothing is said.
    """
    sun = scene.sun
    ground = scene.surface.albedo * np.cos(np.radians(sun.zenith)) * sun.irradiance / np.pi
    found = []
    views = zip(measurements.views, measurements.images, measurements.standard_errors)
    for number, (view, image, error) in enumerate(views):
        if isinstance(view, RayView) or not np.nanmax(image) > (1 + _GROUND) * ground:
            continue
        if count := saturated_pixels(image):
            found.append(
                f"{count} pixels of view {number} have exactly {np.nanmax(image):.4g} W m^-2 sr^-1, the largest"
            )
        for name, pixels, noise in (("column", image, error), ("row", image.T, error.T)):
            for place in bright_columns(pixels, noise):
                found.append(f"{name} {place} of view {number} has one radiance, brighter than beside it")
    if not found:
        return ""
    more = f"; and {len(found) - _NAMED} more" if len(found) > _NAMED else ""
    named = "; ".join(found[:_NAMED])
    return f"pixels seem to be saturated or stuck: {named}{more}. Set the radiance of such pixels to NaN"


def saturated_pixels(image: np.ndarray) -> int:
    """The number of pixels that share the largest radiance, if they are many more than share any other; otherwise 0."""
    radiances, counts = np.unique(image[~np.isnan(image)], return_counts=True)
    bright = counts[radiances > radiances[-1] / 2]
    many = len(bright) > _LEVELS and bright[-1] >= _SATURATED and bright[-1] > _MORE * bright[:-1].max()
    return int(bright[-1]) if many else 0


def bright_columns(image: np.ndarray, error: np.ndarray) -> list[int]:
    """Columns all of whose pixels have one radiance, and are brighter than those on both sides beyond their noise.

    image, error : radiances and their standard errors (0 where unknown), shape (rows, columns)
    """
    found = []
    for column in range(1, image.shape[1] - 1):
        values = image[:, column][~np.isnan(image[:, column])]
        if len(values) and (values == values[0]).all():
            beside = [column - 1, column + 1]
            darker = (values[0] - image[:, beside] > _SIGNIFICANT * error[:, beside]).all(axis=1)
            if np.count_nonzero(darker) >= _LINE:
                found.append(column)
    return found
