"""Where sensors, sun and north are: as seen from the cloud, and within images."""

from __future__ import annotations

import numpy as np

from cloudtomo_cl.scene.grid import Grid
from cloudtomo_cl.scene.sensors import RayView, View
from cloudtomo_cl.scene.sights import towards_sensor

# Displacements whose images tell directions, as a share of the domain's height.
_SMALL = 1e-3


def angles(direction: np.ndarray) -> tuple[float, float]:
    """Zenith angle and azimuth (from +x towards +y, 0 to 360) of a direction, degrees."""
    zenith = np.degrees(np.arccos(np.clip(direction[2] / np.linalg.norm(direction), -1, 1)))
    azimuth = np.degrees(np.arctan2(direction[1], direction[0])) % 360
    vertical = min(zenith, 180 - zenith) < _SMALL
    return float(zenith), 0.0 if vertical or azimuth > 360 - _SMALL else float(azimuth)


def in_image(view: View, grid: Grid, displacement: np.ndarray) -> np.ndarray | None:
    """Where a displacement at the domain's centre points in an image: pixels to the right and down per km.

    None for a list of rays, and for a sensor in whose plane the centre lies.
    """
    if isinstance(view, RayView):
        return None
    step = _SMALL * max(grid.extent)
    points = np.array([grid.centre, np.add(grid.centre, step * np.asarray(displacement, float))])
    u, v, depth = view.project(grid, points)
    if not (depth > 0).all():
        return None
    moved = np.array([u[1] - u[0], v[1] - v[0]]) * view.pixels / step
    return moved if np.isfinite(moved).all() else None


def kilometre(view: View, grid: Grid) -> float | None:
    """Pixels of a kilometre across the line of sight, level and at the domain's centre; None where `in_image` is."""
    sight = towards_sensor(view, grid)
    across = np.array([-sight[1], sight[0], 0.0])
    if np.linalg.norm(across) < _SMALL:
        across = np.array([1.0, 0.0, 0.0])
    moved = in_image(view, grid, across / np.linalg.norm(across))
    return None if moved is None else float(np.linalg.norm(moved))


def round_length(longest: float) -> float:
    """The largest of 1, 2, 5 times a power of ten that is not longer: for scale bars."""
    power = 10.0 ** np.floor(np.log10(longest))
    return float(max(digit * power for digit in (1, 2, 5) if digit * power <= longest * (1 + 1e-9)))
