"""Pixels that no cloud explains hardly count, and are named."""

from dataclasses import replace

import numpy as np
import pytest

import cloudtomo_cl as ct
from cloudtomo_cl.inversion.outliers import Outlier, outlier_factors, outlier_text
from cloudtomo_cl.inversion.pixels import active_pixels
from cloudtomo_cl.scene.pixels import all_pixels, touching

GRID = ct.Grid((12, 12, 12), (0.05, 0.05, 0.05))
VIEWS = tuple(
    ct.OrthographicView(zenith=zenith, azimuth=azimuth, width=1.0, pixels=(24, 24))
    for zenith, azimuth in [(0, 0), (45, 0), (45, 90), (45, 180), (45, 270)]
)
PIXELS = all_pixels(VIEWS)
SCENE = ct.Scene(grid=GRID, sun=ct.Sun(zenith=20.0))
# Pixels (row, column) of view 2; far from its edges.
TOGETHER = {1: [(9, 9)], 2: [(9, 9), (9, 10)], 3: [(9, 9), (9, 10), (10, 9)], 4: [(9, 9), (9, 10), (10, 9), (10, 10)]}


def squares(far, places):
    """Squared residuals of 1 everywhere, but for some of a view."""
    square = np.ones((len(VIEWS), 24, 24))
    for place in places:
        square[(2, *place)] = far
    return square.ravel()


def factors(square, noise=0.0):
    return outlier_factors(square, np.full(len(square), noise), touching(VIEWS, PIXELS))


def test_an_outlier_counts_as_no_more_than_ten_root_mean_squares():
    """Of residuals of 1 and one of 1000, with L = 100 (n - 1 + L) / n."""
    count = len(PIXELS)
    limit = 100 * (count - 1) / (count - 100)
    found = factors(squares(1e6, TOGETHER[1]))
    assert found.min() == pytest.approx(limit / 1e6)
    assert np.count_nonzero(found < 1) == 1


@pytest.mark.parametrize("count", TOGETHER)
def test_outliers_are_no_more_than_three_together(count):
    """Four and more are a cloud that is not found yet."""
    found = factors(squares(1e6, TOGETHER[count]))
    assert np.count_nonzero(found < 1) == (count if count < 4 else 0)


def test_pixels_as_noisy_as_that_are_no_outliers():
    assert (factors(squares(1e6, TOGETHER[1]), noise=4.1e4) == 1).all()


def test_rays_have_no_neighbours_to_tell_outliers_by():
    view = ct.RayView(origins=np.zeros((500, 3)), directions=np.tile([0.0, 0.0, 1.0], (500, 1)))
    square = np.ones(500)
    square[7] = 1e6
    assert (outlier_factors(square, np.zeros(500), touching([view], all_pixels([view]))) == 1).all()


@pytest.fixture(scope="module")
def rendered(device):
    operator = ct.RadianceOperator(SCENE, VIEWS, device)
    cloud = ct.cumulus(GRID, seed=1, peak=60)
    return cloud, ct.Measurements.rendered(operator, operator.render(cloud, samples=512, seed=1))


def with_pixel(measurements, radiance):
    images = [image.copy() for image in measurements.images]
    images[0][12, 11] = radiance
    return replace(measurements, images=tuple(images))


@pytest.mark.parametrize("times", [8, 1e6])
def test_weights_of_other_pixels_do_not_follow_a_broken_one(rendered, times):
    """But for those that touch it."""
    _, measurements = rendered
    broken = with_pixel(measurements, times * max(image.max() for image in measurements.images))
    mask = np.ones(GRID.shape, bool)
    ratio = active_pixels(broken, GRID, mask).weights / active_pixels(measurements, GRID, mask).weights
    assert np.quantile(np.abs(ratio - 1), 0.98) < 0.1


@pytest.fixture(scope="module")
def recovered(rendered, device):
    """How well the cloud is recovered from images of which one pixel is multiplied by a factor."""
    cloud, measurements = rendered

    def recover(times):
        images = with_pixel(measurements, times * measurements.images[0][12, 11])
        solver = ct.GaussNewton(iterations=6)
        return ct.reconstruct(SCENE, images, truth=cloud, seed=2, device=device, solver=solver, uncertainty=0)

    return recover


@pytest.fixture(scope="module")
def unbroken(recovered):
    return recovered(1)


@pytest.mark.parametrize("times", [0.0, 50, 1e6])
def test_a_broken_pixel_spoils_no_recovery(recovered, unbroken, times):
    """Runs that differ in a few bits are some 0.02 apart."""
    result = recovered(times)
    assert result.history[-1].epsilon < unbroken.history[-1].epsilon + 0.06


def test_a_broken_pixel_is_named(recovered):
    outliers = recovered(50).outliers
    assert [(outlier.view, outlier.row, outlier.column) for outlier in outliers] == [(0, 12, 11)]
    assert outliers[0].measured > 20 * outliers[0].modelled > 0


def test_no_pixel_of_a_rendered_image_is_an_outlier(unbroken):
    assert unbroken.outliers == ()


def test_what_is_said_of_outliers():
    one = Outlier(view=3, row=4, column=5, measured=7.123, modelled=0.5)
    assert outlier_text([]) == ""
    assert outlier_text([one]).startswith(
        "1 pixel is far from what any cloud explains, and it hardly counted: row 4, column 5 of view 3 "
        "(measured 7.12, modelled 0.5 W m^-2 sr^-1). Set the radiance of broken pixels to NaN"
    )
    assert " and 2 more. Set" in outlier_text([one] * 5)
