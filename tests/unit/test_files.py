"""Files: what is written comes back the same, and unfit files are named as such."""

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from cloudtomo_cl.errors import DataError
from cloudtomo_cl.files.extinction import read_extinction, write_extinction
from cloudtomo_cl.files.measurements import read_measurements, read_rays, write_measurements, write_rays
from cloudtomo_cl.files.stored_settings import read_settings
from cloudtomo_cl.scene.grid import Grid
from cloudtomo_cl.scene.measurements import Measurements
from cloudtomo_cl.scene.sensors import OrthographicView, PerspectiveView, PushBroomView, RadiometerView, RayView

GRID = Grid(shape=(3, 4, 5), spacing=(0.02, 0.02, 0.04))


def some_extinction(grid=GRID, seed=0):
    return np.random.default_rng(seed).uniform(0.0, 100.0, grid.shape).astype(np.float32)


def some_measurements():
    generator = np.random.default_rng(1)
    views = (
        PerspectiveView(position=(0.1, 0.2, 1 / 3), target=(0.3, 0.1, 0.0), field_of_view=100 / 3, pixels=(3, 2)),
        OrthographicView(width=0.7, zenith=100 / 3, azimuth=12.0, pixels=(2, 4)),
        OrthographicView(
            width=0.1, position=(0.0, 0.0, 2.0), target=(0.0, 0.0, 1.0), up=(1.0, 0.1, 0.0), pixels=(1, 1)
        ),
    )
    images = tuple(generator.uniform(size=view.pixels[::-1]) for view in views)
    return Measurements(views, images, tuple(0.1 * image for image in images))


def dataset(extinction=None, grid=GRID, unit="km", factor=1.0, dtype=np.float64):
    extinction = some_extinction(grid) if extinction is None else extinction
    coordinates = {
        name: (name, (grid.centres(axis) * factor).astype(dtype), {"units": unit}) for axis, name in enumerate("xyz")
    }
    return xr.Dataset({"extinction": (("x", "y", "z"), extinction, {"units": "km-1"})}, coordinates)


@pytest.mark.parametrize(
    "grid",
    [
        GRID,
        Grid(shape=(3, 4, 5), spacing=(0.1 / 3, 0.02, 0.04), origin=(1.2, -0.3, 0.7)),
        Grid(shape=(1, 1, 7), spacing=(0.5, 0.25, 0.04), origin=(0.1, 0.0, 0.0)),
    ],
)
def test_extinction_comes_back_with_its_grid(tmp_path, grid):
    extinction = some_extinction(grid)
    write_extinction(tmp_path / "cloud.nc", grid, extinction)
    grid_read, extinction_read = read_extinction(tmp_path / "cloud.nc")
    np.testing.assert_array_equal(extinction_read, extinction)
    assert grid_read.shape == grid.shape
    np.testing.assert_allclose(grid_read.spacing, grid.spacing, rtol=1e-14)
    np.testing.assert_allclose(grid_read.origin, grid.origin, rtol=1e-14)


def test_metres_mean_the_same_as_kilometres(tmp_path):
    values = some_extinction()
    data = dataset(values / 1e3, unit="m", factor=1e3, dtype=np.float32)
    data.extinction.attrs["units"] = "m-1"
    data.to_netcdf(tmp_path / "metres.nc")
    grid, extinction = read_extinction(tmp_path / "metres.nc")
    assert grid == GRID
    np.testing.assert_allclose(extinction, values, rtol=1e-6)


def test_dimensions_in_another_order_are_transposed(tmp_path):
    dataset().transpose("z", "y", "x").to_netcdf(tmp_path / "zyx.nc")
    np.testing.assert_array_equal(read_extinction(tmp_path / "zyx.nc")[1], some_extinction())


@pytest.mark.parametrize("axis", ["x", "y", "z"])
def test_a_falling_axis_is_turned(axis):
    turned = dataset().isel({axis: slice(None, None, -1)})
    grid, extinction = read_extinction(turned)
    assert grid == GRID
    np.testing.assert_array_equal(extinction, some_extinction())


def test_a_domain_starts_half_a_voxel_below_its_first_centre(tmp_path):
    data = dataset()
    data.assign_coords(z=data.z + 0.4).to_netcdf(tmp_path / "lifted.nc")
    assert read_extinction(tmp_path / "lifted.nc")[0].origin == (0.0, 0.0, 0.4)


def test_an_origin_within_rounding_of_zero_is_exactly_zero(tmp_path):
    dataset(dtype=np.float32).to_netcdf(tmp_path / "single.nc")
    grid = read_extinction(tmp_path / "single.nc")[0]
    assert grid.origin == (0.0, 0.0, 0.0)
    assert grid.spacing == GRID.spacing


