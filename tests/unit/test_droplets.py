"""Extinction of liquid water in droplets."""

from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

from cloudtomo_cl.errors import DataError
from cloudtomo_cl.scene.droplets import DropletTable, extinction_from_water
from cloudtomo_cl.scene.phase import TabulatedPhaseFunction
from cloudtomo_cl.scene.water import water_refractive_index

FUNCTION = TabulatedPhaseFunction((0, 180), np.full((2, 2), 1 / (4 * np.pi)), (5.0, 15.0))
TABLE = DropletTable(FUNCTION, (2.4, 2.2), 672.0, 0.1, 1.331, 2e-8)


def test_large_droplets_are_in_the_geometric_limit():
    # By hand: 1 g in droplets of 10 um radius; volume 1e-6 m^3, cross-section 3/4 V / r = 0.075 m^2, twice.
    assert extinction_from_water(1.0, 10.0) == pytest.approx(150.0)


def test_the_table_gives_the_efficiency_between_its_radii():
    assert extinction_from_water(1.0, 10.0, TABLE) == pytest.approx(150.0 * 2.3 / 2)


def test_the_table_at_its_radii_is_its_mass_extinction():
    expected = 0.3 * TABLE.mass_extinction * 1e3  # m^-1 to km^-1
    np.testing.assert_allclose(extinction_from_water(0.3, np.array([5.0, 15.0]), TABLE), expected, rtol=1e-14)


def test_air_without_water_needs_no_radius():
    extinction = extinction_from_water(np.array([0.0, 0.2]), np.array([np.nan, 6.0]), TABLE)
    assert extinction[0] == 0 and extinction[1] > 0


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((-0.1, 10.0), "liquid_water_content must be finite and at least 0"),
        ((np.nan, 10.0), "liquid_water_content must be finite"),
        ((0.1, 0.0), "effective_radius must be finite and greater than 0"),
        ((0.1, 20.0, TABLE), "effective_radius is 20 to 20 micrometres, the table has 5 to 15"),
    ],
)
def test_what_is_impossible_is_named(arguments, message):
    with pytest.raises(DataError, match=message):
        extinction_from_water(*arguments)


@pytest.mark.parametrize(
    ("wavelength", "index", "real_error", "relative_imaginary_error"),
    [
        # Not Hale and Querry's: IAPWS R9-97 at 25 degrees C and 0.1 MPa, 589.0 nm and 632.8 nm.
        (589.0, 1.33251, 6e-4, np.inf),
        (632.8, 1.33143, 6e-4, np.inf),
        # Pope and Fry 1997: water absorbs 0.340 m^-1 at 650 nm, which is 4 pi k / wavelength.
        (650.0, 1.331 - 1j * 0.340 * 650e-9 / (4 * np.pi), 6e-4, 0.1),
        # Kedenburg et al. 2012 (Opt. Mat. Express 2, 1588), at 20 degrees C: windows and the band between.
        (1060.0, 1.3243 - 1.248e-6j, 3e-3, 0.15),
        (1240.0, 1.3221 - 1.135e-5j, 3e-3, 0.15),
        (1300.0, 1.3212 - 1.376e-5j, 3e-3, 0.15),
        (1450.0, 1.3186 - 3.208e-4j, 3e-3, 0.15),
        (1650.0, 1.3145 - 8.101e-5j, 3e-3, 0.15),
    ],
)
def test_water_is_water(wavelength, index, real_error, relative_imaginary_error):
    found = water_refractive_index(wavelength)
    assert found.real == pytest.approx(index.real, abs=real_error)
    if np.isfinite(relative_imaginary_error):
        assert found.imag == pytest.approx(index.imag, rel=relative_imaginary_error)


def test_water_between_its_bands_absorbs_as_segelstein_has_it():
    """The table that miepython ships is another copy of Segelstein's."""
    # Not imported: before mie.py does it would be without its compiled code, for all tests after this one.
    found = find_spec("miepython")
    if found is None:
        pytest.skip("miepython is not installed")
    table = np.loadtxt(Path(found.origin).parent / "data" / "segelstein81_index.txt", skiprows=4)
    table = table[(table[:, 0] >= 1.0) & (table[:, 0] <= 2.4001)]
    found = [-water_refractive_index(wavelength * 1e3).imag for wavelength in table[:, 0]]
    np.testing.assert_allclose(found, table[:, 2], rtol=1e-9)


def test_water_far_in_the_infrared_needs_an_index():
    with pytest.raises(DataError, match="10000 nm: water's refractive index is known from 200 to 4000 nm"):
        water_refractive_index(10000.0)
