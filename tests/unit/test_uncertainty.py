"""Standard errors of linear problems, against the inverse of the model's second derivative."""

import numpy as np
import pytest
from dense_term import DenseTerm

from cloudtomo_cl.inversion.noise_units import NoiseUnits
from cloudtomo_cl.inversion.noisy_model import NoisyModel
from cloudtomo_cl.inversion.prior_terms import hessian_of
from cloudtomo_cl.inversion.smoothness import roughness
from cloudtomo_cl.inversion.uncertainty import WIDENED, standard_errors, widening
from cloudtomo_cl.reference.prior import smoothness_matrix

SHAPE = (4, 3, 5)
PIXELS = 90
DRAWS = 200
# Of a root mean square over the draws, five standard errors: a significance of 6e-7 for each of some 50 voxels.
BOUND = 5 / np.sqrt(2 * DRAWS)


class Smooth:
    """What the standard errors use of a prior that knows the host alone, of weight / 2 ||matrix b||^2."""

    def __init__(self, matrix, weight):
        self.matrix, self.weight = matrix, weight

    def curvature(self, extinction, units):
        return self.weight * np.sum(self.matrix**2, axis=0)

    def hessian_times(self, columns, units):
        return self.weight * self.matrix.T @ (self.matrix @ columns)

    def value_and_gradient(self, extinction, units):
        """Its slope at the estimate is in the given gradient."""
        return 0.0, np.zeros_like(extinction)

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


# Where no bound is near.
FAR = 100.0


@pytest.fixture
def found(problem, device):
    """Makes standard errors of the problem."""
    mask, jacobian, weights, deviation, matrix = problem

    def made(smoothness, draws=DRAWS, correct=lambda residual: residual, estimate=FAR, gradient=0.0):
        data, prior = DenseTerm(device, jacobian, weights, correct), Smooth(matrix, smoothness)
        hessian_diagonal = weights @ jacobian**2 + prior.curvature(None, UNITS) + 1e-3
        model = NoisyModel(
            [data, hessian_of(prior, UNITS, device)],
            hessian_diagonal,
            np.broadcast_to(gradient, mask.sum()),
            lambda random: data.slope(deviation * random.standard_normal(PIXELS)),
            prior,
            UNITS,
            np.broadcast_to(estimate, mask.sum()),
            device,
        )
        return standard_errors(model, draws, seed=1)

    return made


def test_roughness_is_the_priors(random):
    values = random.random(SHAPE)
    expected = smoothness_matrix(SHAPE) @ values.ravel()
    np.testing.assert_allclose(roughness(values).ravel(), expected, atol=1e-12)


@pytest.mark.parametrize("smoothness", [0.0, 20.0])
def test_errors_are_those_of_the_linear_model(problem, found, smoothness):
    """Without the prior, those of weighted least squares, whatever the weights are; and by Bayes with it."""
    mask, jacobian, weights, deviation, matrix = problem
    data, prior = jacobian.T * weights, smoothness * matrix.T @ matrix
    inverse = np.linalg.inv(data @ jacobian + prior)
    middle = data * deviation**2 @ data.T + 0.3 * prior
    expected = np.sqrt(np.diag(inverse @ middle @ inverse))
    np.testing.assert_allclose(found(smoothness), expected, rtol=BOUND + 0.01)


def test_the_prior_alone_gives_errors_where_no_pixel_looks(problem, found):
    mask, jacobian, weights, deviation, matrix = problem
    jacobian[:, 0] = 0
    errors = found(20.0, 100)
    assert np.isfinite(errors).all() and errors[0] > 1.2 * np.median(errors)


def test_equal_seeds_give_equal_errors(found):
    np.testing.assert_array_equal(found(1.0, 5), found(1.0, 5))


def test_what_is_corrected_away_tells_nothing(found):
    """With half of the pixels taken out, errors are larger."""
    half = np.arange(PIXELS) % 2
    whole = np.mean(found(1.0, 50))
    assert np.mean(found(1.0, 50, lambda residual: residual * half)) > 1.3 * whole


def test_voxels_pressed_against_zero_have_small_errors(problem, found):
    pressed = np.arange(problem[0].sum()) % 2 == 0
    errors = found(1.0, 50, estimate=np.where(pressed, 0.0, FAR), gradient=np.where(pressed, 1e3, 0.0))
    assert (errors[pressed] == 0).all() and (errors[~pressed] > 0).all()


def test_errors_are_wider_where_images_do_not_fit_and_voxels_are_deep():
    """By the root of the misfit, where noise does not explain it; in a deep voxel in proportion to its depth."""
    thin, deep = np.zeros(3), np.array([30.0, 60.0])
    np.testing.assert_allclose(widening(0.5, thin), WIDENED)
    np.testing.assert_allclose(widening(4.0, thin), 2 * WIDENED)
    np.testing.assert_allclose(widening(1.0, deep)[1] / widening(1.0, deep)[0], 2.0, rtol=0.01)
