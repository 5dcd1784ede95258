"""Files as other programs write them: read as the cloud or the images that they hold, or refused with what to do."""

import os
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from cloudtomo_cl.clouds.readers import ReadingOptions, read_cloud
from cloudtomo_cl.commands.cli import main
from cloudtomo_cl.errors import DataError
from cloudtomo_cl.files.measurements import measurements_dataset, read_measurements
from cloudtomo_cl.scene.measurements import Measurements
from cloudtomo_cl.scene.sensors import OrthographicView

# Columns of 50 m, layers of 40 m; water of 0.3 and 0.6 g m^-3 in one column, droplets of 10 um: 45 and 90 km^-1.
WATER = np.zeros((6, 5, 4))
WATER[2, 1, 1:3] = 0.3, 0.6
DEPTH, MASS = 5.4, (45 + 90) * 0.05 * 0.05 * 0.04
AIR = 0.8
X, Y, Z = ((np.arange(count) + 0.5) * step for count, step in zip(WATER.shape, (50.0, 50.0, 40.0)))
ZYX = WATER.transpose(2, 1, 0)
RADIUS = {"effective_radius": 10.0}


def field(name, dims, values, coordinates, others=None, **attributes):
    variables = {name: (dims, values, attributes), **(others or {})}
    return xr.Dataset(variables, coordinates)


def metres(x="x", y="y", z="z", units="m", factor=1.0, **attributes):
    """Coordinates of these names."""
    return {name: (name, values * factor, {"units": units, **attributes}) for name, values in ((x, X), (y, Y), (z, Z))}


def sam(profile=True):
    """SAM's 3-D file: condensate in g/kg, pressure beside heights; air's density only where somebody adds it."""
    others = {"p": ("z", 900.0 - Z / 10, {"units": "mb", "long_name": "Pressure"})}
    if profile:
        others["RHO"] = ("z", np.full(4, AIR), {"units": "kg/m3", "long_name": "Air density"})
    about = {"units": "g/kg", "long_name": "Non-precipitating Condensate (Water+Ice)"}
    return field("QN", ("time", "z", "y", "x"), ZYX[None] / AIR, metres(), others, **about)


def ucla():
    """UCLA-LES: x and y between z, two times, half levels, a base state."""
    values = WATER.transpose(1, 0, 2)[None] * np.array([0.5, 1.0])[:, None, None, None] / AIR / 1e3
    faces = {"zm": ("zm", Z + 20.0, {"units": "m"}), "time": ("time", [3600.0, 7200.0], {"units": "s"})}
    others = {"dn0": ("zt", np.full(4, AIR), {"units": "kg/m3", "long_name": "Base-state density"}),
              "q": (("time", "yt", "xt", "zt"), np.full(values.shape, 9e-3), {"units": "kg/kg"})}  # fmt: skip
    return field("l", ("time", "yt", "xt", "zt"), values, {**metres("xt", "yt", "zt"), **faces}, others, units="kg/kg")


def dales():
    """DALES: whole numbers of 1e-5 kg/kg."""
    whole = np.round(ZYX[None] / AIR / 1e3 / 1e-5 * 8).astype(np.int16)
    others = {"rhobf": ("zt", np.full(4, AIR * 1.0), {"units": "kg/m^3", "long_name": "Base-state density"})}
    about = {"units": "1e-5kg/kg", "long_name": "Liquid water specific humidity", "scale_factor": 0.125}
    return field("ql", ("time", "zt", "yt", "xt"), whole, metres("xt", "yt", "zt"), others, **about)


def cm1(dims=("zh", "yh", "xh")):
    """CM1: everything in km; or dimensions of other names than their coordinates."""
    others = {"rho": (("time", *dims), np.full((1, *ZYX.shape), AIR), {"units": "kg/m^3"}),
              "qv": (("time", *dims), np.full((1, *ZYX.shape), 9e-3), {"units": "kg/kg"})}  # fmt: skip
    coordinates = metres("xh", "yh", "zh", "km", 1e-3)
    if dims[0] != "zh":
        coordinates = {name: (dim, *rest) for (name, (_, *rest)), dim in zip(coordinates.items(), dims[::-1])}
    about = {"units": "kg/kg", "long_name": "mixing ratio of cloud water"}
    return field("qc", ("time", *dims), ZYX[None] / AIR / 1e3, coordinates, others, **about)


def palm(fill):
    """PALM: a level below the ground first, and fill values within the topography."""
    values = np.concatenate([np.full((1, *ZYX.shape[1:]), fill), ZYX / AIR / 1e3])[None]
    heights = np.concatenate([[-20.0], Z])
    coordinates = {**metres(units="m"), "zu_3d": ("zu_3d", heights, {"units": "meters"})}
    del coordinates["z"]
    others = {"rho_air": ("zu_3d", np.full(5, AIR), {"units": "kg/m3"})}
    data = field("ql", ("time", "zu_3d", "y", "x"), values, coordinates, others, units="kg/kg")
    data.ql.attrs["_FillValue"] = -9999.0
    return data


