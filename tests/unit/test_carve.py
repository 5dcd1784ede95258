"""Carving on images drawn by hand: what is removed, and above all what is not."""

from dataclasses import replace

import numpy as np
import pytest

from cloudtomo_cl.errors import DataError
from cloudtomo_cl.inversion.carving import carve, cloudy_pixels
from cloudtomo_cl.scene import visibility
from cloudtomo_cl.scene.grid import Grid, coarsened
from cloudtomo_cl.scene.measurements import Measurements
from cloudtomo_cl.scene.scene import Air, Scene, Sun, Surface
from cloudtomo_cl.scene.sensors import OrthographicView, PerspectiveView, PushBroomView, RadiometerView, RayView
from cloudtomo_cl.scene.visibility import check_views, pixels_that_meet, pixels_that_see

GRID = Grid(shape=(8, 8, 4), spacing=(0.1, 0.1, 0.1))
# Each pixel looks down one column of voxels.
FROM_ABOVE = OrthographicView(width=0.8, pixels=(8, 8), zenith=0.0)


def images(views, bright=(), error=0.0, cloud=1.0, ground=0.1):
    """Measurements with bright pixels (view, row, column) on uniform ground, and the clear images."""
    clear = tuple(np.full(view.pixels[::-1], ground) for view in views)
    seen = tuple(image.copy() for image in clear)
    for view, row, column in bright:
        seen[view][row, column] = cloud
    errors = tuple(np.full(image.shape, error) for image in clear)
    nothing = tuple(np.zeros(image.shape) for image in clear)
    return Measurements(tuple(views), seen, errors), Measurements(tuple(views), clear, nothing)


def test_a_bright_pixel_keeps_its_column_alone():
    mask = carve(GRID, *images([FROM_ABOVE], [(0, 0, 2)]))
    expected = np.zeros(GRID.shape, bool)
    expected[2, 7] = True  # row 0 is the northern edge
    np.testing.assert_array_equal(mask, expected)


def test_beside_a_bright_pixel_columns_stay_as_far_as_pointing_is_uncertain():
    """Two standard errors of a shift by 0.3 pixels along each axis: one pixel, on every side."""
    measured, cloud_free = images([FROM_ABOVE], [(0, 3, 2)])
    mask = carve(GRID, replace(measured, position_errors=(0.03,)), cloud_free)
    expected = np.zeros(GRID.shape, bool)
    expected[1:4, 3:6] = True
    np.testing.assert_array_equal(mask, expected)


def test_two_views_keep_the_intersection():
    from_south = OrthographicView(width=0.8, pixels=(8, 4), position=(0.4, -1.0, 0.2), target=(0.4, 0.4, 0.2))
    mask = carve(GRID, *images([FROM_ABOVE, from_south], [(0, 3, 2), (1, 1, 2)]))
    assert np.argwhere(mask).tolist() == [[2, 4, 2]]


def test_voxels_beside_the_frame_are_kept():
    narrow = OrthographicView(width=0.4, pixels=(4, 4), zenith=0.0)
    mask = carve(GRID, *images([narrow]), significance=0.0)
    # The image is clear all over but for its scale of zero: nothing in it differs.
    expected = np.ones(GRID.shape, bool)
    expected[2:6, 2:6] = False
    np.testing.assert_array_equal(mask, expected)


def test_a_camera_inside_the_domain_removes_nothing_behind_it():
    inside = PerspectiveView(
        position=(0.4, 0.4, 0.25), target=(0.4, 0.4, 0.0), up=(0.0, 1.0, 0.0), field_of_view=100.0, pixels=(9, 9)
    )
    mask = carve(GRID, *images([inside]))
    assert mask[:, :, 2:].all()
    assert not mask[4, 4, 0]


