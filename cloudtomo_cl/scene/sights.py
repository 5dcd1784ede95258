"""Where sensors look from, seen from the cloud."""

from __future__ import annotations

import numpy as np

from cloudtomo_cl.scene.grid import Grid
from cloudtomo_cl.scene.sensors import PerspectiveView, RayView, View


def towards_sensor(view: View, grid: Grid) -> np.ndarray:
    """Unit vector from the domain's centre towards a sensor; of a list of rays against their mean direction."""
    if isinstance(view, RayView):
        sight = view.directions.mean(axis=0)
    elif isinstance(view, PerspectiveView):
        sight = np.subtract(grid.centre, view.position)
    else:
        sight = view.rays(grid)[1][0]
        if view.type == "push-broom":  # its middle column looks straight ahead, down, or back
            sight = sight + view.rays(grid)[1][1] / 2
    length = float(np.linalg.norm(sight))
    return -sight / length if length > 0 else np.array([0.0, 0.0, 1.0])