def wrf(air=True):
    """WRF: no coordinates, heights in two potentials on half levels."""
    dims = ("Time", "bottom_top", "south_north", "west_east")
    half = ("Time", "bottom_top_stag", "south_north", "west_east")
    others = {"PH": (half, np.zeros((1, 5, 5, 6)), {"units": "m2 s-2"}),
              "PHB": (half, np.full((1, 5, 5, 6), 9.81), {"units": "m2 s-2"}),
              "ALT": (dims, np.full((1, *ZYX.shape), 1 / AIR), {"units": "m3 kg-1"})}  # fmt: skip
    if air:
        others["RHO"] = (dims, np.full((1, *ZYX.shape), AIR), {"units": "kg m-3", "description": "dry air density"})
    about = {"units": "kg kg-1", "description": "Cloud water mixing ratio", "MemoryOrder": "XYZ"}
    data = field("QCLOUD", dims, ZYX[None] / AIR / 1e3, {}, others, **about)
    return data.assign_attrs(DX=50.0, DY=50.0)


def degrees(name, units, vertical):
    """COSMO and ERA5: turned or geographic degrees, and levels or pressures."""
    coordinates = {
        "lon": ("lon", X / 1e5, {"units": "degrees_east"}),
        "lat": ("lat", Y / 1e5, {"units": "degrees_north"}),
    }
    return field(name, ("lev", "lat", "lon"), ZYX / 1e3, {**coordinates, "lev": ("lev", *vertical)}, units=units)


def icon():
    """ICON: cells without an order, levels counted from the top."""
    values = ZYX.reshape(4, 30)[::-1] / 1e3
    level = ("height", np.arange(1.0, 5.0), {"axis": "Z", "positive": "down", "standard_name": "height"})
    return field("clw", ("height", "ncells"), values, {"height": level}, units="kg kg-1")


def monc():
    """MONC: no units anywhere, and numbers along x and y."""
    others = {"rhon": ("zn", np.full(4, AIR)), "zn": ("zn", Z)}
    return field("q_cloud_liquid_mass", ("time_series_300_300", "x", "y", "zn"), WATER[None] / AIR / 1e3, {}, others)


def mitgcm():
    """An ocean model's axes: depths below zero."""
    coordinates = {**metres(), "z": ("z", -Z[::-1] - 100.0, {"units": "m", "positive": "up", "axis": "Z"})}
    return field("lwc", ("z", "y", "x"), ZYX, coordinates, units="g m-3")


def at3d():
    """AT3D's own: density in g/m^3, droplets' sizes where there are some."""
    others = {"reff": (("x", "y", "z"), np.where(WATER > 0, 10.0, np.nan), {"units": "micron"}),
              "veff": (("x", "y", "z"), np.where(WATER > 0, 0.1, np.nan)),
              "delx": ((), 0.05), "dely": ((), 0.05)}  # fmt: skip
    coordinates = {name: (name, values[1] / 1e3) for name, values in metres().items()}
    about = {"units": "g/m^3", "long_name": "liquid water content"}
    return field("density", ("x", "y", "z"), WATER, coordinates, others, **about)


BOX = {"spacing": (0.05, 0.05, 0.04)}
CASES = {
    "SAM": (sam, RADIUS, None),
    "SAM without air": (lambda: sam(False), RADIUS, "QN is a mixing ratio, which needs the density of air"),
    "UCLA-LES": (ucla, {**RADIUS, "time": 1}, None),
    "UCLA-LES, two times": (ucla, RADIUS, "l has 2 steps of time"),
    "DALES": (dales, RADIUS, None),
    "CM1": (cm1, RADIUS, None),
    "CM1, old": (lambda: cm1(("nk", "nj", "ni")), RADIUS, "ni has no coordinate: add --spacing"),
    "CM1, old, spacing": (lambda: cm1(("nk", "nj", "ni")), RADIUS | BOX, None),
    "PALM": (lambda: palm(0.0), RADIUS, None),
    "PALM, topography": (lambda: palm(-9999.0), RADIUS, "missing in 30 of 150 voxels"),
    "PALM, clear": (lambda: palm(-9999.0), RADIUS | {"missing": "clear"}, None),
    "WRF": (wrf, RADIUS, "west_east has no coordinate: add --spacing"),
    "WRF, spacing": (wrf, RADIUS | BOX, None),
    "WRF without air": (lambda: wrf(False), RADIUS | BOX, "needs the density of air"),
    "COSMO": (
        lambda: degrees("QC", "kg kg-1", (np.arange(4.0), {"standard_name": "model_level_number"})), RADIUS, "an angle"
    ),
    "ERA5": (lambda: degrees("clwc", "kg kg**-1", (900.0 - Z, {"units": "millibars"})), RADIUS, "an angle|pressure"),
    "ICON": (icon, RADIUS, "ncells|3|no variable"),
    "MONC": (monc, RADIUS, "--variable"),
    "MONC, chosen": (monc, RADIUS | {"variable": "q_cloud_liquid_mass"}, "has no units"),
    "MITgcm": (mitgcm, RADIUS, "below the ground"),
    "AT3D": (at3d, {}, None),
}  # fmt: skip