def test_a_camera_that_looks_away_removes_nothing():
    away = PerspectiveView(
        position=(0.4, 0.4, 0.9), target=(0.4, 0.4, 2.0), up=(0.0, 1.0, 0.0), field_of_view=60.0, pixels=(9, 9)
    )
    assert carve(GRID, *images([away])).all()


def test_a_voxel_is_kept_if_it_only_touches_a_cloudy_pixel():
    # Pixels of one and a half voxels: pixel 0 covers voxel 0 and half of voxel 1.
    grid = Grid(shape=(6, 6, 1), spacing=(0.1, 0.1, 0.1))
    view = OrthographicView(width=0.6, pixels=(4, 4), zenith=0.0)
    mask = carve(grid, *images([view], [(0, 3, 0)]))
    assert np.argwhere(mask[:, :, 0]).tolist() == [[0, 0], [0, 1], [1, 0], [1, 1]]


@pytest.mark.parametrize("cloud", [0.02, 0.3])
def test_brighter_and_darker_than_the_ground_are_both_cloud(cloud):
    measurements, clear = images([FROM_ABOVE], [(0, 4, 4)], cloud=cloud)
    assert np.argwhere(cloudy_pixels(measurements, clear)[0]).tolist() == [[4, 4]]


def test_a_pixel_too_noisy_to_tell_counts_as_cloudy():
    measurements, clear = images([FROM_ABOVE], [(0, 4, 4)])
    measurements.standard_errors[0][1, 1] = 0.1
    assert np.argwhere(cloudy_pixels(measurements, clear)[0]).tolist() == [[1, 1], [4, 4]]


def test_noise_alone_marks_few_pixels():
    view = OrthographicView(width=0.8, pixels=(64, 64), zenith=0.0)
    square = [(0, row, column) for row in range(20, 40) for column in range(20, 40)]
    measurements, clear = images([view], square, error=0.01)
    noise = np.random.default_rng(0).normal(0.0, 0.01, (64, 64))
    noisy = Measurements(measurements.views, (measurements.images[0] + noise,), measurements.standard_errors)
    cloudy = cloudy_pixels(noisy, clear)[0]
    assert cloudy[20:40, 20:40].all()
    assert cloudy.sum() < 400 + 0.01 * 64**2


def test_ground_lit_by_the_cloud_is_no_cloud():
    view = OrthographicView(width=0.8, pixels=(16, 16), zenith=0.0)
    measurements, clear = images([view], [(0, row, 3) for row in range(4, 9)])
    measurements.images[0][:, 8:] += 0.01  # one per cent of the cloud's brightness
    assert not cloudy_pixels(measurements, clear)[0][:, 8:].any()


def test_a_contour_as_bright_as_the_ground_is_closed():
    view = OrthographicView(width=0.8, pixels=(16, 16), zenith=0.0)
    bright = [(0, row, column) for row in range(3, 12) for column in range(3, 12) if column != 6]
    cloudy = cloudy_pixels(*images([view], bright))[0]
    assert cloudy[3:12, 3:12].all()
    assert cloudy.sum() == 81


def test_a_bad_pixel_rules_nothing_out():
    seen, clear = images([FROM_ABOVE], [(0, 0, 2)])
    seen.images[0][6, 6] = np.nan
    mask = carve(GRID, seen, clear)
    assert mask[6, 1].all() and mask.sum() == 2 * GRID.shape[2]


def test_a_bad_pixel_opens_no_way_to_its_neighbours():
    """Closing gaps of a pixel or two would join it to the cloud."""
    seen, clear = images([FROM_ABOVE], [(0, 3, 2), (0, 4, 2)])
    seen.images[0][3, 4] = np.nan
    assert [tuple(place) for place in np.argwhere(cloudy_pixels(seen, clear)[0])] == [(3, 2), (3, 4), (4, 2)]


def test_rays_beside_the_domain_do_not_count():
    wide = OrthographicView(width=1.6, pixels=(16, 16), zenith=0.0)
    meets = pixels_that_meet(wide, GRID)
    assert meets[4:12, 4:12].all()
    # A pixel that shares an edge with the domain's outline touches it.
    assert not meets[:3].any() and not meets[13:].any() and not meets[:, :3].any() and not meets[:, 13:].any()


