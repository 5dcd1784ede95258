"""The data term and its residuals, with images whose noise is known."""

import numpy as np
import pytest

from cloudtomo_cl.objective import LaggedResidual

PIXELS = 400
MEASURED = np.full(PIXELS, 1.0)
WEIGHTS = np.linspace(0.5, 1.5, PIXELS)
NOISE = 0.5


def halves(random, image):
    return image[:, None] + NOISE * random.normal(size=(PIXELS, 2))


@pytest.mark.parametrize("memory", [1, 10])
def test_the_costs_mean_has_no_bias_of_noise(random, memory):
    """5 standard errors of the mean: a significance of 6e-7. The square of a mean would be off by 20."""
    image = MEASURED + 0.1
    costs = []
    for _ in range(2000):
        residual = LaggedResidual(MEASURED, WEIGHTS, memory)
        residual.adjoint(halves(random, image))
        costs.append(residual.cost(halves(random, image))[0])
    expected = 0.5 * np.sum(WEIGHTS * 0.1**2)
    assert abs(np.mean(costs) - expected) < 5 * np.std(costs) / np.sqrt(len(costs))


@pytest.mark.parametrize("memory", [1, 10])
def test_the_costs_standard_error_is_its_scatter(random, memory):
    costs, errors = [], []
    for _ in range(1000):
        residual = LaggedResidual(MEASURED, WEIGHTS, memory)
        residual.adjoint(halves(random, MEASURED + 0.1))
        cost, error = residual.cost(halves(random, MEASURED + 0.1))
        costs.append(cost)
        errors.append(error)
    assert np.sqrt(np.mean(np.square(errors))) == pytest.approx(np.std(costs), rel=0.1)


@pytest.mark.parametrize("memory", [1, 10])
def test_a_halfs_adjoint_does_not_depend_on_that_half(random, memory):
    first, second = halves(random, MEASURED), halves(random, MEASURED)
    changed = second + np.array([1.0, 0.0])
    adjoints = []
    for now in (second, changed):
        residual = LaggedResidual(MEASURED, WEIGHTS, memory)
        residual.adjoint(first)
        adjoints.append(residual.adjoint(now))
    np.testing.assert_array_equal(adjoints[0][:, 0], adjoints[1][:, 0])
    assert (adjoints[0][:, 1] != adjoints[1][:, 1]).all()


@pytest.mark.parametrize("memory", [1, 10])
def test_without_noise_the_adjoint_is_the_costs_derivative(memory):
    image = MEASURED + np.linspace(-0.2, 0.3, PIXELS)
    residual = LaggedResidual(MEASURED, WEIGHTS, memory)
    for _ in range(3):
        adjoint = residual.adjoint(np.column_stack([image, image]))
    np.testing.assert_allclose(adjoint.sum(axis=1), WEIGHTS * (image - MEASURED), atol=1e-12)