@pytest.mark.parametrize("case", CASES)
def test_a_models_file_is_the_cloud_or_refused(tmp_path, case):
    make, options, refusal = CASES[case]
    data = make()
    data.to_netcdf(tmp_path / "cloud.nc")
    for source in (data, tmp_path / "cloud.nc"):
        if refusal is not None:
            with pytest.raises(DataError, match=refusal):
                read_cloud(source, ReadingOptions(**options))
            continue
        cloud = read_cloud(source, ReadingOptions(**options))
        assert cloud.optical_depth.max() == pytest.approx(DEPTH, rel=2e-3)
        assert cloud.extinction.sum() * cloud.grid.voxel_volume == pytest.approx(MASS, rel=2e-3)
        place = np.unravel_index(np.argmax(cloud.extinction), cloud.grid.shape)
        centre = [cloud.grid.centres(axis)[index] for axis, index in enumerate(place)]
        assert centre == pytest.approx([0.125, 0.075, 0.1], abs=1e-6)


TEXTS = {
    "pyshdom": ("# comment\n6 5 4\n0.05 0.05 0.02 0.06 0.1 0.14\n2 1 1 0.3 10\n2 1 2 0.6 10\n", None),
    "AT3D": ("6,5,4 # nx,ny,nz\n.05,.05 # dx,dy\n.02,.06,.1,.14\nx,y,z,lwc,reff,veff\n2,1,1,.3,10,.1\n2,1,2,.6,10,.1\n",
             None),
    "SHDOM": ("2 parameter LWC file\n6 5 4\n.05 .05\n.02 .06 .1 .14\n280 279 278 277\n3 2 2 .3 10\n3 2 3 .6 10\n",
              None),
    "Fortran": ("6 5 4\n5.0D-2 5.0D-2 2.0D-2 6.0D-2 1.0D-1 1.4D-1\n2 1 1 3.0D-1 1.0D+1\n2 1 2 6.0D-1 1.0D1\n", None),
    "semicolons": ("6;5;4\n0,05;0,05;0,02;0,06;0,1;0,14\n2;1;1;0,3;10\n2;1;2;0,6;10\n", None),
    "metres": ("6 5 4\n50 50 20 60 100 140\n2 1 1 0.3 10\n", "in km, not in metres"),
    "other columns": ("6,5,4\n.05,.05\n.02,.06,.1,.14\nx,y,z,reff,lwc\n2,1,1,10,.3\n2,1,2,10,.6\n", None),
    "kg": ("6,5,4\n.05,.05\n.02,.06,.1,.14\nx,y,z,lwc [kg m-3],reff\n2,1,1,.0003,10\n", "must be in g m-3"),
    "twice": ("6 5 4\n.05 .05 .02 .06 .1 .14\n2 1 1 .3 10\n2 1 1 .3 10\n", "line 4.*stands on line 3"),
    "no radius": ("6 5 4\n.05 .05 .02 .06 .1 .14\n2 1 1 .3 nan\n", "effective radius is missing"),
    "property file": ("Tabulated phase function property file\n6 5 4\n", "line 1"),
}  # fmt: skip


@pytest.mark.parametrize("case", TEXTS)
@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16"])
def test_a_text_is_the_cloud_or_refused(tmp_path, case, encoding):
    text, refusal = TEXTS[case]
    (tmp_path / "cloud.txt").write_text(text, encoding)
    if refusal is not None:
        with pytest.raises(DataError, match=refusal):
            read_cloud(tmp_path / "cloud.txt")
        return
    cloud = read_cloud(tmp_path / "cloud.txt")
    assert cloud.optical_depth[2, 1] == pytest.approx(DEPTH) and cloud.extinction[2, 1, 2] == pytest.approx(90.0)
    assert cloud.extinction.sum() * cloud.grid.voxel_volume == pytest.approx(MASS)


# ---- images


def images(**attributes):
    """A view of 4 x 3 pixels; the radiance as whole numbers, as satellites' files have it."""
    view = OrthographicView(width=1.2, zenith=40.0, azimuth=90.0, pixels=(4, 3))
    radiance = 10.0 + np.arange(12.0).reshape(3, 4)
    data = measurements_dataset(Measurements((view,), (radiance,), (np.ones((3, 4)),)))
    counts = np.round(data.radiance.values * 100).astype(np.uint16)
    counts[0, 1, 2] = 65535
    return radiance, data.assign(radiance=(data.radiance.dims, counts, {"units": "W m-2 sr-1", **attributes}))


