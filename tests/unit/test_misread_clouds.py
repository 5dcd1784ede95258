"""One cloud in files that other programs' readers get wrong: read as what it is, or refused with what is wrong."""

import importlib
import random
from pathlib import Path

import netCDF4
import numpy as np
import pytest
import xarray as xr
from scipy.io import savemat

from cloudtomo_cl.clouds.readers import ReadingOptions, read_cloud
from cloudtomo_cl.clouds.volume import CloudVolume
from cloudtomo_cl.commands.cli import main
from cloudtomo_cl.errors import DataError
from cloudtomo_cl.files.extinction import read_effective_radius, read_extinction, write_extinction
from cloudtomo_cl.scene.grid import Grid

# Columns of 50 m, layers of 40 m; water of 0.3 and 0.6 g m^-3 in the two middle layers of one column, droplets of
# 10 um: 3 LWC / (2 rho r_e) makes 45 and 90 km^-1.
WATER = np.zeros((6, 5, 4))
WATER[2, 1, 1:3] = 0.3, 0.6
DEPTH, MASS = (45 + 90) * 0.04, (45 + 90) * 0.05 * 0.05 * 0.04
RADIUS = ReadingOptions(effective_radius=10.0)


def les(field=WATER, name="lwc", dims=("x", "y", "z"), **attributes):
    """A dataset with the field, in metres."""
    coordinates = {
        axis: (axis, (np.arange(count) + 0.5) * step, {"units": "m"})
        for axis, count, step in zip("xyz", WATER.shape, (50, 50, 40))
    }
    return xr.Dataset({name: (dims, np.asarray(field), {"units": "g m-3", **attributes})}, coordinates)


def assert_is_the_cloud(cloud):
    assert cloud.optical_depth.max() == pytest.approx(DEPTH, rel=1e-5)
    assert cloud.extinction.sum() * cloud.grid.voxel_volume == pytest.approx(MASS, rel=1e-5)
    assert cloud.optical_depth[2, 1] == pytest.approx(DEPTH, rel=1e-5)
    assert cloud.grid.spacing == pytest.approx((0.05, 0.05, 0.04))
    assert cloud.extinction[2, 1, 2] == pytest.approx(90.0, rel=1e-5)


def mixed(**air):
    """A mixing ratio, with 0.8 kg m^-3 of air on the field's levels, or as it is given."""
    data = les(WATER / 0.8, "ql", units="g kg-1")
    given = {"dims": ("z",), "values": np.full(4, 0.8), "attributes": {"units": "kg m-3"}} | air
    return data.assign(rho=(given["dims"], given["values"], given["attributes"]))


# ---- which variable is what


def test_air_is_not_taken_for_water():
    """The name density is AT3D's for water, and others' for air."""
    data = les(WATER / 1.1, "ql", units="g kg-1").assign(density=(("x", "y", "z"), np.full(WATER.shape, 1.1)))
    for attributes in ({"units": "kg m-3", "long_name": "density of air"}, {"units": "kg m-3"}):
        data.density.attrs.update(attributes)
        cloud = read_cloud(data, RADIUS)
        assert_is_the_cloud(cloud)
        assert dict(cloud.readings)["air density"] == "density, kg m-3 (stated); none missing"


@pytest.mark.parametrize(
    ("name", "attributes", "value"),
    [
        ("beta", {"units": "m-1 s-1", "long_name": "gradient of the Coriolis parameter"}, 2e-11),
        ("beta", {"units": "K-1"}, 3e-3),
        ("beta", {"units": "m-1", "long_name": "attenuated backscatter"}, 1e-3),
        ("ext", {"units": "km-1", "standard_name": "volume_extinction_coefficient_in_air_due_to_ambient_aerosol"}, 0.1),
        ("Re", {"long_name": "Reynolds number"}, 300.0),
        ("Re", {"units": "1"}, 300.0),
        ("qc", {"units": "kg kg-1", "long_name": "rain water"}, 1e-3),
    ],
)
def test_what_only_has_the_name_is_not_read(name, attributes, value):
    data = les().assign({name: (("x", "y", "z"), np.full(WATER.shape, value), attributes)})
    assert_is_the_cloud(read_cloud(data, RADIUS))


