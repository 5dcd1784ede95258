"""Clouds in the files of others become what those files say."""

import os
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from scipy.io import savemat

from cloudtomo_cl.clouds.readers import ReadingOptions, read_cloud
from cloudtomo_cl.errors import DataError
from cloudtomo_cl.files.extinction import write_extinction
from cloudtomo_cl.files.phase import write_phase_function
from cloudtomo_cl.scene.droplets import DropletTable
from cloudtomo_cl.scene.phase import TabulatedPhaseFunction

DATA = Path(os.environ.get("CLOUDTOMO_DATA", Path(__file__).parents[2].parent / "shared" / "data"))
POINTS = [(0, 1, 0, 0.3, 10.0), (2, 0, 1, 0.6, 12.0), (1, 1, 2, 0.1, 15.0)]  # x, y, z, g m^-3, um
LEVELS = [0.5, 0.54, 0.58]


def expected():
    """Of POINTS: 3 LWC / (2 rho r_e)."""
    extinction = np.zeros((3, 2, 3))
    for x, y, z, water, radius in POINTS:
        extinction[x, y, z] = 1.5 * water * 1e-6 / (radius * 1e-6) * 1e3
    return extinction


def rows(first=0, separator=" "):
    return "\n".join(
        separator.join(map(str, (x + first, y + first, z + first, water, radius))) for x, y, z, water, radius in POINTS
    )


TEXTS = {
    "pyshdom": f"# a comment\n3 2 3\n0.02 0.03 {' '.join(map(str, LEVELS))}\n{rows()}\n",
    "shdom": f"2 parameter LWC file\n 3 2 3\n0.02 0.03\n{' '.join(map(str, LEVELS))}\n280 280 280\n{rows(1)}\n",
    "at3d": f"# a comment\n3,2,3\n0.02,0.03\n{','.join(map(str, LEVELS))}\nx,y,z,lwc,reff\n{rows(0, ',')}\n",
}


@pytest.mark.parametrize("kind", TEXTS)
def test_the_text_formats_tell_the_same_cloud(tmp_path, kind):
    (tmp_path / "cloud.txt").write_text(TEXTS[kind])
    cloud = read_cloud(tmp_path / "cloud.txt")
    assert np.allclose(cloud.extinction, expected())
    assert cloud.grid.spacing == (0.02, 0.03, 0.04)
    # Levels are centres of layers.
    assert np.allclose(cloud.grid.centres(2), LEVELS)
    assert np.nanmax(cloud.effective_radius) == 15 and np.isnan(cloud.effective_radius[0, 0, 0])


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("3 2 3\n", "3 2 4\n", "3 levels, the first line says 4"),
        ("2 0 1 0.6", "3 0 1 0.6", "outside of"),
        ("0.6 12.0", "0.6 0.0", "above 0 um"),
        ("0.6 12.0", "-0.6 12.0", "at least 0"),
        ("0.6 12.0", "nonsense", "nx ny nz"),
        ("0.5 0.54", "0.6 0.54", "increase"),
    ],
)
def test_a_wrong_text_is_answered_with_what_is_wrong(tmp_path, old, new, message):
    assert old in TEXTS["pyshdom"]
    (tmp_path / "cloud.txt").write_text(TEXTS["pyshdom"].replace(old, new))
    with pytest.raises(DataError, match=message):
        read_cloud(tmp_path / "cloud.txt")


def test_the_large_eddy_cloud_of_pyshdom_keeps_its_water():
    path = DATA / "rico32x37x26.txt"
    if not path.is_file():
        pytest.skip(f"needs {path.name}; set CLOUDTOMO_DATA to the folder that has it")
    cloud = read_cloud(path)
    table = np.loadtxt(path, skiprows=3)
    water = cloud.extinction * np.nan_to_num(cloud.effective_radius) / 1500
    assert water.sum() == pytest.approx(table[:, 3].sum(), rel=1e-5)
    assert (cloud.extinction > 0).sum() == len(table)
    assert cloud.grid.shape == (32, 37, 26) and cloud.grid.origin == (0, 0, 0.42)


def les(levels=(100.0, 140.0, 200.0, 300.0), **units):
    """A field over z, y, x in metres on stretched levels."""
    generator = np.random.default_rng(3)
    field = generator.uniform(0.1, 1.0, (4, 3, 2)).astype(np.float32)
    return xr.Dataset(
        {
            "lwc": (("z", "y", "x"), field, {"units": units.get("lwc", "g m-3")}),
            "reff": (("z", "y", "x"), 8 + 4 * field, {"units": "um"}),
        },
        {
            "z": ("z", np.array(levels), {"units": "m"}),
            "y": ("y", [25.0, 75.0, 125.0], {"units": "m"}),
            "x": ("x", [10.0, 30.0], {"units": "m"}),
        },
    )


# Half-way between the levels, and as far beyond the outermost ones: 80, 120, 170, 250, 350 m.
THICKNESS = np.array([40.0, 50.0, 80.0, 100.0])


