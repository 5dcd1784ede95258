"""The reference itself, where it can be checked by something plainer still."""

import numpy as np
import pytest
from scipy import ndimage

from cloudtomo_cl.reference import flights as reference
from cloudtomo_cl.reference import prior as reference_prior
from cloudtomo_cl.scene.grid import Grid

SHAPE = (4, 5, 6)


@pytest.fixture
def extinction(random):
    """km^-1, with voxels at 0 and others just above the threshold of the prior."""
    values = random.uniform(0, 30, SHAPE) * (random.random(SHAPE) > 0.3)
    values[1, 1, :3] = 0.05
    return values


def test_the_smoothness_matrix_is_a_convolution_with_nearest_edges(extinction):
    kernel = np.full((3, 3, 3), 1 / 26)
    kernel[1, 1, 1] = -1
    expected = ndimage.convolve(extinction, kernel, mode="nearest")
    found = reference_prior.smoothness_matrix(SHAPE) @ extinction.ravel()
    np.testing.assert_allclose(found.reshape(SHAPE), expected, atol=1e-12)


def test_the_vertical_matrix_is_numpys_gradient(extinction):
    expected = np.gradient(extinction, axis=2)
    found = reference_prior.vertical_matrix(SHAPE) @ extinction.ravel()
    np.testing.assert_allclose(found.reshape(SHAPE), expected, atol=1e-12)


def test_one_layer_has_no_vertical_derivative():
    assert reference_prior.vertical_matrix((2, 2, 1)).nnz == 0


@pytest.mark.parametrize("mu1, mu2", [(0.7, 0.0), (0.0, 1.3), (0.7, 1.3)])
def test_the_priors_gradient_is_that_of_finite_differences(extinction, random, mu1, mu2):
    # The indicator jumps where a voxel crosses the threshold: only voxels beside it are moved.
    change = random.normal(size=SHAPE) * (extinction > 0.02)
    _, gradient = reference_prior.prior_value_and_gradient(extinction, mu1, mu2)
    step = 1e-5
    upper, _ = reference_prior.prior_value_and_gradient(extinction + step * change, mu1, mu2)
    lower, _ = reference_prior.prior_value_and_gradient(extinction - step * change, mu1, mu2)
    assert np.sum(gradient * change) == pytest.approx((upper - lower) / (2 * step), rel=1e-6)


def test_the_prior_rewards_growth_with_height():
    growing = np.broadcast_to(np.arange(1.0, 7.0), SHAPE)
    up, _ = reference_prior.prior_value_and_gradient(growing, 0.0, 1.0)
    down, _ = reference_prior.prior_value_and_gradient(growing[..., ::-1], 0.0, 1.0)
    assert up < 0 < down


def test_the_prior_leaves_out_voxels_at_or_below_the_threshold():
    column = np.array([[[0.0, 0.01, 0.5]]])
    value, _ = reference_prior.prior_value_and_gradient(column, 0.0, 1.0)
    assert value == pytest.approx(-np.tanh(0.49 / 5) * np.tanh(0.5 / 20))


@pytest.mark.parametrize("periodic", [False, True], ids=["open", "periodic"])
def test_crossings_follow_each_other_without_gaps(random, periodic):
    grid = Grid(shape=(3, 4, 5), spacing=(0.1, 0.2, 0.3), origin=(1, 2, 3))
    position = grid.centre + random.normal(size=3)
    direction = np.array(grid.centre) - position
    direction /= np.linalg.norm(direction)
    _, starts, lengths = reference.voxel_crossings(grid, position, direction, periodic)
    assert len(starts) > 3
    np.testing.assert_allclose(starts[1:], starts[:-1] + lengths[:-1], atol=1e-12)


def test_crossings_of_a_diagonal_are_known():
    grid = Grid(shape=(2, 2, 2), spacing=(1, 1, 1))
    direction = np.array([1.0, 1.0, 0.0]) / np.sqrt(2)
    voxels, starts, lengths = reference.voxel_crossings(grid, np.array([-0.5, -0.25, 1.5]), direction)
    assert voxels.tolist() == [[0, 0, 1], [0, 1, 1], [1, 1, 1]]
    np.testing.assert_allclose(starts, np.sqrt(2) * np.array([0.5, 1.25, 1.5]))
    np.testing.assert_allclose(lengths, np.sqrt(2) * np.array([0.75, 0.25, 0.5 + 0.25]))


def test_a_horizontal_ray_never_leaves_a_periodic_domain():
    grid = Grid(shape=(2, 2, 2), spacing=(1, 1, 1))
    with pytest.raises(ValueError, match="never leaves"):
        reference.voxel_crossings(grid, np.array([0.5, 0.5, 0.5]), np.array([1.0, 0, 0]), periodic=True)
