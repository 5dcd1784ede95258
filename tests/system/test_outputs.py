"""What the commands write opens in xarray, tells all units, and where it comes from."""

import json

import numpy as np
import pytest
import xarray as xr

from cloudtomo_cl.commands.cli import main
from cloudtomo_cl.files.measurements import write_rays
from cloudtomo_cl.files.phase import write_phase_function
from cloudtomo_cl.scene.droplets import DropletTable
from cloudtomo_cl.scene.phase import TabulatedPhaseFunction
from cloudtomo_cl.scene.sensors import RayView

SCENE = """
[cloud]
file = "cloud.nc"
phase_function = { type = "henyey-greenstein", g = 0.5 }
[sun]
zenith = 30.0
[[view]]
type = "orthographic"
zenith = 20.0
azimuth = 10.0
width = 1.0
pixels = [8, 8]
[[view]]
type = "rays"
file = "rays.nc"
"""
RUN = """
[measurements]
file = "images.nc"
[run]
uncertainty = 2
[[stage]]
grid = [6, 6, 6]
samples = 8
iterations = 2
"""
WATER = "# rico\n3 3 3\n0.1 0.1 0.1 0.2 0.3\n1 1 1 0.3 8.0\n1 1 2 0.5 9.0\n"
# Where from: every file; how to do it again: all but what has no settings.
ABOUT = {"Conventions", "source", "versions", "settings"}


@pytest.fixture(scope="module")
def outputs(tmp_path_factory):
    """The folder in which every command has written what it writes."""
    folder = tmp_path_factory.mktemp("outputs")
    (folder / "scene.toml").write_text(SCENE)
    (folder / "run.toml").write_text(RUN)
    (folder / "water.txt").write_text(WATER)
    down = RayView(origins=np.array([[0.3, 0.3, 2.0], [0.4, 0.3, 2.0]]), directions=np.array([[0.0, 0.0, -1.0]] * 2))
    write_rays(folder / "rays.nc", down)
    angle = (0.0, 90.0, 180.0)
    table = TabulatedPhaseFunction(angle, (((1 / (4 * np.pi),) * 3),) * 2, (5.0, 10.0), (1.0, 0.99))
    write_phase_function(folder / "mie.nc", DropletTable(table, (2.1, 2.2), 672.0, 0.1, 1.33, 1e-8))
    make = "cloud --generate cumulus --shape 6 6 6 --spacing 0.1 0.1 0.1 --output cloud.nc"
    periodic = """--set boundary.horizontal="periodic" """
    commands = [
        make,
        "cloud water.txt --output radius.nc",
        "render scene.toml --samples 8 --output images.nc",
        f"flux scene.toml --photons 5000 --seed 3 --output fluxes.nc {periodic}",
        "reconstruct run.toml --output run --no-report",
    ]
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        for command in commands:
            assert main([*command.split(), "--quiet"]) == 0
    return folder


@pytest.mark.parametrize(
    "name",
    [
        *("cloud.nc", "radius.nc", "rays.nc", "mie.nc"),
        *("images.nc", "fluxes.nc", "run/reconstruction.nc", "run/modelled.nc"),
    ],
)
def test_every_variable_and_coordinate_has_a_unit(outputs, name):
    with xr.open_dataset(outputs / name) as dataset:
        assert len(dataset.variables) > 2
        # Bounds are described by what they bound.
        own = [name for name in dataset.variables if not name.endswith("_bounds")]
        assert not [name for name in own if "units" not in dataset[name].attrs]
        # Nor is there a dimension without a name and a meaning.
        assert not [name for name in own if "long_name" not in dataset[name].attrs]


@pytest.mark.parametrize(
    "name", ["cloud.nc", "images.nc", "fluxes.nc", "run/reconstruction.nc", "run/modelled.nc", "radius.nc"]
)
def test_every_file_says_where_it_comes_from(outputs, name):
    with xr.open_dataset(outputs / name) as dataset:
        assert set(dataset.attrs) >= ABOUT | (set() if name in ("cloud.nc", "radius.nc") else {"device"})
        assert "numpy" in json.loads(dataset.attrs["versions"])


