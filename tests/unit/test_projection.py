"""Projection of points is the inverse of the views' rays."""

import numpy as np
import pytest

from cloudtomo_cl.grid import Grid
from cloudtomo_cl.sensors import OrthographicView, PerspectiveView

GRID = Grid(shape=(4, 5, 6), spacing=(0.1, 0.1, 0.2))
VIEWS = [
    PerspectiveView(position=(0.3, -0.2, 2.0), target=(0.2, 0.2, 0.5), field_of_view=70.0, pixels=(20, 10)),
    PerspectiveView(
        position=(0.2, 0.2, 2.0), target=(0.2, 0.2, 0.5), field_of_view=40.0, pixels=(8, 9), up=(0.0, 1.0, 0.0)
    ),
    OrthographicView(width=1.5, pixels=(10, 20), zenith=50.0, azimuth=130.0),
    OrthographicView(width=0.5, pixels=(10, 5), position=(0.1, 0.2, 3.0), target=(0.3, 0.2, 0.0)),
]


@pytest.mark.parametrize("view", VIEWS)
def test_a_point_on_a_ray_projects_to_the_rays_image_coordinates(view):
    generator = np.random.default_rng(0)
    u, v, distance = generator.uniform(0.1, 1.0, (3, 50))
    origin, axes = view.rays(GRID)
    image = np.stack([np.ones_like(u), u, v], axis=-1)
    points = image @ origin + distance[:, None] * (image @ axes)
    u_found, v_found, depth = view.project(GRID, points)
    np.testing.assert_allclose(u_found, u, atol=1e-12)
    np.testing.assert_allclose(v_found, v, atol=1e-12)
    np.testing.assert_allclose(depth, distance, atol=1e-12)


@pytest.mark.parametrize("view", VIEWS)
def test_points_behind_the_sensor_have_negative_depth(view):
    origin, axes = view.rays(GRID)
    behind = (origin - 0.3 * axes)[0] + 0.5 * (origin - 0.3 * axes)[1:].sum(axis=0)
    assert view.project(GRID, behind)[2] == pytest.approx(-0.3)


def test_east_is_right_and_north_is_up_from_above():
    u, v, _ = VIEWS[1].project(GRID, np.array([[0.25, 0.2, 0.5], [0.2, 0.25, 0.5]]))
    assert u[0] > 0.5 and v[0] == pytest.approx(0.5)
    assert v[1] < 0.5 and u[1] == pytest.approx(0.5)
