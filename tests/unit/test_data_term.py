"""The data term on a device, against its formula in NumPy."""

import numpy as np
import pytest

from cloudtomo_cl.inversion.calibration import Calibration
from cloudtomo_cl.inversion.data_term import DataTerm, ResidualWeights
from cloudtomo_cl.inversion.vectors import Vectors

PIXELS, VOXELS, VIEWS = 300, 30, 3


class Dense:
    """What the data term uses of a Jacobian, of an array."""

    voxel_shares = None

    def __init__(self, values):
        self.values = values.astype(np.float32)

    def times(self, x, result):
        result.set((self.values @ x.get()).astype(np.float32))

    def transposed(self, y, result):
        result.set((self.values.T @ y.get()).astype(np.float32))


CALIBRATIONS = {
    "exact": ((0.0, 0.0, 0.0), False),
    "gains": ((0.02, 0.0, 0.05), False),
    "all gains": ((0.02, 0.03, 0.05), False),
    "gains and motions": ((0.02, 0.01, 0.0), True),
}


@pytest.fixture(params=CALIBRATIONS)
def case(request, random, device):
    """A term, its residual at the start, W C as a function, the Jacobian and the damping."""
    gains, moves = CALIBRATIONS[request.param]
    weights, view = random.uniform(0.5, 2, PIXELS), random.integers(0, VIEWS, PIXELS)
    motions = random.normal(size=(PIXELS, 3)) if moves else None
    errors = random.uniform(0.1, 1, (VIEWS, 3)) if moves else None
    calibration = Calibration(weights, view, gains, 0.3, motions, errors)
    image, residual = random.uniform(1, 2, PIXELS), random.normal(size=PIXELS)
    jacobian, start = random.normal(size=(PIXELS, VOXELS)), random.random(VOXELS)
    damping = random.random(VOXELS)
    term = DataTerm(Dense(jacobian), ResidualWeights(weights, calibration, image, device), residual, start, damping)
    return term, residual, lambda r: weights * calibration(r, image), jacobian, start, damping


def test_the_gradient_is_that_of_the_formula(case, random, device):
    term, residual, force, jacobian, start, damping = case
    x, vectors = random.random(VOXELS), Vectors(device, VOXELS)
    found = vectors.zeros()
    term.add_gradient(vectors.of(x), found)
    expected = jacobian.T @ force(residual + jacobian @ (x - start)) + damping * (x - start)
    np.testing.assert_allclose(found.get(), expected, atol=2e-5 * np.abs(expected).max())
    np.testing.assert_allclose(term.gradient(start), jacobian.T @ force(residual), atol=2e-5 * np.abs(expected).max())


def test_the_product_is_that_of_the_second_derivative(case, random, device):
    term, _, force, jacobian, _, damping = case
    x, vectors = random.random(VOXELS), Vectors(device, VOXELS)
    found = vectors.zeros()
    term.add_product(vectors.of(x), found)
    expected = jacobian.T @ force(jacobian @ x) + damping * x
    np.testing.assert_allclose(found.get(), expected, atol=2e-5 * np.abs(expected).max())