@pytest.mark.parametrize(
    ("command", "name", "variable"),
    [("render", "run/modelled.nc", "radiance"), ("flux", "fluxes.nc", "reflected")],
)
def test_it_is_computed_again_from_its_own_file_alone(outputs, tmp_path, command, name, variable):
    alone, again = tmp_path / "alone.nc", tmp_path / "again.nc"
    alone.write_bytes((outputs / name).read_bytes())
    assert main([command, str(alone), "--quiet", "--output", str(again)]) == 0
    with xr.open_dataset(alone) as first, xr.open_dataset(again) as second:
        assert np.array_equal(first[variable], second[variable], equal_nan=True) and first[variable].max() > 0


def test_without_a_report_there_are_no_figures_until_it_is_asked_for(outputs):
    run = outputs / "run"
    assert not (run / "report.html").exists() and not list((run / "figures").iterdir())
    assert main(["report", str(run), "--quiet"]) == 0
    assert (run / "report.html").exists() and (run / "figures" / "comparison.pdf").exists()


def test_a_run_that_its_time_limit_ended_says_so(outputs, tmp_path):
    words = ["--quiet", "--no-report", "--output", str(tmp_path / "run"), "--set", "run.time_limit=1e-3"]
    assert main(["reconstruct", str(outputs / "run.toml"), *words]) == 0
    with xr.open_dataset(tmp_path / "run" / "reconstruction.nc") as dataset:
        assert dataset.attrs["state"] == "stopped by its time limit in stage 1 of 1, iteration 1"
    with xr.open_dataset(outputs / "run" / "reconstruction.nc") as dataset:
        assert dataset.attrs["state"] == "complete"


def test_a_run_without_a_standard_error_says_so(outputs, tmp_path, capsys):
    """On the terminal, in the file, and on the page."""
    run = tmp_path / "run"
    assert main(["reconstruct", str(outputs / "run.toml"), "--output", str(run), "--set", 'solver.type="adam"']) == 0
    reason = "Adam does not tell it"
    assert reason in " ".join(capsys.readouterr().out.split())
    with xr.open_dataset(run / "reconstruction.nc") as dataset:
        assert reason in dataset.attrs["no_standard_error"]
    assert reason in (run / "report.html").read_text(encoding="utf-8")


def test_a_run_with_a_broken_pixel_names_it(outputs, tmp_path, monkeypatch, capsys):
    """On the terminal, in the file, and on the page."""
    monkeypatch.chdir(tmp_path)
    for name in ("scene.toml", "run.toml", "cloud.nc", "rays.nc"):
        (tmp_path / name).write_bytes((outputs / name).read_bytes())
    sharp = "view[0].pixels=[24, 24]"
    assert main(["render", "scene.toml", "--samples", "64", "--output", "right.nc", "--quiet", "--set", sharp]) == 0
    with xr.open_dataset("right.nc") as images:
        first = next(name for name in images.data_vars if name.startswith("radiance") and images[name].ndim > 1)
        radiance = images[first].values.copy()
        radiance[(0, 12, 11)[-radiance.ndim :]] = 50 * np.nanmax(radiance)
        images.assign({first: (images[first].dims, radiance, images[first].attrs)}).to_netcdf("images.nc")
    assert main(["reconstruct", "run.toml", "--output", "run", "--seed", "2"]) == 0
    named = "hardly counted: row 12, column 11 of view 0"
    assert named in " ".join(capsys.readouterr().out.split())
    with xr.open_dataset("run/reconstruction.nc") as dataset:
        assert named in dataset.attrs["outliers"]
    assert named in (tmp_path / "run" / "report.html").read_text(encoding="utf-8")
