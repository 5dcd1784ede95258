"""Standard errors of linear problems, against the inverse of the model's second derivative."""

import numpy as np
import pytest
from scipy.optimize import lsq_linear
from scipy.sparse.linalg import LinearOperator

from cloudtomo_cl.inversion.bound_prior import NoiseUnits
from cloudtomo_cl.inversion.priors import roughness
from cloudtomo_cl.inversion.uncertainty import bounded_minimum, standard_errors
from cloudtomo_cl.reference.prior import smoothness_matrix

SHAPE = (4, 3, 5)
PIXELS = 90
DRAWS = 400
# Of a root mean square over the draws, five standard errors: a significance of 6e-7 for each of some 50 voxels.
BOUND = 5 / np.sqrt(2 * DRAWS)


class Dense(LinearOperator):
    """What the standard errors use of a Jacobian, of an array."""

    def __init__(self, values):
        super().__init__(values.dtype, values.shape)
        self.values = values

    def _matmat(self, x):
        return self.values @ x

    def _rmatmat(self, y):
        return self.values.T @ y

    def curvature(self, weights):
        return weights @ self.values**2


class Smooth:
    """What the standard errors use of a prior, of weight / 2 ||matrix b||^2."""

    def __init__(self, matrix, weight):
        self.matrix, self.weight = matrix, weight

    def curvature(self, extinction, units):
        return self.weight * np.sum(self.matrix**2, axis=0)

    def stiffness(self, columns, units):
        return self.weight * self.matrix.T @ (self.matrix @ columns)

    def perturbation(self, random, units):
        return np.sqrt(self.weight * units.both) * self.matrix.T @ random.standard_normal(len(self.matrix))


UNITS = NoiseUnits(0.3, 0.3)


@pytest.fixture
def problem(random):
    mask = random.random(SHAPE) < 0.8
    jacobian = random.normal(size=(PIXELS, mask.sum())).astype(np.float32)
    weights, deviation = random.uniform(0.5, 2, PIXELS), random.uniform(0.1, 0.5, PIXELS)
    matrix = smoothness_matrix(SHAPE)[:, mask.ravel()].toarray()
    return mask, jacobian, weights, deviation, matrix


def found(problem, smoothness, draws=DRAWS, correct=lambda residual: residual):
    mask, jacobian, weights, deviation, matrix = problem
    return standard_errors(
        Dense(jacobian), weights, lambda random: deviation * random.standard_normal(PIXELS), correct,
        Smooth(matrix, smoothness), UNITS, np.full(mask.sum(), np.inf), np.zeros(mask.sum()), draws, seed=1,
    )  # fmt: skip


def test_roughness_is_the_priors(random):
    values = random.random(SHAPE)
    expected = smoothness_matrix(SHAPE) @ values.ravel()
    np.testing.assert_allclose(roughness(values).ravel(), expected, atol=1e-12)


@pytest.mark.parametrize("smoothness", [0.0, 20.0])
def test_errors_are_those_of_the_linear_model(problem, smoothness):
    """Without the prior, those of weighted least squares, whatever the weights are; and by Bayes with it."""
    mask, jacobian, weights, deviation, matrix = problem
    data, prior = jacobian.T * weights, smoothness * matrix.T @ matrix
    inverse = np.linalg.inv(data @ jacobian + prior)
    middle = data * deviation**2 @ data.T + 0.3 * prior
    expected = np.sqrt(np.diag(inverse @ middle @ inverse))
    np.testing.assert_allclose(found(problem, smoothness), expected, rtol=BOUND + 0.01)


def test_the_prior_alone_gives_errors_where_no_pixel_looks(problem):
    mask, jacobian, weights, deviation, matrix = problem
    jacobian[:, 0] = 0
    errors = found(problem, 20.0, 100)
    assert np.isfinite(errors).all() and errors[0] > 1.2 * np.median(errors)


def test_equal_seeds_give_equal_errors(problem):
    np.testing.assert_array_equal(found(problem, 1.0, 5), found(problem, 1.0, 5))


def test_what_is_corrected_away_tells_nothing(problem):
    """With half of the pixels taken out, errors are larger."""
    half = np.arange(PIXELS) % 2
    whole = np.mean(found(problem, 1.0, 50))
    assert np.mean(found(problem, 1.0, 50, lambda residual: residual * half)) > 1.3 * whole


def test_minima_respect_their_bounds(random):
    """Against SciPy's bounded least squares: about half of the unknowns end on a bound."""
    matrix, aim = random.normal(size=(60, 20)), random.normal(size=(60, 5))
    lower = -random.uniform(0, 0.1, (20, 1))
    second = matrix.T @ matrix
    scale = 1 / np.diag(second)[:, None]
    columns = bounded_minimum(lambda values: second @ values, matrix.T @ aim, scale, lower)
    for column, right in zip(columns.T, aim.T):
        expected = lsq_linear(matrix, right, bounds=(lower[:, 0], np.inf)).x
        np.testing.assert_allclose(column, expected, atol=0.01 * np.abs(expected).max())
    assert 0.2 < np.mean(columns == lower) < 0.8


def test_voxels_pressed_against_zero_have_small_errors(problem):
    mask, jacobian, weights, deviation, matrix = problem
    voxels = mask.sum()
    pressed = np.arange(voxels) % 2 == 0
    errors = standard_errors(
        Dense(jacobian), weights, lambda random: deviation * random.standard_normal(PIXELS), lambda r: r,
        Smooth(matrix, 1.0), UNITS, np.where(pressed, 0.0, np.inf), np.where(pressed, 1e3, 0.0), 50, seed=1,
    )  # fmt: skip
    assert (errors[pressed] == 0).all() and (errors[~pressed] > 0).all()
