"""Pooled standard errors of rendered pixels hold what they should, against renderings with many more paths."""

import numpy as np
import pytest

import cloudtomo_cl as ct

GRID = ct.Grid((12, 12, 12), (0.08, 0.08, 0.08))
VIEWS = tuple(ct.OrthographicView(width=1.3, zenith=zenith, azimuth=210.0, pixels=(18, 18)) for zenith in (0.0, 50.0))
TRUE_SAMPLES = 2048
REPEATS = {16: 8, 64: 4, 256: 2}


@pytest.fixture(scope="module", params=["sea", "black"])
def renderings(request):
    """The operator, a rendering close to the truth, and several with few paths."""
    albedo, zenith = {"sea": (0.05, 40.0), "black": (0.0, 60.0)}[request.param]
    scene = ct.Scene(GRID, ct.Sun(zenith, 30.0), ct.Cloud(), None, ct.Surface(albedo=albedo))
    operator, extinction = ct.RadianceOperator(scene, VIEWS), ct.cumulus(GRID, seed=3)
    few = {
        samples: [operator.render(extinction, samples, seed=seed) for seed in range(count)]
        for samples, count in REPEATS.items()
    }
    return operator, operator.render(extinction, TRUE_SAMPLES, seed=999), few


def kinds(radiance):
    """Bright, dark and clear pixels of a view over the sea or over black ground; clear ones over black are none."""
    ground = np.median(radiance)
    if ground > 0:
        near = np.abs(radiance / ground - 1) < 0.1
        return {"bright": radiance > 2 * ground, "dark": radiance < 0.7 * ground, "clear": near}
    bright = 0.3 * np.quantile(radiance[radiance > 0], 0.9)
    return {"bright": radiance > bright, "dark": (radiance < 0.3 * bright) & (radiance > 1e-6)}


def errors_of(operator, rendering):
    """As files, reports and recoveries have them, in the order of the operator's pixels."""
    return np.concatenate([error.ravel() for error in ct.Measurements.rendered(operator, rendering).standard_errors])


@pytest.mark.parametrize("samples", REPEATS)
def test_errors_of_pixels_hold_what_they_should(renderings, samples):
    """A hundred pixels a kind and repeat, whose errors are pooled: shares are known to about 0.03."""
    operator, truth, few = renderings
    for kind, chosen in kinds(truth.mean).items():
        assert chosen.sum() > 30, kind
        deviations = []
        for rendering in few[samples]:
            error = errors_of(operator, rendering)
            both = np.hypot(error, truth.standard_error)
            deviations.append(np.abs(rendering.mean - truth.mean)[chosen] / both[chosen])
        within = [np.mean(np.array(deviations) <= count) for count in (1, 2, 3)]
        assert within[0] > 0.62 and within[1] > 0.90 and within[2] > 0.95, (kind, within)


def test_weights_by_errors_keep_the_brightness(renderings):
    """Of the bright pixels, at 16 paths: their own errors make it two thirds or less, for the dark is taken for sure.

    The eight means of 70 pixels or more have a standard error of 0.03 together.
    """
    operator, truth, few = renderings
    chosen = kinds(truth.mean)["bright"]
    ratios, own_ratios = [], []
    for rendering in few[16]:
        for error, found in ((errors_of(operator, rendering), ratios), (rendering.standard_error, own_ratios)):
            weights = np.maximum(error[chosen], 1e-9) ** -2.0
            found.append((weights @ rendering.mean[chosen]) / (weights @ truth.mean[chosen]))
    assert abs(np.mean(ratios) - 1) < 0.1 and np.mean(own_ratios) < 0.7
