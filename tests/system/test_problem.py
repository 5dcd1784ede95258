"""The public core: problems, linear models, priors and solvers of a user's own."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

import cloudtomo_cl as ct
from cloudtomo_cl.errors import DataError
from cloudtomo_cl.inversion.solvers.gauss_newton import trusted

GRID = ct.Grid(shape=(6, 5, 7), spacing=(0.1, 0.1, 0.08))


@pytest.fixture(scope="module")
def scene():
    return ct.Scene(grid=GRID, sun=ct.Sun(zenith=30.0))


@pytest.fixture(scope="module")
def truth():
    return ct.cumulus(GRID, seed=3, peak=20.0)


@pytest.fixture(scope="module")
def measurements(scene, truth, device):
    views = tuple(
        ct.OrthographicView(zenith=zenith, azimuth=azimuth, width=0.9, pixels=(10, 10))
        for zenith, azimuth in [(0, 0), (45, 60), (45, 240)]
    )
    operator = ct.RadianceOperator(scene, views, device)
    return ct.Measurements.rendered(operator, operator.render(truth, 256, seed=1))


@pytest.fixture(scope="module")
def problem(scene, measurements, truth, device):
    return ct.Problem.of(scene, measurements, mask=truth > 0, device=device)


@pytest.fixture(scope="module")
def model(problem, truth):
    return problem.linearise(truth[problem.mask], samples=16, seed=2, stream=3)


def test_a_model_has_the_shapes_of_its_problem(problem, model):
    assert model.jacobian.shape == (len(problem.pixels), len(problem.voxels)) and problem.pixels.shape[1] == 2
    assert problem.radiance.shape == problem.weights.shape == model.image.shape == (len(problem.pixels),)
    assert problem.mask.sum() == len(problem.voxels) == len(model.x0)


def test_the_transpose_is_the_transpose(model, random):
    """<J x, y> = <x, J^T y>, to the rounding of single precision."""
    x, y = random.normal(size=model.jacobian.shape[1]), random.normal(size=model.jacobian.shape[0])
    forward = np.dot((model.jacobian @ x).astype(float), y)
    assert forward == pytest.approx(np.dot(x, (model.jacobian.T @ y).astype(float)), rel=1e-4)


def test_products_with_columns_are_those_with_each(model, random):
    x = random.normal(size=(model.jacobian.shape[1], 3))
    columns = np.column_stack([model.jacobian @ column for column in x.T])
    np.testing.assert_allclose(model.jacobian @ x, columns, rtol=1e-3, atol=1e-5 * np.abs(columns).max())


def test_the_curvature_is_the_diagonal(problem, model):
    identity = np.eye(model.jacobian.shape[1])
    matrix = np.asarray(model.jacobian @ identity, float)
    expected = problem.weights @ matrix**2
    np.testing.assert_allclose(model.jacobian.curvature(problem.weights), expected, rtol=1e-3)


def test_products_change_nothing(model, random):
    x = random.normal(size=model.jacobian.shape[1])
    first = model.jacobian @ x
    _ = model.jacobian.T @ first
    np.testing.assert_array_equal(model.jacobian @ x, first)


def test_the_same_seed_and_stream_give_the_same_model(problem, model, truth, random):
    again = problem.linearise(truth[problem.mask], samples=16, seed=2, stream=3)
    x = random.normal(size=model.jacobian.shape[1])
    np.testing.assert_array_equal(again.image, model.image)
    np.testing.assert_array_equal(again.jacobian @ x, model.jacobian @ x)


def test_another_stream_gives_another_model(problem, model, truth):
    other = problem.linearise(truth[problem.mask], samples=16, seed=2, stream=4)
    assert (other.image != model.image).any()


def test_a_model_is_linear_around_its_extinction(model, random):
    step = random.uniform(0, 0.1, len(model.x0))
    np.testing.assert_array_equal(model(model.x0), model.image)
    np.testing.assert_allclose(model(model.x0 + step) - model.image, model.jacobian @ step, atol=1e-7)


def test_value_and_gradient_repeat_themselves(problem, truth):
    x = 0.8 * truth[problem.mask]
    first, second = (problem.value_and_gradient(x, samples=16, seed=1, stream=2) for _ in range(2))
    assert first[0] == second[0] and np.array_equal(first[1], second[1])


def test_the_gradient_points_towards_the_truth(problem, truth):
    """Of too thin a cloud: the cost falls where extinction grows. The slope is 1,000 times its noise."""
    x = 0.5 * truth[problem.mask]
    _, gradient = problem.value_and_gradient(x, samples=64, seed=1, stream=2)
    assert gradient @ (truth[problem.mask] - x) < 0


@pytest.mark.parametrize("shape", [(3,), (4, 5, 6)])
def test_an_extinction_of_another_shape_is_refused(problem, shape):
    with pytest.raises(DataError, match="the voxels of the mask"):
        problem.linearise(np.ones(shape), samples=2)


def test_a_coarser_grid_has_fewer_voxels(scene, measurements, truth, device):
    coarse = ct.Problem.of(scene, measurements, mask=truth > 0, grid=(3, 3, 4), device=device)
    assert coarse.mask.shape == (3, 3, 4) == coarse.grid.shape and coarse.grid.extent == pytest.approx(GRID.extent)


def test_without_a_mask_space_is_carved(scene, measurements, device):
    carved = ct.Problem.of(scene, measurements, device=device)
    operator = ct.RadianceOperator(scene, measurements.views, device, estimator="plain")
    clear = ct.Measurements.rendered(operator, operator.render(np.zeros(GRID.shape), 16))
    np.testing.assert_array_equal(carved.mask, ct.carve(GRID, measurements, clear))


STAGES = (ct.Stage(grid=(6, 5, 7), samples=16, iterations=3),)


def recover(scene, measurements, device, **options):
    return ct.reconstruct(
        scene, measurements, **{"stages": STAGES, "device": device, "seed": 2, "uncertainty": 0, **options}
    )


def test_python_carves_as_problems_do(scene, measurements, device):
    mask = ct.Problem.of(scene, measurements, device=device).mask
    first, second = (recover(scene, measurements, device, mask=given) for given in (None, mask))
    np.testing.assert_array_equal(first.extinction, second.extinction)


class Ridge:
    """Minus the logarithm of a Gaussian of width 1 / sqrt(weight) around 0."""

    def __init__(self, weight):
        self.weight = weight

    def value_and_gradient(self, extinction, voxels):
        assert extinction.shape == (len(voxels),)
        return self.weight / 2 * np.sum(extinction**2), self.weight * extinction

    def curvature(self, extinction, voxels):
        return np.full(len(voxels), self.weight)


def test_an_own_prior_pulls(scene, measurements, device, truth):
    free, pulled = (
        recover(scene, measurements, device, mask=truth > 0, prior=Ridge(weight)).extinction.sum()
        for weight in (1e-6, 1e3)
    )
    assert pulled < 0.1 * free


def test_the_weight_of_the_prior_is_that_of_all_its_terms(scene, measurements, device, truth):
    """Smoothness, monotonicity and sparsity, whose unit is another."""
    prior = ct.Prior(monotonicity=1.0)
    problem = ct.Problem.of(scene, measurements, mask=truth > 0, prior=prior, device=device)
    x = truth[problem.mask].astype(float)
    (value, slope), (third, of_third) = (
        problem.prior.value_and_gradient(x, replace(problem, prior_weight=weight).units()) for weight in (1.0, 1 / 3)
    )
    assert third == pytest.approx(value / 3, rel=1e-6)
    np.testing.assert_allclose(of_third, slope / 3, rtol=1e-4, atol=1e-5 * np.abs(slope).max())


def test_an_own_prior_of_another_shape_is_refused(scene, measurements, device, truth):
    class Wrong(Ridge):
        def value_and_gradient(self, extinction, voxels):
            return 0.0, extinction[:-1]

    with pytest.raises(DataError, match="the gradient of the prior Wrong has shape"):
        recover(scene, measurements, device, mask=truth > 0, prior=Wrong(1.0))


def test_what_is_no_prior_is_refused(scene, measurements, device, truth):
    with pytest.raises(
        DataError, match="prior is 3.0, of type float: it must be a PatchPrior or a Prior, or an object with"
    ):
        recover(scene, measurements, device, mask=truth > 0, prior=3.0)


@dataclass(frozen=True)
class State:
    """Of a solver that goes half of the way towards a given cloud."""

    extinction: np.ndarray
    steps: int = 0

    @property
    def estimate(self):
        return self.extinction


class HalfWay:
    start = 2.0

    def __init__(self, aim):
        self.aim = aim

    def __repr__(self):
        return "HalfWay()"

    def init(self, problem, extinction):
        return State(np.array(extinction, float))

    def step(self, problem, state, *, seed, stream):
        aim = self.aim[problem.mask]
        cost, _ = problem.value_and_gradient(state.extinction, samples=2, seed=seed, stream=stream)
        moved = replace(state, extinction=(state.extinction + aim) / 2, steps=state.steps + 1)
        return moved, ct.Progress(cost, 1.0, 0.0, 2 * len(problem.pixels))


def test_an_own_solver_is_stepped(scene, measurements, device, truth):
    result = recover(scene, measurements, device, mask=truth > 0, solver=HalfWay(truth), truth=truth)
    np.testing.assert_allclose(result.extinction, np.where(truth > 0, truth + (2.0 - truth) / 8, 0), rtol=1e-5)
    assert [record.paths for record in result.history] == [2 * n * len(
        ct.Problem.of(scene, measurements, mask=truth > 0, device=device).pixels) for n in (1, 2, 3)]  # fmt: skip


def test_an_own_solver_goes_on_from_a_checkpoint(scene, measurements, device, truth):
    taken = []
    solver = HalfWay(truth)
    whole = recover(scene, measurements, device, mask=truth > 0, solver=solver)
    recover(scene, measurements, device, mask=truth > 0, solver=solver, checkpoint=taken.append, stop=lambda: True)
    resumed = recover(scene, measurements, device, solver=solver, resume=taken[-1])
    np.testing.assert_array_equal(resumed.extinction, whole.extinction)


@pytest.mark.parametrize(("paths", "samples", "expected"), [(1.0, None, 1), (2.5, None, 2.5), (2.5, 8, None)])
def test_paths_are_those_by_default_times_a_factor(problem, paths, samples, expected):
    """And those of a stage, where it says how many."""
    problem, solver = replace(problem, samples=samples), ct.GaussNewton(paths=paths, image_samples=0)
    _, progress = solver.step(problem, solver.init(problem, np.full(len(problem.voxels), 5.0)), seed=2, stream=1)
    of_derivatives = samples or 2 * round(expected * problem.default_samples / 2)
    assert progress.paths == of_derivatives * len(problem.pixels)


@pytest.mark.parametrize(("voxels", "expected"), [(1000, 90), (2000, 180), (10**6, 180)])
def test_more_voxels_for_a_pixel_than_two_are_no_reason_for_more_paths(problem, voxels, expected):
    """90 paths for each of them: of 1000 pixels, each so many."""
    assert replace(problem, active=range(1000), voxels=range(voxels)).default_samples == expected


@pytest.mark.parametrize(
    ("error", "extinction", "expected"),
    [
        (0.3, 1.0, 6),  # of the measured images' own: their noise is far below a rendering's
        (10.0, 1.0, 1),
        (0.3, 0.0, 1),  # no cloud, where images have one
    ],
)
def test_images_have_no_more_paths_than_it_takes_for_their_noise(problem, truth, error, extinction, expected):
    """To be small beside that of the measured images, or the misfit; 30 paths a pixel, the images have 256."""
    active = replace(problem.active, standard_error=error * problem.active.standard_error)
    problem = replace(problem, active=active, samples=30)
    solver = ct.GaussNewton()
    _, progress = solver.step(problem, solver.init(problem, extinction * truth[problem.mask]), seed=2, stream=1)
    assert progress.paths == expected * 30 * len(problem.pixels)


def test_a_step_makes_no_voxel_deeper_than_its_model_is_trusted(problem):
    """By a third of an optical depth along a mean chord of a voxel, 4 volume / surface."""
    problem, solver = replace(problem, prior_weight=1e-6), ct.GaussNewton(image_samples=1)
    depth = 1 / (2 / np.sum(1 / np.array(problem.grid.spacing)))
    state, _ = solver.step(problem, solver.init(problem, np.full(len(problem.voxels), 0.1 * depth)), seed=2, stream=1)
    assert state.extinction.max() == pytest.approx((0.1 + 1 / 3) * depth)


def test_simulated_recoveries_may_go_on_upwards(problem, truth, monkeypatch):
    """What the share of mass is found by, where images are fitted: not held back as one step of many is."""
    reached = []

    def share_that_keeps_mass(recovered, extinction, noise):
        bound = trusted(extinction, problem.grid)
        reached.append((recovered(-100 * np.abs(noise[:, 0]), 1.0) / bound).max())  # as if far more light had come
        return 0.0

    monkeypatch.setattr("cloudtomo_cl.inversion.solvers.gauss_newton.share_that_keeps_mass", share_that_keeps_mass)
    solver, start = ct.GaussNewton(image_samples=1), truth[problem.mask].astype(float)
    state, _ = solver.step(problem, solver.init(problem, start), seed=2, stream=1)
    assert state.fitted and reached[0] > 1.5
    assert np.all(state.extinction <= trusted(start, problem.grid) * (1 + 1e-5))


@pytest.mark.parametrize("times", [1.0, 20.0])
def test_the_prior_counts_for_more_in_deep_clouds(scene, problem, device, truth, monkeypatch, times):
    """Where images are fitted: by 1 + (depth / 3)^2, of a voxel with the cloud's mean extinction."""
    weights = []

    def annealed(inner, start):
        weights.append(inner.units.weight)
        return start

    monkeypatch.setattr("cloudtomo_cl.inversion.solvers.gauss_newton.annealed", annealed)
    cloud = times * truth
    operator = ct.RadianceOperator(scene, problem.active.views, device)
    seen = ct.Measurements.rendered(operator, operator.render(cloud, 256, seed=1))
    problem = ct.Problem.of(scene, seen, mask=truth > 0, device=device)
    solver = ct.GaussNewton(image_samples=1)
    solver.step(problem, solver.init(problem, cloud[problem.mask].astype(float)), seed=2, stream=1)
    depth = np.sum(cloud**2) / np.sum(cloud) * problem.grid.mean_chord
    assert weights[-1] == pytest.approx(1 + (depth / 3) ** 2, rel=1e-5)


