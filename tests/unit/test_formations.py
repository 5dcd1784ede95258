"""Several views at once: rings, strings, an all-sky camera."""

import numpy as np
import pytest

from cloudtomo_cl.errors import SettingsError
from cloudtomo_cl.scene.formations import MISR_ANGLES, RingOfViews, StringOfScans, StringOfViews, fisheye_rays
from cloudtomo_cl.scene.grid import Grid

GRID = Grid(shape=(4, 4, 4), spacing=(0.1, 0.1, 0.1))
TARGET = (0.25, 0.15, 0.2)
RING = {"target": TARGET, "height": 2.0, "radius": 0.5, "field_of_view": 40.0, "pixels": (8, 6)}


def test_a_ring_has_its_cameras_at_equal_distances_around_the_target():
    views = RingOfViews(**RING, count=5, azimuth=30.0, nadir=False).views()
    offsets = np.array([np.subtract(view.position, TARGET) for view in views])
    np.testing.assert_allclose(np.hypot(*offsets[:, :2].T), 0.5)
    np.testing.assert_allclose(offsets[:, 2], 1.8)
    azimuths = np.degrees(np.arctan2(offsets[:, 1], offsets[:, 0])) % 360
    np.testing.assert_allclose(azimuths, [30, 102, 174, 246, 318])


def test_the_first_camera_of_a_ring_is_at_nadir():
    views = RingOfViews(**RING).views()
    assert len(views) == 9
    assert views[0].position == (0.25, 0.15, 2.0)


@pytest.mark.parametrize("view", RingOfViews(**RING).views())
def test_every_camera_of_a_ring_has_the_target_in_its_centre(view):
    np.testing.assert_allclose(view.project(GRID, np.array(TARGET))[:2], 0.5)


def test_the_cameras_of_a_ring_are_above_their_target():
    with pytest.raises(SettingsError, match="above the target"):
        RingOfViews(**{**RING, "height": 0.1})


def strings():
    """The nine views of MISR, as satellite and as aircraft, flying to the south-west."""
    satellite = StringOfViews(width=1.0, pixels=(8, 8), azimuth=225.0, target=TARGET)
    aircraft = StringOfScans(TARGET, 20.0, 1.0, 5.0, (8, 8), azimuth=225.0)
    return list(zip(MISR_ANGLES * 2, satellite.views() + aircraft.views()))


@pytest.mark.parametrize(("angle", "view"), strings())
def test_every_view_of_a_string_has_the_target_in_its_centre(angle, view):
    np.testing.assert_allclose(view.project(GRID, np.array(TARGET))[:2], 0.5, atol=1e-12)


@pytest.mark.parametrize(("angle", "view"), strings())
def test_every_view_of_a_string_looks_at_its_angle_along_the_track(angle, view):
    _, direction = view.rays(GRID)
    sight = direction[0] + 0.5 * (direction[1] + direction[2])
    ahead = np.array([-1, -1]) / np.sqrt(2)
    np.testing.assert_allclose(np.degrees(np.arctan2(sight[:2] @ ahead, -sight[2])), angle, atol=1e-12)
    assert sight[0] == pytest.approx(sight[1], abs=1e-12)


@pytest.mark.parametrize(("angle", "view"), strings())
def test_every_view_of_a_string_has_the_flight_direction_up(angle, view):
    ahead_and_right = np.array(TARGET) + [[-0.05, -0.05, 0], [-0.05, 0.05, 0]]
    u, v, _ = view.project(GRID, ahead_and_right)
    np.testing.assert_allclose(u[0], 0.5)
    assert v[0] < 0.5
    np.testing.assert_allclose(v[1], 0.5)
    assert u[1] > 0.5


def test_a_fisheye_image_has_the_zenith_in_its_middle_and_the_horizon_at_its_edge():
    view, circle = fisheye_rays((0.1, 0.2, 0.0), 101)
    zenith = np.full(circle.shape, np.nan)
    zenith[circle] = np.degrees(np.arccos(view.directions[:, 2]))
    assert zenith[50, 50] == 0
    # Equidistant: 90 degrees over half of the image.
    np.testing.assert_allclose(zenith[50, 50:], 90 * np.arange(51) / 50.5, atol=1e-5)
    assert not circle[0, 0] and circle.mean() == pytest.approx(np.pi / 4, abs=0.01)
    np.testing.assert_array_equal(view.origins, [(0.1, 0.2, 0.0)] * circle.sum())


def test_a_fisheye_image_has_north_at_the_top_and_east_on_the_left():
    view, circle = fisheye_rays((0, 0, 0), 5, field_of_view=120.0)
    east, north = np.zeros((2, 5, 5))
    east[circle], north[circle] = view.directions[:, 0], view.directions[:, 1]
    assert np.all(np.diff(east[2]) < 0) and np.all(np.diff(north[:, 2]) < 0)


@pytest.mark.parametrize(("pixels", "field_of_view"), [(0, 180.0), (4, 0.0), (4, 181.0), (4, np.nan)])
def test_an_impossible_fisheye_is_refused(pixels, field_of_view):
    with pytest.raises(ValueError, match="must be"):
        fisheye_rays((0, 0, 0), pixels, field_of_view)


def test_a_view_that_looks_ahead_by_half_a_degree_stands_behind():
    (view,) = StringOfViews(width=1.0, pixels=(8, 8), azimuth=90.0, along_track_angles=(0.5,)).views()
    _, direction = view.rays(GRID)
    sight = direction[0] + 0.5 * (direction[1] + direction[2])
    assert np.degrees(np.arctan2(sight[1], -sight[2])) == pytest.approx(0.5)


def test_a_ring_may_be_lower_than_a_kilometre():
    assert len(RingOfViews(**{**RING, "height": 0.5}).views()) == 9


def test_scans_are_not_flown_at_the_height_of_their_target():
    with pytest.raises(SettingsError, match="above"):
        StringOfScans(TARGET, TARGET[2], 1.0, 5.0, (8, 8))


def test_a_fisheye_image_may_have_one_pixel():
    view, circle = fisheye_rays((0, 0, 0), 1)
    np.testing.assert_allclose(view.directions, [(0, 0, 1)])
    assert circle.all()
