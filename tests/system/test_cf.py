"""The files that are written follow the CF conventions, as IOOS's checker knows them."""

import re

import netCDF4
import numpy as np
import pytest
import xarray as xr

import cloudtomo_cl as ct
from cloudtomo_cl.commands.cli import main

# The one warning that is none (docs/reference/dependencies.md): the checker knows y and x by latitude and longitude, or
# by the attribute axis, and calls (z, y, x) out of order where they are projection_y_coordinate and
# projection_x_coordinate. VTK's reader takes axis for latitude and longitude.
ORDER = re.compile(r"(\w+)'s spatio-temporal dimensions are not in the recommended order T, Z, Y, X ")
SCENE = """
[cloud]
file = "cloud.nc"
[sun]
zenith = 30.0
[boundary]
horizontal = "periodic"
[[view]]
type = "orthographic"
zenith = 20.0
width = 0.6
pixels = [5, 5]
[[view]]
type = "push-broom"
start = [0.2, 0.0, 3.0]
end = [0.2, 0.5, 3.0]
field_of_view = 8.0
pixels = [4, 6]
"""
RUN = """
[measurements]
file = "images.nc"
[run]
uncertainty = 2
[solver]
inner_iterations = 5
[[stage]]
grid = [5, 5, 5]
samples = 8
iterations = 2
"""
FILES = (
    "cloud.nc",
    "images.nc",
    "fluxes.nc",
    "run/reconstruction.nc",
    "run/modelled.nc",
    "rays.nc",
    "lists.nc",
    "phase.nc",
    "spectrum.nc",
    "phases.nc",
    "water.nc",
    "prior.nc",
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Every kind of file that is written."""
    folder = tmp_path_factory.mktemp("cf")
    grid = ct.Grid((5, 5, 5), (0.1, 0.1, 0.1))
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        (folder / "scene.toml").write_text(SCENE)
        (folder / "run.toml").write_text(RUN)
        extinction = ct.cumulus(grid, seed=1)
        radius = np.where(extinction > 0, 10.0, np.nan)
        ct.write_extinction("cloud.nc", grid, extinction, {"source": "a test"}, radius)
        assert main("prior learn cloud.nc --components 1 --rounds 1 --quiet --output prior.nc".split()) == 0
        assert main("render scene.toml --samples 16 --quiet --output images.nc".split()) == 0
        assert main("flux scene.toml --photons 5000 --quiet --output fluxes.nc".split()) == 0
        assert main("reconstruct run.toml --quiet --output run --no-report".split()) == 0
        rays = ct.fisheye_rays((0.0, 0.0, 0.0), 4)[0]
        ones = np.ones(rays.pixels[::-1])
        ct.write_rays("rays.nc", rays)
        ct.write_measurements("lists.nc", ct.Measurements((rays,), (ones,), (0.1 * ones,), (0.02,)))
        function = ct.TabulatedPhaseFunction([0, 90, 180], [[1 / (4 * np.pi)] * 3] * 2, [5.0, 10.0], [1.0, 0.9])
        tables = [ct.DropletTable(function, (2.1, 2.0), wavelength, 0.1, 1.33, 0.0) for wavelength in (672.0, 2130.0)]
        ct.write_phase_function("phase.nc", tables[0])
        ct.write_phase_function("phases.nc", tables)
        ct.write_extinction("water.nc", grid, extinction, None, radius, wavelength=0.0)
        light = ["--set", 'cloud.phase_function={ type = "table", file = "phases.nc" }']
        light += ["--set", "spectrum.wavelengths=[672.0, 2130.0]"]
        assert main(["render", "scene.toml", "--samples", "16", "--quiet", "--output", "spectrum.nc", *light]) == 0
    return folder


@pytest.fixture(scope="module")
def checker():
    runner = pytest.importorskip("compliance_checker.runner", reason="compliance-checker is not installed")
    suite = runner.CheckSuite()
    suite.load_all_available_checkers()
    return suite


def passed(value):
    """A check is true or false, or a number of points out of some."""
    return value[0] == value[1] if isinstance(value, tuple) else bool(value)


def said(checker, path):
    """What the checker finds in a file, errors and warnings."""
    dataset = checker.load_dataset(str(path))
    results, errors = checker.run_all(dataset, ["cf:1.10"], [])["cf:1.10"]
    dataset.close()
    assert not errors
    return [message for result in results if not passed(result.value) for message in result.msgs]


@pytest.mark.parametrize("name", FILES)
def test_a_file_follows_the_conventions(folder, checker, name):
    messages = said(checker, folder / name)
    excused = [found[1] for found in map(ORDER.match, messages) if found]
    assert not [message for message in messages if not ORDER.match(message)]
    with xr.open_dataset(folder / name) as dataset:
        assert all(dataset[variable].dims[-3:] == ("z", "y", "x") for variable in excused)


@pytest.mark.parametrize("name", FILES)
def test_nothing_is_left_to_say_where_axes_are_named(folder, checker, name, tmp_path):
    """The same file with axis = X and Y: its dimensions are in order."""
    path = tmp_path / "named.nc"
    path.write_bytes((folder / name).read_bytes())
    with netCDF4.Dataset(path, "a") as dataset:
        for axis in {"x", "y"} & set(dataset.variables):
            dataset[axis].axis = axis.upper()
    assert said(checker, path) == []


@pytest.mark.parametrize("name", FILES)
def test_a_file_says_what_it_is_and_where_it_is_from(folder, name):
    with xr.open_dataset(folder / name) as dataset:
        assert dataset.attrs["title"] and "Cloud Tomography" in dataset.attrs["references"]
        assert "Z written by cloudtomo-cl " in dataset.attrs["history"]


def test_vectors_name_their_components_in_any_order(folder):
    with xr.open_dataset(folder / "images.nc") as dataset:
        loaded = dataset.load()
    assert loaded.component.values.tolist() == ["x", "y", "z"]
    turned = loaded.isel(axis=[2, 0, 1])
    assert ct.read_measurements(turned).views == ct.read_measurements(loaded).views


def test_bounds_have_the_units_of_their_coordinate(folder):
    with xr.open_dataset(folder / "cloud.nc") as dataset:
        assert dataset.x_bounds.attrs == {}
    assert ct.read_extinction(folder / "cloud.nc")[0] == ct.Grid((5, 5, 5), (0.1, 0.1, 0.1))