def test_the_file_follows_the_conventions(tmp_path):
    write_extinction(tmp_path / "cloud.nc", GRID, some_extinction(), {"source": "a test", "settings": {"seed": 1}})
    with xr.open_dataset(tmp_path / "cloud.nc") as data:
        assert data.attrs["Conventions"].startswith("CF-")
        assert data.attrs["source"] == "a test"
        assert data.attrs["settings"] == '{"seed": 1}'
        assert data.extinction.attrs["units"] == "km-1"
        assert "long_name" in data.extinction.attrs
        assert all(data[axis].attrs["units"] == "km" for axis in "xyz")


def changed(what):
    """A dataset with one thing wrong."""
    values = some_extinction()
    if what in ("nan", "inf", "negative"):
        values[1, 2, 3] = {"nan": np.nan, "inf": np.inf, "negative": -1.0}[what]
    data = dataset(np.zeros_like(values) if what == "zeros" else values)
    if what == "name":
        return data.rename(extinction="beta")
    if what == "coordinate":
        return data.drop_vars("y")
    if what == "dims":
        return data.rename(x="longitude")
    if what == "time":
        return data.expand_dims(time=2)
    if what == "stretched":
        return data.assign_coords(z=data.z * np.array([1.0, 1.0, 1.0, 1.0, 1.1]))
    if what == "single":
        return data.isel(x=slice(0, 1))
    if what == "underground":
        return data.assign_coords(z=data.z - 1.0)
    if what == "unit":
        data.x.attrs["units"] = "degrees_east"
    if what == "extinction unit":
        data.extinction.attrs["units"] = "g m-3"
    if what == "text":
        data["extinction"] = (("x", "y", "z"), np.full(data.extinction.shape, "cloud", dtype=object))
    return data


@pytest.mark.parametrize(
    ("what", "text"),
    [
        ("nan", r"extinction at voxel \(1, 2, 3\) is nan"),
        ("inf", r"extinction at voxel \(1, 2, 3\) is inf"),
        ("negative", r"extinction at voxel \(1, 2, 3\) is -1"),
        ("zeros", "zero in every voxel"),
        ("name", r"no variable extinction\(x, y, z\); the file has beta"),
        ("coordinate", r"no variable y\(y\)"),
        ("dims", r"extinction has dimensions \(longitude, y, z\)"),
        ("time", r"extinction has dimensions \(time, x, y, z\)"),
        ("stretched", "z is not uniform"),
        ("single", "x has one voxel centre only"),
        ("underground", "z must be at least 0"),
        ("unit", "x has units 'degrees_east', an angle, allowed are km and m"),
        ("extinction unit", "extinction has units 'g m-3', allowed are km-1"),
        ("text", "it must hold numbers"),
    ],
)
def test_unfit_extinction_is_named(tmp_path, what, text):
    path = tmp_path / "cloud.nc"
    changed(what).to_netcdf(path)
    with pytest.raises(DataError, match=text) as caught:
        read_extinction(path)
    assert str(path) in str(caught.value)


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(DataError, match="no such file"):
        read_extinction(tmp_path / "nowhere.nc")


def test_a_file_that_is_not_netcdf_is_named(tmp_path):
    (tmp_path / "notes.nc").write_text("not a cloud")
    with pytest.raises(DataError, match="not a netCDF file"):
        read_extinction(tmp_path / "notes.nc")


@pytest.mark.parametrize("format", ["NETCDF4", "NETCDF3_64BIT"])
@pytest.mark.parametrize("share", [0.02, 0.5, 0.95])
def test_a_file_that_was_cut_short_is_named(tmp_path, format, share):
    grid = Grid(shape=(16, 16, 16), spacing=(0.02, 0.02, 0.04))
    path = tmp_path / "cloud.nc"
    dataset(grid=grid).to_netcdf(path, format=format)
    content = path.read_bytes()
    path.write_bytes(content[: int(share * len(content))])
    with pytest.raises(DataError, match="cut short"):
        read_extinction(path)


def test_extinction_of_another_shape_is_not_written(tmp_path):
    with pytest.raises(DataError, match="shape"):
        write_extinction(tmp_path / "cloud.nc", GRID, some_extinction()[1:])
    assert not list(tmp_path.iterdir())


def test_a_failed_write_leaves_the_old_file_and_nothing_else(tmp_path, monkeypatch):
    path = tmp_path / "cloud.nc"
    write_extinction(path, GRID, some_extinction())
    before = path.read_bytes()

    def fails(self, target, **options):
        Path(target).write_bytes(b"half")
        raise OSError("no space left on device")

    monkeypatch.setattr(xr.Dataset, "to_netcdf", fails)
    with pytest.raises(DataError, match="no space left"):
        write_extinction(path, GRID, 2 * some_extinction())
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]