def test_a_reynolds_number_is_no_radius():
    with pytest.raises(DataError, match="no effective radius"):
        read_cloud(les().assign(Re=((), 300.0)))


@pytest.mark.parametrize(
    "long_name",
    ["cloud liquid water content in air", "mass of cloud liquid water per volume of air", "water + ice condensate"],
)
def test_water_may_say_what_it_lies_in(long_name):
    assert_is_the_cloud(read_cloud(les(long_name=long_name), RADIUS))


@pytest.mark.parametrize("units", [b"g m-3", np.array(["g m-3"], dtype=object)])
def test_units_may_be_bytes_or_an_array_of_one(units):
    assert_is_the_cloud(read_cloud(les(units=units), RADIUS))


def test_a_standard_name_finds_a_field_of_any_name():
    data = les(name="foo", standard_name="mass_concentration_of_cloud_liquid_water_in_air")
    assert_is_the_cloud(read_cloud(data, RADIUS))


def test_air_that_somebody_calls_the_water_is_refused():
    data = les().assign(dens=(("x", "y", "z"), np.full(WATER.shape, 1.1), {"units": "kg m-3"}))
    with pytest.raises(DataError, match="dens is 1100 g m-3 at most, and no cloud holds more than 50"):
        read_cloud(data, ReadingOptions(variable="dens", effective_radius=10.0))


# ---- units


@pytest.mark.parametrize(
    ("factor", "message"),
    [(1e-3, "set its attribute units, likely kg m-3"), (1e3, "is none of a cloud"), (1e-6, "is none of a cloud")],
)
@pytest.mark.parametrize("units", [{"units": ""}, {"units": "  "}])
def test_water_without_units_that_is_none_of_a_cloud_is_refused(factor, message, units):
    with pytest.raises(DataError, match=message):
        read_cloud(les(WATER * factor, **units), RADIUS)
    assert_is_the_cloud(read_cloud(les(**units), RADIUS))
    stated = ReadingOptions(units={1e-3: "kg m-3", 1e3: "mg m-3", 1e-6: "kg cm-3"}[factor], effective_radius=10.0)
    if factor != 1e-6:
        assert_is_the_cloud(read_cloud(les(WATER * factor, **units), stated))


@pytest.mark.parametrize(("largest", "likely"), [(0.09, "likely m-1"), (9e4, "none of a cloud")])
def test_extinction_without_units_that_is_none_of_a_cloud_is_refused(tmp_path, largest, likely):
    extinction = les(WATER / 0.6 * largest, "extinction", units="")
    for read in (read_extinction, read_cloud):
        with pytest.raises(DataError, match=likely):
            read(extinction)


@pytest.mark.parametrize(
    ("value", "attributes", "message"),
    [
        (1e-5, {}, "has no units, and as um .* likely m"),
        (1e4, {}, "has no units"),
        (10.0, {"units": "m"}, "no droplets are"),
        (10.0, {"units": "mm"}, "no droplets are"),
        (10.0, {"units": "K"}, "reff has units 'K', it must have um or m"),
    ],
)
def test_a_radius_that_no_droplet_has_is_refused(value, attributes, message):
    with pytest.raises(DataError, match=message):
        read_cloud(les().assign(reff=(("x", "y", "z"), np.full(WATER.shape, value), attributes)))


@pytest.mark.parametrize(
    ("units", "factor"), [("um", 1), ("m", 1e-6), ("µm", 1), ("microns", 1), ("mm", 1e-3), ("", 1)]
)
def test_a_radius_is_converted(units, factor):
    cloud = read_cloud(les().assign(reff=(("x", "y", "z"), np.full(WATER.shape, 10.0 * factor), {"units": units})))
    assert_is_the_cloud(cloud)
    assert cloud.effective_radius[2, 1, 1] == pytest.approx(10.0)


