"""Pooled standard errors hold what they should where paths are made up and the truth is known."""

import numpy as np
import pytest

from cloudtomo_cl.errors import DataError
from cloudtomo_cl.scene.pixel_errors import pooled_standard_errors

SHAPE = (24, 28)
# What a path brings, and how likely: a bright cloud, its dark side, and the sea, which all paths see and few more.
KINDS = {"bright": (0.0, 0.3, 1.0), "dark": (0.0, 0.06, 1.0), "clear": (0.0127, 0.03, 0.02)}


def rendered(kind, samples, seed):
    """Means and their own standard errors of paths that bring an exponential variate now and then."""
    always, probability, scale = KINDS[kind]
    generator = np.random.default_rng(seed)
    shape = (*SHAPE, samples)
    paths = always + (generator.random(shape) < probability) * generator.exponential(scale, shape)
    return paths.mean(axis=-1), paths.std(axis=-1, ddof=1) / np.sqrt(samples), always + probability * scale


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("samples", [16, 64, 256])
def test_errors_hold_what_they_should(kind, samples):
    """About 13,400 pixels a case, of which neighbours share their errors: shares are known to 0.01 or better."""
    deviations, own_deviations = [], []
    for seed in range(20):
        mean, own, truth = rendered(kind, samples, seed)
        pooled = pooled_standard_errors(own, samples)
        deviations.append(np.abs(mean - truth) / pooled)
        own_deviations.append(np.abs(mean - truth) / np.maximum(own, 1e-12))
    within = [np.mean(np.array(deviations) <= count) for count in (1, 2, 3)]
    assert within[0] > 0.64 and within[1] > 0.93 and within[2] > 0.97, within
    # They are no larger than they need be.
    assert np.sqrt(np.mean(np.square(deviations))) > 0.7
    if samples == 16 and kind != "bright":
        assert np.mean(np.array(own_deviations) <= 3) < 0.6


@pytest.mark.parametrize("kind", KINDS)
def test_weights_by_errors_keep_the_brightness(kind):
    """Weighting with the pixels' own errors prefers pixels that the bright paths have missed so far."""
    ratios, own_ratios = [], []
    for seed in range(20):
        mean, own, truth = rendered(kind, 16, seed)
        for errors, found in ((pooled_standard_errors(own, 16), ratios), (np.maximum(own, 1e-12), own_ratios)):
            found.append(np.average(mean, weights=errors**-2.0) / truth)
    # Half of the dark pixels have seen no bright path at all. Twenty means have a standard error of 0.01 or less.
    assert np.mean(ratios) == pytest.approx(1, abs=0.04)
    assert abs(np.mean(own_ratios) - 1) > 0.02


def test_equal_errors_stay_what_they_are():
    equal = np.full(SHAPE, 0.25)
    np.testing.assert_allclose(pooled_standard_errors(equal, 64), equal, rtol=1e-12)


def test_paths_count_the_same_wherever_there_are_more():
    """A path scatters by 2 in every pixel: n of them leave 2 / sqrt(n)."""
    samples = np.random.default_rng(1).integers(8, 1000, SHAPE)
    own = 2 / np.sqrt(samples)
    np.testing.assert_allclose(pooled_standard_errors(own, samples), own, rtol=1e-12)


def test_pixels_that_are_not_there_are_left_out():
    """Half of an image that no operator renders is none of the neighbours of the other half."""
    own = np.full(SHAPE, 0.3)
    own[:, 14:] = np.nan
    pooled = pooled_standard_errors(own, np.where(np.isnan(own), np.nan, 16))
    np.testing.assert_allclose(pooled[:, :14], 0.3, rtol=1e-12)
    assert np.isnan(pooled[:, 14:]).all()


def test_an_image_without_scatter_has_no_error():
    assert (pooled_standard_errors(np.zeros(SHAPE), 16) == 0).all()


def test_a_pixel_that_missed_the_bright_paths_has_the_error_of_those_around():
    own = np.full(SHAPE, 0.3)
    own[12, 12] = 0.0
    pooled = pooled_standard_errors(own, 16)
    assert pooled[12, 12] == pytest.approx(0.3)
    assert pooled[11, 11] == pytest.approx(0.3 * np.sqrt(47 / 48)) and pooled[20, 20] == pytest.approx(0.3)


def test_a_pixels_error_has_nothing_to_do_with_its_own_scatter():
    """But for what is five times that of its neighbours: a first bright path of a dark place."""
    own = np.random.default_rng(2).random(SHAPE)
    changed = own.copy()
    for value, least in ((0.0, 0.0), (2.5, 0.5), (10.0, 2.0)):
        changed[9, 9] = value
        before, after = pooled_standard_errors(own, 16)[9, 9], pooled_standard_errors(changed, 16)[9, 9]
        assert after == pytest.approx(max(before, least))


def test_the_mean_is_that_over_the_other_pixels_of_a_window():
    random = np.random.default_rng(5)
    own, samples = random.random(SHAPE), random.integers(8, 99, SHAPE)
    row, column, means = 10, 0, []
    for reach, share in ((1, 1.0), (3, min(1.0, 64 / samples[row, column]))):
        window = np.s_[row - reach : row + reach + 1, 0 : reach + 1]
        scatter, paths = (own * samples)[window] ** 2, samples[window].copy()
        scatter[reach, 0], paths[reach, 0] = 0.0, 0
        means.append(share * scatter.sum() / paths.sum())
    expected = np.sqrt(max(means) / samples[row, column])
    assert pooled_standard_errors(own, samples)[row, column] == pytest.approx(expected)


def test_in_a_list_of_rays_a_rays_own_paths_count():
    """A bright ray between dark ones that have nothing to do with it is not taken for certain."""
    for shape in ((1, 9), (9, 1)):
        own = np.zeros(shape)
        own.ravel()[4] = 0.3
        pooled = pooled_standard_errors(own, 16).ravel()
        assert pooled[4] == pytest.approx(0.3 / np.sqrt(3)) and pooled[0] == 0
    assert pooled_standard_errors(np.full((1, 1), 0.3), 16) == pytest.approx(0.3)


@pytest.mark.parametrize(
    ("errors", "samples"),
    [
        (np.ones(3), 16),
        (np.ones(SHAPE), np.ones(3)),
        (np.full(SHAPE, np.inf), 16),
        (-np.ones(SHAPE), 16),
        (np.ones(SHAPE), 0),
        (np.ones(SHAPE), np.nan),
    ],
)
def test_what_is_impossible_is_named(errors, samples):
    with pytest.raises(DataError, match="must be"):
        pooled_standard_errors(errors, samples)