def test_a_missing_folder_is_named(tmp_path):
    with pytest.raises(DataError, match="does not exist"):
        write_extinction(tmp_path / "missing" / "cloud.nc", GRID, some_extinction())


def test_measurements_come_back_exactly(tmp_path):
    measurements = some_measurements()
    write_measurements(tmp_path / "images.nc", measurements)
    read = read_measurements(tmp_path / "images.nc")
    assert read.views == measurements.views
    for name in ("images", "standard_errors"):
        for array, expected in zip(getattr(read, name), getattr(measurements, name)):
            np.testing.assert_array_equal(array, expected)


def every_kind_of_view():
    generator = np.random.default_rng(2)
    first, second = (
        RayView(generator.uniform(size=(count, 3)), generator.normal(size=(count, 3)), pixels)
        for count, pixels in ((6, (3, 2)), (5, (5, 1)))
    )
    return (
        first,
        PushBroomView((0.1, 0.2, 1 / 3), (0.4, 0.1, 1 / 3), 100 / 3, (3, 4), -26.1),
        RadiometerView(zenith=100 / 3, azimuth=12.0, pixels=(2, 4)),
        second,
        PerspectiveView((0.1, 0.2, 0.0), (0.1, 0.2, 1.0), 90.0, (4, 4), aspect=1.1),
    )


def test_views_of_every_kind_come_back_exactly(tmp_path):
    views = every_kind_of_view()
    images = tuple(np.ones(view.pixels[::-1]) for view in views)
    write_measurements(tmp_path / "images.nc", Measurements(views, images, images))
    assert read_measurements(tmp_path / "images.nc").views == views


def test_rays_come_back_exactly(tmp_path):
    view = every_kind_of_view()[0]
    write_rays(tmp_path / "rays.nc", view)
    assert read_rays(tmp_path / "rays.nc") == view


def test_rays_of_another_program_may_be_in_metres(tmp_path):
    variables = {
        "origin": (("axis", "ray"), [[100.0, 200.0], [0.0, 0.0], [2000.0, 2000.0]], {"units": "m"}),
        "direction": (("ray", "axis"), [[0, 0, -2], [3, 0, -4]]),
    }
    xr.Dataset(variables).to_netcdf(tmp_path / "rays.nc")
    expected = RayView([(0.1, 0, 2), (0.2, 0, 2)], [(0, 0, -1), (0.6, 0, -0.8)], (2, 1))
    assert read_rays(tmp_path / "rays.nc") == expected


@pytest.mark.parametrize(
    ("variables", "attributes", "message"),
    [
        ({"origin": np.ones((2, 3))}, {}, r"no variable direction\(ray, axis\)"),
        ({"origin": np.ones((2, 3)), "direction": np.zeros((2, 3))}, {}, "rays are not possible: .*row 0 is zero"),
        ({"origin": np.ones((2, 2)), "direction": np.ones((2, 2))}, {}, r"rays are not possible: .*shape \(2, 2\)"),
        ({"origin": np.ones((2, 3)), "direction": np.ones((2, 3))}, {"image_width": 3}, "3 x 1 for 2 rays"),
        ({"origin": np.ones((2, 3)), "direction": np.ones((2, 3))}, {"image_width": "wide"}, "pixels"),
    ],
)
def test_unfit_rays_are_named(tmp_path, variables, attributes, message):
    dataset = xr.Dataset({name: (("ray", "axis"), values) for name, values in variables.items()}, attrs=attributes)
    dataset.to_netcdf(tmp_path / "rays.nc")
    with pytest.raises(DataError, match=message):
        read_rays(tmp_path / "rays.nc")


def test_a_file_without_its_rays_is_named(tmp_path):
    views = every_kind_of_view()
    images = tuple(np.ones(view.pixels[::-1]) for view in views)
    write_measurements(tmp_path / "images.nc", Measurements(views, images, images))
    with xr.open_dataset(tmp_path / "images.nc") as data:
        data.load().drop_vars("ray_direction").to_netcdf(tmp_path / "wrong.nc")
    with pytest.raises(DataError, match=r"no variable ray_direction\(ray, axis\)"):
        read_measurements(tmp_path / "wrong.nc")