def test_a_unit_that_a_user_says_in_place_of_the_files_is_told():
    cloud = read_cloud(les(units="kg m-3"), ReadingOptions(units="g m-3", effective_radius=10.0))
    assert_is_the_cloud(cloud)
    assert dict(cloud.readings)["units"] == "g m-3, by --units, instead of the file's kg m-3"


# ---- missing values


def with_missing(inside):
    field = WATER.copy()
    field[(2, 1, 1) if inside else (0, 0, 0)] = np.nan
    return field


@pytest.mark.parametrize("inside", [True, False])
def test_missing_values_are_refused_or_counted(inside):
    data = les(with_missing(inside))
    with pytest.raises(DataError, match="liquid water content is missing in 1 of 120 voxels.*--missing clear"):
        read_cloud(data, RADIUS)
    cloud = read_cloud(data, ReadingOptions(effective_radius=10.0, missing="clear"))
    assert dict(cloud.readings)["liquid water content"].endswith("1 of 120 missing, taken as clear")
    assert cloud.optical_depth.max() == pytest.approx(3.6 if inside else DEPTH, rel=1e-5)


def test_the_rule_is_the_same_for_extinction():
    field = np.where(np.isnan(with_missing(False)), np.nan, WATER * 150)
    data = les(field, "extinction", units="km-1")
    with pytest.raises(DataError, match="1 of 120 voxels"):
        read_extinction(data)
    with pytest.raises(DataError, match="1 of 120 voxels"):
        read_cloud(data)
    grid = Grid(WATER.shape, (0.05, 0.05, 0.04))
    with pytest.raises(DataError, match="1 of 120 voxels"):
        CloudVolume(grid, field)
    masked = np.ma.masked_invalid(field)
    with pytest.raises(DataError, match="1 of 120 voxels"):
        CloudVolume(grid, masked)
    with pytest.raises(DataError, match="not finite"):
        write_extinction("nowhere.nc", grid, masked)


@pytest.mark.parametrize("missing", ["refuse", "clear"])
def test_air_is_never_missing_in_a_cloud(missing):
    options = ReadingOptions(effective_radius=10.0, missing=missing)
    air = np.array([0.8, np.nan, 0.8, 0.8])
    with pytest.raises(DataError, match="air density is missing in 1 of 120 voxels, first at \\(2, 1, 1\\)"):
        read_cloud(mixed(values=air), options)
    assert_is_the_cloud(read_cloud(mixed(values=np.array([np.nan, 0.8, 0.8, np.nan])), options))


@pytest.mark.parametrize("missing", ["refuse", "clear"])
@pytest.mark.parametrize("bad", [np.nan, 0.0, -999.0])
def test_a_radius_is_never_missing_in_a_cloud(missing, bad):
    radius = np.full(WATER.shape, 10.0)
    radius[2, 1, 1] = bad
    with pytest.raises(DataError, match="effective radius .*\\(2, 1, 1\\)"):
        read_cloud(les().assign(reff=(("x", "y", "z"), radius, {"units": "um"})), ReadingOptions(missing=missing))
    radius[2, 1, 1], radius[0, 0, 0] = 10.0, bad
    cloud = read_cloud(les().assign(reff=(("x", "y", "z"), radius, {"units": "um"})))
    assert_is_the_cloud(cloud)


def test_a_radius_that_is_missing_in_a_clouds_own_file_is_refused():
    data = les(WATER * 150, "extinction", units="km-1")
    radius = np.where(WATER > 0, 10.0, np.nan)
    assert read_effective_radius(data.assign(effective_radius=(("x", "y", "z"), radius)))[2, 1, 1] == 10.0
    radius[2, 1, 1] = np.nan
    with pytest.raises(DataError, match="missing in 1 of 120 voxels, first at \\(2, 1, 1\\)"):
        read_effective_radius(data.assign(effective_radius=(("x", "y", "z"), radius)))


def test_a_fill_that_no_attribute_tells_is_named():
    for fill in (-999.0, 1e20, -1e34, 9e36):
        for read, data in (
            (lambda data: read_cloud(data, RADIUS), les(np.where(WATER == 0.3, fill, WATER))),
            (read_extinction, les(np.where(WATER == 0.3, fill, 150 * WATER), "extinction", units="km-1")),
            (read_cloud, les(np.where(WATER == 0.3, fill, 150 * WATER), "extinction", units="km-1")),
        ):
            with pytest.raises(DataError, match="voxel \\(2, 1, 1\\).*attribute _FillValue"):
                read(data)