def test_what_lies_beside_the_domain_keeps_no_voxel():
    oblique = OrthographicView(width=2.4, pixels=(24, 24), zenith=60.0, azimuth=45.0)
    measurements, clear = images([oblique])
    measurements.images[0][~pixels_that_meet(oblique, GRID)] = 1.0
    assert not carve(GRID, measurements, clear).any()


def test_pieces_of_the_domain_are_put_together_right(monkeypatch):
    view = PerspectiveView(position=(1.5, -0.6, 1.5), target=(0.4, 0.4, 0.2), field_of_view=50.0, pixels=(20, 20))
    arguments = images([view], [(0, 9, 9), (0, 10, 12)])
    whole = carve(GRID, *arguments)
    assert 0 < whole.sum() < whole.size
    monkeypatch.setattr(visibility, "_CORNERS_AT_ONCE", 1)
    np.testing.assert_array_equal(carve(GRID, *arguments), whole)


@pytest.mark.parametrize("shape", [(2, 2, 2), (3, 5, 7), (11, 9, 10)])
def test_a_coarsened_mask_covers_all_that_was_kept(shape):
    mask = np.zeros((6, 6, 6), bool)
    mask[2, 3, 4] = True
    coarse = coarsened(mask, shape)
    middle = tuple(int((index + 0.5) / 6 * count) for index, count in zip((2, 3, 4), shape))
    assert coarse[middle] and coarse.shape == shape
    if shape == (2, 2, 2):
        assert coarse.sum() == 1


def test_clear_images_of_other_views_are_named():
    other = OrthographicView(width=0.7, pixels=(8, 8), zenith=0.0)
    with pytest.raises(DataError, match="not of the measurements' views"):
        carve(GRID, images([FROM_ABOVE])[0], images([other])[1])


def test_negative_thresholds_are_named():
    with pytest.raises(DataError, match="contrast is -1"):
        carve(GRID, *images([FROM_ABOVE]), contrast=-1.0)


VIEWS = [
    PerspectiveView(position=(2.0, -1.0, 1.5), target=(0.4, 0.4, 0.2), field_of_view=25, pixels=(30, 24)),
    OrthographicView(width=1.2, pixels=(30, 30), zenith=50, azimuth=30, target=(0.4, 0.4, 0.2)),
]


@pytest.mark.parametrize("view", VIEWS, ids=lambda view: view.type)
def test_pixels_that_see_a_mask_are_those_whose_rays_cross_it(view):
    """Against rays through a fine raster of the image."""
    mask = np.zeros(GRID.shape, dtype=bool)
    mask[2, 1, 3] = True
    voxel = Grid(shape=(1, 1, 1), spacing=GRID.spacing, origin=(0.2, 0.1, 0.3))
    fine = replace(view, pixels=tuple(10 * count for count in view.pixels))
    width, height = view.pixels
    crossed = pixels_that_meet(fine, voxel).reshape(height, 10, width, 10).any(axis=(1, 3))
    seen = pixels_that_see(view, GRID, mask)
    assert not (crossed & ~seen).any()
    assert crossed.any() and seen.sum() <= 2 * crossed.sum() + 4


def test_a_sensor_inside_the_mask_sees_all_that_the_domain_shows():
    view = PerspectiveView(
        position=(0.25, 0.15, 0.35), target=(0.25, 0.15, 0.0), up=(0, 1, 0), field_of_view=60, pixels=(8, 8)
    )
    mask = np.ones(GRID.shape, dtype=bool)
    assert pixels_that_see(view, GRID, mask).all()


