"""Axes of files: lengths in km that rise, whatever the file has, or a refusal that names the attribute."""

import numpy as np
import pytest
import xarray as xr

from cloudtomo_cl.errors import DataError
from cloudtomo_cl.files.axes import find_axes, read_axis

HEIGHTS = np.array([0.1, 0.2, 0.3, 0.5])


def axis(values=HEIGHTS, name="z", letter="z", spacing=None, others=None, **attributes):
    dataset = xr.Dataset(coords={name: (name, np.asarray(values, float), attributes), **(others or {})})
    return read_axis("file.nc", dataset, name, letter, spacing)


@pytest.mark.parametrize(
    ("units", "factor"),
    [("km", 1.0), ("m", 1e3), ("cm", 1e5), ("ft", 1 / 0.3048e-3), ("kilometres", 1.0), ("Metres", 1e3), (" m ", 1e3)],
)
def test_lengths_are_converted(units, factor):
    read = axis(HEIGHTS * factor, units=units)
    np.testing.assert_allclose(read.points, HEIGHTS, rtol=1e-12)
    np.testing.assert_allclose(read.edges, [0.05, 0.15, 0.25, 0.4, 0.6], rtol=1e-12)
    assert read.stated and not read.falls


def test_a_falling_axis_rises_and_says_so():
    read = axis(HEIGHTS[::-1], units="km")
    np.testing.assert_array_equal(read.points, HEIGHTS)
    assert read.falls and "turned" in read.text()


def test_without_any_unit_small_steps_are_km():
    read = axis()
    np.testing.assert_array_equal(read.points, HEIGHTS)
    assert not read.stated and "guessed" in read.text()


