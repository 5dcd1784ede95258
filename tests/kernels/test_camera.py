"""From a sample to a ray."""

import numpy as np
import pytest

from cloudtomo_cl.opencl.layout import ray_array, scene_struct, view_structs
from cloudtomo_cl.reference import flights as reference
from cloudtomo_cl.reference import random as reference_random
from cloudtomo_cl.scene.grid import Grid
from cloudtomo_cl.scene.scene import Scene, Sun
from cloudtomo_cl.scene.sensors import OrthographicView, PerspectiveView, PushBroomView, RadiometerView, RayView

GRID = Grid(shape=(4, 4, 5), spacing=(0.1, 0.1, 0.05), origin=(1.0, -2.0, 0.3))
SEED = 11

VIEWS = {
    "perspective, oblique": PerspectiveView((0.2, -3, 1.5), (1.2, -1.8, 0.4), 40.0, (7, 5)),
    "perspective, nadir": PerspectiveView((1.2, -1.8, 2.0), (1.2, -1.8, 0.0), 85.4, (5, 5), up=(0, 1, 0)),
    "orthographic, nadir": OrthographicView(width=0.5, pixels=(5, 3), zenith=0),
    "orthographic, oblique": OrthographicView(width=0.8, pixels=(3, 4), zenith=60, azimuth=110),
    "orthographic, from a place": OrthographicView(0.5, (4, 4), position=(0, -2, 0.4), target=(1.2, -1.8, 0.7)),
    "perspective, from the ground": PerspectiveView((1.2, -1.8, 0.0), (1.2, -1.8, 1.0), 80.0, (5, 5)),
    "orthographic, from 36000 km": OrthographicView(
        0.6, (4, 3), position=(12001.2, -9001.8, 36000.5), target=(1.2, -1.8, 0.5)
    ),
    "push-broom, nadir": PushBroomView((1.2, -2.1, 1.5), (1.2, -1.5, 1.5), 60.0, (5, 3)),
    "push-broom, aft": PushBroomView((0.4, -2.2, 2.0), (1.1, -1.7, 2.0), 25.0, (4, 6), along_track_angle=-45.6),
    "radiometer, nadir": RadiometerView.of_columns(GRID, zenith=0),
    "radiometer, oblique": RadiometerView(zenith=60, azimuth=180, pixels=(8, 2)),
    "radiometer, looking up": RadiometerView(zenith=130, azimuth=-50, pixels=(4, 4)),
}
RAYS = RayView(
    origins=[(0.2, -3, 1.5), (1.2, -1.8, 2.0), (1.1, -1.9, 0.4), (700, -1.9, 900), (1.2, -1.8, 0.0), (0, 0, 700)],
    directions=[(2, 3, -2), (0, 0, -1), (1, 1, 0.5), (-699, 0.1, -899.7), (0.1, 0.2, 3), (-300, 200, -700)],
    pixels=(3, 2),
)
EVERY_VIEW = {**VIEWS, "rays": RAYS}


def rays(probe, view, sample=0, others=()):
    """Origins (km) and directions of one sample in every pixel of a view that comes after others."""
    count = view.pixels[0] * view.pixels[1]
    scene = Scene(grid=GRID, sun=Sun(zenith=0))
    origins, directions = probe(
        "probe_camera", count, scene_struct(scene), view_structs([*others, view], GRID)[-1:],
        ray_array([*others, view], scene),
        np.uint32(SEED), np.uint32(sample), results=[np.zeros((count, 3), np.float32)] * 2,
    )  # fmt: skip
    return origins.astype(float) + GRID.origin, directions.astype(float)


@pytest.mark.parametrize("view", EVERY_VIEW.values(), ids=EVERY_VIEW)
def test_rays_are_those_of_the_reference(probe, view):
    origins, directions = rays(probe, view, sample=3)
    for pixel, (origin, direction) in enumerate(zip(origins, directions, strict=True)):
        jitter = reference_random.uniforms(SEED, 0, 0, pixel, 3, 0)
        column, row = pixel % view.pixels[0] + jitter[0], pixel // view.pixels[0] + jitter[1]
        start, expected = reference.camera_ray(view, GRID, column, row)
        np.testing.assert_allclose(direction, expected, atol=5e-7)
        # The start along the ray is free: only the line matters.
        apart = origin - start
        np.testing.assert_allclose(apart - (apart @ expected) * expected, 0, atol=3e-6)


@pytest.mark.parametrize("view", EVERY_VIEW.values(), ids=EVERY_VIEW)
def test_directions_have_unit_length(probe, view):
    np.testing.assert_allclose(np.linalg.norm(rays(probe, view)[1], axis=1), 1, atol=3e-7)


def angles(view, column, row):
    """Degrees to the right of and above the line of sight."""
    _, direction = reference.camera_ray(view, GRID, column, row)
    sight = np.subtract(view.target, view.position) / np.linalg.norm(np.subtract(view.target, view.position))
    right = np.cross(sight, (0, 0, 1))
    right /= np.linalg.norm(right)
    forward = direction @ sight
    return np.degrees(np.arctan([direction @ right / forward, direction @ np.cross(right, sight) / forward]))


def test_corners_of_a_perspective_image_lie_at_half_the_field_of_view():
    view = VIEWS["perspective, oblique"]
    vertical = np.degrees(np.arctan(np.tan(np.radians(20)) * 5 / 7))
    np.testing.assert_allclose(angles(view, 0, 0), [-20, vertical])
    np.testing.assert_allclose(angles(view, 7, 0), [20, vertical])
    np.testing.assert_allclose(angles(view, 7, 5), [20, -vertical])


