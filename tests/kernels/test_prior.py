"""The prior's kernels against the NumPy reference, which is itself held against finite differences."""

from dataclasses import replace

import numpy as np
import pyopencl.array as cl_array
import pytest

from cloudtomo_cl.inversion.priors import Prior
from cloudtomo_cl.inversion.smoothness import PriorOperator
from cloudtomo_cl.reference.prior import prior_value_and_gradient

SHAPES = [(5, 4, 6), (3, 1, 2), (1, 1, 1), (2, 7, 1)]
PRIORS = [Prior(smoothness=1.0), Prior(smoothness=0.0, monotonicity=1.0), Prior(smoothness=0.3, monotonicity=2.0)]
PRIORS = [*(replace(prior, sparsity=0.0) for prior in PRIORS), Prior(smoothness=0.1, sparsity=2.0, sparsity_scale=4.0)]
NOISE = 0.7


def both(device, random, shape, prior, weight=1.0):
    extinction = (random.uniform(0, 60, shape) * (random.random(shape) > 0.3)).astype(np.float32)
    on_device = cl_array.to_device(device.queue, extinction)
    value, gradient = PriorOperator(prior, shape, device).value_and_gradient(on_device, weight, NOISE)
    expected = prior_value_and_gradient(
        extinction,
        prior.smoothness,
        prior.monotonicity,
        prior.c1,
        prior.c2,
        prior.threshold,
        prior.sparsity * NOISE,
        prior.sparsity_scale,
    )
    return value, gradient.get(), expected


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("prior", PRIORS)
def test_value_is_that_of_the_reference(device, random, shape, prior):
    value, _, (expected, _) = both(device, random, shape, prior)
    assert value == pytest.approx(expected, rel=1e-5, abs=1e-5)


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("prior", PRIORS)
def test_gradient_is_that_of_the_reference(device, random, shape, prior):
    _, gradient, (_, expected) = both(device, random, shape, prior)
    np.testing.assert_allclose(gradient, expected, rtol=1e-4, atol=1e-4)


def test_weight_scales_value_and_gradient(device, random):
    value, gradient, (expected, expected_gradient) = both(device, random, SHAPES[0], PRIORS[2], weight=5.0)
    assert value == pytest.approx(5 * expected, rel=1e-5)
    np.testing.assert_allclose(gradient, 5 * expected_gradient, rtol=1e-4, atol=1e-3)
