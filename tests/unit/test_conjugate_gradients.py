"""The minimiser of terms on a device, against SciPy's and linear algebra."""

import numpy as np
import pytest
from scipy.optimize import lsq_linear, minimize

from cloudtomo_cl.inversion.conjugate_gradients import minimised
from cloudtomo_cl.inversion.prior_terms import HostTerm, term_of
from cloudtomo_cl.inversion.terms import Around
from cloudtomo_cl.inversion.vectors import PARTS, Vectors
from cloudtomo_cl.opencl.layout import STRUCTS

UNKNOWNS = 40


class Quadratic:
    """1/2 x^T H x - b^T x on arrays of the host; counts products."""

    quadratic = True

    def __init__(self, device, second, slope):
        self.vectors, self.second, self.slope = Vectors(device, len(slope)), second, slope
        self.products = 0

    def add_gradient(self, x, result):
        self.vectors.add(1.0, self.vectors.of(self.second @ x.get() - self.slope), result)

    def add_product(self, x, result):
        self.products += 1
        self.vectors.add(1.0, self.vectors.of(self.second @ x.get()), result)

    def value(self, x):
        return 0.5 * x @ self.second @ x - self.slope @ x


class Own:
    """A user's prior: sum of weight (b - aim)^4 / 4, which no term is made of."""

    def __init__(self, aim):
        self.aim = aim

    def value_and_gradient(self, extinction, units):
        away = extinction - self.aim
        return np.sum(away**4) / 4, away**3


@pytest.fixture
def random():
    return np.random.default_rng(11)


@pytest.fixture
def matrix(random):
    return random.normal(size=(60, UNKNOWNS)) * np.exp(random.normal(size=UNKNOWNS))


def test_minima_respect_their_bounds(device, random, matrix):
    """Against SciPy's bounded least squares: about half of the unknowns end on the bound."""
    aim = random.normal(size=60)
    term = Quadratic(device, matrix.T @ matrix, matrix.T @ aim)
    found = minimised([term], np.ones(UNKNOWNS), np.sum(matrix**2, axis=0), 200, device, 1e-12)
    expected = lsq_linear(matrix, aim, bounds=(0, np.inf), tol=1e-12).x
    np.testing.assert_allclose(found, expected, atol=1e-4 * np.abs(expected).max())
    assert 0.2 < np.mean(found == 0) < 0.8


def test_minima_respect_upper_bounds(device, random, matrix):
    """Against SciPy's bounded least squares: of the unknowns some end on either bound, and some between."""
    aim, upper = random.normal(size=60), 0.1 * random.random(UNKNOWNS) + 0.01
    term = Quadratic(device, matrix.T @ matrix, matrix.T @ aim)
    found = minimised([term], 0.5 * upper, np.sum(matrix**2, axis=0), 200, device, 1e-12, upper)
    upper = upper.astype(np.float32)
    expected = lsq_linear(matrix, aim, bounds=(0, upper), tol=1e-12).x
    np.testing.assert_allclose(found, expected, atol=1e-4 * expected.max())
    on_bounds = (found == 0).mean(), (found == upper).mean()
    assert min(on_bounds) > 0.1 and sum(on_bounds) < 0.9


def test_without_bounds_they_are_conjugate_gradients(device, random):
    """Which end after as many products as there are different eigenvalues."""
    axes = np.linalg.qr(random.normal(size=(UNKNOWNS, UNKNOWNS)))[0]
    second = axes * np.resize([1.0, 3.0, 10.0], UNKNOWNS) @ axes.T
    minimum = 100 + random.random(UNKNOWNS)
    term = Quadratic(device, second, second @ minimum)
    found = minimised([term], np.full(UNKNOWNS, 100.0), np.ones(UNKNOWNS), 3, device)
    np.testing.assert_allclose(found, minimum, atol=1e-4)


def test_an_iteration_takes_a_product_and_lowers_the_function(device, random, matrix):
    term = Quadratic(device, matrix.T @ matrix, matrix.T @ random.normal(size=60))
    start, hessian_diagonal = random.random(UNKNOWNS), np.sum(matrix**2, axis=0)
    values = [term.value(start)]
    for iterations in range(1, 12):
        term.products = 0
        values.append(term.value(minimised([term], start, hessian_diagonal, iterations, device)))
        assert term.products <= iterations + 1  # a direction that leads up is replaced
    assert (np.diff(values) < 0).all()


