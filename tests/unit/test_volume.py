"""Clouds in 3-D, and directions within images."""

import json
import re

import numpy as np
import pytest

from cloudtomo_cl.report.directions import angles, in_image, kilometre, round_length, towards_sensor
from cloudtomo_cl.report.page import report_page
from cloudtomo_cl.report.plots import new_figure
from cloudtomo_cl.report.volume import AMBIENT, EYE, LOST, edges, eye_axes, marks_of, plot_volume, rendered, sunlight
from cloudtomo_cl.scene.formations import fisheye_rays
from cloudtomo_cl.scene.grid import Grid
from cloudtomo_cl.scene.scene import Sun
from cloudtomo_cl.scene.sensors import OrthographicView, PerspectiveView, PushBroomView, RadiometerView

GRID = Grid((8, 6, 10), (0.1, 0.1, 0.1), (1.0, 2.0, 0.5))
EAST = PerspectiveView(position=(21.4, 2.3, 1.0), target=(1.4, 2.3, 1.0), field_of_view=5.0, pixels=(30, 20))
ABOVE = OrthographicView(zenith=0, width=1.0, pixels=(40, 40))


@pytest.mark.parametrize(
    ("view", "expected"),
    [
        (EAST, (90, 0)),
        (ABOVE, (0, 0)),
        (OrthographicView(zenith=40, azimuth=250, width=1, pixels=(4, 4)), (40, 250)),
        (RadiometerView(zenith=130, azimuth=20, pixels=(4, 4)), (130, 20)),
        # It flies north and looks 30 degrees ahead: so it stands in the south.
        (PushBroomView((1, 0, 9), (1, 4, 9), field_of_view=20, pixels=(9, 9), along_track_angle=30), (30, 270)),
        (fisheye_rays((1.4, 2.3, 0.0), pixels=9)[0], (180, 0)),
    ],
    ids=["camera", "nadir", "satellite", "radiometer", "scanner", "fisheye"],
)  # fmt: skip
def test_a_view_tells_where_its_sensor_is(view, expected):
    assert angles(towards_sensor(view, GRID)) == pytest.approx(expected, abs=0.01)


def test_north_and_up_lie_in_images_as_the_sensors_page_says():
    assert in_image(ABOVE, GRID, np.array([0.0, 1.0, 0.0])) == pytest.approx([0, -40])
    assert in_image(ABOVE, GRID, np.array([1.0, 0.0, 0.0])) == pytest.approx([40, 0])
    # Seen from the east, north is on the right.
    pixels_per_km = 30 / (2 * 20 * np.tan(np.radians(2.5)))
    assert in_image(EAST, GRID, np.array([0.0, 1.0, 0.0])) == pytest.approx([pixels_per_km, 0], rel=1e-3)
    assert in_image(EAST, GRID, np.array([0.0, 0.0, 1.0])) == pytest.approx([0, -pixels_per_km], rel=1e-3)
    assert kilometre(EAST, GRID) == pytest.approx(pixels_per_km, rel=1e-3)


@pytest.mark.parametrize(("longest", "length"), [(0.9, 0.5), (1.0, 1.0), (0.23, 0.2), (47.0, 20.0)])
def test_scale_bars_have_round_lengths(longest, length):
    assert round_length(longest) == pytest.approx(length)


def test_sunlight_is_lost_by_the_depth_towards_the_sun():
    """A slab: below the middle of a layer lies the depth of what is above it, over the cosine."""
    extinction = np.zeros(GRID.shape)
    extinction[:, :, 5] = 4.0
    light = sunlight(GRID, extinction, Sun(zenith=60.0, azimuth=90.0))
    across = 4.0 * 0.1 / np.cos(np.radians(60))
    column = light[4, 0]  # the shadow of the domain's northern side does not reach the south
    assert column[[9, 5, 4, 3]] == pytest.approx(np.exp(-LOST * across * np.array([0, 0.5, 1, 1])))


