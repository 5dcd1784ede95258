"""Steps of descent against their formulas in NumPy."""

import numpy as np
import pyopencl.array as cl_array
import pytest

from cloudtomo_cl.inversion.solvers.optimizer import Descent, Optimizer

SHAPE = (3, 4, 2)
FLOOR = 0.01


@pytest.fixture
def start(random):
    return random.uniform(1, 50, SHAPE).astype(np.float32)


def descend(device, optimizer, start, gradients, mask=None):
    descent = Descent(optimizer, start, np.ones(SHAPE, bool) if mask is None else mask, device)
    for gradient in gradients:
        descent.step(cl_array.to_device(device.queue, gradient.astype(np.float32)))
    return descent


def adam(variable, gradients, step, decay1, decay2, halving):
    """Kingma and Ba 2015, Algorithm 1, with a step that halves."""
    first, second = np.zeros(SHAPE), np.zeros(SHAPE)
    for t, gradient in enumerate(gradients, start=1):
        slope = gradient(variable)
        first = decay1 * first + (1 - decay1) * slope
        second = decay2 * second + (1 - decay2) * slope**2
        length = step / (1 + (t - 1) / halving)
        variable = variable - length * (first / (1 - decay1**t)) / np.sqrt(second / (1 - decay2**t))
    return variable


def test_sgd_moves_against_the_gradient(device, start, random):
    gradient = random.normal(size=SHAPE)
    optimizer = Optimizer(type="sgd", step=0.5, variable="extinction", halving=None)
    result = descend(device, optimizer, start, [gradient]).extinction.get()
    np.testing.assert_allclose(result, np.maximum(start - 0.5 * gradient, FLOOR), rtol=1e-5)


def test_adam_is_that_of_kingma_and_ba(device, start, random):
    gradients = random.normal(size=(5, *SHAPE))
    optimizer = Optimizer(type="adam", step=0.1, variable="extinction", halving=3.0)
    result = descend(device, optimizer, start, gradients).extinction.get()
    expected = adam(start.astype(float), [lambda _, g=g: g for g in gradients], 0.1, 0.9, 0.999, 3.0)
    np.testing.assert_allclose(result, expected, rtol=1e-5)


def test_square_root_follows_the_chain_rule(device, start, random):
    gradients = random.normal(size=(5, *SHAPE))
    optimizer = Optimizer(type="adam", step=0.1, variable="square-root", halving=3.0)
    result = descend(device, optimizer, start, gradients).extinction.get()
    roots = adam(np.sqrt(start, dtype=float), [lambda u, g=g: 2 * u * g for g in gradients], 0.1, 0.9, 0.999, 3.0)
    np.testing.assert_allclose(result, roots**2, rtol=1e-4)


@pytest.mark.parametrize("variable", ["extinction", "square-root"])
def test_extinction_stays_at_the_floor(device, start, variable):
    optimizer = Optimizer(type="sgd", step=1e6, variable=variable)
    result = descend(device, optimizer, start, [np.ones(SHAPE)]).extinction.get()
    np.testing.assert_allclose(result, FLOOR, rtol=1e-6)


def test_voxels_outside_of_the_mask_stay_empty(device, start, random):
    mask = random.random(SHAPE) > 0.5
    result = descend(device, Optimizer(type="adam"), start, -np.ones((3, *SHAPE)), mask).extinction.get()
    assert (result[~mask] == 0).all() and (result[mask] > 0).all()


def test_estimate_is_the_mean_of_the_iterates(device, start):
    optimizer = Optimizer(type="sgd", step=1.0, variable="extinction", halving=None, averaging=10)
    descent = descend(device, optimizer, start + 10, np.ones((3, *SHAPE)))
    np.testing.assert_allclose(descent.estimate(), start + 10 - 2, rtol=1e-5)  # after 1, 2 and 3 km^-1
