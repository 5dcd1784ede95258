"""Settings in Python are answered as those in a file: one of the package's errors, what is wrong, what was meant."""

import pickle
from dataclasses import replace

import numpy as np
import pytest

import cloudtomo_cl as ct

RING = {"target": (0, 0, 1), "height": 3.0, "radius": 2.0, "field_of_view": 30.0, "pixels": (8, 8)}


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: ct.Sun(zenit=3.0), "Sun: zenith is missing\nSun: zenit is no known key: did you mean zenith?"),
        (lambda: ct.Sun(100.0), "Sun: zenith must be less than 90, is 100.0"),
        (lambda: ct.Sun(zenith="high"), "Sun: zenith must be a number, unable to parse string as a number, is"),
        (lambda: ct.Sun(1.0, 2.0, 3.0, 4.0), "Sun: takes 3 arguments (zenith, azimuth, irradiance), 4 are given"),
        (lambda: ct.Grid((3, 0, 3), (1, 1, 1)), "Grid: shape[1] must be greater than or equal to 1, is 0"),
        (
            lambda: ct.Grid((3, 3, 3), (1, 1, 1), (0, 0, -1)),
            "Grid: origin[2] must be greater than or equal to 0, is -1",
        ),
        (lambda: ct.GaussNewton(samples=3), "GaussNewton: samples is no known key: did you mean image_samples?"),
        (lambda: ct.Stage(grid=(2, 2, 2), sample=8), "Stage: sample is no known key: did you mean samples?"),
        (lambda: ct.Prior(smoothness=-1), "Prior: smoothness must be greater than or equal to 0, is -1"),
        (lambda: ct.RingOfViews(**RING, azimut=3), "RingOfViews: azimut is no known key: did you mean azimuth?"),
        (
            lambda: ct.RingOfViews(**{**RING, "height": 0.5}),
            "RingOfViews: is wrong: height is 0.5 km: it must be above",
        ),
        (lambda: ct.RayView([[0, 0, 1]], [[0, 0, 0]]), "RayView: is wrong: directions: row 0 is zero"),
        (lambda: ct.RayView([[0, 0]], [[0, 0, 1]]), "RayView: origins is wrong: has shape (1, 2)"),
        (lambda: ct.Scene(grid=3, sun=ct.Sun(3.0)), "Scene: grid must be a table"),
    ],
)
def test_a_wrong_argument_is_named(make, message):
    with pytest.raises(ct.CloudtomoError) as error:
        make()
    assert str(error.value).startswith(message), str(error.value)


def test_the_error_is_a_value_error_and_keeps_the_details():
    with pytest.raises(ValueError) as error:
        ct.Sun(zenith=95.0)
    assert isinstance(error.value, ct.InvalidSettingError) and error.value.details[0]["loc"] == ("zenith",)
    assert isinstance(error.value, ct.SettingsError)


def test_settings_are_copied_compared_and_pickled_as_before():
    view = ct.PerspectiveView((0, 0, 3), (0, 0, 0), field_of_view=30, pixels=(4, 4))
    assert pickle.loads(pickle.dumps(view)) == view and view.with_pixels((8, 8)).pixels == (8, 8)


def test_every_error_of_the_package_is_public():
    from cloudtomo_cl import errors

    kinds = [name for name, kind in vars(errors).items() if isinstance(kind, type) and issubclass(kind, Exception)]
    assert set(kinds) <= set(ct.__all__)


GRID = ct.Grid((3, 4, 5), (0.1, 0.1, 0.1))
SCENE = ct.Scene(GRID, ct.Sun(30.0))
VIEW = ct.OrthographicView(width=0.6, zenith=0.0, pixels=(4, 4))
CLOUD = np.full(GRID.shape, 5.0)


@pytest.mark.parametrize("estimator", ["side_flights", "Plain", ""])
def test_an_unknown_estimator_is_refused(device, estimator):
    allowed = '"branches", "side-flights" or "plain"'
    with pytest.raises(ct.DataError, match=f"estimator is '{estimator}': it must be {allowed}"):
        ct.RadianceOperator(SCENE, [VIEW], device, estimator=estimator)


@pytest.fixture(scope="module")
def fluxes(device):
    return ct.FluxOperator(SCENE, device)


@pytest.mark.parametrize("photons", [1e3, np.float32(1000), np.int16(1000), np.array(1000)])
def test_a_whole_number_of_photons_may_be_of_any_type(fluxes, photons):
    expected = fluxes.compute(CLOUD, 1000, seed=1).reflected.value
    np.testing.assert_array_equal(fluxes.compute(CLOUD, photons, seed=1).reflected.value, expected)


@pytest.mark.parametrize("photons", [0, -1, 999.5, float("nan"), float("inf"), "1000", None, [1000, 2000]])
def test_what_is_no_number_of_photons_is_refused(fluxes, photons):
    with pytest.raises(ct.DataError, match="photons is .*: it must be a whole number of at least 1"):
        fluxes.compute(CLOUD, photons)


class Empty:
    """A prior, or a solver, of length 0: Python takes it for false."""

    def __len__(self):
        return 0

    def value_and_gradient(self, extinction, voxels):
        return 0.0, np.zeros_like(extinction)

    def init(self, problem, extinction):
        raise ct.DataError("the own solver")

    def step(self, problem, state, *, seed, stream):
        raise NotImplementedError


@pytest.fixture(scope="module")
def measurements(device):
    operator = ct.RadianceOperator(SCENE, [VIEW], device)
    return ct.Measurements.rendered(operator, operator.render(CLOUD, 4))