def test_an_extinction_that_no_cloud_has_is_refused_whatever_its_unit():
    with pytest.raises(DataError, match="no cloud has over 100000"):
        read_cloud(les(1e4 * WATER, "extinction", units="m-1"))


# ---- dimensions


def test_a_time_is_not_applied_to_levels():
    """--time once chose a level of a profile on half levels."""
    faces = {"zm": ("zm", [0.0, 40.0, 80.0, 120.0, 160.0], {"units": "m"})}
    air = 0.8 + 0.01 * np.array([2.0, 1.0, 0.0, -1.0, -2.0])
    data = les(WATER / (0.8 + 0.01 * np.array([1.5, 0.5, -0.5, -1.5])), "ql", units="g kg-1").assign_coords(faces)
    data = data.assign(rho=("zm", air, {"units": "kg m-3"}))
    data["ql"] = data.ql.expand_dims(time=2)
    assert_is_the_cloud(read_cloud(data, ReadingOptions(effective_radius=10.0, time=1)))


@pytest.mark.parametrize(
    ("faces", "air", "message"),
    [
        ({}, np.full(4, 0.8), "dimension zm has no coordinate|lies on zm"),
        ({"zm": ("zm", [0.0, 40.0, 80.0, 120.0])}, np.full(4, 0.8), "zm has no units"),
        ({"zm": ("zm", [0.0, 10.0, 20.0, 30.0], {"units": "m"})}, np.full(4, 0.8), "known from 0 to 0.03 km only"),
        ({"zm": ("zm", [0.0, 40.0, 80.0, 120.0], {"units": "m"})}, np.array([1.0, 0.8, 0.6, 0.4]), "too much"),
    ],
)
def test_half_levels_that_cannot_be_interpolated_are_refused(faces, air, message):
    data = les(WATER / 0.8, "ql", units="g kg-1").assign_coords(faces).assign(rho=("zm", air, {"units": "kg m-3"}))
    with pytest.raises(DataError, match=message):
        read_cloud(data, RADIUS)


def test_a_time_that_the_file_does_not_have_is_refused():
    data = les()
    data["lwc"] = data.lwc.expand_dims(time=1)
    assert_is_the_cloud(read_cloud(data, ReadingOptions(effective_radius=10.0, time=-1)))
    with pytest.raises(DataError, match="--time 5: lwc has 1 entries along time"):
        read_cloud(data, ReadingOptions(effective_radius=10.0, time=5))


def test_a_profile_of_one_time_goes_with_every_time():
    data = mixed(dims=("time", "z"), values=np.full((1, 4), 0.8))
    data["ql"] = data.ql.expand_dims({"Time": 3})
    assert_is_the_cloud(read_cloud(data, ReadingOptions(effective_radius=10.0, time=2)))


@pytest.mark.parametrize("options", [{"layer": 1e-9}, {}])
def test_layers_beyond_memory_are_refused_at_once(options):
    data = les()
    if not options:
        data = data.assign_coords(z=("z", [20.0, 20.0 + 1e-7, 100.0, 140.0], {"units": "m"}))
    with pytest.raises(DataError, match="layers.*--layer"):
        read_cloud(data, ReadingOptions(effective_radius=10.0, **options))


def test_members_are_chosen_by_name():
    data = les()
    data["lwc"] = data.lwc.expand_dims(member=3) * xr.DataArray([0.5, 1.0, 2.0], dims="member")
    data.lwc.attrs["units"] = "g m-3"
    for options in (RADIUS, ReadingOptions(effective_radius=10.0, time=1)):
        with pytest.raises(DataError, match="3 entries along member: choose one with --select member=INDEX"):
            read_cloud(data, options)
    assert_is_the_cloud(read_cloud(data, ReadingOptions(effective_radius=10.0, select={"member": 1})))
    with pytest.raises(DataError, match="--select member=7"):
        read_cloud(data, ReadingOptions(effective_radius=10.0, select={"member": 7}))


