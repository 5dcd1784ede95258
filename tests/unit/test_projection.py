"""Projection of points is the inverse of the views' rays."""

import numpy as np
import pytest

from cloudtomo_cl.scene.grid import Grid
from cloudtomo_cl.scene.sensors import OrthographicView, PerspectiveView, PushBroomView, RadiometerView

GRID = Grid(shape=(4, 5, 6), spacing=(0.1, 0.1, 0.2))
VIEWS = [
    PerspectiveView(position=(0.3, -0.2, 2.0), target=(0.2, 0.2, 0.5), field_of_view=70.0, pixels=(20, 10)),
    PerspectiveView(
        position=(0.2, 0.2, 2.0), target=(0.2, 0.2, 0.5), field_of_view=40.0, pixels=(8, 9), up=(0.0, 1.0, 0.0)
    ),
    OrthographicView(width=1.5, pixels=(10, 20), zenith=50.0, azimuth=130.0),
    OrthographicView(width=0.5, pixels=(10, 5), position=(0.1, 0.2, 3.0), target=(0.3, 0.2, 0.0)),
    PerspectiveView(position=(0.2, 0.2, 0.0), target=(0.2, 0.2, 1.0), field_of_view=100.0, pixels=(8, 8)),
    PushBroomView(start=(0.1, 0.0, 2.0), end=(0.4, 0.5, 2.0), field_of_view=50.0, pixels=(10, 20)),
    PushBroomView((0.1, 0.0, 2.0), (0.0, 0.5, 2.0), 50.0, (10, 20), along_track_angle=60.0),
    RadiometerView.of_columns(GRID, zenith=60.0, azimuth=200.0),
    RadiometerView(zenith=140.0, azimuth=20.0, pixels=(3, 4)),
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


@pytest.mark.parametrize("view", VIEWS)
def test_other_pixels_show_the_same_field(view):
    u, v, _ = view.project(GRID, np.array([0.3, 0.1, 0.4]))
    u_coarse, v_coarse, _ = view.with_pixels((3, 7)).project(GRID, np.array([0.3, 0.1, 0.4]))
    assert (u_coarse, v_coarse) == (pytest.approx(u), pytest.approx(v))
    assert view.with_pixels((3, 7)).pixels == (3, 7)


def test_east_is_right_and_north_is_up_from_above():
    u, v, _ = VIEWS[1].project(GRID, np.array([[0.25, 0.2, 0.5], [0.2, 0.25, 0.5]]))
    assert u[0] > 0.5 and v[0] == pytest.approx(0.5)
    assert v[1] < 0.5 and u[1] == pytest.approx(0.5)


def test_from_the_ground_north_is_up_and_east_is_left():
    u, v, depth = VIEWS[4].project(GRID, np.array([[0.25, 0.2, 0.5], [0.2, 0.25, 0.5]]))
    assert u[0] < 0.5 and v[0] == pytest.approx(0.5)
    assert v[1] < 0.5 and u[1] == pytest.approx(0.5)
    assert np.all(depth > 0)


def test_a_scanner_that_looks_ahead_sees_what_lies_ahead():
    # From 2 km at 45 degrees: the ground 2 km ahead of the track, here its middle.
    view = PushBroomView((0.2, -2.8, 2.0), (0.2, -0.8, 2.0), 50.0, (10, 20), along_track_angle=45.0)
    u, v, depth = view.project(GRID, np.array([0.2, 0.2, 0.0]))
    np.testing.assert_allclose((u, v, depth), (0.5, 0.5, np.sqrt(8)))


def test_an_orthographic_view_sees_the_same_from_any_distance():
    near, far = (
        OrthographicView(0.7, (4, 4), position=(0.2 + 0.3 * d, 0.2 - 0.2 * d, d), target=(0.2, 0.2, 0.0))
        for d in (3.0, 36000.0)
    )
    points = np.random.default_rng(0).uniform(0, 0.4, (20, 3))
    np.testing.assert_allclose(near.project(GRID, points)[:2], far.project(GRID, points)[:2], atol=1e-10)
    assert np.abs(far.rays(GRID)[0]).max() < 10


def test_an_orthographic_view_from_far_away_still_has_the_domain_before_it():
    view = OrthographicView(0.2, (4, 4), position=(500.0, 0.2, 300.0), target=(0.2, 0.2, 0.0))
    corners = np.stack(np.meshgrid([0, 0.4], [0, 0.5], [0, 1.2]), axis=-1)
    assert view.project(GRID, corners)[2].min() >= -1e-12
