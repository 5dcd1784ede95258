"""Sun and molecules: directions by hand, optical depths from first principles."""

import numpy as np
import pytest

from cloudtomo_cl.scene.grid import Grid
from cloudtomo_cl.scene.scene import Air, Sun, rayleigh_optical_depth


@pytest.mark.parametrize(
    ("zenith", "azimuth", "direction"),
    [(0, 0, (0, 0, 1)), (30, 0, (0.5, 0, 0.75**0.5)), (30, 90, (0, 0.5, 0.75**0.5)), (60, 180, (-(0.75**0.5), 0, 0.5))],
)
def test_the_sun_stands_where_its_angles_say(zenith, azimuth, direction):
    np.testing.assert_allclose(Sun(zenith=zenith, azimuth=azimuth).direction, direction, atol=1e-12)


def first_principles(wavelength):
    """Rayleigh optical depth by refractive index, depolarisation and the column's molecules, as Bodhaine et al. (1999),
    Secs. 3 and 4, have it: their Eq. 30 is a fit to this. Lengths in cm; 360 ppm of CO2, 45 degrees of latitude."""
    w = (wavelength / 1000) ** -2  # um^-2
    # Peck and Reeder 1972, at 300 ppm.
    refractivity = 1e-8 * (8060.51 + 2480990 / (132.274 - w) + 17455.7 / (39.32957 - w)) * (1 + 0.54 * 6e-5)
    square = (1 + refractivity) ** 2
    # Bates 1984: N2, O2, Ar, CO2, by their shares of the volume.
    factors = 1.034 + 3.17e-4 * w, 1.096 + 1.385e-3 * w + 1.448e-4 * w**2, 1.0, 1.15
    king = np.average(factors, weights=(78.084, 20.946, 0.934, 0.036))
    cross_section = 24 * np.pi**3 * (square - 1) ** 2 / (square + 2) ** 2 * king
    cross_section /= (wavelength * 1e-7) ** 4 * 2.546899e19**2
    molar_mass, gravity = 28.9595 + 15.0556 * 3.6e-4, 978.916
    return cross_section * 1013250 * 6.0221367e23 / (molar_mass * gravity)


@pytest.mark.parametrize("wavelength", [250, 300, 440, 550, 670, 850])
def test_rayleigh_optical_depth_is_that_of_first_principles(wavelength):
    """The fit's own error: 0.01 % from 250 to 850 nm, say its authors."""
    assert rayleigh_optical_depth(wavelength) == pytest.approx(first_principles(wavelength), rel=3e-4)


def test_values_of_air_without_levels_are_of_layers_of_equal_height():
    """On whatever layers the grid has, also those of a coarser stage."""
    air = Air(extinction=(1.0, 2.0, 3.0))
    assert np.allclose(air.profile(Grid((2, 2, 6), (0.1, 0.1, 0.1))), [1, 1, 2, 2, 3, 3])
    assert np.allclose(air.profile(Grid((2, 2, 2), (0.1, 0.1, 0.3))), [4 / 3, 8 / 3])
