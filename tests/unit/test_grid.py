"""Resampling between grids of one domain."""

import numpy as np
import pytest

from cloudtomo_cl.scene.grid import Grid, resample, resample_in_mask

SHAPES = [((4, 6, 8), (8, 6, 4)), ((4, 4, 4), (6, 11, 38)), ((38, 38, 38), (11, 7, 3)), ((3, 5, 2), (3, 5, 2))]


@pytest.mark.parametrize("shape, new_shape", SHAPES)
def test_the_mean_is_kept(random, shape, new_shape):
    values = random.random(shape)
    assert resample(values, new_shape).mean() == pytest.approx(values.mean(), rel=1e-12)


def test_averages_weigh_by_overlap():
    np.testing.assert_allclose(resample(np.array([1.0, 2.0, 6.0]), (2,)), [(1 + 2 / 2) / 1.5, (2 / 2 + 6) / 1.5])


@pytest.mark.parametrize("shape, new_shape", SHAPES)
def test_the_optical_depth_of_every_column_is_kept(random, shape, new_shape):
    values = random.random(shape)
    columns = (*shape[:2], new_shape[2])
    np.testing.assert_allclose(resample(values, columns).mean(axis=2), values.mean(axis=2), rtol=1e-12)


@pytest.mark.parametrize("shape, new_shape", SHAPES)
def test_a_mask_costs_no_optical_mass(random, shape, new_shape):
    mask = random.random(new_shape) > 0.6
    reached = resample(mask, shape) > 0
    values = random.random(shape) * reached
    assert resample_in_mask(values, mask).mean() == pytest.approx(values.mean(), rel=1e-12)


def test_nothing_lies_outside_of_a_mask(random):
    mask = random.random((9, 9, 9)) > 0.5
    assert (resample_in_mask(random.random((4, 4, 4)), mask)[~mask] == 0).all()


def test_the_masks_edge_is_not_diluted():
    # A coarse cell half of which lies in the mask: its mass goes into that half.
    np.testing.assert_allclose(resample_in_mask(np.array([3.0, 5.0]), np.array([0, 1, 1, 1])), [0, 6, 5, 5])


def test_other_voxels_fill_the_same_domain():
    grid = Grid(shape=(4, 5, 6), spacing=(0.1, 0.2, 0.3), origin=(1.0, 2.0, 3.0)).with_shape((8, 3, 1))
    np.testing.assert_allclose(grid.extent, (0.4, 1.0, 1.8))
    assert grid.origin == (1.0, 2.0, 3.0)
