"""Images, rays and stored settings as other programs may write them: read right, or refused."""

import json
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from cloudtomo_cl.commands.cli import main
from cloudtomo_cl.errors import DataError, SettingsError
from cloudtomo_cl.files.measurements import measurements_dataset, read_measurements, read_rays
from cloudtomo_cl.files.stored_settings import read_settings
from cloudtomo_cl.scene.measurements import Measurements
from cloudtomo_cl.scene.sensors import OrthographicView, PerspectiveView, RayView
from cloudtomo_cl.settings.stored import noise_of_table, scene_of_tables

VIEWS = (
    OrthographicView(width=1.2, zenith=40.0, azimuth=90.0, pixels=(5, 4)),
    PerspectiveView(position=(0.4, 0.4, 2.9), target=(0.4, 0.4, 0.4), field_of_view=30.0, pixels=(5, 4)),
    RayView(np.full((6, 3), 0.5), np.tile([0.0, 0.6, -0.8], (6, 1)), (3, 2)),
)
DIMS = ("view", "row", "column")


def images():
    generator = np.random.default_rng(4)
    arrays = tuple(generator.uniform(0.05, 0.2, view.pixels[::-1]) for view in VIEWS)
    errors = tuple(0.01 * array for array in arrays)
    return Measurements(VIEWS, arrays, errors, (0.02, 0.0, 0.0), (0.5, 0.0, 1.0), (0.0, 0.0, 0.02))


def dataset():
    return measurements_dataset(images())


def assert_same(read):
    expected = images()
    for view, other in zip(read.views, expected.views):
        assert view.type == other.type and view.pixels == other.pixels
        if isinstance(view, RayView):
            np.testing.assert_allclose(view.origins, other.origins)
            np.testing.assert_allclose(view.directions, other.directions)
        else:
            for name in ("width", "position", "target", "zenith", "azimuth", "field_of_view"):
                value = getattr(view, name, None)
                assert value is None or value == pytest.approx(getattr(other, name), rel=1e-12)
    for name in ("images", "standard_errors"):
        for array, other in zip(getattr(read, name), getattr(expected, name)):
            np.testing.assert_allclose(array, other, rtol=1e-12)
    for name in ("calibration_errors", "pointing_errors", "position_errors"):
        assert getattr(read, name) == pytest.approx(getattr(expected, name))


def scaled(data, name, factor, units):
    attributes = {} if units is None else {"units": units}
    return data.assign({name: (data[name].dims, data[name].values * factor, attributes)})


@pytest.mark.parametrize(
    ("name", "factor", "units"),
    [
        *((name, 1e3, "m") for name in ("position", "target", "width", "ray_origin")),
        ("position", 1 / 0.3048e-3, "feet"),
        ("width", 1e5, "cm"),
        *((name, np.pi / 180, "radian") for name in ("zenith", "azimuth", "field_of_view")),
        ("radiance", 1e3, "mW m^-2 sr^-1"),
        ("radiance", 1.0, "W m^-2 sr^-1"),
        ("radiance", 1.0, "W/(m^2 sr)"),
        ("radiance", 0.1, "mW/cm2/sr"),
        ("radiance_standard_error", 1e3, "mW m-2 sr-1"),
        ("calibration_error", 100.0, "%"),
        ("calibration_error", 100.0, "percent"),
        ("pointing_error", np.pi / 180, "radian"),
        ("position_error", 1e3, "m"),
    ],
)
def test_units_of_every_field_are_converted(name, factor, units):
    assert_same(read_measurements(scaled(dataset(), name, factor, units)))


@pytest.mark.parametrize(
    ("name", "units", "message"),
    [
        ("position", "degrees", "position has units 'degrees', allowed are km"),
        ("zenith", "km", "zenith has units 'km', allowed are degree"),
        ("radiance", "W m-2 sr-1 um-1", "width of its band"),
        ("radiance", "W m-2 sr-1 nm-1", "width of its band"),
        ("radiance", "1", "a reflectance factor R is the radiance R mu0 F0 / pi"),
        ("radiance", "W m-2", "allowed are W m-2 sr-1"),
        ("radiance", 5, "allowed are W m-2 sr-1"),
        ("calibration_error", "km", "allowed are 1"),
        ("pointing_error", "km", "allowed are degree"),
        ("pointing_error", None, "pointing_error has no units"),
        ("position_error", None, "position_error has no units"),
    ],
)
def test_units_of_something_else_are_refused(name, units, message):
    with pytest.raises(DataError, match=message):
        read_measurements(scaled(dataset(), name, 1.0, units))