def test_shadows_fall_away_from_the_sun():
    extinction = np.zeros(GRID.shape)
    extinction[4, 3, 6] = 100.0
    light = sunlight(GRID, extinction, Sun(zenith=45.0, azimuth=0.0))
    assert light[3, 3, 5] == light[2, 3, 4] == light.min() and light[5, 3, 5] == light[4, 3, 5] == 1.0


def test_a_picture_is_as_opaque_as_the_cloud_is_deep():
    grid = Grid((9, 9, 9), (0.1, 0.1, 0.1))
    extinction = np.zeros(grid.shape)
    extinction[3:6, 3:6, 3:6] = 5.0
    picture = rendered(grid, extinction, Sun(zenith=0.0))
    # Optical mass: the integral of the depth over the plane across the rays.
    depth = -np.log(1 - picture[..., 3])
    pixel = np.linalg.norm(grid.extent) / len(picture)
    assert depth.sum() * pixel**2 == pytest.approx(extinction.sum() * 0.001, rel=0.02)
    assert picture[0, 0, 3] == 0 and AMBIENT <= picture[picture[..., 3] > 0, 0].min()


def test_a_single_voxel_is_seen():
    grid = Grid((1, 1, 1), (0.2, 0.1, 0.3))
    depth = -np.log(1 - rendered(grid, np.full((1, 1, 1), 5.0), Sun(zenith=30.0))[..., 3])
    pixel = np.linalg.norm(grid.extent) / len(depth)
    assert depth.sum() * pixel**2 == pytest.approx(5.0 * 0.006, rel=0.02)


def test_the_bright_voxel_is_drawn_where_it_is():
    extinction = np.zeros(GRID.shape)
    extinction[7, 1, 8] = 1.0
    picture = rendered(GRID, extinction, Sun(zenith=0.0))[..., 3]
    right, up, _ = eye_axes(*EYE)
    reach = np.linalg.norm(GRID.extent) / 2
    point = np.array([GRID.centres(axis)[index] for axis, index in enumerate((7, 1, 8))]) - GRID.centre
    row, column = np.unravel_index(np.argmax(picture), picture.shape)
    found = (np.array([column, row]) + 0.5) / len(picture) * 2 * reach - reach
    assert found == pytest.approx([point @ right, point @ up], abs=0.06)


def test_a_box_has_twelve_edges():
    lengths = sorted(round(float(np.linalg.norm(end - start)), 6) for start, end in edges(GRID))
    assert lengths == [0.6] * 4 + [0.8] * 4 + [1.0] * 4


def test_the_picture_names_sun_sensors_north_and_scale():
    figure = new_figure(8, 5)
    plot_volume(figure, GRID, np.ones(GRID.shape), np.ones(GRID.shape), Sun(zenith=40.0), (EAST, ABOVE))
    for panel, title in zip(figure.axes, ("true", "recovered")):
        assert panel.get_title() == title
        assert {text.get_text() for text in panel.texts} == {"", "0", "1", "sun", "N", "0.2 km"}


def test_the_page_knows_the_directions():
    marks = marks_of(GRID, Sun(zenith=60.0, azimuth=90.0), (EAST,))
    assert marks["light"] == pytest.approx([0, np.sqrt(0.75), 0.5], abs=1e-5)
    assert marks["sensors"][0]["towards"] == pytest.approx([1, 0, 0], abs=1e-5)
    assert marks["sensors"][0]["text"] == "view 0, perspective: zenith 90°, azimuth 0°"
    extinction = np.ones(GRID.shape)
    text = report_page("title", "source", {}, GRID, extinction, {}, {}, sun=Sun(zenith=60.0, azimuth=90.0))
    scene = json.loads(re.search(r"^const scene = (.*);$", text, flags=re.MULTILINE)[1])
    assert scene["sun"] == "sun: zenith 60°, azimuth 90°" and scene["sensors"] == []


def test_the_page_adds_little_to_what_it_shows():
    """Less than 2 MB beside figures, whatever the size of the cloud."""
    grid = Grid((100, 100, 100), (0.1, 0.1, 0.1))
    extinction = np.random.default_rng(1).uniform(0, 90, grid.shape)
    assert len(report_page("title", "source", {}, grid, extinction, {}, {})) < 2e6