def test_a_prior_of_unknown_form_is_minimised_with_the_others(device, random, matrix):
    aim, wanted = random.normal(size=60), random.normal(size=UNKNOWNS)
    term, own = Quadratic(device, matrix.T @ matrix, matrix.T @ aim), Own(wanted)
    other = term_of(own, None, device)
    assert isinstance(other, HostTerm)
    found = minimised([term, other], np.ones(UNKNOWNS), np.sum(matrix**2, axis=0) + 1, 200, device, 1e-12)

    def value_and_gradient(x):
        value, gradient = own.value_and_gradient(x, None)
        return value + term.value(x), gradient + term.second @ x - term.slope

    bounds = [(0, None)] * UNKNOWNS
    options = {"maxiter": 2000, "ftol": 1e-15, "gtol": 1e-10}
    expected = minimize(
        value_and_gradient, np.ones(UNKNOWNS), jac=True, method="L-BFGS-B", bounds=bounds, options=options
    )
    assert value_and_gradient(found)[0] == pytest.approx(expected.fun, rel=1e-6)


def test_a_start_at_the_minimum_is_the_result(device):
    term = Quadratic(device, np.eye(UNKNOWNS), np.zeros(UNKNOWNS))
    np.testing.assert_array_equal(minimised([term], np.zeros(UNKNOWNS), np.ones(UNKNOWNS), 5, device), 0)


def test_a_function_around_a_centre_has_its_slope_there(device, random, matrix):
    """Its minimum without bounds is a Newton step from the centre."""
    second, slope, centre = matrix.T @ matrix + np.eye(UNKNOWNS), random.normal(size=UNKNOWNS), np.full(UNKNOWNS, 50.0)
    model = Around([Quadratic(device, second, np.full(UNKNOWNS, np.nan))], centre, slope, device)
    found = minimised([model], centre, np.diag(second), 200, device)
    np.testing.assert_allclose(found - centre, -np.linalg.solve(second, slope), atol=1e-3)


def chosen(device, sums, *, before=None, longest=np.inf, most_steps=9, tolerance=1e-7):
    """What `choose_step` makes of sums, shape (3, PARTS)."""
    state = np.zeros(1, STRUCTS["Minimisation"])
    state["length"] = 1.0
    for name, value in (before or {}).items():
        state[name] = value
    state = device.array(state)
    Vectors(device, 1).launch_once(
        "choose_step", sums=device.array(np.asarray(sums, np.float32)), longest=longest, most_steps=most_steps,
        tolerance=tolerance, state=state,
    )  # fmt: skip
    return state.get()[0]


