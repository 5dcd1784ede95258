"""Views that cannot be: each is refused when it is made."""

import numpy as np
import pytest
from pydantic import ValidationError

from cloudtomo_cl.grid import Grid
from cloudtomo_cl.sensors import OrthographicView, PerspectiveView

PERSPECTIVE = {"position": (0.0, 0.0, 2.0), "target": (0.5, 0.5, 0.0), "field_of_view": 30.0, "pixels": (4, 4)}


@pytest.mark.parametrize("number", [np.nan, np.inf])
@pytest.mark.parametrize("name", ["position", "target", "up"])
def test_coordinates_are_finite(name, number):
    with pytest.raises(ValidationError, match="finite"):
        PerspectiveView(**{**PERSPECTIVE, name: (0.0, number, 1.0)})


def test_an_azimuth_is_finite():
    with pytest.raises(ValidationError, match="finite"):
        OrthographicView(zenith=10.0, azimuth=np.nan, width=1.0, pixels=(4, 4))


@pytest.mark.parametrize("up", [(0.0, 0.0, 1.0), (0.0, 0.0, 0.0)])
def test_up_is_not_along_the_line_of_sight(up):
    with pytest.raises(ValidationError, match="up is parallel"):
        OrthographicView(zenith=0.0, width=1.0, pixels=(4, 4), up=up)


def test_a_line_of_sight_close_to_vertical_has_north_up():
    view = OrthographicView(zenith=1e-9, width=1.0, pixels=(4, 4))
    origin, _ = view.rays(Grid(shape=(1, 1, 1), spacing=(1, 1, 1)))
    np.testing.assert_allclose(origin[2], (0, -1, 0), atol=1e-6)


def test_no_ray_starts_below_the_ground():
    with pytest.raises(ValidationError, match="below the ground"):
        OrthographicView(position=(-1, 0.4, 0.1), target=(0.4, 0.4, 0.6), width=1.2, pixels=(4, 4))


def test_an_aspect_of_ones_own_stretches_the_pixels():
    grid = Grid(shape=(1, 1, 1), spacing=(1, 1, 1))
    square, stretched = (PerspectiveView(**PERSPECTIVE, aspect=aspect).rays(grid)[1] for aspect in (None, 2.0))
    np.testing.assert_allclose(stretched[1:], square[1:] * [[1], [2]])