@pytest.mark.parametrize("axis", ["x", "y", "z"])
@pytest.mark.parametrize("dims", [("x", "y", "z"), ("z", "y", "x"), ("y", "z", "x")])
def test_falling_axes_are_turned_with_all_that_lies_on_them(axis, dims):
    data = mixed().transpose(*dims, missing_dims="ignore").isel({axis: slice(None, None, -1)})
    assert_is_the_cloud(read_cloud(data, RADIUS))


def test_heights_of_numbered_levels_are_found():
    data = les().rename(z="lev").assign_coords(lev=("lev", [1.0, 2.0, 3.0, 4.0]))
    data = data.assign_coords(height=("lev", [20.0, 60.0, 100.0, 140.0], {"units": "m", "standard_name": "height"}))
    assert_is_the_cloud(read_cloud(data, RADIUS))


def test_level_numbers_from_the_top_are_turned_where_the_spacing_is_said():
    data = les().isel(z=slice(None, None, -1)).assign_coords(z=("z", [0.0, 1.0, 2.0, 3.0], {"positive": "down"}))
    with pytest.raises(DataError, match="z has no units"):
        read_cloud(data, RADIUS)
    options = ReadingOptions(effective_radius=10.0, spacing=(0.05, 0.05, 0.04))
    assert_is_the_cloud(read_cloud(data, options))


# ---- options


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"time": 0}, "--time 0 has no effect"),
        ({"select": {"member": 0}}, "--select member has no effect"),
        ({"spacing": (0.1, 0.1, 0.1)}, "--spacing says 0.1 km along x"),
        ({"order": "zyx"}, "--order zyx has no effect"),
        ({"droplet_number": 100.0}, "both give the droplets' size"),
        ({"variable": "nowhere"}, "has no variable nowhere"),
        ({"missing": "zero"}, "must be 'refuse' or 'clear'"),
    ],
)
def test_options_without_effect_are_answered(options, message):
    with pytest.raises(DataError, match=message):
        read_cloud(les(), ReadingOptions(**{"effective_radius": 10.0, **options}))


@pytest.mark.parametrize("options", [{"droplet_number": 100.0}, {"droplet_table": Path("mie.nc")}])
def test_options_of_water_are_refused_with_extinction(options):
    with pytest.raises(DataError, match="has no effect: the file holds extinction"):
        read_cloud(les(WATER * 150, "extinction", units="km-1"), ReadingOptions(**options))


# ---- arrays


def test_arrays_that_are_none_are_named(tmp_path):
    options = ReadingOptions(spacing=(0.05, 0.05, 0.04))
    np.save(tmp_path / "object.npy", np.array([[["a", 1.0]]], dtype=object), allow_pickle=True)
    np.savez(tmp_path / "archive.npz", WATER)
    np.save(tmp_path / "complex.npy", WATER + 1j)
    savemat(tmp_path / "cell.mat", {"c": np.array([[["a", 1.0]]], dtype=object)})
    for name, message in (
        ("object.npy", "holds Python objects"),
        ("archive.npz", "is an archive"),
        ("complex.npy", "must hold 3-D numbers"),
        ("cell.mat", "must hold 3-D numbers|three-dimensional array"),
    ):
        with pytest.raises(DataError, match=message):
            read_cloud(tmp_path / name, options)


def test_an_array_that_claims_more_than_there_is_is_refused(tmp_path):
    np.save(tmp_path / "cloud.npy", WATER)
    content = (tmp_path / "cloud.npy").read_bytes().replace(b"(6, 5, 4)", b"(99999, 99999, 9)"[:17])
    (tmp_path / "cloud.npy").write_bytes(content)
    with pytest.raises(DataError, match="cloud.npy"):
        read_cloud(tmp_path / "cloud.npy", ReadingOptions(spacing=(0.05, 0.05, 0.04)))


