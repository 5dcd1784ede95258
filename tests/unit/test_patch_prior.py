"""The patch prior: mixtures of Gaussians, the function made of them, and its scale."""

import numpy as np
import pytest

import cloudtomo_cl as ct
from cloudtomo_cl.inversion.bound_priors import stage_prior
from cloudtomo_cl.inversion.mixture import Mixture
from cloudtomo_cl.inversion.mixture_file import MixtureFile, read_mixtures
from cloudtomo_cl.inversion.mixture_fit import cloudy_patches, fitted_mixture
from cloudtomo_cl.inversion.noise_units import NoiseUnits
from cloudtomo_cl.inversion.patch_operator import PatchOperator
from cloudtomo_cl.inversion.patch_prior import StagePatches, voxels_of_cloud
from cloudtomo_cl.inversion.patch_quadratic import PatchQuadratic
from cloudtomo_cl.inversion.patches import Patches
from cloudtomo_cl.inversion.priors import PatchPrior, Prior
from cloudtomo_cl.inversion.relative_prior import RelativePrior, mean_extinction
from cloudtomo_cl.inversion.vectors import Vectors

SIZE = (3, 3, 3)
LEAST = 1e-3  # km^-1
UNITS = NoiseUnits(0.5, 0.8, 0.7)
STRENGTH, NOISE = 1.3, 0.05


@pytest.fixture
def random():
    return np.random.default_rng(5)


@pytest.fixture
def voxels(random):
    mask = random.random((7, 6, 8)) < 0.8
    return ct.Voxels(ct.Grid(mask.shape, (0.02, 0.02, 0.04)), mask)


@pytest.fixture
def cloud(voxels, random):
    """Extinctions of the mask's voxels, a third of them clear."""
    return 30 * random.random(len(voxels)) * (random.random(len(voxels)) < 0.67)


def mixture_of(random, components=3, size=SIZE):
    """One of clear patches and some others, not alike."""
    values = int(np.prod(size))
    roots = 0.2 * random.normal(size=(components, values, values)) / values**0.5
    covariances = roots @ roots.transpose(0, 2, 1) + 0.01 * np.eye(values)
    covariances[0] = 0.02**2 * np.eye(values)
    means = random.random((components, 1)) * np.ones(values)
    means[0] = 0
    return Mixture(size, np.full(components, 1 / components), means, covariances)


@pytest.fixture
def mixture(random):
    return mixture_of(random)


@pytest.fixture
def bound(voxels, mixture, device):
    return StagePatches(PatchOperator(Patches(voxels, SIZE), mixture, device), STRENGTH, NOISE)


