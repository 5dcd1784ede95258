"""Measured images over larger pixels."""

import numpy as np
import pytest

from cloudtomo_cl.errors import DataError
from cloudtomo_cl.inversion.pixels import active_pixels
from cloudtomo_cl.scene.grid import Grid
from cloudtomo_cl.scene.measurements import Measurements
from cloudtomo_cl.scene.pixels import all_pixels
from cloudtomo_cl.scene.sensors import OrthographicView, PerspectiveView, RayView


def measurements(random, width=12, height=8):
    view = OrthographicView(zenith=0, width=1.0, pixels=(width, height))
    return Measurements((view,), (random.random((height, width)),), (np.full((height, width), 0.3),))


def test_larger_pixels_hold_means(random):
    fine = measurements(random)
    coarse = fine.resampled([(6, 4)])
    expected = fine.images[0].reshape(4, 2, 6, 2).mean(axis=(1, 3))
    np.testing.assert_allclose(coarse.images[0], expected)
    assert coarse.views[0].pixels == (6, 4)


def test_errors_of_larger_pixels_are_those_of_means(random):
    np.testing.assert_allclose(measurements(random).resampled([(6, 4)]).standard_errors[0], 0.3 / 2)


@pytest.mark.parametrize("share", [0.25, 0.37, 0.6])
def test_larger_pixels_cover_the_same_field(random, share):
    """Also where width and height round to another proportion."""
    grid = Grid(shape=(1, 1, 1), spacing=(1.0, 1.0, 1.0))
    view = PerspectiveView(position=(0, 0, 3), target=(1, 1, 0), field_of_view=40, pixels=(48, 12))
    fine = Measurements((view,), (np.ones((12, 48)),), (np.ones((12, 48)),))
    np.testing.assert_allclose(fine.at_share(share).views[0].rays(grid), view.rays(grid))


def test_negative_standard_errors_are_refused(random):
    view = OrthographicView(zenith=0, width=1.0, pixels=(4, 4))
    with pytest.raises(DataError, match="negative"):
        Measurements((view,), (np.ones((4, 4)),), (np.full((4, 4), -1.0),))


@pytest.mark.parametrize("kind", [np.int16, np.uint8, np.float16])
def test_numbers_of_a_camera_are_squared_as_what_they_are(kind):
    """Squares of small integers ran over, and weights became NaN."""
    view = OrthographicView(zenith=0, width=1.0, pixels=(4, 4))
    grid = Grid(shape=(2, 2, 2), spacing=(0.4, 0.4, 0.4))
    counts = np.arange(200, 216).reshape(4, 4)
    found = [
        active_pixels(Measurements((view,), (values,), (values,)), grid, np.ones(grid.shape, bool)).weights
        for values in (counts.astype(kind), counts.astype(float))
    ]
    np.testing.assert_array_equal(*found)


@pytest.mark.parametrize("values", [np.full((4, 4), 1j), np.full((4, 4), "0.1"), np.full((4, 4), None)])
def test_radiances_are_real_numbers(values):
    view = OrthographicView(zenith=0, width=1.0, pixels=(4, 4))
    with pytest.raises(DataError, match="images are of type .*: they must be real numbers"):
        Measurements((view,), (values,), (np.ones((4, 4)),))


@pytest.mark.parametrize("name", ["images", "standard_errors"])
def test_marks_for_invalid_pixels_are_no_radiances(name):
    view = OrthographicView(zenith=0, width=1.0, pixels=(4, 4))
    given = {"images": np.ones((4, 4)), "standard_errors": np.ones((4, 4))}
    given[name][1, 2] = 9.96921e36
    with pytest.raises(DataError, match=rf"{name} of view 0 have 9.96921e\+36 at row 1, column 2"):
        Measurements((view,), **{key: (values,) for key, values in given.items()})


def test_shares_keep_at_least_eight_pixels(random):
    assert measurements(random, 40, 20).at_share(0.25).views[0].pixels == (10, 8)


def test_lists_of_rays_keep_their_pixels(random):
    rays = RayView(np.ones((400, 3)), np.ones((400, 3)), (20, 20))
    above = OrthographicView(zenith=0, width=1.0, pixels=(40, 40))
    images = tuple(random.random(view.pixels[::-1]) for view in (rays, above))
    coarse = Measurements((rays, above), images, images).at_share(0.5)
    assert [view.pixels for view in coarse.views] == [(20, 20), (20, 20)]
    assert coarse.views[0] is rays
    np.testing.assert_array_equal(coarse.images[0], images[0])
    with pytest.raises(DataError, match="list of rays"):
        coarse.resampled([(10, 10), (10, 10)])


