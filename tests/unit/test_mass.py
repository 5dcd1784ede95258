"""The mass that a prior's pull takes and that is given back: linear models, against their inverse and their draws."""

import numpy as np
import pytest
from dense_term import DenseTerm
from scipy.optimize import lsq_linear

import cloudtomo_cl as ct
from cloudtomo_cl.inversion.bound_priors import stage_prior
from cloudtomo_cl.inversion.conjugate_gradients import minimised
from cloudtomo_cl.inversion.mass import PAIRS, is_due, share_that_keeps_mass
from cloudtomo_cl.inversion.noise_units import NoiseUnits
from cloudtomo_cl.inversion.prior_terms import term_of
from cloudtomo_cl.inversion.priors import PatchPrior, Prior
from cloudtomo_cl.inversion.terms import Around

PIXELS = 400
DEVIATION = 100.0
UNITS = NoiseUnits(DEVIATION**2, DEVIATION**2)
DRAWS = 100
CENTRE = np.full(12, 50.0)


@pytest.fixture
def second_derivative(random):
    root = random.normal(size=(30, 12))
    return root.T @ root


def unbounded(second_derivative, slope, back):
    """Recovers exactly a quadratic function, of whose slope at the centre a prior has a part, and takes some back."""
    return lambda noise, share: CENTRE - np.linalg.solve(second_derivative, slope + share * back + noise)


def test_without_bounds_the_mass_is_kept_exactly_whatever_the_draws(second_derivative, random):
    noise = 5 * random.normal(size=(12, 2))
    slope = second_derivative @ (0.1 + random.random(12))
    back = -2 * second_derivative @ (0.1 + random.random(12))
    recovered = unbounded(second_derivative, slope, back)
    share = share_that_keeps_mass(recovered, CENTRE, noise)
    assert 0 < share < 1
    assert np.sum(recovered(np.zeros(12), share) - CENTRE) == pytest.approx(0, abs=1e-11)


def test_what_noise_adds_at_a_bound_need_not_be_given_back(second_derivative, random):
    slope, noise = np.full(12, 0.1), 3 * random.normal(size=(12, 2))
    bounds = (-np.where(np.arange(12) % 2, 0.05, 50.0), np.inf)
    root = np.linalg.cholesky(second_derivative)

    def recovered(noise, share):
        slopes = slope - 2 * share * slope + noise
        return CENTRE + lsq_linear(root.T, -np.linalg.solve(root, slopes), bounds, method="bvls").x

    quiet = share_that_keeps_mass(recovered, CENTRE, 1e-6 * noise)
    assert share_that_keeps_mass(recovered, CENTRE, noise) < quiet - 0.05


def test_a_cloud_is_not_made_thinner(second_derivative):
    recovered = unbounded(second_derivative, -np.ones(12), -np.ones(12))
    assert share_that_keeps_mass(recovered, CENTRE, np.zeros((12, 1))) == 0


def test_a_slope_that_gives_no_mass_gives_nothing_back(second_derivative):
    recovered = unbounded(second_derivative, np.ones(12), np.zeros(12))
    assert share_that_keeps_mass(recovered, CENTRE, np.zeros((12, 1))) == 0


@pytest.fixture
def grid():
    return ct.Grid((10, 10, 10), (0.04,) * 3)


@pytest.fixture
def voxels(grid):
    return ct.Voxels(grid, ct.cumulus(grid, seed=4) > 0)


@pytest.fixture
def cloud(grid, voxels):
    return ct.cumulus(grid, seed=4)[voxels.mask].astype(float)


def test_recoveries_of_other_simulated_images_keep_the_mass(voxels, cloud, device, random):
    """The mean of 100 keeps it to five standard errors and a fifth of what is lost with nothing given back.

    The fifth is for the few draws that the share was found by.
    """
    data = DenseTerm(device, random.normal(size=(PIXELS, len(cloud))), np.ones(PIXELS))
    at_stage = stage_prior(PatchPrior(), voxels, device)
    hessian_diagonal = np.sum(data.jacobian**2, axis=0) + at_stage.frozen(cloud).curvature(cloud, UNITS)

    def recovered(slope, share):
        prior = at_stage.frozen(cloud, mass_share=share)
        terms = [Around([data], cloud, slope, device), term_of(prior, UNITS, device)]
        return minimised(terms, cloud, hessian_diagonal, 40, device, 1e-5)

    noise = np.column_stack([data.slope(DEVIATION * random.standard_normal(PIXELS)) for _ in range(PAIRS + DRAWS)])
    share = share_that_keeps_mass(recovered, cloud, noise[:, :PAIRS])

    def changes_of_mass(taken_back):
        return np.array([np.sum(recovered(drawn, taken_back) - cloud) for drawn in noise[:, PAIRS:].T])

    lost, kept = changes_of_mass(0.0), changes_of_mass(share)
    assert lost.mean() < -5 * lost.std() / np.sqrt(DRAWS)
    assert abs(kept.mean()) < 5 * kept.std() / np.sqrt(DRAWS) + 0.2 * abs(lost.mean())


@pytest.mark.parametrize("prior, corrects", [(PatchPrior(), True), (Prior(), False), (Prior(reference=46.0), False)])
def test_patches_alone_correct_the_mass(prior, corrects, voxels, device):
    assert bool(getattr(stage_prior(prior, voxels, device), "corrects_mass", False)) == corrects


def test_what_is_taken_back_is_a_share_of_the_pull_along_the_cloud(voxels, cloud, device):
    at_stage = stage_prior(PatchPrior(), voxels, device)
    along = [
        at_stage.frozen(cloud, mass_share=share).value_and_gradient(cloud, UNITS)[1] @ cloud for share in (0, 0.3, 1)
    ]
    assert along[1] == pytest.approx(0.7 * along[0], rel=1e-5) and abs(along[2]) < 1e-5 * abs(along[0])


def test_the_share_is_found_in_ever_fewer_iterations():
    assert [n for n in range(1, 31) if is_due(n)] == [1, 2, 4, 8, 16]