@pytest.mark.parametrize(
    "view",
    [
        RadiometerView.of_columns(GRID, zenith=0),
        # From so high that its fan is narrower than a voxel is high: each pixel looks down one column.
        PushBroomView((0.4, 0.0, 200.0), (0.4, 0.8, 200.0), np.degrees(2 * np.arctan(0.4 / 200)), (8, 8)),
    ],
)
def test_line_scanners_and_radiometers_carve_as_a_view_from_above(view):
    mask = carve(GRID, *images([view], [(0, 0, 2)]))
    assert mask[2, 7].all()
    others = mask.copy()
    others[1:4, 7] = False  # a neighbour's edge may lie in the pixel
    assert not others[1:-1, :].any()


# Down through the middle of the lowest layer's columns (2, 7) and (5, 3), and past the domain.
DOWN = RayView([(0.25, 0.75, 9), (0.55, 0.35, 9), (5, 5, 9)], [(0, 0, -1)] * 3)


def test_lists_of_rays_rule_out_nothing():
    assert carve(GRID, *images([DOWN], [(0, 0, 0)])).all()


def test_pixels_of_a_list_of_rays_have_no_neighbours():
    rays = RayView([(0.05 + 0.1 * i, 0.4, 9) for i in range(8)], [(0, 0, -1)] * 8)
    (cloudy,) = cloudy_pixels(*images([rays], [(0, 0, 1), (0, 0, 3)]))
    np.testing.assert_array_equal(cloudy, [[False, True, False, True, False, False, False, False]])


def test_rays_that_meet_the_domain_and_a_mask():
    mask = np.zeros(GRID.shape, bool)
    mask[2, 7, 0] = True
    np.testing.assert_array_equal(pixels_that_meet(DOWN, GRID), [[True, True, False]])
    np.testing.assert_array_equal(pixels_that_see(DOWN, GRID, mask), [[True, False, False]])
    assert not pixels_that_see(DOWN, GRID, np.zeros(GRID.shape, bool)).any()


def test_a_pixel_meets_the_domain_by_any_of_its_corners():
    """One pixel that is larger than the domain, which is at each of its corners in turn."""
    pixel = OrthographicView(width=8.0, pixels=(1, 1), position=(4.0, 4.0, 5.0), target=(4.0, 4.0, 0.0), up=(0, 1, 0))
    for x, y in ((0.0, 0.0), (0.0, 8.0), (8.0, 0.0), (8.0, 8.0)):
        assert pixels_that_meet(pixel, Grid(shape=(1, 1, 1), spacing=(0.4,) * 3, origin=(x - 0.2, y - 0.2, 0.0))).all()


def test_a_ray_sees_the_box_of_all_kept_voxels():
    mask = np.zeros(GRID.shape, bool)
    mask[1, 2, 0] = mask[3, 6, 3] = True
    x, y = np.meshgrid((0.05, 0.15, 0.25, 0.35, 0.45), (0.15, 0.25, 0.65, 0.75))
    origins = np.stack([x, y, np.ones_like(x)], axis=-1).reshape(-1, 3)
    rays = RayView(origins, np.tile([0.0, 0.0, -1.0], (20, 1)), (5, 4))
    expected = np.zeros((4, 5), bool)
    expected[1:3, 1:4] = True
    np.testing.assert_array_equal(pixels_that_see(rays, GRID, mask), expected)


@pytest.mark.parametrize("scattering", [{"surface": Surface(albedo=0.1)}, {"air": Air(0.1)}])
def test_a_view_past_the_domain_is_refused_only_where_nothing_else_scatters(scattering):
    past = OrthographicView(width=0.4, pixels=(2, 2), position=(9.0, 9.0, 2.0), target=(9.0, 9.0, 0.0), up=(0, 1, 0))
    scene = Scene(grid=GRID, sun=Sun(zenith=30.0), surface=Surface(albedo=0.0))
    with pytest.raises(DataError, match="view 0 looks past the domain"):
        check_views(scene, [past])
    check_views(replace(scene, **scattering), [past])
