"""Cameras far away see what parallel rays see, for positions have single precision in the kernels."""

import numpy as np
import pytest

import cloudtomo_cl as ct

GRID = ct.Grid((12, 12, 12), (0.08, 0.08, 0.08))
SIZE = 1.3


@pytest.mark.parametrize("zenith", [0.0, 50.0])
@pytest.mark.parametrize("distance", [36_000.0, 95_000.0])
def test_the_mean_of_a_far_image_is_that_of_parallel_rays(distance, zenith):
    """By the same random numbers; the noise of the difference is less than 1 %."""
    centre = np.array([0.48, 0.48, 0.48])
    sine, cosine = np.sin(np.radians(zenith)), np.cos(np.radians(zenith))
    position = tuple(centre + distance * np.array([sine, 0.0, cosine]))
    field = float(np.degrees(2 * np.arctan(SIZE / 2 / distance)))
    views = [
        ct.OrthographicView(width=SIZE, zenith=zenith, azimuth=0.0, target=tuple(centre), pixels=(16, 16)),
        ct.PerspectiveView(position, tuple(centre), field, (16, 16)),
        ct.OrthographicView(width=SIZE, position=position, target=tuple(centre), pixels=(16, 16)),
    ]
    scene = ct.Scene(GRID, ct.Sun(30.0, 200.0), surface=ct.Surface(albedo=0.02))
    extinction = ct.cumulus(GRID, seed=3)
    means = [ct.RadianceOperator(scene, [view]).render(extinction, 256).mean.mean() for view in views]
    assert means[1:] == pytest.approx([means[0]] * 2, rel=0.02)
