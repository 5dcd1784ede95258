"""Priors that the package does not know: what is taken, in which unit, and what is refused."""

import numpy as np
import pytest

from cloudtomo_cl.errors import DataError
from cloudtomo_cl.inversion.bound_priors import stage_prior
from cloudtomo_cl.inversion.noise_units import NoiseUnits
from cloudtomo_cl.inversion.voxels import Voxels
from cloudtomo_cl.scene.grid import Grid

VOXELS = Voxels(Grid(shape=(2, 1, 1), spacing=(0.1, 0.1, 0.1)), np.ones((2, 1, 1), bool))
EXTINCTION = np.array([3.0, 5.0])
UNITS = NoiseUnits(measured=1.0, both=7.0, weight=2.0)


class Squares:
    """Half the sum of squares."""

    def value_and_gradient(self, extinction, voxels):
        return 0.5 * float(extinction @ extinction), extinction


class Infinite(Squares):
    def value_and_gradient(self, extinction, voxels):
        return np.inf, extinction


class Short(Squares):
    def value_and_gradient(self, extinction, voxels):
        return 0.0, extinction[:1]


def test_an_own_prior_is_in_the_unit_of_the_data_term():
    value, gradient = stage_prior(Squares(), VOXELS, None).value_and_gradient(EXTINCTION, UNITS)
    assert value == 14 * 17
    np.testing.assert_array_equal(gradient, 14 * EXTINCTION)


@pytest.mark.parametrize(("prior", "message"), [(Infinite(), "Infinite .* not finite"), (Short(), "shape")])
def test_what_an_own_prior_may_not_return_is_named(prior, message):
    with pytest.raises(DataError, match=message):
        stage_prior(prior, VOXELS, None).value_and_gradient(EXTINCTION, UNITS)


def test_what_is_no_prior_is_refused():
    with pytest.raises(DataError, match="prior is a float"):
        stage_prior(3.0, VOXELS, None)


@pytest.mark.parametrize(("own", "bound"), [(0.25, 14 * 0.25), (-1.0, 0.0)])
def test_an_own_curvature_is_in_the_same_unit_and_never_negative(own, bound):
    prior = Squares()
    prior.curvature = lambda extinction, voxels: own
    np.testing.assert_array_equal(stage_prior(prior, VOXELS, None).curvature(EXTINCTION, UNITS), [bound, bound])
