"""Noise of cameras, on images of one radiance. Bounds are 5 standard errors: a significance of 6e-7."""

from dataclasses import replace

import numpy as np
import pytest

from cloudtomo_cl.errors import DataError
from cloudtomo_cl.scene.measurements import Measurements
from cloudtomo_cl.scene.noise import Noise
from cloudtomo_cl.scene.sensors import OrthographicView

SIZE = 200
LEVEL = 0.04
PHOTONS = Noise(full_well=1000, full_radiance=0.1)  # 400 electrons at LEVEL


def images(views=1, level=LEVEL, error=0.0):
    view = OrthographicView(zenith=0, width=1.0, pixels=(SIZE, SIZE))
    arrays = [tuple(np.full((SIZE, SIZE), value) for _ in range(views)) for value in (level, error)]
    return Measurements((view,) * views, *arrays)


def scatter(noise, level=LEVEL):
    """Standard deviation of the pixels, and what the images say it is."""
    noisy = noise.added_to(images(level=level), seed=3)
    return noisy.images[0].std(), noisy.standard_errors[0][0, 0]


def test_noise_keeps_the_mean():
    noisy = PHOTONS.added_to(images()).images[0]
    assert noisy.mean() == pytest.approx(LEVEL, abs=5 * LEVEL / 20 / SIZE)


def test_photon_noise_is_the_square_root_of_the_electrons():
    assert scatter(PHOTONS)[0] == pytest.approx(LEVEL / 20, rel=5 / SIZE)


def test_signal_to_noise_is_that_of_a_full_pixel():
    """Just below saturation, which begins at the full well."""
    noise = Noise(signal_to_noise=100, full_radiance=0.1)
    assert scatter(noise, 0.09)[0] == pytest.approx(0.1 / 100 * np.sqrt(0.9), rel=5 / SIZE)


def test_read_noise_is_there_in_the_dark():
    assert scatter(replace(PHOTONS, read_noise=8.0), 0.0)[0] == pytest.approx(8e-4, rel=5 / SIZE)


@pytest.mark.parametrize(
    "noise", [PHOTONS, replace(PHOTONS, read_noise=8.0), replace(PHOTONS, bits=5), replace(PHOTONS, bits=3)]
)
def test_standard_errors_are_the_scatter(noise):
    """Rounding to 125 electrons where photons scatter by 20 hardly is noise: there the error is too large."""
    found, stated = scatter(noise)
    if noise.bits == 3:
        assert found < 1.3 * stated
    else:
        assert found == pytest.approx(stated, rel=5 / SIZE)


def test_digital_numbers_are_whole():
    noisy = replace(PHOTONS, bits=6, read_noise=20.0).added_to(images()).images[0]
    numbers = noisy / (0.1 / 2**6)
    np.testing.assert_allclose(numbers, np.round(numbers), atol=1e-9)


def test_errors_of_the_images_themselves_add_up():
    noisy = PHOTONS.added_to(images(error=0.003))
    assert noisy.standard_errors[0][0, 0] == pytest.approx(np.hypot(0.003, LEVEL / 20))


def test_saturated_pixels_are_bad():
    some = images()
    some.images[0][3, 4] = 0.2
    noisy = PHOTONS.added_to(some)
    assert np.argwhere(~noisy.valid[0]).tolist() == [[3, 4]]


def test_bad_pixels_stay_bad():
    some = images()
    some.images[0][3, 4] = np.nan
    assert np.argwhere(~PHOTONS.added_to(some).valid[0]).tolist() == [[3, 4]]


def test_the_exposure_fits_the_brightest_pixel():
    """To 80 % of the well, which noise of 2 % does not fill."""
    assert Noise(full_well=2000).added_to(images()).valid[0].all()


def test_a_gain_is_common_to_a_view():
    noise = Noise(full_well=1e9, full_radiance=0.1, calibration_error=0.1)
    noisy = noise.added_to(images(views=30))
    gains = np.array([image.mean() for image in noisy.images]) / LEVEL
    assert max(image.std() for image in noisy.images) < 1e-3 * LEVEL
    # The scatter of 30 gains is known to 13 %.
    assert gains.std() == pytest.approx(0.1, rel=0.5)
    assert noisy.calibration_errors == (0.1,) * 30


def test_equal_seeds_give_equal_noise():
    noise = replace(PHOTONS, read_noise=3.0, calibration_error=0.1)
    first, second, other = (noise.added_to(images(), seed).images[0] for seed in (1, 1, 2))
    np.testing.assert_array_equal(first, second)
    assert not np.array_equal(first, other)


def test_views_have_noise_of_their_own():
    noisy = PHOTONS.added_to(images(views=2))
    correlation = np.corrcoef(noisy.images[0].ravel(), noisy.images[1].ravel())[0, 1]
    assert abs(correlation) < 5 / SIZE


@pytest.mark.parametrize("keys", [{}, {"full_well": 100, "signal_to_noise": 10}])
def test_the_well_is_given_in_one_way(keys):
    with pytest.raises(ValueError, match="one of full_well and signal_to_noise"):
        Noise(**keys)


def test_dark_images_need_a_full_radiance():
    with pytest.raises(DataError, match="full_radiance"):
        Noise(full_well=100).added_to(images(level=0.0))


def test_a_view_that_is_saturated_as_a_whole_is_named():
    with pytest.raises(DataError, match="view 0 is saturated"):
        PHOTONS.added_to(images(level=1.0))