def test_haze_goes_in_steps_but_not_in_simulated_recoveries(problem, truth, monkeypatch):
    """Else these would lose what a cloud without haze gets of it, and too much of the mass be given back."""
    hazy = truth[problem.mask].astype(float)
    hazy[np.argmin(hazy)] = 1e-4 * hazy.mean()
    simulated = []

    def share_that_keeps_mass(recovered, extinction, noise):
        simulated.append(recovered(noise[:, 0], 0.0))
        return 0.0

    of_solver = "cloudtomo_cl.inversion.solvers.gauss_newton."
    monkeypatch.setattr(of_solver + "annealed", lambda inner, start: hazy)
    monkeypatch.setattr(of_solver + "share_that_keeps_mass", share_that_keeps_mass)
    solver = ct.GaussNewton(image_samples=1)
    state, _ = solver.step(problem, solver.init(problem, truth[problem.mask].astype(float)), seed=2, stream=1)
    np.testing.assert_array_equal(simulated[0], hazy)
    np.testing.assert_array_equal(state.extinction, np.where(np.arange(len(hazy)) == np.argmin(hazy), 0, hazy))


def test_old_names_are_answered_with_the_new(scene, measurements, device):
    with pytest.raises(DataError, match="the argument optimizer is now solver: a GaussNewton, Adam or SGD"):
        recover(scene, measurements, device, optimizer=None)
    with pytest.raises(AttributeError, match="cloudtomo_cl.Optimizer is now GaussNewton, Adam or SGD"):
        _ = ct.Optimizer
    with pytest.raises(TypeError, match="unexpected keyword argument 'opt'"):
        recover(scene, measurements, device, opt=None)