def test_a_file_that_is_short_of_rays_is_named(tmp_path):
    views = every_kind_of_view()
    images = tuple(np.ones(view.pixels[::-1]) for view in views)
    write_measurements(tmp_path / "images.nc", Measurements(views, images, images))
    with xr.open_dataset(tmp_path / "images.nc") as data:
        data.load().isel(ray=slice(0, 9)).to_netcdf(tmp_path / "wrong.nc")
    with pytest.raises(DataError, match="has 9 rays for 11 pixels of the views of type rays"):
        read_measurements(tmp_path / "wrong.nc")


def test_images_are_padded_with_nan(tmp_path):
    write_measurements(tmp_path / "images.nc", some_measurements())
    with xr.open_dataset(tmp_path / "images.nc") as data:
        assert data.radiance.shape == (3, 4, 3)
        assert data.radiance.attrs["units"] == "W m-2 sr-1"
        assert np.isfinite(data.radiance).sum(("row", "column")).values.tolist() == [6, 8, 1]
        assert data.image_height.values.tolist() == [2, 4, 1]


def test_settings_come_back(tmp_path):
    settings = {"scene": {"sun": {"zenith": 50.0}}, "views": [{"type": "perspective"}], "note": "Wolke ü"}
    write_measurements(tmp_path / "images.nc", some_measurements(), settings=settings)
    assert read_settings(tmp_path / "images.nc") == settings


def test_missing_settings_are_named(tmp_path):
    write_measurements(tmp_path / "images.nc", some_measurements())
    with pytest.raises(DataError, match="no attribute settings"):
        read_settings(tmp_path / "images.nc")


@pytest.mark.parametrize(
    ("name", "value", "text"),
    [
        ("radiance", np.inf, "images of view 1 are not finite at row 0, column 0"),
        ("image_width", 7, "image_width is"),
        ("field_of_view", 200.0, "view 0 is not possible: .*field_of_view"),
        ("view_type", "fisheye", "view 0 is not possible"),
        ("zenith", None, r"no variable zenith\(view\)"),
    ],
)
def test_unfit_measurements_are_named(tmp_path, name, value, text):
    write_measurements(tmp_path / "images.nc", some_measurements())
    with xr.open_dataset(tmp_path / "images.nc") as data:
        data = data.load()
    if value is None:
        data = data.drop_vars(name)
    elif name == "radiance":
        data[name].values[1, 0, 0] = value
    else:
        data[name].values[0] = value
    data.to_netcdf(tmp_path / "wrong.nc")
    with pytest.raises(DataError, match=text):
        read_measurements(tmp_path / "wrong.nc")


def test_bad_pixels_survive_a_file(tmp_path):
    measurements = some_measurements()
    measurements.images[0][1, 2] = np.nan
    write_measurements(tmp_path / "images.nc", measurements)
    read = read_measurements(tmp_path / "images.nc")
    for kept, image in zip(read.images, measurements.images):
        np.testing.assert_array_equal(kept, image)


@pytest.mark.parametrize("name", ["calibration_errors", "pointing_errors", "position_errors"])
def test_errors_of_views_survive_a_file(tmp_path, name):
    measurements = replace(some_measurements(), **{name: (0.02, 0.0, 0.1)})
    write_measurements(tmp_path / "images.nc", measurements)
    read = read_measurements(tmp_path / "images.nc")
    assert getattr(read, name) == (0.02, 0.0, 0.1)
    assert replace(read, **{name: ()}).views == measurements.views


def test_a_variable_says_which_pixels_are_valid(tmp_path):
    write_measurements(tmp_path / "images.nc", some_measurements())
    with xr.open_dataset(tmp_path / "images.nc") as data:
        data = data.load()
    valid = np.ones(data.radiance.shape, np.int8)
    valid[1, 3, 0] = 0
    data["valid"] = (("view", "row", "column"), valid)
    read = read_measurements(data)
    assert read.invalid_pixels == 1 and np.isnan(read.images[1][3, 0])


def test_the_package_imports_without_xarray():
    code = "import sys, cloudtomo_cl.files.measurements; sys.exit('xarray' in sys.modules or 'netCDF4' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code]).returncode == 0


def test_a_file_that_is_being_written_is_not_called_damaged(tmp_path):
    pytest.importorskip("fcntl")
    path = tmp_path / "cloud.nc"
    write_extinction(path, Grid((2, 2, 2), (0.1, 0.1, 0.1)), np.ones((2, 2, 2)))
    code = f"import netCDF4; d = netCDF4.Dataset({str(path)!r}, 'a'); print('open', flush=True); input()"
    words = [sys.executable, "-c", code]
    with subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as writer:
        assert writer.stdout.readline() == "open\n"
        with pytest.raises(DataError, match="another program has it open for writing"):
            read_extinction(path)
        writer.communicate("\n", timeout=60)
    assert read_extinction(path)[1].max() == 1