def test_stretched_levels_keep_optical_depth_and_water_path(tmp_path):
    dataset = les()
    dataset.to_netcdf(tmp_path / "les.nc")
    cloud = read_cloud(tmp_path / "les.nc")
    depth = np.einsum("zyx,z->xy", 1.5 * dataset.lwc.values / dataset.reff.values, THICKNESS)
    assert np.allclose(cloud.optical_depth, depth, rtol=1e-5)
    path = (cloud.extinction * cloud.effective_radius).sum(axis=2) * cloud.grid.spacing[2] / 1.5
    assert np.allclose(path, np.einsum("zyx,z->xy", dataset.lwc.values, THICKNESS), rtol=1e-5)
    assert cloud.grid.spacing[:2] == (0.02, 0.05)
    assert cloud.grid.origin[2] == 0.08 and cloud.grid.extent[2] == pytest.approx(0.27)


def test_a_layer_can_be_chosen(tmp_path):
    les().to_netcdf(tmp_path / "les.nc")
    cloud = read_cloud(tmp_path / "les.nc", ReadingOptions(layer=0.09))
    assert cloud.grid.shape[2] == 3
    assert np.allclose(cloud.optical_depth, read_cloud(tmp_path / "les.nc").optical_depth, rtol=1e-5)


def test_units_are_understood(tmp_path):
    dataset = les()
    dataset.to_netcdf(tmp_path / "grams.nc")
    dataset["lwc"] = (dataset.lwc * 1e-3).assign_attrs(units="kg m-3")
    for axis in "xyz":
        dataset[axis] = (dataset[axis] * 1e-3).assign_attrs(units="km")
    dataset["reff"] = (dataset.reff * 1e-6).assign_attrs(units="m")
    dataset.to_netcdf(tmp_path / "kilograms.nc")
    one, other = (read_cloud(tmp_path / f"{name}.nc") for name in ("grams", "kilograms"))
    assert np.allclose(one.extinction, other.extinction, rtol=1e-5)
    assert np.allclose(one.grid.spacing, other.grid.spacing)
    assert np.allclose(one.effective_radius, other.effective_radius)


@pytest.mark.parametrize(("units", "factor"), [("m-1", 1000.0), ("km-1", 1.0), ("1/km", 1.0)])
def test_extinction_in_its_units(tmp_path, units, factor):
    dataset = les().rename(lwc="extinction").drop_vars("reff")
    dataset.extinction.attrs["units"] = units
    dataset.to_netcdf(tmp_path / "les.nc")
    depth = np.einsum("zyx,z->xy", dataset.extinction.values, THICKNESS) * factor / 1000
    assert np.allclose(read_cloud(tmp_path / "les.nc").optical_depth, depth, rtol=1e-5)


def test_a_mixing_ratio_needs_the_density_of_air(tmp_path):
    dataset = les()
    density = np.array([1.2, 1.19, 1.17, 1.15])
    mixed = dataset.rename(lwc="ql")
    mixed["ql"] = (dataset.lwc / density[:, None, None]).assign_attrs(units="g kg-1")
    mixed.to_netcdf(tmp_path / "mixed.nc")
    with pytest.raises(DataError, match="density of air"):
        read_cloud(tmp_path / "mixed.nc")
    mixed["rho"] = ("z", density, {"units": "kg m-3"})
    mixed.to_netcdf(tmp_path / "with.nc")
    dataset.to_netcdf(tmp_path / "les.nc")
    assert np.allclose(
        read_cloud(tmp_path / "with.nc").extinction, read_cloud(tmp_path / "les.nc").extinction, rtol=1e-5
    )


def test_one_of_several_times_is_chosen(tmp_path):
    dataset = xr.concat([les(), 2 * les()], "time")
    dataset["lwc"].attrs["units"] = "g m-3"
    dataset["reff"] = les().reff
    dataset.to_netcdf(tmp_path / "les.nc")
    with pytest.raises(DataError, match="2 steps of time: choose one with --time"):
        read_cloud(tmp_path / "les.nc")
    first, last = (read_cloud(tmp_path / "les.nc", ReadingOptions(time=time)) for time in (0, -1))
    assert np.allclose(2 * first.extinction, last.extinction)


def test_the_droplets_number_gives_their_radius(tmp_path):
    les().drop_vars("reff").to_netcdf(tmp_path / "les.nc")
    with pytest.raises(DataError, match="--effective-radius"):
        read_cloud(tmp_path / "les.nc")
    cloud = read_cloud(tmp_path / "les.nc", ReadingOptions(droplet_number=100.0))
    # Drops of the volume mean radius, r_e times 0.8^(1/3), at 100 cm^-3 hold the water.
    radius = cloud.effective_radius[0, 0, 0] * 1e-6
    water = 1e8 * 4 / 3 * np.pi * 0.8 * radius**3 * 1e6
    assert water == pytest.approx(float(les().lwc[0, 0, 0]), rel=1e-5)
    assert 8 < radius * 1e6 < 15


