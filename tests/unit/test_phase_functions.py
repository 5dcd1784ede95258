"""Phase functions: integral, mean cosine, and what is said of tables that are none."""

import numpy as np
import pytest
from pydantic import TypeAdapter
from scipy.integrate import quad

from cloudtomo_cl.errors import SettingsError
from cloudtomo_cl.scene.phase import (
    DoubleHenyeyGreenstein,
    HenyeyGreenstein,
    PhaseFunction,
    TabulatedPhaseFunction,
    sphere_integral,
)

ANGLE = (0.0, 1.0, 5.0, 40.0, 90.0, 150.0, 180.0)
SHAPES = ((90.0, 60.0, 20.0, 1.0, 0.1, 0.2, 0.4), (9.0, 8.0, 5.0, 1.0, 0.1, 0.1, 0.0))
ISOTROPIC = 1 / (4 * np.pi)
TABLE = TabulatedPhaseFunction.normalised(ANGLE, SHAPES, effective_radius=(5, 10), single_scattering_albedo=(1, 0.99))
PHASE_FUNCTIONS = {
    "henyey-greenstein": HenyeyGreenstein(0.85),
    "backward": HenyeyGreenstein(-0.4),
    "isotropic": HenyeyGreenstein(0.0),
    "double": DoubleHenyeyGreenstein(0.9, -0.6, 0.95),
    "table": TABLE,
    "linear": TabulatedPhaseFunction((0, 180), (2 * ISOTROPIC, 0)),
}


def moment(phase_function, power):
    """By SciPy's adaptive quadrature, between the nodes of the table if there is one."""
    nodes = np.cos(np.radians(getattr(phase_function, "angle", (0, 10, 30, 90, 180))))[::-1]

    def integrand(cosine):
        return 2 * np.pi * phase_function.density(cosine) * cosine**power

    return sum(quad(integrand, a, b, epsabs=0, epsrel=1e-12)[0] for a, b in zip(nodes, nodes[1:]))


@pytest.mark.parametrize("name", PHASE_FUNCTIONS)
def test_integral_over_the_sphere_is_one(name):
    assert moment(PHASE_FUNCTIONS[name], 0) == pytest.approx(1, abs=1e-9)


@pytest.mark.parametrize("name", PHASE_FUNCTIONS)
def test_g_is_the_mean_cosine(name):
    assert PHASE_FUNCTIONS[name].g == pytest.approx(moment(PHASE_FUNCTIONS[name], 1), abs=1e-9)


def test_linear_table_has_an_asymmetry_of_a_third():
    assert PHASE_FUNCTIONS["linear"].g == pytest.approx(1 / 3, rel=1e-14)


def test_every_row_has_its_asymmetry():
    rows = [TabulatedPhaseFunction.normalised(ANGLE, shape).g for shape in SHAPES]
    np.testing.assert_allclose(TABLE.asymmetry(), rows, rtol=1e-14)


def test_table_holds_at_its_nodes():
    np.testing.assert_allclose(TABLE.density(np.cos(np.radians(ANGLE)), row=0), TABLE.values[0], rtol=1e-9)


def test_table_is_linear_in_the_cosine_between_its_nodes():
    cosine = (np.cos(np.radians(5.0)) + np.cos(np.radians(40.0))) / 2
    expected = (np.array(TABLE.values)[:, 2] + np.array(TABLE.values)[:, 3]) / 2
    assert [TABLE.density(cosine, row) for row in (0, 1)] == pytest.approx(list(expected), rel=1e-12)


def test_steps_of_the_cosine_keep_their_digits_in_the_forward_peak():
    angle = np.array([0.0, 1e-5, 2e-5])
    expected = np.pi * np.radians(2e-5) ** 2  # of a small spherical cap
    assert sphere_integral(angle, np.ones(3)) == pytest.approx(expected, rel=1e-12)


def test_integral_of_one_over_the_sphere_is_its_area():
    assert sphere_integral(np.linspace(0, 180, 7), np.ones((2, 7))) == pytest.approx(4 * np.pi, rel=1e-14)


def test_small_errors_of_the_integral_are_removed():
    table = TabulatedPhaseFunction((0, 90, 180), np.full(3, 1.005 * ISOTROPIC))
    np.testing.assert_allclose(table.values, ISOTROPIC, rtol=1e-15)


def test_normalised_table_is_kept_bit_by_bit():
    assert TabulatedPhaseFunction(TABLE.angle, TABLE.values, TABLE.effective_radius).values == TABLE.values


def test_arrays_lists_and_tuples_are_the_same_table():
    assert TABLE == TabulatedPhaseFunction(
        np.array(ANGLE), np.array(TABLE.values), [5, 10], single_scattering_albedo=np.array([1, 0.99])
    )


def test_table_survives_json():
    adapter = TypeAdapter(PhaseFunction)
    assert adapter.validate_json(adapter.dump_json(TABLE), strict=True) == TABLE


def test_normalised_takes_any_factor():
    assert TabulatedPhaseFunction.normalised(ANGLE, 3.7 * np.array(SHAPES[1])).g == pytest.approx(
        TABLE.asymmetry()[1], rel=1e-13
    )


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (((0, 90, 180), (1, 1, 1)), "integrates to 12.5664 .* common one to 4 pi.*TabulatedPhaseFunction.normalised"),
        (((0, 90, 180), (0.5, 0.5, 0.5)), "integral over the cosine alone is 1"),
        (((0, 90, 180), (0, 0, 0)), "integrates to 0 over the sphere; it must be 1 within 1 %"),
        (((0, 180), (1.02 * ISOTROPIC,) * 2), "integrates to 1.02 over the sphere; it must be 1"),
        (((1, 90, 180), (1, 1, 1)), "angle runs from 1 to 180 degrees: it must run from exactly 0 to exactly 180"),
        (((180, 90, 0), (1, 1, 1)), "angle runs from 180 to 0 degrees"),
        (((0, 90, 90, 180), (1, 1, 1, 1)), "angle must increase: entry 2 is 90, the one before it 90"),
        (((0, 90, 180), (1, 1)), r"values\[0\] has 2 entries: angle has 3"),
        (((0, 180), (1, 1), (5, 10)), "values has 1 rows: it must have 2"),
        (((0, 180), ((1, 1), (1, 1)), (10, 5)), "effective_radius must increase: entry 1 is 5"),
        (((0, 180), (ISOTROPIC,) * 2, (), (1, 1)), "single_scattering_albedo has 2 entries: it must have 1"),
        (((0, 180), (ISOTROPIC,) * 2, (), (1.5,)), "less than or equal to 1"),
        (((0, 180), (-1, 1)), "greater than or equal to 0"),
        (((0, 180), (1, float("nan"))), "greater than or equal to 0|finite"),
        (((0, 180), (1, float("inf"))), "finite"),
        (((0,), (1,)), "at least 2"),
    ],
)
def test_table_that_is_none_is_named(arguments, message):
    with pytest.raises(SettingsError, match=message):
        TabulatedPhaseFunction(*arguments)


def test_what_cannot_be_normalised_is_named():
    with pytest.raises(ValueError, match="cannot be normalised"):
        TabulatedPhaseFunction.normalised((0, 180), (0, 0))


def test_double_of_one_lobe_is_that_lobe():
    cosine = np.linspace(-1, 1, 11)
    np.testing.assert_allclose(
        DoubleHenyeyGreenstein(0.7, -0.3, 1.0).density(cosine), HenyeyGreenstein(0.7).density(cosine), rtol=1e-15
    )