@pytest.mark.parametrize("view", VIEWS.values(), ids=VIEWS)
def test_the_affine_rays_of_a_view_agree_with_the_reference_at_corners_and_centre(view):
    origin, direction = view.rays(GRID)
    for u, v in [(0, 0), (1, 0), (0, 1), (1, 1), (0.5, 0.5)]:
        start, expected = reference.camera_ray(view, GRID, u * view.pixels[0], v * view.pixels[1])
        found = direction[0] + u * direction[1] + v * direction[2]
        np.testing.assert_allclose(found / np.linalg.norm(found), expected, atol=1e-12)
        apart = origin[0] + u * origin[1] + v * origin[2] - start
        # A satellite's own coordinates have 16 digits.
        np.testing.assert_allclose(np.cross(apart, expected), 0, atol=max(1e-12, 1e-15 * np.abs(start).max()))


def test_row_0_of_an_oblique_image_looks_highest(probe):
    _, directions = rays(probe, VIEWS["perspective, oblique"])
    heights = directions[:, 2].reshape(5, 7).mean(axis=1)
    assert np.all(np.diff(heights) < 0)


def test_columns_of_an_oblique_image_run_to_the_right(probe):
    # Looking towards the north-east: south-east is on the right.
    _, directions = rays(probe, VIEWS["perspective, oblique"])
    south_east = (directions @ [1, -1, 0]).reshape(5, 7).mean(axis=0)
    assert np.all(np.diff(south_east) > 0)


def test_a_nadir_image_has_north_at_the_top_and_east_on_the_right(probe):
    origins, directions = rays(probe, VIEWS["orthographic, nadir"])
    np.testing.assert_allclose(directions, [[0, 0, -1]] * 15, atol=1e-7)
    assert np.all(np.diff(origins[:, 1].reshape(3, 5).mean(axis=1)) < 0)
    assert np.all(np.diff(origins[:, 0].reshape(3, 5).mean(axis=0)) > 0)


def test_a_radiometer_has_a_pixel_for_each_column(probe):
    origins, _ = rays(probe, RadiometerView.of_columns(GRID, zenith=48, azimuth=20), sample=2)
    columns = np.floor((origins[:, :2] - GRID.origin[:2]) / GRID.spacing[:2]).reshape(4, 4, 2)
    np.testing.assert_array_equal(columns[..., 0], [[0, 1, 2, 3]] * 4)
    np.testing.assert_array_equal(columns[..., 1].T, [[3, 2, 1, 0]] * 4)
    np.testing.assert_allclose(origins[:, 2], 0.55, atol=1e-7)


def test_a_radiometer_that_looks_up_is_at_the_bottom(probe):
    origins, directions = rays(probe, VIEWS["radiometer, looking up"])
    np.testing.assert_allclose(origins[:, 2], 0.3, atol=1e-7)
    assert np.all(directions[:, 2] > 0)


def test_a_push_broom_image_has_the_end_of_the_track_at_the_top_and_its_right_on_the_right(probe):
    origins, directions = rays(probe, VIEWS["push-broom, nadir"])  # flies north
    assert np.all(np.diff(origins[:, 1].reshape(3, 5).mean(axis=1)) < 0)
    assert np.all(np.diff(directions[:, 0].reshape(3, 5).mean(axis=0)) > 0)
    np.testing.assert_allclose(directions[:, 1], 0, atol=1e-7)


def test_several_lists_of_rays_are_kept_apart(probe):
    alone = rays(probe, RAYS)
    others = [RayView([(1, -2, 1)] * 5, [(0, 0, -1)] * 5), VIEWS["orthographic, nadir"]]
    np.testing.assert_array_equal(rays(probe, RAYS, others=others), alone)


@pytest.mark.parametrize("distance", [0, 1, 700, 36_000])
def test_a_ray_from_far_away_keeps_its_line(probe, distance):
    point, direction = np.array([1.23456, -1.87654, 0.4]), np.array([0.48, 0.6, -0.64])
    view = RayView([point - distance * direction], [direction])
    origins, directions = rays(probe, view)
    apart = origins[0] - point
    np.testing.assert_allclose(apart - (apart @ direction) * direction, 0, atol=3e-7)
    np.testing.assert_allclose(directions[0], direction, atol=1e-7)


def test_pixels_of_an_orthographic_image_are_square(probe):
    origins, _ = rays(probe, VIEWS["orthographic, nadir"])
    # Every sample lies in its own square of 0.1 km around the domain's centre.
    columns, rows = np.meshgrid(np.arange(5), np.arange(3))
    assert np.all(np.floor((origins[:, 0] - GRID.centre[0] + 0.25) / 0.1) == columns.ravel())
    assert np.all(np.floor((GRID.centre[1] + 0.15 - origins[:, 1]) / 0.1) == rows.ravel())


def test_samples_fill_their_pixel(probe):
    view = OrthographicView(width=1.0, pixels=(1, 1), zenith=0)
    places = np.array([rays(probe, view, sample)[0][0, :2] for sample in range(64)])
    # 64 uniform numbers: one end stays empty by a tenth with probability 0.9^64 = 1e-3.
    assert np.all(places.min(axis=0) - np.array(GRID.centre[:2]) < -0.4)
    assert np.all(places.max(axis=0) - np.array(GRID.centre[:2]) > 0.4)