def test_the_true_clouds_cost_is_the_expected_one(scene, truth, measurements, device, random):
    """The cost of images with Gaussian noise of the stated errors, 30 draws; 4 standard errors, by their scatter."""
    operator = ct.RadianceOperator(scene, measurements.views, device)
    images = operator.images(operator.render(truth, 4096, seed=7).mean)
    errors = tuple(0.3 * np.sqrt(image * image.max()) + 0.01 * image.max() for image in images)
    costs = []
    for draw in range(30):
        noisy = tuple(image + error * random.standard_normal(image.shape) for image, error in zip(images, errors))
        seen = replace(measurements, images=noisy, standard_errors=errors)
        problem = ct.Problem.of(scene, seen, mask=truth > 0, device=device, prior_weight=0.0)
        cost, _ = problem.value_and_gradient(truth[problem.mask], samples=64, seed=draw)
        costs.append(cost / problem.active.expected_cost)
    assert abs(np.mean(costs) - 1) < 4 * np.std(costs) / np.sqrt(len(costs))


def test_derivatives_are_those_of_the_views_as_they_were_found(device):
    """Near the lines of sight as they are, four voxels from where they were told: the same bits as if told right."""
    grid = ct.Grid(shape=(12, 12, 6), spacing=(0.05, 0.05, 0.05))
    scene, truth = ct.Scene(grid=grid, sun=ct.Sun(zenith=30.0)), ct.cumulus(grid, seed=3, peak=20.0)
    views = tuple(ct.OrthographicView(zenith=zenith, azimuth=60, width=0.1, pixels=(4, 4)) for zenith in (0, 30))
    operator = ct.RadianceOperator(scene, views, device)
    seen = ct.Measurements.rendered(operator, operator.render(truth, 64, seed=1))
    told = replace(seen, position_errors=(0.2,) * 2)
    motions = np.array([[0.2, 0.0, 0.0], [-0.15, 0.1, 0.0]])
    products = []
    for measurements, found in ((told, motions), (told.moved(motions, grid), np.zeros_like(motions))):
        problem = ct.Problem.of(scene, measurements, mask=np.ones(grid.shape, bool), device=device, samples=64)
        problem, solver = replace(problem, motions=found), ct.GaussNewton(inner_iterations=1)
        state = solver.init(problem, truth.ravel() + 0.1)
        state, _ = solver.step(problem, state, seed=3, stream=1)
        products.append(state.derivatives.jacobian @ np.arange(truth.size))
    np.testing.assert_array_equal(*products)
