"""The data term and its residuals, with images whose noise is known."""

from types import SimpleNamespace

import numpy as np
import pytest

from cloudtomo_cl.inversion.calibration import Calibration
from cloudtomo_cl.inversion.objective import (
    AveragedImage,
    error_beyond_noise,
    pixel_weights,
    relative_weights,
)
from cloudtomo_cl.inversion.pixels import ActivePixels
from cloudtomo_cl.inversion.solvers.gauss_newton import _cost
from cloudtomo_cl.scene.sensors import OrthographicView

PIXELS = 400
MEASURED = np.full(PIXELS, 1.0)
WEIGHTS = np.linspace(0.5, 1.5, PIXELS)
NOISE = 0.5


def halves(random, image):
    return image[:, None] + NOISE * random.normal(size=(PIXELS, 2))


@pytest.mark.parametrize("window", [1, 10])
def test_the_costs_mean_has_no_bias_of_noise(random, window):
    """5 standard errors of the mean: a significance of 6e-7. The square of a mean would be off by 20."""
    image = MEASURED + 0.1
    costs = []
    for _ in range(2000):
        averaged = AveragedImage.empty(PIXELS).with_halves(halves(random, image), window)
        costs.append(averaged.cost(halves(random, image), MEASURED, WEIGHTS, window=window)[0])
    expected = 0.5 * np.sum(WEIGHTS * 0.1**2)
    assert abs(np.mean(costs) - expected) < 5 * np.std(costs) / np.sqrt(len(costs))


@pytest.mark.parametrize("window", [1, 10])
def test_the_costs_standard_error_is_its_scatter(random, window):
    costs, errors = [], []
    for _ in range(1000):
        averaged = AveragedImage.empty(PIXELS).with_halves(halves(random, MEASURED + 0.1), window)
        cost, error = averaged.cost(halves(random, MEASURED + 0.1), MEASURED, WEIGHTS, window=window)
        costs.append(cost)
        errors.append(error)
    assert np.sqrt(np.mean(np.square(errors))) == pytest.approx(np.std(costs), rel=0.1)


@pytest.mark.parametrize(("off", "least", "most"), [(0.0, 0.0, 1.0), (0.5, 0.97, 1.01), (1.0, 0.98, 1.01)])
def test_what_an_image_is_off_by_beyond_its_noise(random, off, least, most):
    """Mean of 500 draws: of what it is off by, or, where that is nothing, of the standard error of one draw.

    Where all is noise, 1/6 of the draws find something, of 0.13 standard errors on average over all: at most 0.2 here.
    """
    found = []
    for _ in range(500):
        image = MEASURED + off + 0.3 * random.normal(size=PIXELS)
        found.append(error_beyond_noise(image, np.full(PIXELS, 0.3**2), halves(random, MEASURED), WEIGHTS))
    expected = 0.5 * np.sum(WEIGHTS * off**2)
    scatter = 0.5 * np.sqrt(np.sum(WEIGHTS**2 * (NOISE**2 + 0.3**2) ** 2))
    assert least <= np.mean(found) / (expected or 0.2 * scatter) <= most


@pytest.mark.parametrize("window", [1, 10])
def test_a_halfs_adjoint_does_not_depend_on_that_half(random, window):
    first, second = halves(random, MEASURED), halves(random, MEASURED)
    changed = second + np.array([1.0, 0.0])
    adjoints = []
    for now in (second, changed):
        averaged = AveragedImage.empty(PIXELS).with_halves(first, window)
        adjoints.append(averaged.adjoint(now, MEASURED, WEIGHTS, window=window))
    np.testing.assert_array_equal(adjoints[0][:, 0], adjoints[1][:, 0])
    assert (adjoints[0][:, 1] != adjoints[1][:, 1]).all()


@pytest.mark.parametrize("window", [1, 10])
def test_without_noise_the_adjoint_is_the_costs_derivative(window):
    image = MEASURED + np.linspace(-0.2, 0.3, PIXELS)
    averaged, both = AveragedImage.empty(PIXELS), np.column_stack([image, image])
    for _ in range(3):
        adjoint = averaged.adjoint(both, MEASURED, WEIGHTS, window=window)
        averaged = averaged.with_halves(both, window)
    np.testing.assert_allclose(adjoint.sum(axis=1), WEIGHTS * (image - MEASURED), atol=1e-12)


def test_pixels_of_unknown_noise_have_relative_weights(random):
    measured = random.random(50)
    np.testing.assert_allclose(pixel_weights(measured, np.zeros(50)), relative_weights(measured), rtol=1e-12)


def test_pixels_of_equal_relative_noise_have_relative_weights(random):
    measured = random.random(50)
    error = 0.02 / np.sqrt(relative_weights(measured))
    np.testing.assert_allclose(pixel_weights(measured, error), relative_weights(measured))


def test_noisy_pixels_weigh_by_their_inverse_variance():
    """Of two that are far noisier than the others, one has three times the other's error."""
    error = np.full(50, 0.02)
    error[:2] = 100.0, 300.0
    weights = pixel_weights(np.ones(50), error)
    assert weights[0] / weights[1] == pytest.approx(9, rel=1e-3)
    assert weights[0] < 1e-4 * weights[2]


def test_quiet_pixels_and_those_somewhat_noisier_weigh_by_their_radiance():
    """However well a pixel is known: the modelled radiance is not."""
    error = np.full(50, 0.02)
    error[:2] = 1e-9, 0.039
    np.testing.assert_array_equal(pixel_weights(np.ones(50), error), relative_weights(np.ones(50)))


def test_weights_by_the_level_do_not_favour_pixels_that_are_dark_by_chance(random):
    """A factor fitted to an image of ones with 15 % noise is 1 - 0.15^2 / 9 on average; with weights of the pixels'
    own radiances it is 1 - 0.15^2. 5 standard errors of the mean."""
    side, noise = 100, 0.15
    pixels = np.column_stack([np.zeros(side**2, int), np.arange(side**2)])
    radiance = 1 + noise * random.standard_normal(side**2)
    view = OrthographicView(width=1.0, pixels=(side, side), zenith=0, azimuth=0)
    seen = ActivePixels((view,), pixels, radiance, np.full(side**2, noise), ())
    weights = pixel_weights(seen.level, seen.standard_error)
    assert np.average(radiance, weights=weights) == pytest.approx(1 - noise**2 / 9, abs=5 * noise / side)


def test_the_standard_error_of_gauss_newtons_cost_is_its_scatter(random):
    """The variance of an image is that of the mean of its two halves."""
    active = SimpleNamespace(calibration=Calibration(WEIGHTS, np.zeros(PIXELS, int), (0.0,), 1.0))
    problem = SimpleNamespace(radiance=MEASURED, weights=WEIGHTS, active=active)
    state = SimpleNamespace(image=MEASURED, motions=np.zeros((1, 3)))
    found = np.array([_cost(problem, halves(random, MEASURED + 0.1), state) for _ in range(1000)])
    assert np.sqrt(np.mean(found[:, 1] ** 2)) == pytest.approx(np.std(found[:, 0]), rel=0.1)