def patches_by_hand(voxels, u, size=SIZE):
    """The values of all patches that hold a voxel of the mask, cut out with NumPy, shape (patches, values)."""
    margins = [(n // 2, n // 2) for n in size]
    mask = np.pad(voxels.mask, margins, mode="edge")
    full = np.pad(voxels.on_grid(u).astype(float), margins, mode="edge")
    boxes = [tuple(slice(i, i + n) for i, n in zip(corner, size)) for corner in np.ndindex(voxels.mask.shape)]
    return np.array([full[box].ravel() for box in boxes if mask[box].any()])


def costs_by_hand(mixture, patches, noise=NOISE):
    """Minus the log densities of patches, by component, but for 2 pi: with NumPy's inverses and determinants."""
    costs = []
    for weight, mean, covariance in zip(mixture.weights, mixture.means, mixture.covariances):
        wide, away = covariance + noise**2 * np.eye(len(mean)), patches - mean
        forms = np.einsum("ij,ji->i", away, np.linalg.solve(wide, away.T))
        costs.append(0.5 * forms + 0.5 * np.linalg.slogdet(wide)[1] - np.log(weight))
    clear = 0.5 * np.linalg.slogdet(mixture.covariances[0] + noise**2 * np.eye(patches.shape[1]))[1]
    return np.array(costs) - (clear - np.log(mixture.weights[0]))


def by_hand(voxels, mixture, u):
    """The value, patch by patch."""
    return STRENGTH / 27 * costs_by_hand(mixture, patches_by_hand(voxels, u)).min(axis=0).sum()


def test_the_value_is_the_sum_over_patches_that_hold_a_voxel_of_the_mask(voxels, mixture, cloud, bound):
    value, _ = bound.value_and_gradient(cloud / 20, UNITS)
    assert value == pytest.approx(UNITS.weighted * by_hand(voxels, mixture, cloud / 20), rel=1e-4)


def difference_quotient(function, x, direction, step):
    return (function(x + step * direction)[0] - function(x - step * direction)[0]) / (2 * step)


@pytest.mark.parametrize("of", ["function", "step"])
def test_the_gradient_is_that_of_the_value(voxels, bound, cloud, random, of):
    prior = RelativePrior(bound, 1.0, LEAST)
    used = prior if of == "function" else prior.frozen(cloud)
    direction = random.random(len(voxels))
    quotient = difference_quotient(lambda x: used.value_and_gradient(x, UNITS), cloud, direction, 1e-2)
    assert used.value_and_gradient(cloud, UNITS)[1] @ direction == pytest.approx(quotient, rel=2e-3)


def test_a_cloud_of_next_to_nothing_is_measured_by_more_than_it_has(voxels, bound, cloud):
    """Else all else would be a peak, and the prior a wall that no later step comes over."""
    prior, nothing = RelativePrior(bound, 1.0, LEAST), 1e-9 * cloud
    value, gradient = prior.value_and_gradient(nothing, UNITS)
    assert value == pytest.approx(bound.value_and_gradient(nothing / LEAST, UNITS)[0])
    np.testing.assert_allclose(gradient, bound.value_and_gradient(nothing / LEAST, UNITS)[1] / LEAST)
    np.testing.assert_allclose(
        prior.frozen(nothing).value_and_gradient(nothing, UNITS)[1],
        bound.frozen(nothing / LEAST).value_and_gradient(nothing / LEAST, UNITS)[1] / LEAST,
    )


def test_a_step_begins_at_a_share_of_the_functions_value_when_the_noise_has_fallen(bound, cloud):
    """No patch of this cloud is clear."""
    prior = RelativePrior(bound, 1.0, LEAST)
    share = voxels_of_cloud(cloud) / (voxels_of_cloud(cloud) + 200)
    assert prior.frozen(cloud).value_and_gradient(cloud, UNITS)[0] == pytest.approx(
        share * prior.value_and_gradient(cloud, UNITS)[0]
    )


def test_clear_patches_of_a_cloud_of_few_voxels_count_in_full(random, device):
    """A voxel far from the cloud has 27 patches, all clear, with a precision of 1 / (0.02^2 + 0.05^2)."""
    voxels = ct.Voxels(ct.Grid((9, 9, 9), (0.04,) * 3), np.ones((9, 9, 9), bool))
    cloud, far = np.zeros((2, 9, 9, 9))
    cloud[:2, :2, :2], far[6, 6, 6] = 1.0, 1.0
    operator = PatchOperator(Patches(voxels, SIZE), mixture_of(random), device)
    step = StagePatches(operator, STRENGTH, NOISE).frozen(cloud.ravel())
    expected = UNITS.weighted * 1.3 / (0.02**2 + 0.05**2)
    assert step.hessian_times(far.reshape(-1, 1), UNITS)[:, 0] == pytest.approx(expected * far.ravel())


def test_a_cloud_of_equal_voxels_has_as_many():
    assert voxels_of_cloud(np.repeat([0.0, 7.0], [5, 9])) == pytest.approx(9)
    assert voxels_of_cloud(np.zeros(4)) == 0


def test_the_steps_hessian_is_the_second_derivative_of_its_value(voxels, bound, cloud, random):
    step = RelativePrior(bound, 1.0, LEAST).frozen(cloud)
    direction = random.random(len(voxels))
    change = step.value_and_gradient(cloud + direction, UNITS)[1] - step.value_and_gradient(cloud, UNITS)[1]
    np.testing.assert_allclose(step.hessian_times(direction[:, None], UNITS)[:, 0], change, rtol=1e-3, atol=1e-5)


def test_perturbations_have_the_hessian_as_covariance(voxels, bound, cloud):
    """Along one direction, of 2000 draws: the ratio of variances has a standard error of sqrt(2/2000), 3 %."""
    step = RelativePrior(bound, 1.0, LEAST).frozen(cloud)
    random = np.random.default_rng(3)
    direction = random.random(len(voxels))
    draws = [step.perturbation(random, UNITS) @ direction for _ in range(2000)]
    expected = UNITS.both * direction @ step.hessian_times(direction[:, None], UNITS)[:, 0]
    assert np.var(draws) == pytest.approx(expected, rel=0.13)


@pytest.mark.parametrize(
    "prior", [PatchPrior(), Prior(monotonicity=1.0, reference=46.0)], ids=["patches", "smoothness"]
)
@pytest.mark.parametrize("factor", [0.2, 5.0])
def test_a_cloud_and_a_brighter_one_of_its_shape_are_as_likely(voxels, cloud, device, prior, factor):
    own = stage_prior(prior, voxels, device)
    value, gradient = own.value_and_gradient(cloud, UNITS)
    scaled_value, scaled = own.value_and_gradient(factor * cloud, UNITS)
    assert scaled_value == pytest.approx(value, rel=1e-4)
    np.testing.assert_allclose(factor * scaled, gradient, rtol=1e-3, atol=1e-4 * np.abs(gradient).max())


@pytest.mark.parametrize(
    "prior", [PatchPrior(), Prior(monotonicity=1.0, reference=46.0)], ids=["patches", "smoothness"]
)
def test_a_step_from_a_brighter_cloud_of_the_same_shape_is_as_stiff_for_its_brightness(voxels, cloud, device, prior):
    own, change = stage_prior(prior, voxels, device), np.ones((len(voxels), 1))
    stiffness, scaled = (own.frozen(by * cloud).hessian_times(change, UNITS) for by in (1.0, 5.0))
    np.testing.assert_allclose(25 * scaled, stiffness, rtol=1e-3, atol=1e-4 * np.abs(stiffness).max())


def test_the_numbers_of_a_prior_without_a_reference_hold_as_they_stand(voxels, cloud, device):
    given = stage_prior(Prior(sparsity=0.0, reference=0.0), voxels, device)
    value, scaled = (given.value_and_gradient(by * cloud, UNITS)[0] for by in (1.0, 2.0))
    assert scaled == pytest.approx(4 * value, rel=1e-5)


def test_a_prior_at_its_reference_is_the_one_as_its_numbers_stand(voxels, cloud, device):
    reference = mean_extinction(cloud)
    values = [
        stage_prior(Prior(monotonicity=0.5, reference=number), voxels, device).value_and_gradient(cloud, UNITS)[0]
        for number in (0.0, reference)
    ]
    assert values[1] == pytest.approx(values[0], rel=1e-6)


def test_clear_air_costs_nothing(voxels, device):
    value, gradient = stage_prior(PatchPrior(), voxels, device).value_and_gradient(np.zeros(len(voxels)), UNITS)
    assert value == 0 and not gradient.any()


def test_the_mean_extinction_is_that_over_the_mass():
    assert mean_extinction(np.array([0.0, 10.0, 30.0])) == pytest.approx(25.0)
    assert mean_extinction(np.zeros(3)) == 0.0


def test_denoising_with_one_gaussian_is_the_posterior_mean(random):
    mixture = mixture_of(random, components=2)
    noise = 0.3
    patches = (0.9 + 0.5 * random.random((20, 27))).astype(np.float32)  # far from clear
    gain = mixture.covariances[1] @ np.linalg.inv(mixture.covariances[1] + noise**2 * np.eye(27))
    expected = mixture.means[1] + (patches - mixture.means[1]) @ gain.T
    found = patches - noise**2 * (patches - mixture.means[1]) @ mixture.precisions(noise)[1]
    np.testing.assert_allclose(found, expected, atol=1e-5)


# Among them grids that are thinner than a patch, and one of more than a tile along z.
@pytest.mark.parametrize("shape, size", [((7, 6, 8), SIZE), ((2, 1, 11), (5, 3, 3)), ((4, 6, 1), (3, 3, 5))])
def test_a_steps_function_is_that_of_its_patches(random, device, shape, size):
    """At another cloud than that which components were chosen for; those that another density would have are others."""
    mask = random.random(shape) < 0.8
    voxels, mixture = ct.Voxels(ct.Grid(shape, (0.02,) * 3), mask), mixture_of(random, 4, size)
    u = 1.5 * random.random(mask.sum()) * (random.random(mask.sum()) < 0.67)
    step = PatchQuadratic(PatchOperator(Patches(voxels, size), mixture, device), u, NOISE)
    patches = patches_by_hand(voxels, u, size)
    chosen = np.where(patches.any(axis=1), costs_by_hand(mixture, patches).argmin(axis=0), 0)
    np.testing.assert_array_equal(step.components, chosen)
    assert len(np.unique(chosen)) > 1
    other = u + 0.3 * random.random(len(u))
    costs = costs_by_hand(mixture, patches_by_hand(voxels, other, size))
    assert step.value_and_gradient(other)[0] == pytest.approx(costs[chosen, np.arange(len(chosen))].sum(), rel=1e-4)


def test_no_change_has_the_product_that_kernels_make_of_it(voxels, mixture, cloud, device):
    """Zeros, none of them negative: nobody asks kernels for it."""
    step = PatchQuadratic(PatchOperator(Patches(voxels, mixture.size), mixture, device), cloud, NOISE)
    nothing = np.zeros(len(cloud))
    assert step.times(nothing).tobytes() == step._product(nothing, means=0.0).tobytes()


def test_what_was_chosen_before_changes_nothing(voxels, mixture, cloud, device, random):
    operator = PatchOperator(Patches(voxels, SIZE), mixture, device)
    first = PatchQuadratic(operator, cloud / 20, NOISE)
    PatchQuadratic(operator, random.random(len(voxels)), 0.3)
    again = PatchQuadratic(operator, cloud / 20, NOISE)
    np.testing.assert_array_equal(again.components, first.components)
    assert again.value == first.value and np.array_equal(again.times(cloud), first.times(cloud))


@pytest.mark.parametrize("scale", [1.0, 0.25])
def test_a_steps_term_has_its_gradient_and_its_second_derivative(voxels, bound, cloud, device, random, scale):
    step = bound.frozen(cloud / 20)
    term, vectors = step.term(UNITS, scale), Vectors(device, len(voxels))
    gradient, product, direction = vectors.zeros(), vectors.zeros(), random.random(len(voxels))
    term.add_gradient(vectors.of(cloud / 20 / scale), gradient)
    term.add_product(vectors.of(direction), product)
    expected = scale * step.value_and_gradient(cloud / 20, UNITS)[1]
    np.testing.assert_allclose(gradient.get(), expected, rtol=1e-4, atol=1e-5 * np.abs(expected).max())
    expected = scale**2 * step.hessian_times(direction[:, None], UNITS)[:, 0]
    np.testing.assert_allclose(product.get(), expected, rtol=1e-4, atol=1e-5 * np.abs(expected).max())


def test_a_mixture_is_found_again_from_its_patches(random):
    """Means to 5 standard errors of 4000 patches of deviation 0.1, weights to 5 of theirs."""
    truth = {0.3: 0.25, 1.0: 0.75}
    which = random.random(4000) < 0.25
    patches = np.where(which, 0.3, 1.0)[:, None] + 0.1 * random.normal(size=(4000, 27))
    found = fitted_mixture(patches.astype(np.float32), SIZE, 2, 10, random)
    for mean, weight in zip(found.means[1:], found.weights[1:]):
        near = min(truth, key=lambda value: abs(value - mean.mean()))
        assert np.abs(mean - near).max() < 5 * 0.1 / (4000 * truth[near]) ** 0.5
        assert 2 * weight == pytest.approx(truth[near], abs=5 * (0.25 * 0.75 / 4000) ** 0.5)


def test_patches_to_learn_from_do_not_follow_the_clouds_brightness(random):
    clouds = [ct.cumulus(ct.Grid((12, 12, 12), (0.05,) * 3), 3)]
    patches, brighter = (
        cloudy_patches([by * cloud for cloud in clouds], SIZE, 100, np.random.default_rng(2)) for by in (1.0, 8.0)
    )
    np.testing.assert_allclose(brighter, patches, rtol=1e-5)


def test_a_file_gives_back_the_mixture_for_the_shape_of_voxels(tmp_path, mixture, random):
    MixtureFile((1.0, 2.0), (mixture_of(random), mixture)).write(tmp_path / "prior.nc")
    found = read_mixtures(tmp_path / "prior.nc").of_spacing((0.02, 0.02, 0.038))
    np.testing.assert_allclose(found.covariances, mixture.covariances, rtol=1e-6)
    np.testing.assert_allclose(found.means, mixture.means, rtol=1e-6)


@pytest.mark.parametrize(("height", "alike"), [(0.009, True), (0.006, False), (0.058, True), (0.064, False)])
def test_voxels_unlike_all_that_were_learnt_from_are_told(mixture, height, alike):
    """Learnt from heights over width of 0.5 and 2; a factor of 1.5 is alike."""
    assert (MixtureFile((0.5, 2.0), (mixture, mixture)).unlike((0.02, 0.02, height)) == "") is alike


@pytest.mark.parametrize(
    "content", [None, b"no mixture", b"PK\x05\x06" + bytes(18)], ids=["absent", "damaged", "empty archive"]
)
def test_a_file_without_mixtures_is_refused(tmp_path, content):
    path = tmp_path / "prior.nc"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(ct.CloudtomoError, match="prior.nc: "):
        read_mixtures(path)


def test_the_mixtures_that_come_with_the_package_know_several_shapes_of_voxels():
    shipped = read_mixtures()
    assert len(shipped.aspects) >= 4 and shipped.mixtures[0].size == (5, 5, 3)
    for mixture in shipped.mixtures:
        assert mixture.weights.sum() == pytest.approx(1, abs=1e-5)
        assert np.linalg.eigvalsh(mixture.covariances).min() > 0