def test_an_array_without_units_is_taken_for_a_cloud_only_if_it_may_be_one(tmp_path):
    np.save(tmp_path / "cloud.npy", WATER * 0.15)  # m^-1
    options = {"spacing": (0.05, 0.05, 0.04)}
    with pytest.raises(DataError, match="likely m-1, or say --units"):
        read_cloud(tmp_path / "cloud.npy", ReadingOptions(**options))
    assert_is_the_cloud(read_cloud(tmp_path / "cloud.npy", ReadingOptions(**options, units="m-1")))


# ---- the command


def test_the_summary_says_what_was_read_as_what(tmp_path, capsys):
    data = mixed().assign(reff=(("x", "y", "z"), np.where(WATER > 0, 10.0, np.nan)))
    data.isel(z=slice(None, None, -1)).to_netcdf(tmp_path / "les.nc")
    assert main(["cloud", str(tmp_path / "les.nc")]) == 0
    rows = [line.split(None, 3) for line in capsys.readouterr().out.splitlines()]
    said = "\n".join(" ".join(row) for row in rows)
    for line in (
        "liquid water content ql, g kg-1 (stated); none missing",
        "air density rho, kg m-3 (stated); none missing",
        "radius of droplets reff, um (guessed); 118 of 120 missing, none of them in the cloud",
        "z z, m (stated), 0.02 to 0.14 km, turned: falls in the file",
    ):
        assert line in said


def test_the_command_chooses_members_and_calls_missing_values_clear(tmp_path, capsys):
    data = les(with_missing(False))
    data["lwc"] = data.lwc.expand_dims(member=2)
    data.to_netcdf(tmp_path / "les.nc")
    command = ["cloud", str(tmp_path / "les.nc"), "--effective-radius", "10", "--select", "member=1"]
    assert main(command) == 2
    assert main([*command, "--missing", "clear"]) == 0
    assert "1 of 120 missing, taken as clear" in capsys.readouterr().out
    assert main([*command, "--select", "member"]) == 2
    assert "write for instance --select member=3" in capsys.readouterr().err


@pytest.mark.parametrize("option", ["--time 1", "--units g", "--order zyx", "--missing clear", "--layer 0.1"])
def test_options_of_files_are_refused_with_generated_clouds(tmp_path, capsys, option):
    command = ["cloud", "--generate", "cumulus", "--output", str(tmp_path / "cloud.nc"), *option.split()]
    assert main(command) == 2
    assert "belongs to FILE, not to --generate" in capsys.readouterr().err and not list(tmp_path.iterdir())


# ---- many forms of one cloud


@pytest.mark.parametrize("name", ["fuzz_netcdf", "fuzz_images"])
def test_no_form_of_a_file_is_misread(tmp_path, monkeypatch, name):
    """A hundred files that scripts/fuzz_netcdf.py and fuzz_images.py draw; the scripts draw thousands."""
    monkeypatch.syspath_prepend(Path(__file__).parents[2] / "scripts")
    fuzz = importlib.import_module(name)
    results = []
    for number in range(100):
        writer = fuzz.Writer(random.Random(f"0 {number}"))
        path = tmp_path / f"{number}.nc"
        writer.write(path)
        result, why = fuzz.outcome(path, writer)
        assert result != "wrong" and not (result == "refused" and writer.complete), f"case {number}: {why}"
        results.append(result)
    assert 40 < results.count("right") < 95


def test_half_a_file_is_not_filled_up(tmp_path):
    """What was never written is the netCDF library's fill value, and missing."""
    les().to_netcdf(tmp_path / "whole.nc")
    with netCDF4.Dataset(tmp_path / "half.nc", "w") as file:
        for axis, count, step in zip("xyz", WATER.shape, (50, 50, 40)):
            file.createDimension(axis, count)
            file.createVariable(axis, "f8", (axis,))[:] = (np.arange(count) + 0.5) * step
            file[axis].units = "m"
        file.createVariable("lwc", "f4", ("x", "y", "z"))[:3] = WATER[:3]
        file["lwc"].units = "g m-3"
    with pytest.raises(DataError, match="missing in 60 of 120 voxels"):
        read_cloud(tmp_path / "half.nc", RADIUS)