def test_counts_with_a_scale_are_radiances():
    radiance, data = images(scale_factor=0.01, _FillValue=np.uint16(65535), valid_range=np.array([0, 32767], "u2"))
    read = read_measurements(data).images[0]
    assert np.isnan(read[1, 2])
    np.testing.assert_allclose(np.delete(read.ravel(), 6), np.delete(radiance.ravel(), 6))


@pytest.mark.parametrize("name", ["radiance_scales", "radiance_offsets", "Scale", "slope", "gain"])
def test_counts_with_a_scale_of_another_name_are_refused(name):
    """MODIS has (counts - radiance_offsets) * radiance_scales: nothing that anybody could guess."""
    _, data = images(**{name: 0.01, "_FillValue": np.uint16(65535)})
    with pytest.raises(DataError, match=f"radiance has the attribute {name}"):
        read_measurements(data)


def test_a_cloud_in_counts_with_a_scale_of_another_name_is_refused():
    counts = np.round(WATER * 100).astype(np.int16)
    with pytest.raises(DataError, match="lwc has the attribute slope"):
        read_cloud(field("lwc", ("x", "y", "z"), counts, metres(), units="g m-3", slope=0.01), ReadingOptions(**RADIUS))


# ---- the files that were misread once, where they are at hand

FOLDER = Path(os.environ.get("CLOUDTOMO_DATA", Path(__file__).resolve().parents[3] / "shared" / "data")) / "misread"
ONCE_MISREAD = {
    "masked_inside.nc": (RADIUS, "missing in 1 of 120 voxels"),
    "rho_fill.nc": (RADIUS | {"time": 0}, "air density is missing"),
    "nan.txt": ({}, "missing in 1 of 27 voxels"),
    "cloud_rnan.nc": ({}, "effective radius is missing"),
    "empty_units.nc": (RADIUS, "x has no units"),
    "stale_bounds.nc": (RADIUS, "z_bnds, the bounds of z"),
    "level_index_top_down.nc": (RADIUS, "height has no units"),
    "density_and_ql.nc": (RADIUS, 0.04275),
    "rho_half_levels.nc": (RADIUS | {"time": 0}, "zm"),
    "reff_no_units_m.nc": ({}, "likely m"),
    "coordinates.txt": ({}, "line 4, column 1: 0.05 is no whole number"),
    "at3d_header_comments.csv": ({}, 0.0135),
    "at3d_ijk.csv": ({}, 0.0135),
    "coord_20GB.nc": ({}, "claims 640 GB"),
    "int_scale_factor.nc": ({}, 0.9695),
}


@pytest.mark.parametrize("name", ONCE_MISREAD)
def test_a_file_that_was_misread_is_right_or_refused(name):
    if not (FOLDER / name).is_file():
        pytest.skip(f"{name} is not in {FOLDER}")
    options, expected = ONCE_MISREAD[name]
    if isinstance(expected, str):
        with pytest.raises(DataError, match=expected):
            read_cloud(FOLDER / name, ReadingOptions(**options))
        return
    cloud = read_cloud(FOLDER / name, ReadingOptions(**options))
    assert cloud.extinction.sum() * cloud.grid.voxel_volume == pytest.approx(expected, rel=1e-3)


@pytest.mark.parametrize(
    ("name", "said"), [("ring_1e8.toml", "count"), ("s_rnan.toml", "effective radius is missing"), ("bom.toml", None)]
)
def test_settings_that_were_misread_are_answered(tmp_path, capsys, name, said):
    if not (FOLDER / name).is_file():
        pytest.skip(f"{name} is not in {FOLDER}")
    for file in FOLDER.iterdir():
        (tmp_path / file.name).symlink_to(file)
    cloud = tmp_path / "cloud.nc"
    if not cloud.exists():
        main(["cloud", "--generate", "cumulus", "--shape", "8", "8", "8", "--output", str(cloud), "--quiet"])
    command = ["render", str(tmp_path / name), "--samples", "2", "--output", str(tmp_path / "images.nc"), "--quiet"]
    assert main(command) == (0 if said is None else 2)
    assert said is None or said in capsys.readouterr().err


def test_images_that_were_misread_are_right():
    if not (FOLDER / "m_metres.nc").is_file():
        pytest.skip(f"m_metres.nc is not in {FOLDER}")
    in_metres = read_measurements(FOLDER / "m_metres.nc")
    assert in_metres.views[1].position == pytest.approx((0.4, 0.4, 2.9)) and in_metres.views[0].width < 2
    assert read_measurements(FOLDER / "m_valid_fill0.nc").invalid_pixels > 0