def test_images_of_another_size_than_their_view_are_refused(random):
    view = OrthographicView(zenith=0, width=1.0, pixels=(4, 5))
    with pytest.raises(DataError, match="5 rows and 4 columns"):
        Measurements((view,), (np.ones((4, 5)),), (np.ones((5, 4)),))


def test_a_pixel_that_is_not_finite_is_named(random):
    view = OrthographicView(zenith=0, width=1.0, pixels=(4, 5))
    image = np.ones((5, 4))
    image[3, 2] = np.inf
    with pytest.raises(DataError, match="row 3, column 2"):
        Measurements((view,), (image,), (np.ones((5, 4)),))


def test_images_without_a_view_are_refused():
    with pytest.raises(DataError, match="there is no view"):
        Measurements((), (), ())


def with_bad_pixels(random, chosen):
    fine = measurements(random)
    fine.images[0][chosen] = np.nan
    return fine


def test_a_larger_pixel_is_the_mean_of_what_is_not_bad(random):
    fine = with_bad_pixels(random, (0, 1))
    coarse = fine.resampled([(6, 4)])
    assert coarse.images[0][0, 0] == pytest.approx(np.nanmean(fine.images[0][:2, :2]))
    assert coarse.standard_errors[0][0, 0] == pytest.approx(0.3 / np.sqrt(3))


def test_a_larger_pixel_that_is_mostly_bad_is_bad(random):
    """Of the first one three quarters are bad, of its neighbour half."""
    coarse = with_bad_pixels(random, ([0, 0, 1, 0, 1], [0, 1, 1, 2, 2])).resampled([(6, 4)])
    np.testing.assert_array_equal(np.argwhere(np.isnan(coarse.images[0])), [[0, 0]])


def test_other_larger_pixels_do_not_feel_bad_ones(random):
    fine = measurements(random)
    whole = fine.resampled([(6, 4)]).images[0]
    fine.images[0][0, 0] = np.nan
    differs = ~np.isclose(fine.resampled([(6, 4)]).images[0], whole, rtol=1e-12)
    np.testing.assert_array_equal(np.argwhere(differs), [[0, 0]])


def test_errors_of_bad_pixels_mean_nothing(random):
    view = OrthographicView(zenith=0, width=1.0, pixels=(4, 5))
    image, error = np.ones((5, 4)), np.ones((5, 4))
    image[3, 2] = error[3, 2] = np.nan
    assert Measurements((view,), (image,), (error,)).invalid_pixels == 1


def test_an_image_of_bad_pixels_alone_is_refused():
    view = OrthographicView(zenith=0, width=1.0, pixels=(4, 5))
    with pytest.raises(DataError, match="all pixels of view 0 are bad"):
        Measurements((view,), (np.full((5, 4), np.nan),), (np.ones((5, 4)),))


def test_bad_pixels_are_not_among_those_that_see_cloud(random):
    grid = Grid(shape=(2, 2, 2), spacing=(0.5, 0.5, 0.5))
    mask = np.ones(grid.shape, bool)
    fine = measurements(random)
    before = active_pixels(fine, grid, mask)
    place = before.listed[5, 1]
    fine.images[0].flat[place] = np.nan
    after = active_pixels(fine, grid, mask)
    assert len(after.listed) == len(before.listed) - 1 and place not in after.listed[:, 1]


@pytest.mark.parametrize(("errors", "text"), [((0.1, 0.1), "2 calibration_errors, 1 views"), ((-0.1,), "at least 0")])
def test_unfit_calibration_errors_are_refused(random, errors, text):
    fine = measurements(random)
    with pytest.raises(DataError, match=text):
        Measurements(fine.views, fine.images, fine.standard_errors, errors)


def test_differences_are_positive_where_the_model_is_brighter(random):
    fine = measurements(random)
    brighter = Measurements(fine.views, (fine.images[0] + 1.0,), (np.full((8, 12), 0.4),))
    np.testing.assert_allclose(fine.differences(brighter)[0], 1.0 / 0.5)


def test_measurements_are_told_in_a_line():
    views = [OrthographicView(zenith=0, width=1.0, pixels=(2, rows)) for rows in (2, 3, 4, 5)]
    images = tuple(np.full((rows, 2), 0.25) for rows in (2, 3, 4, 5))
    told = repr(Measurements(tuple(views), images, images))
    assert told.startswith("Measurements(4 views of 2 x 2, 2 x 3, 2 x 4, ... pixels, radiance 0.25 to 0.25")


def test_all_pixels_of_wide_images_are_listed():
    view = OrthographicView(zenith=0, width=1.0, pixels=(3, 2))
    assert all_pixels([view, view]).tolist() == [[n, pixel] for n in (0, 1) for pixel in range(6)]
