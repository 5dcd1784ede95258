"""The unknowns of Gauss-Newton."""

import numpy as np
import pytest

from cloudtomo_cl.inversion.solvers.parametrisation import Parametrisation

EXTINCTION = np.array([0.0, 1e-3, 2.0, 80.0, 5000.0])


@pytest.mark.parametrize("scale", [0.3, 20.0, np.inf])
def test_extinctions_come_back(scale):
    own = Parametrisation(scale)
    np.testing.assert_allclose(own.extinction(own.of(EXTINCTION)), EXTINCTION, rtol=1e-12)


@pytest.mark.parametrize("scale", [0.3, 20.0, np.inf])
def test_the_slope_is_the_derivative(scale):
    own = Parametrisation(scale)
    u, step = own.of(EXTINCTION), 1e-6
    numeric = (own.extinction(u + step) - own.extinction(u - step)) / (2 * step)
    np.testing.assert_allclose(own.slope(EXTINCTION), numeric, rtol=1e-5)


def test_small_extinctions_are_their_own_unknowns():
    np.testing.assert_allclose(Parametrisation(20.0).of(np.array([0.0, 0.01])), [0.0, 0.01], rtol=1e-3)