@pytest.mark.parametrize("dimension", ["row", "column"])
def test_rows_and_columns_come_in_the_order_of_their_numbers(dimension):
    assert_same(read_measurements(dataset().isel({dimension: slice(None, None, -1)})))
    numbers = np.arange(1, dataset().sizes[dimension] + 1)
    assert_same(read_measurements(dataset().assign_coords({dimension: numbers})))


def test_rows_from_the_bottom_are_turned():
    first = dataset().isel(view=[0, 1])
    data = first.isel(row=slice(None, None, -1)).assign_coords(row=("row", np.arange(4), {"positive": "up"}))
    np.testing.assert_array_equal(read_measurements(data).images[0], images().images[0])


@pytest.mark.parametrize("numbers", [[0, 1, 1, 2], [0, 2, 4, 6], [0.1, 0.2, 0.3, 0.4], [0, 1, np.nan, 3]])
def test_rows_whose_coordinate_does_not_number_them_are_refused(numbers):
    with pytest.raises(DataError, match="row"):
        read_measurements(dataset().assign_coords(row=("row", numbers)))


def test_components_of_vectors_come_by_their_names():
    assert_same(read_measurements(dataset().isel(axis=[2, 0, 1])))
    assert_same(read_measurements(dataset().drop_vars("component")))
    older = dataset().drop_vars("component").assign_coords(axis=("axis", ["x", "y", "z"]))
    assert_same(read_measurements(older.isel(axis=[2, 0, 1])))
    for name in ("component", "axis"):
        with pytest.raises(DataError, match=f"{name} must name x, y and z, is east, north, up"):
            read_measurements(dataset().drop_vars("component").assign_coords({name: ("axis", ["east", "north", "up"])}))
    turned = {"origin": (("ray", "axis"), [[2.0, 0.1, 0.2]]), "direction": (("ray", "axis"), [[-1.0, 0.0, 0.0]])}
    rays = xr.Dataset(turned, {"axis": ("axis", ["z", "x", "y"])})
    assert read_rays(rays) == RayView([(0.1, 0.2, 2.0)], [(0, 0, -1)], (1, 1))


def flags(values, **attributes):
    data = dataset()
    given = np.ones(data.radiance.shape, np.asarray(values).dtype)
    given[0, 1, 2] = values
    return data.assign(valid=(DIMS, given, attributes))


@pytest.mark.parametrize(
    ("values", "attributes"),
    [
        (np.int8(0), {}),
        (np.bool_(False), {}),
        (np.int8(0), {"_FillValue": np.int8(0)}),
        (np.int8(-1), {"missing_value": np.int8(-1)}),
        (np.float32(np.nan), {}),
        (np.int8(0), {"flag_values": [0, 1], "flag_meanings": "bad good"}),
    ],
)
def test_a_pixel_that_is_not_valid_is_bad(values, attributes):
    read = read_measurements(flags(values, **attributes))
    assert read.invalid_pixels == 1 and np.isnan(read.images[0][1, 2])


@pytest.mark.parametrize(
    ("values", "attributes", "message"),
    [
        (np.int8(3), {}, "valid holds 3: it must be 1 in good pixels"),
        (np.int8(0), {"flag_values": [0, 1], "flag_meanings": "good bad"}, "valid calls 0 'good'"),
    ],
)
def test_flags_that_mean_something_else_are_refused(values, attributes, message):
    with pytest.raises(DataError, match=message):
        read_measurements(flags(values, **attributes))


@pytest.mark.parametrize(
    ("value", "attributes"),
    [(np.nan, {}), (-999.0, {"missing_value": -999.0}), (9.969209968386869e36, {}), (50.0, {"valid_max": 10.0})],
)
def test_a_missing_radiance_is_a_bad_pixel(value, attributes):
    data = dataset()
    data.radiance.values[1, 2, 3] = value
    data.radiance.attrs.update(attributes)
    read = read_measurements(data)
    assert read.invalid_pixels == 1 and np.isnan(read.images[1][2, 3])