def sums_of(slope, curvature, farthest=np.inf):
    sums = np.zeros((3, PARTS))
    sums[:, PARTS // 3] = slope, curvature, farthest
    sums[2, : PARTS // 3] = np.inf
    sums[2, PARTS // 3 + 1 :] = np.inf
    return sums


@pytest.mark.parametrize("count", [1, PARTS - 1, 3 * PARTS + 5])
def test_sums_are_those_of_all_numbers(device, random, count):
    """Seen by the step that they lead to: -slope / curvature, as far as no bound is met."""
    vectors, sums = Vectors(device, count), device.empty((3, PARTS), np.float32)
    x, room = np.abs(random.normal(size=(2, count))).astype(np.float32)
    gradient, change, hessian_change = random.normal(size=(3, count)).astype(np.float32)
    gradient, hessian_change = -np.sign(change) * np.abs(gradient), np.sign(change) * np.abs(hessian_change)
    vectors.launch_parts(
        "sums_of_change", sums=sums,
        **{
            name: vectors.of(values)
            for name, values in dict(
                x=x, upper=x + room, gradient=gradient, change=change, hessian_change=hessian_change
            ).items()
        },
    )  # fmt: skip
    way = np.where(change < 0, x, (x + room) - x)
    best = -(gradient.astype(float) @ change) / (hessian_change.astype(float) @ change)
    farthest = np.min(way / np.abs(change))
    assert chosen(device, sums.get())["taken"] == pytest.approx(min(best, farthest), rel=1e-5)
    assert sums.get()[2].min() == pytest.approx(farthest)
    without_bounds = np.where(np.arange(3)[:, None] < 2, sums.get(), np.inf)
    assert chosen(device, without_bounds)["taken"] == pytest.approx(best, rel=1e-5)


@pytest.mark.parametrize(
    "sums, longest, taken, length",
    [
        (sums_of(-3.0, 2.0), np.inf, 1.5, 1.3 * 1.5),
        (sums_of(-3.0, 2.0, 1.25), np.inf, 1.25, 1.3 * 1.5),
        (sums_of(-3.0, 2.0), 1.0, 1.0, 1.3 * 1.5),
        (sums_of(-3.0, 0.5), np.inf, 6.0, 2.0),
        (sums_of(-3.0, 30.0), np.inf, 0.1, 0.5),
        (sums_of(-3.0, -1.0, 4.0), np.inf, 4.0, 2.0),
    ],
    ids=["least", "to a bound", "no farther", "longer", "shorter", "concave"],
)
def test_a_step_goes_to_the_least_value_on_its_way(device, sums, longest, taken, length):
    found = chosen(device, sums, longest=longest)
    assert (found["taken"], found["length"]) == (pytest.approx(taken), pytest.approx(length))
    gain = -(taken * sums[0].sum() + 0.5 * taken**2 * sums[1].sum())
    assert found["gained"] == pytest.approx(gain)
    assert (found["steps"], found["ended"]) == (1, 0)


@pytest.mark.parametrize(
    "sums, before, ended",
    [
        (sums_of(1.0, 1.0), {"conjugation": 0.5}, False),  # up: by the gradient alone
        (sums_of(1.0, 1.0), {}, True),
        (sums_of(0.0, 0.0), {}, True),
        (sums_of(np.nan, 1.0), {"conjugation": 0.5}, True),
        (sums_of(-1.0, 0.0), {}, True),  # falls for ever
        (sums_of(-1.0, 1.0), {"ended": 1}, True),
    ],
    ids=["up", "up the gradient", "flat", "no number", "without end", "ended"],
)
def test_without_a_way_down_no_step_is_taken(device, sums, before, ended):
    found = chosen(device, sums, before=before)
    assert (found["taken"], found["steps"], found["ended"]) == (0, 0, ended)


def test_it_ends_with_the_last_step_or_the_second_in_a_row_that_gains_little(device):
    sums = sums_of(-1.0, 1.0)
    assert chosen(device, sums, before={"steps": 8})["ended"]
    assert chosen(device, sums, before={"gained": 1e8, "poor": 1})["ended"]
    once = chosen(device, sums, before={"gained": 1e8})
    assert (once["ended"], once["poor"]) == (0, 1)
    assert chosen(device, sums, before={"gained": 1.0, "poor": 1})["poor"] == 0


@pytest.mark.parametrize("along, taken, expected", [(-3.0, 1.0, 1.5), (3.0, 1.0, 0.0), (-3.0, 0.0, 0.25)])
def test_the_next_direction_is_conjugate_to_the_change(device, along, taken, expected):
    state = np.zeros(1, STRUCTS["Minimisation"])
    state["curvature"], state["taken"], state["conjugation"] = 2.0, taken, 0.25 * (taken == 0)
    state, sums = device.array(state), np.full(PARTS, along / PARTS, np.float32)
    Vectors(device, 1).launch_once("choose_conjugation", sums=device.array(sums), state=state)
    assert state.get()[0]["conjugation"] == pytest.approx(expected)


def test_what_is_chosen_follows_from_no_group_size(device, random, monkeypatch):
    """To the bit: groups of other sizes add the same numbers in the same order."""
    sums, found = np.abs(random.normal(size=(3, PARTS))) * np.array([[-1], [1], [9]]), []
    for size in (1, 16, 48, 64, 128):
        monkeypatch.setattr(device, "group_size", size)
        state = chosen(device, sums)
        on_device = device.array(state[None])
        given = device.array(-sums[1].astype(np.float32))
        Vectors(device, 1).launch_once("choose_conjugation", sums=given, state=on_device)
        found.append(on_device.get().tobytes())
    assert len(set(found)) == 1
