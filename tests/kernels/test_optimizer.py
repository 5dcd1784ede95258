"""Steps of descent against their formulas in NumPy."""

import numpy as np
import pytest

from cloudtomo_cl.inversion.objective import AveragedImage
from cloudtomo_cl.inversion.solvers.descent import SGD, Adam, DescentState

VOXELS = 24
FLOOR = 0.01


@pytest.fixture
def start(random):
    return random.uniform(1, 50, VOXELS).astype(np.float32)


def descend(device, solver, start, gradients):
    nothing = np.zeros_like(start)
    state = DescentState(start, start, start, nothing, nothing, 0, AveragedImage.empty(1), None)
    for gradient in gradients:
        state = solver.moved(state, gradient.astype(np.float32), device)
    return state


def adam(variable, gradients, step, beta1, beta2, half_life):
    """Kingma and Ba 2015, Algorithm 1, with a step that halves."""
    first, second = np.zeros(VOXELS), np.zeros(VOXELS)
    for t, gradient in enumerate(gradients, start=1):
        slope = gradient(variable)
        first = beta1 * first + (1 - beta1) * slope
        second = beta2 * second + (1 - beta2) * slope**2
        length = step / (1 + (t - 1) / half_life)
        variable = variable - length * (first / (1 - beta1**t)) / np.sqrt(second / (1 - beta2**t))
    return variable


def test_sgd_moves_against_the_gradient(device, start, random):
    gradient = random.normal(size=VOXELS)
    solver = SGD(step_size=0.5, parametrisation="extinction", step_half_life=None)
    result = descend(device, solver, start, [gradient]).extinction
    np.testing.assert_allclose(result, np.maximum(start - 0.5 * gradient, FLOOR), rtol=1e-5)


def test_adam_is_that_of_kingma_and_ba(device, start, random):
    gradients = random.normal(size=(5, VOXELS))
    solver = Adam(step_size=0.1, parametrisation="extinction", step_half_life=3.0)
    result = descend(device, solver, start, gradients).extinction
    expected = adam(start.astype(float), [lambda _, g=g: g for g in gradients], 0.1, 0.9, 0.999, 3.0)
    np.testing.assert_allclose(result, expected, rtol=1e-5)


def test_square_root_follows_the_chain_rule(device, start, random):
    gradients = random.normal(size=(5, VOXELS))
    solver = Adam(step_size=0.1, parametrisation="square-root", step_half_life=3.0)
    result = descend(device, solver, start, gradients).extinction
    roots = adam(np.sqrt(start, dtype=float), [lambda u, g=g: 2 * u * g for g in gradients], 0.1, 0.9, 0.999, 3.0)
    np.testing.assert_allclose(result, roots**2, rtol=1e-4)


@pytest.mark.parametrize("parametrisation", ["extinction", "square-root"])
def test_extinction_stays_at_the_floor(device, start, parametrisation):
    solver = SGD(step_size=1e6, parametrisation=parametrisation)
    result = descend(device, solver, start, [np.ones(VOXELS)]).extinction
    np.testing.assert_allclose(result, FLOOR, rtol=1e-6)


def test_estimate_is_the_mean_of_the_iterates(device, start):
    solver = SGD(step_size=1.0, parametrisation="extinction", step_half_life=None, iterate_average_window=10)
    state = descend(device, solver, start + 10, np.ones((3, VOXELS)))
    np.testing.assert_allclose(state.estimate, start + 10 - 2, rtol=1e-5)  # after 1, 2 and 3 km^-1