def test_a_prior_of_length_0_is_a_prior(measurements, device):
    problem = ct.Problem.of(SCENE, measurements, mask=CLOUD > 0, prior=Empty(), device=device)
    assert problem.prior.value_and_gradient(CLOUD.reshape(-1), problem.units())[0] == 0


def test_a_solver_of_length_0_is_a_solver(measurements, device):
    with pytest.raises(ct.DataError, match="the own solver"):
        ct.reconstruct(SCENE, measurements, mask=CLOUD > 0, prior=Empty(), solver=Empty(), device=device)


@pytest.mark.parametrize("of_problem, asked", [(None, 0), (0, None)], ids=["asked for", "the problem's"])
@pytest.mark.parametrize("method", ["linearise", "value_and_gradient"])
def test_no_paths_are_not_those_by_default(measurements, device, method, of_problem, asked):
    problem = ct.Problem.of(SCENE, measurements, mask=CLOUD > 0, prior=ct.Prior(), device=device, samples=of_problem)
    with pytest.raises(ct.DataError, match="samples is 0: it must be even and at least 2"):
        getattr(problem, method)(CLOUD.reshape(-1), samples=asked)


@pytest.mark.parametrize("solver", [ct.GaussNewton(), ct.Adam()], ids=["Gauss-Newton", "Adam"])
def test_solvers_take_no_paths_for_none(measurements, device, solver):
    problem = ct.Problem.of(SCENE, measurements, mask=CLOUD > 0, prior=ct.Prior(), device=device, samples=0)
    with pytest.raises(ct.DataError, match="samples is 0: it must be even and at least 2"):
        solver.step(problem, solver.init(problem, CLOUD.reshape(-1)), seed=0, stream=1)


@pytest.mark.parametrize(
    "given",
    [
        {"uncertainty": -1},
        {"uncertainty": 2.5},
        {"time_limit": "60"},
        {"time_limit": float("nan")},
        {"time_limit": -1.0},
        {"checkpoint_interval": None},
        {"checkpoint_interval": float("nan")},
    ],
    ids=str,
)
def test_what_a_recovery_needs_late_is_looked_at_before_it_begins(measurements, device, given):
    with pytest.raises(ct.DataError, match=f"{next(iter(given))} is .*: it must be"):
        ct.reconstruct(SCENE, measurements, mask=CLOUD > 0, solver=Empty(), device=device, **given)


ANGLE = (0.0, 90.0, 180.0)


@pytest.mark.parametrize(
    ("use", "message"),
    [
        (lambda operator: operator.render(CLOUD, "64"), "samples is '64': it must be a whole number"),
        (lambda operator: operator.render(CLOUD, 4, first_sample=None), "first_sample is None: it must be a whole"),
        (lambda operator: operator.render(CLOUD + 1j, 4), "extinction is complex"),
        (lambda operator: operator.images(np.zeros(3)), r"values have shape \(3,\): one is needed for each"),
        (
            lambda operator: operator.gradient(operator.render(CLOUD, 4, store_paths=True), None),
            r"adjoint is object \(\): it must be numbers",
        ),
        (lambda operator: ct.cumulus(SCENE.grid, seed=-1), "seed is -1: it must be a whole number"),
        (lambda operator: ct.cumulus(SCENE.grid, seed=2.5), "seed is 2.5: it must be a whole number"),
        (lambda operator: ct.TabulatedPhaseFunction.normalised(ANGLE, [0, 0, 0]), "cannot be normalised"),
        (lambda operator: ct.extinction_from_water(np.ones(3), np.ones(2)), r"liquid_water_content \(3,\) and eff"),
        (lambda operator: ct.extinction_at(np.ones(3), np.ones(2), None), r"extinction \(3,\) and effective_radius"),
    ],
)
def test_arguments_of_functions_are_answered_too(device, use, message):
    with pytest.raises(ct.CloudtomoError, match=message):
        use(ct.RadianceOperator(SCENE, [VIEW], device))


@pytest.mark.parametrize("seed", [-1, None, 1.5])
def test_a_camera_needs_a_seed(measurements, seed):
    with pytest.raises(ct.DataError, match="seed is .*: it must be a whole number"):
        ct.Noise(full_well=1e4).added_to(measurements, seed=seed)


def test_the_gradient_takes_lists(device):
    operator = ct.RadianceOperator(SCENE, [VIEW], device)
    rendering = operator.render(CLOUD, 4, store_paths=True)
    ones = np.ones((len(operator.pixels), 2))
    np.testing.assert_array_equal(*(operator.gradient(rendering, given).get() for given in (ones, ones.tolist())))


def test_who_reads_no_pickles_advises_none(tmp_path):
    (tmp_path / "checkpoint.npz").write_text("x")
    with pytest.raises(ct.DataError, match="is no checkpoint") as error:
        ct.read_checkpoint(tmp_path / "checkpoint.npz")
    assert "unsafely" not in str(error.value)


def test_ranks_that_are_asked_different_things_say_which(measurements):
    def work(device):
        images = tuple(image * (1 + device.ranks.rank) for image in measurements.images)
        given = replace(measurements, images=images)
        ct.reconstruct(SCENE, given, mask=CLOUD > 0, solver=Empty(), device=device, seed=device.ranks.rank)

    with pytest.raises(ct.DataError, match="ranks were given different seed, images: all call this with the same"):
        ct.on_devices((0, 0), work)
