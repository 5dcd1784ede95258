"""Pooled standard errors hold what they should where paths are made up and the truth is known."""

import numpy as np
import pytest

from cloudtomo_cl.errors import DataError
from cloudtomo_cl.scene.pixel_errors import pooled_standard_errors
from cloudtomo_cl.scene.pixels import all_pixels, neighbours
from cloudtomo_cl.scene.sensors import OrthographicView, RayView

VIEWS = tuple(OrthographicView(width=1.0, zenith=0.0, pixels=pixels) for pixels in ((24, 24), (12, 10)))
PIXELS = all_pixels(VIEWS)
AROUND = neighbours(VIEWS, PIXELS)
# What a path brings, and how likely: a bright cloud, its dark side, and the sea, which all paths see and few more.
KINDS = {"bright": (0.0, 0.3, 1.0), "dark": (0.0, 0.06, 1.0), "clear": (0.0127, 0.03, 0.02)}


def rendered(kind, samples, seed):
    """Means and their own standard errors of paths that bring an exponential variate now and then."""
    always, probability, scale = KINDS[kind]
    generator = np.random.default_rng(seed)
    shape = (len(PIXELS), samples)
    paths = always + (generator.random(shape) < probability) * generator.exponential(scale, shape)
    return paths.mean(axis=1), paths.std(axis=1, ddof=1) / np.sqrt(samples), always + probability * scale


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("samples", [16, 64, 256])
def test_errors_hold_what_they_should(kind, samples):
    """About 12,800 pixels a case, of which neighbours share their errors: shares are known to 0.01 or better."""
    deviations, own_deviations = [], []
    for seed in range(20):
        mean, own, truth = rendered(kind, samples, seed)
        pooled = pooled_standard_errors(own, samples, AROUND)
        deviations.append(np.abs(mean - truth) / pooled)
        own_deviations.append(np.abs(mean - truth) / np.maximum(own, 1e-12))
    within = [np.mean(np.array(deviations) <= count) for count in (1, 2, 3)]
    assert within[0] > 0.64 and within[1] > 0.93 and within[2] > 0.975, within
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
        for errors, found in ((pooled_standard_errors(own, 16, AROUND), ratios), (np.maximum(own, 1e-12), own_ratios)):
            found.append(np.average(mean, weights=errors**-2.0) / truth)
    # Half of the dark pixels have seen no bright path at all.
    assert np.mean(ratios) == pytest.approx(1, abs=0.25 if kind == "dark" else 0.1)
    assert abs(np.mean(ratios) - 1) < 0.5 * abs(np.mean(own_ratios) - 1)


def test_equal_errors_stay_what_they_are():
    equal = np.full(len(PIXELS), 0.25)
    np.testing.assert_allclose(pooled_standard_errors(equal, 64, AROUND), equal, rtol=1e-6)


def test_paths_count_the_same_wherever_there_are_more():
    """A path scatters by 2 in every pixel: n of them leave 2 / sqrt(n)."""
    samples = np.random.default_rng(1).integers(8, 1000, len(PIXELS))
    own = 2 / np.sqrt(samples)
    np.testing.assert_allclose(pooled_standard_errors(own, samples, AROUND), own, rtol=1e-5)


def test_an_image_without_scatter_has_no_error():
    own = np.where(PIXELS[:, 0] == 0, 0.3, 0.0)
    pooled = pooled_standard_errors(own, 16, AROUND)
    assert (pooled[PIXELS[:, 0] == 1] == 0).all() and (pooled[PIXELS[:, 0] == 0] > 0.2).all()


def test_rays_of_a_list_are_neighbours_if_somebody_says_so():
    view = RayView(np.ones((12, 3)), np.ones((12, 3)))
    pixels, own = all_pixels([view]), np.eye(12)[6]
    np.testing.assert_allclose(pooled_standard_errors(own, 16, neighbours([view], pixels)), own)
    pooled = pooled_standard_errors(own, 16, neighbours([view], pixels, lists=True))
    assert (pooled[4:9] > 0.2).all() and pooled[0] == 0


@pytest.mark.parametrize(
    ("errors", "samples"), [(np.ones(3), 16), (np.full(len(PIXELS), np.nan), 16), (-np.ones(len(PIXELS)), 16),
                            (np.ones(len(PIXELS)), 0)]
)  # fmt: skip
def test_what_is_impossible_is_named(errors, samples):
    with pytest.raises(DataError, match="must be"):
        pooled_standard_errors(errors, samples, AROUND)
