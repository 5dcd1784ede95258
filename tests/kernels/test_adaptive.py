"""Renderings to a wanted noise."""

import numpy as np
import pytest
from scenes import ABOVE, CAMERA, SCENES, extinction_of

from cloudtomo_cl.errors import DataError
from cloudtomo_cl.scene.grid import Grid
from cloudtomo_cl.scene.scene import Scene, Sun
from cloudtomo_cl.scene.sensors import OrthographicView, RayView
from cloudtomo_cl.transport.adaptive import relative_error, render_to_error
from cloudtomo_cl.transport.radiance import RadianceOperator

SCENE = SCENES["forward peak"]


@pytest.fixture(scope="module")
def operator(device):
    return RadianceOperator(SCENE, [ABOVE, CAMERA], device)


def test_the_target_is_reached(operator):
    rendering = render_to_error(operator, extinction_of(SCENE), 0.02, seed=1)
    assert 0.012 < relative_error(operator, rendering).max() <= 0.02


def test_means_agree_with_equal_samples(operator):
    """Pooled over the pixels: 4 standard errors, significance 6e-5."""
    adaptive = render_to_error(operator, extinction_of(SCENE), 0.01, seed=1)
    equal = operator.render(extinction_of(SCENE), 20_000, seed=2)
    difference = adaptive.mean - equal.mean
    error = np.hypot(adaptive.standard_error, equal.standard_error)
    assert abs(difference.sum()) < 4 * np.sqrt((error**2).sum()) < 0.06 * equal.mean.sum()
    assert np.abs(difference / error).max() < 5


def test_paths_go_where_the_noise_is(device):
    wide = OrthographicView(width=3.0, pixels=(15, 15), zenith=0)
    operator = RadianceOperator(SCENE, [wide], device)
    rendering = render_to_error(operator, extinction_of(SCENE), 0.2, seed=1)
    lit = rendering.mean > 0.1 * rendering.mean.max()
    assert 4 < lit.sum() < 60
    assert np.median(rendering.samples[lit]) > 5 * np.median(rendering.samples[~lit])


def test_photons_are_limited_and_counted(operator):
    rendering = render_to_error(operator, extinction_of(SCENE), 1e-6, seed=1, most_paths=50_000)
    assert 40_000 < rendering.audit.launched <= 50_000 + 2 * len(operator.pixels)
    assert abs(rendering.audit.balance) < 1e-5


@pytest.mark.parametrize("target", [0.0, -1.0, float("nan")])
def test_impossible_targets_are_refused(operator, target):
    with pytest.raises(DataError, match="target_error"):
        render_to_error(operator, extinction_of(SCENE), target)


def test_a_ray_through_thin_cloud_is_not_taken_for_dark(device):
    """Of 2048 paths at an optical depth of 0.01 none collides with a chance of 1e-9."""
    down = RayView(origins=[(0.05, 0.05, 2.0)], directions=[(0.0, 0.0, -1.0)])
    grid = Grid(shape=(1, 1, 1), spacing=(0.1, 0.1, 0.1))
    operator = RadianceOperator(Scene(grid=grid, sun=Sun(zenith=30)), [down], device)
    rendering = render_to_error(operator, np.full(grid.shape, 0.1), 0.1, seed=1)
    assert 0.05 < relative_error(operator, rendering)[0] <= 0.1