@pytest.mark.parametrize("value", [-999.0, -1.0, -9999.0, 1e20, -0.5])
@pytest.mark.parametrize("known", [True, False])
def test_a_mark_for_bad_pixels_that_no_attribute_tells_is_refused(value, known):
    data = dataset()
    data.radiance.values[1, 2, 3] = value
    if not known:
        data["radiance_standard_error"] = xr.zeros_like(data.radiance_standard_error).assign_attrs(units="W m-2 sr-1")
    with pytest.raises(DataError, match="radiance of view 1 at row 2, column 3 is .*_FillValue"):
        read_measurements(data)


def test_a_radiance_far_below_its_noise_is_refused():
    data = dataset()
    data.radiance.values[1, 2, 3] = -0.1
    with pytest.raises(DataError, match="row 2, column 3 is -0.1 .*no noise"):
        read_measurements(data)


def test_noise_below_zero_is_read():
    data = dataset()
    data.radiance.values[1, 2, 3], data.radiance_standard_error.values[1, 2, 3] = -0.02, 0.01
    assert read_measurements(data).images[1][2, 3] == -0.02


def test_a_field_that_is_missing_in_part_is_refused():
    data = dataset()
    data.position.values[1, 2] = np.nan
    with pytest.raises(DataError, match="position of view 1 is missing in part"):
        read_measurements(data)


def test_masked_pixels_of_arrays_are_bad():
    view = VIEWS[0]
    image = np.ma.masked_array(np.full((4, 5), 0.1), np.arange(20).reshape(4, 5) == 7)
    read = Measurements((view,), (image,), (np.zeros((4, 5)),))
    assert read.invalid_pixels == 1 and np.isnan(read.images[0][1, 2]) and type(read.images[0]) is np.ndarray


# ---- stored settings


@pytest.mark.parametrize(
    ("stored", "message"),
    [
        ({"seed": "x"}, "seed = 'x': it must be a valid integer"),
        ({"seed": -1}, "seed = -1"),
        ({"seed": 2**40}, "seed = 1099511627776"),
        ({"seed": 1.5}, "seed = 1.5"),
        ({"seed": True}, "seed = True"),
        ({"samples": None}, "samples = None"),
        ({"samples": 0}, "samples = 0"),
        ({"samples": "64"}, "samples = '64'"),
        ({"stream": 2**40}, "stream = 1099511627776"),
        ({"iteration": 2**40}, "iteration = 1099511627776"),
        ({"target_error": -1.0}, "target_error = -1.0"),
        ({"photons": "many"}, "photons = 'many'"),
        ({"cloud_file": 5}, "cloud_file = 5"),
    ],
)
def test_stored_settings_are_checked(stored, message):
    data = dataset().assign_attrs(settings=json.dumps(stored))
    with pytest.raises(SettingsError, match=message):
        read_settings(data)


@pytest.mark.parametrize("text", ['{"seed": ' + "9" * 5000 + "}", '{"a": ' + "[" * 100_000, "\ufeff{}", "{'seed': 1}"])
def test_stored_settings_that_are_none_are_named(text):
    with pytest.raises(DataError, match="the attribute settings is not a JSON table"):
        read_settings(dataset().assign_attrs(settings=text))


SCENE = {
    "grid": {"shape": [2, 2, 2], "spacing": [0.1, 0.1, 0.1]},
    "sun": {"zenith": 30.0},
    "cloud": {"phase_function": {"type": "henyey-greenstein", "g": 0.85}},
}


@pytest.mark.parametrize(
    ("table", "key", "value", "message"),
    [
        ("sun", "zenith", "60", "sun.zenith must be a number"),
        ("sun", "zenith", None, "sun.zenith must be a number"),
        ("sun", "zenith", True, "sun.zenith must be a number"),
        ("sun", "zenith", float("nan"), "sun.zenith must be"),
        ("grid", "shape", [2, 2, 2.5], r"grid.shape\[2\] must be an integer"),
        ("cloud", "colour", 1, "cloud.colour is no known key"),
    ],
)
def test_a_stored_scene_is_checked_as_strictly_as_toml(table, key, value, message):
    scene = {**SCENE, table: {**SCENE[table], key: value}}
    assert scene_of_tables(Path("images.nc"), SCENE).sun.zenith == 30.0
    with pytest.raises(SettingsError, match=f"images.nc: {message}"):
        scene_of_tables(Path("images.nc"), scene)


