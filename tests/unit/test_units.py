"""Units in the spellings of files become what pint and UDUNITS-2 say they are, or are not understood at all."""

import numpy as np
import pytest

from cloudtomo_cl.files.units import (
    ANGLE,
    INVERSE_LENGTH,
    LENGTH,
    MASS_DENSITY,
    NUMBER,
    PRESSURE,
    RADIANCE,
    parse_unit,
)

# Factors to m, kg, s, rad, sr: of pint 0.25.3 (with cf_xarray's rewriting) and cf-units 3.3.1, which agree.
KNOWN = {
    INVERSE_LENGTH: {
        **dict.fromkeys(("km-1", "km^-1", "km**-1", "1/km", "per km", "/km", "km⁻¹", "km^(-1)"), 1e-3),
        **dict.fromkeys(("m-1", "m^-1", "1/m", "meter-1"), 1.0),
        "Mm-1": 1e-6,
    },
    MASS_DENSITY: {
        **dict.fromkeys(("g m-3", "g/m3", "g/m^3", "g/m**3", "g m^-3", "g.m-3", "g m⁻³", "g·m⁻³", "gm-3"), 1e-3),
        **dict.fromkeys(("kg m-3", "kg/m^3", "kg m**-3", "kilogram meter-3"), 1.0),
        "mg/m3": 1e-6,
        "g cm-3": 1e3,
        "1e-3 kg m-3": 1e-3,
    },
    NUMBER: {**dict.fromkeys(("g kg-1", "g/kg"), 1e-3), **dict.fromkeys(("kg/kg", "kg kg**-1", "1"), 1.0), "%": 0.01},
    RADIANCE: {
        **dict.fromkeys(("W m-2 sr-1", "W m^-2 sr^-1", "W/(m^2 sr)", "W/m2/sr", "W / (m^2 * sr)"), 1.0),
        "mW cm-2 sr-1": 10.0,
        "mW m-2 sr-1": 1e-3,
    },
    LENGTH: {
        **dict.fromkeys(("um", "micron", "microns", "micrometers", "µm", "μm", "micrometre"), 1e-6),
        **dict.fromkeys(("m", "meters", "Metre", "metres", "[m]"), 1.0),
        **dict.fromkeys(("km", "KM", "Km", "kilometers", "kilometre", "1000 m"), 1e3),
        **dict.fromkeys(("ft", "feet", "foot"), 0.3048),
        "cm": 1e-2,
        "nm": 1e-9,
    },
    PRESSURE: {"hPa": 100.0, "mbar": 100.0, "Pa": 1.0},
    ANGLE: {**dict.fromkeys(("degree", "degrees", "deg", "°"), np.pi / 180), "radians": 1.0, "rad": 1.0},
}


@pytest.mark.parametrize(
    ("text", "dimension", "factor"),
    [(text, dimension, factor) for dimension, texts in KNOWN.items() for text, factor in texts.items()],
)
def test_a_unit_is_what_it_says(text, dimension, factor):
    unit = parse_unit(text)
    assert unit is not None and unit.dimension == dimension
    assert unit.factor == pytest.approx(factor, rel=1e-12)


@pytest.mark.parametrize("text", ["W m-2 sr-1 um-1", "m-1 sr-1", "m s-1", "kg m-2", "m2 g-1"])
def test_a_unit_of_something_else_has_another_dimension(text):
    unit = parse_unit(text)
    assert unit is not None and unit.dimension not in KNOWN


@pytest.mark.parametrize(
    "text",
    ["", " ", "K", "Re", "h", "level", "layer", "count", "degrees_north", "days since 2000-01-01", "M", "g/m3/", "m--1",
     "(", "m(", "^2", "m^", "-1", "dBZ", "mile", "x" * 5000, "m" + "^9" * 200, None, 5, [1, 2], "km-99999"],
)  # fmt: skip
def test_what_is_not_known_is_not_guessed(text):
    assert parse_unit(text) is None