OTHER = {"x": ("x", [50.0, 100.0], {"units": "m"})}
REFUSED = {
    "steps of metres": ({"values": [50.0, 100.0, 150.0]}, "no units and steps of 50"),
    "units of nothing": ({"values": [50.0, 100.0], "units": ""}, "no units and steps of 50"),
    "large voxels of metres": ({"values": [5.0, 10.0, 15.0]}, "no units and steps of 5"),
    "level numbers": ({"values": [0, 1, 2, 3]}, "no units and steps of 1.*--spacing"),
    "level numbers that say so": ({"units": "level"}, "units 'level', allowed are km.*--spacing"),
    "levels by another name": ({"name": "lev"}, "lev has no units"),
    "sigma beside lengths": ({"values": [0.9, 0.89, 0.88], "others": OTHER}, "z has no units, and x has them"),
    "sigma by its long name": ({"long_name": "sigma level"}, "its long_name says 'sigma'"),
    "high": ({"values": [30.0, 30.1]}, "no units"),
    "pressure": ({"values": [900, 890], "units": "hPa"}, "z is a pressure"),
    "hybrid": ({"units": "m", "formula_terms": "a: a b: b"}, "terrain-following"),
    "sigma by its standard name": ({"units": "1", "standard_name": "atmosphere_sigma_coordinate"}, "terrain-following"),
    "depth": ({"units": "m", "standard_name": "depth"}, "standard_name 'depth'"),
    "downwards": ({"units": "km", "positive": "down"}, "positive = 'down'"),
    "sideways": ({"units": "km", "positive": "left"}, "positive = 'left'"),
    "another unit": ({"units": "K"}, "units 'K', allowed are km and m"),
    "a number for a unit": ({"units": 5}, "units '5', allowed are km and m"),
    "longitude": ({"name": "x", "letter": "x", "units": "degrees_east"}, "an angle"),
    "an angle": ({"name": "x", "letter": "x", "units": "rad"}, "an angle"),
    "repeated": ({"values": [0.1, 0.2, 0.2], "units": "km"}, "without repeating one"),
    "to and fro": ({"values": [0.1, 0.3, 0.2], "units": "km"}, "must rise or fall"),
    "missing": ({"values": [0.1, np.nan, 0.3], "units": "km"}, "missing or not finite at index 1"),
    "one point": ({"values": [0.1], "units": "km"}, "one voxel centre only"),
    "no points": ({"values": [], "units": "km"}, "no points"),
    "another spacing": ({"values": [0.1, 0.2], "units": "km", "spacing": 0.05}, "--spacing says 0.05 km along z"),
    "a spacing of neither": ({"values": [50.0, 100.0], "spacing": 0.1}, "neither in km nor in m"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_tells_no_length_is_refused(case):
    arguments, message = REFUSED[case]
    with pytest.raises(DataError, match=f"file.nc: .*{message}"):
        axis(**arguments)


def test_a_spacing_tells_the_unit():
    np.testing.assert_allclose(axis([50.0, 100.0], spacing=0.05).points, [0.05, 0.1])
    np.testing.assert_allclose(axis([0.05, 0.1], spacing=0.05).points, [0.05, 0.1])


@pytest.mark.parametrize(
    ("values", "attributes", "falls"),
    [
        ([0, 1, 2], {}, False),
        ([0, 1, 2], {"positive": "down"}, True),
        ([3, 2, 1], {}, True),
        ([3, 2, 1], {"positive": "down"}, False),
        ([1, 2, 3], {"units": "level", "positive": "up"}, False),
    ],
)
def test_level_numbers_are_voxels_of_a_spacing_that_somebody_says(values, attributes, falls):
    read = axis(values, spacing=0.04, **attributes)
    np.testing.assert_allclose(read.edges, [0, 0.04, 0.08, 0.12])
    assert read.falls == falls


@pytest.mark.parametrize("numbers", [{}, {"units": "1"}, {"units": "hPa"}])
def test_heights_of_numbered_levels_may_stand_in_another_variable(numbers):
    others = {"altitude": ("lev", HEIGHTS * 1e3, {"units": "m", "standard_name": "altitude"})}
    read = axis([1, 2, 3, 4], "lev", others=others, **numbers)
    np.testing.assert_allclose(read.points, HEIGHTS)
    assert read.source == "altitude"


def bounded(pairs, points=(0.1, 0.2, 0.3), units="km", bounds_units=None):
    attributes = {} if bounds_units is None else {"units": bounds_units}
    others = {"z_bnds": (("z", "nv"), np.asarray(pairs, float), attributes)}
    return axis(points, units=units, bounds="z_bnds", others=others)


GOOD = np.array([[0.05, 0.16], [0.16, 0.25], [0.25, 0.4]])


@pytest.mark.parametrize(
    ("pairs", "arguments"),
    [
        (GOOD, {}),
        (GOOD[:, ::-1], {}),
        (GOOD * 1e3, {"bounds_units": "m"}),
        (GOOD * 1e3, {"points": (100, 200, 300), "units": "m"}),
        (GOOD[::-1], {"points": (0.3, 0.2, 0.1)}),
    ],
)
def test_bounds_are_edges(pairs, arguments):
    np.testing.assert_allclose(bounded(pairs, **arguments).edges, [0.05, 0.16, 0.25, 0.4], rtol=1e-12)


@pytest.mark.parametrize(
    ("pairs", "arguments", "message"),
    [
        (GOOD * 1e3, {}, "50 to 160 km at 0.1 km: they must hold their points"),
        (GOOD * [0, 1e3], {}, "must hold their points, as wide as these are apart"),
        (GOOD + 0.1, {}, "must hold their points"),
        (GOOD + [0.01, -0.01], {}, "leave gaps or overlap"),
        (np.where(GOOD == 0.16, np.nan, GOOD), {}, "must hold their points"),
        (GOOD, {"bounds_units": "hPa"}, "z_bnds, the bounds of z, has units 'hPa'"),
        (np.ones((3, 4)), {}, "must have two numbers for each of its points"),
    ],
)
def test_bounds_that_do_not_hold_their_points_are_refused(pairs, arguments, message):
    with pytest.raises(DataError, match=message):
        bounded(pairs, **arguments)


@pytest.mark.parametrize(
    ("names", "attributes"),
    [
        (("x", "y", "z"), {}),
        (("west_east", "south_north", "bottom_top"), {}),
        (("xt", "yt", "zt"), {}),
        (("a", "b", "c"), {"a": {"axis": "X"}, "b": {"axis": "Y"}, "c": {"axis": "Z"}}),
        (
            ("a", "b", "c"),
            {"a": {"standard_name": "grid_longitude"}, "b": {"units": "degrees_north"}, "c": {"positive": "up"}},
        ),
        # Attributes count more than names.
        (("y", "x", "z"), {"y": {"axis": "X"}, "x": {"axis": "Y"}}),
        (("ni", "nj", "lev"), {}),
    ],
)
def test_axes_are_found(names, attributes):
    dataset = xr.Dataset({"v": (names, np.zeros((2, 2, 2)))})
    dataset = dataset.assign_coords({name: (name, [0.0, 1.0], given) for name, given in attributes.items()})
    assert find_axes("file.nc", dataset, dataset["v"]) == dict(zip("xyz", names))


@pytest.mark.parametrize(
    ("names", "message"),
    [(("a", "y", "z"), "not known as x, y and z"), (("x", "zt", "zm"), "zt and zm are both along z")],
)
def test_axes_that_are_not_known_are_named(names, message):
    dataset = xr.Dataset({"v": (names, np.zeros((2, 2, 2)))})
    with pytest.raises(DataError, match=message):
        find_axes("file.nc", dataset, dataset["v"])