def test_stored_noise_is_checked_as_strictly_as_toml():
    assert noise_of_table(Path("images.nc"), {"full_well": 20000}).full_well == 20000
    with pytest.raises(SettingsError, match="noise: full_well must be a number"):
        noise_of_table(Path("images.nc"), {"full_well": "20000"})


@pytest.mark.parametrize(
    ("name", "factor", "message"),
    [
        ("position", 1e3, "position has no units, and its largest number is"),
        ("width", 1e3, "width has no units, and its largest number is"),
        ("zenith", np.pi / 180, "zenith has no units, and its largest number is"),
        ("field_of_view", np.pi / 180, "field_of_view has no units"),
        ("radiance", 1e3, "radiance has no units, and radiance_standard_error is in"),
        ("radiance_standard_error", 1e3, "radiance_standard_error has no units, and radiance is in"),
    ],
)
def test_a_field_without_units_is_ours_only_where_it_can_be_nothing_else(name, factor, message):
    for units in ({}, {"units": ""}):
        data = dataset()
        with pytest.raises(DataError, match=message):
            read_measurements(data.assign({name: (data[name].dims, data[name].values * factor, units)}))
    if "radiance" not in name:
        data[name].attrs.clear()
        assert_same(read_measurements(data))


def test_a_field_without_units_beside_others_in_metres_is_refused():
    data = scaled(dataset(), "position", 1e3, "m")
    data.target.attrs.clear()
    with pytest.raises(DataError, match="target has no units, and position has others than km"):
        read_measurements(data)


def test_errors_without_units_that_are_larger_than_the_radiances_are_refused():
    data = dataset()
    data = data.assign(radiance_standard_error=data.radiance_standard_error * 1e3)
    for name in ("radiance", "radiance_standard_error"):
        data[name].attrs.clear()
    with pytest.raises(DataError, match="the errors are larger than the radiances"):
        read_measurements(data)


@pytest.mark.parametrize("mark", [-999.0, -9999.0, 1e20])
def test_a_mark_for_a_key_that_a_view_does_not_have_is_refused(mark):
    data = dataset()
    data.up.values[:] = mark
    with pytest.raises(DataError, match="up has .*_FillValue"):
        read_measurements(data)
    assert_same(read_measurements(data.assign(up=(data.up.dims, data.up.values, {"missing_value": mark}))))


@pytest.mark.parametrize("rays", [slice(0, 5), [0, 0, 1, 2, 3, 4, 5]])
def test_as_many_rays_as_pixels_are_needed(rays):
    with pytest.raises(DataError, match="rays for 6 pixels of the views of type rays"):
        read_measurements(dataset().isel(ray=rays))


def test_names_of_views_may_be_characters_without_an_encoding():
    data = dataset()
    kinds = np.array([kind.ljust(14).encode() for kind in data.view_type.values])
    assert_same(read_measurements(data.assign(view_type=("view", kinds))))


def test_damaged_settings_of_images_are_not_passed_over(tmp_path, capsys):
    """Images from elsewhere have none; those that have some may not lose the scene that they were made with."""
    dataset().assign_attrs(settings='{"scene": ').to_netcdf(tmp_path / "images.nc")
    (tmp_path / "run.toml").write_text('[measurements]\nfile = "images.nc"\n[sun]\nzenith = 30.0\n')
    command = ["reconstruct", str(tmp_path / "run.toml"), "--output", str(tmp_path / "run")]
    assert main(command) == 2
    assert "the attribute settings is not a JSON table" in capsys.readouterr().err
    assert read_settings(dataset(), required=False) == {}


@pytest.mark.parametrize("run", ["x", 5, [1]])
def test_a_stored_run_that_is_no_table_is_named(tmp_path, capsys, run):
    stored = {"reconstruct": {"run": run}, "seed": 1}
    dataset().assign_attrs(settings=json.dumps(stored)).to_netcdf(tmp_path / "reconstruction.nc")
    command = ["reconstruct", str(tmp_path / "reconstruction.nc"), "--output", str(tmp_path / "run")]
    assert main(command) == 2
    assert "stores run = " in capsys.readouterr().err and not (tmp_path / "run").exists()