def test_a_first_level_on_the_ground_keeps_the_uniform_layers(tmp_path):
    dataset = les(levels=(0.0, 40.0, 80.0, 120.0))
    dataset.lwc[0] = 0
    dataset.to_netcdf(tmp_path / "les.nc")
    cloud = read_cloud(tmp_path / "les.nc")
    assert cloud.grid.origin[2] == 0.02 and cloud.grid.shape[2] == 3


def test_coordinates_without_units_that_look_like_metres_are_refused(tmp_path):
    dataset = les()
    for axis in "xyz":
        dataset[axis].attrs.clear()
    dataset.to_netcdf(tmp_path / "les.nc")
    with pytest.raises(DataError, match="set its attribute units to m or km"):
        read_cloud(tmp_path / "les.nc")


def test_what_was_written_is_read_again(tmp_path):
    (tmp_path / "cloud.txt").write_text(TEXTS["pyshdom"])
    cloud = read_cloud(tmp_path / "cloud.txt")
    write_extinction(tmp_path / "cloud.nc", cloud.grid, cloud.extinction, None, cloud.effective_radius)
    again = read_cloud(tmp_path / "cloud.nc")
    assert again.grid == cloud.grid and np.array_equal(again.extinction, cloud.extinction)
    assert np.array_equal(again.effective_radius, cloud.effective_radius, equal_nan=True)


@pytest.mark.parametrize("order", ["xyz", "zyx", "yxz"])
def test_plain_arrays(tmp_path, order):
    extinction = np.random.default_rng(1).uniform(1, 9, (3, 4, 5))
    stored = extinction.transpose(["xyz".index(axis) for axis in order])
    np.save(tmp_path / "cloud.npy", stored)
    savemat(tmp_path / "cloud.mat", {"beta": stored, "wavelength": 0.67})
    for name in ("cloud.npy", "cloud.mat"):
        with pytest.raises(DataError, match="--spacing"):
            read_cloud(tmp_path / name)
        cloud = read_cloud(tmp_path / name, ReadingOptions(spacing=(0.02, 0.02, 0.04), order=order, units="m-1"))
        assert np.allclose(cloud.extinction, 1000 * extinction) and cloud.grid.spacing == (0.02, 0.02, 0.04)


def test_columns_of_i3rc_keep_their_optical_depths(tmp_path):
    depth, thickness = np.array([[3.0, 0.0], [8.0, 5.0], [1.0, 2.0]]), np.array([[0.12, 0.0], [0.4, 0.3], [0.03, 0.11]])
    np.savetxt(tmp_path / "scene.tau.2x3", depth)
    np.savetxt(tmp_path / "scene.dz.2x3", thickness)
    cloud = read_cloud(tmp_path / "scene.tau.2x3")
    assert np.allclose(cloud.optical_depth, depth.T)
    assert cloud.grid.origin[2] == 0.2 and cloud.grid.shape == (2, 3, 8)
    # A column is uniform from its base up.
    assert np.allclose(cloud.extinction[0, 0], [25, 25, 10, 0, 0, 0, 0, 0])


def test_other_files_are_named(tmp_path):
    (tmp_path / "image.png").write_bytes(b"\x89PNG\r\n\x1a\n" + bytes(range(256)))
    with pytest.raises(DataError, match="none of the known kinds"):
        read_cloud(tmp_path / "image.png")


def test_a_mie_table_takes_the_place_of_the_limit(tmp_path):
    angle, values = (0.0, 90.0, 180.0), ((0.25 / np.pi,) * 3,) * 2
    phase = TabulatedPhaseFunction(angle, values, effective_radius=(5.0, 25.0), single_scattering_albedo=(1.0, 1.0))
    # 5 % more than the limit at 5 um, none at 25: linear between.
    efficiency = (2.1, 2.0)
    table = DropletTable(phase, efficiency, 670.0, 0.1, 1.33, 1e-8)
    write_phase_function(tmp_path / "table.nc", table)
    (tmp_path / "cloud.txt").write_text(TEXTS["pyshdom"])
    cloud = read_cloud(tmp_path / "cloud.txt", ReadingOptions(droplet_table=tmp_path / "table.nc"))
    ratio = cloud.extinction[0, 1, 0] / expected()[0, 1, 0]
    assert ratio == pytest.approx(np.interp(10.0, (5, 25), efficiency) / 2, rel=1e-5)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        # The header of MATLAB's format 7.3: 124 bytes of text and place, version 0x0200, the mark of the byte order.
        (b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM", "format 7.3"),
        # Format 5 with a compressed array of 64 bytes, which is none.
        (b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01IM\x0f\0\0\0\x40\0\0\0spoilt", "damaged or cut short"),
        (b"", "damaged or cut short"),
    ],
    ids=["7.3", "spoilt", "empty"],
)  # fmt: skip
def test_matlab_files_that_cannot_be_read_say_why(tmp_path, content, message):
    path = tmp_path / "cloud.mat"
    path.write_bytes(content)
    with pytest.raises(DataError, match=message):
        read_cloud(path, ReadingOptions(spacing=(0.1, 0.1, 0.1)))
