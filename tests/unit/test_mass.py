"""The mass that a prior's pull takes and that is given back: linear models, against their inverse and their draws."""

import numpy as np
import pytest
from dense_term import DenseTerm
from scipy.optimize import lsq_linear

import cloudtomo_cl as ct
from cloudtomo_cl.inversion.bound_prior import NoiseUnits
from cloudtomo_cl.inversion.mass import give_back, is_due, returned_share, share_that_keeps_mass
from cloudtomo_cl.inversion.noisy_model import NoisyModel
from cloudtomo_cl.inversion.priors import PatchPrior, Prior, bound_prior
from cloudtomo_cl.inversion.terms import stiffness_of

PIXELS = 400
DEVIATION = 100.0
UNITS = NoiseUnits(DEVIATION**2, DEVIATION**2)
DRAWS = 100


@pytest.fixture
def second_derivative(random):
    root = random.normal(size=(30, 12))
    return root.T @ root


def unbounded(second_derivative):
    return lambda slopes: -np.linalg.solve(second_derivative, slopes)


def test_without_bounds_the_mass_is_kept_exactly_whatever_the_draws(second_derivative, random):
    changes, noise = unbounded(second_derivative), 5 * random.normal(size=(12, 2))
    slope = second_derivative @ (0.1 + random.random(12))
    back = -2 * second_derivative @ (0.1 + random.random(12))
    share = share_that_keeps_mass(changes, noise, slope, back)
    assert 0 < share < 1
    assert np.sum(changes(slope + share * back)) == pytest.approx(0, abs=1e-12)


def test_what_noise_adds_at_a_bound_need_not_be_given_back(second_derivative, random):
    slope, noise = np.full(12, 0.1), 3 * random.normal(size=(12, 2))
    bounds = (-np.where(np.arange(12) % 2, 0.05, 50.0), np.inf)
    root = np.linalg.cholesky(second_derivative)

    def changes(slopes):
        ends = [lsq_linear(root.T, -np.linalg.solve(root, column), bounds, method="bvls").x for column in slopes.T]
        return np.column_stack(ends)

    quiet = share_that_keeps_mass(changes, 1e-6 * noise, slope, -2 * slope)
    assert share_that_keeps_mass(changes, noise, slope, -2 * slope) < quiet - 0.05


def test_a_cloud_is_not_made_thinner(second_derivative, random):
    assert share_that_keeps_mass(unbounded(second_derivative), np.zeros((12, 1)), -np.ones(12), -np.ones(12)) == 0


def test_a_slope_that_gives_no_mass_gives_nothing_back(second_derivative):
    assert share_that_keeps_mass(unbounded(second_derivative), np.zeros((12, 1)), np.ones(12), np.zeros(12)) == 0


@pytest.fixture
def grid():
    return ct.Grid((10, 10, 10), (0.04,) * 3)


@pytest.fixture
def voxels(grid):
    return ct.Voxels(grid, ct.cumulus(grid, seed=4) > 0)


@pytest.fixture
def cloud(grid, voxels):
    return ct.cumulus(grid, seed=4)[voxels.mask].astype(float)


@pytest.fixture
def modelled(cloud, device, random):
    """Makes the model of a prior and of images of the cloud."""
    data = DenseTerm(device, random.normal(size=(PIXELS, len(cloud))), np.ones(PIXELS))

    def made(prior):
        stiffness = np.sum(data.jacobian**2, axis=0) + prior.curvature(cloud, UNITS)
        terms = [data, stiffness_of(prior, UNITS, device)]
        return NoisyModel(
            terms, stiffness, np.zeros(len(cloud)),
            lambda random: data.slope(DEVIATION * random.standard_normal(PIXELS)), prior, UNITS, cloud, device,
        )  # fmt: skip

    return made


def test_recoveries_of_other_simulated_images_keep_the_mass(voxels, cloud, device, random, modelled):
    """The mean of 100 keeps it to five standard errors and a fifth of what is lost with nothing given back.

    The fifth is for the few draws that the share was found by.
    """
    prior = bound_prior(PatchPrior(), voxels, device).frozen(cloud)
    model = modelled(prior)
    share = returned_share(model, np.random.default_rng(3))
    noise = [model.slope_of_noise(random) for _ in range(DRAWS)]

    def changes_of_mass(returned):
        give_back(prior, cloud, returned)
        slope = model.prior_slope
        return np.array([np.sum(model.minimum(slope + drawn) - cloud) for drawn in noise])

    lost, kept = changes_of_mass(0.0), changes_of_mass(share)
    assert lost.mean() < -5 * lost.std() / np.sqrt(DRAWS)
    assert abs(kept.mean()) < 5 * kept.std() / np.sqrt(DRAWS) + 0.2 * abs(lost.mean())


def test_smoothness_gives_nothing_back(voxels, cloud, device, modelled):
    for prior in (Prior(), Prior(reference=46.0)):
        frozen = bound_prior(prior, voxels, device).frozen(cloud)
        assert returned_share(modelled(frozen), np.random.default_rng(3)) == 0


def test_the_share_is_found_in_ever_fewer_iterations():
    assert [n for n in range(1, 31) if is_due(n)] == [1, 2, 4, 8, 16]
