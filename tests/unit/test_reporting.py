"""A report shows only what belongs to its result."""

import re
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from cloudtomo_cl.commands import reporting
from cloudtomo_cl.commands.cli import main
from cloudtomo_cl.commands.run_folder import RunFolder
from cloudtomo_cl.files.extinction import read_extinction, write_extinction
from cloudtomo_cl.scene.grid import Grid

SCENE = """
[cloud]
file = "cloud.nc"
[sun]
zenith = 30.0
[[view]]
type = "orthographic"
zenith = 0.0
width = 0.8
pixels = [5, 5]
"""
RUN = """
[measurements]
file = "images.nc"
[truth]
file = "cloud.nc"
[run]
uncertainty = 2
[solver]
inner_iterations = 5
[[stage]]
grid = [6, 6, 6]
samples = 8
iterations = 3
"""


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """The working folder, with a cloud, its images and a run file."""
    extinction = np.zeros((6, 6, 6), np.float32)
    extinction[2:4, 2:4, 2:5] = 8.0
    write_extinction(tmp_path / "cloud.nc", Grid((6, 6, 6), (0.1, 0.1, 0.1)), extinction)
    (tmp_path / "scene.toml").write_text(SCENE)
    (tmp_path / "run.toml").write_text(RUN)
    monkeypatch.chdir(tmp_path)
    assert main("render scene.toml --samples 16 --quiet --output images.nc".split()) == 0
    return tmp_path


def test_a_recovery_goes_to_viewers_with_what_is_known(folder, capsys):
    assert main("reconstruct run.toml --quiet --no-report --output run".split()) == 0
    assert main("report run --vti run.vti".split()) == 0
    head = (folder / "run.vti").read_bytes().partition(b"<AppendedData")[0].decode()
    names = re.findall(r'Name="(\w+)".*?UNITS_LABEL" location="vtkDataArray">([^<]*)<', head)
    assert names[:2] == [("extinction", "km-1"), ("true_extinction", "km-1")] and names[-1] == ("mask", "1")
    assert main("report run --vti run.vti".split()) == 2 and "run.vti: exists already" in capsys.readouterr().err


def test_a_report_has_images_of_the_cloud_it_shows(folder, capsys):
    """After a resume that was interrupted, modelled.nc is of an earlier iteration."""
    assert main("reconstruct run.toml --quiet --output run".split()) == 0
    with xr.load_dataset("run/reconstruction.nc") as dataset:
        dataset["extinction"] = dataset.extinction + 1.0
        dataset.attrs["iterations"] = 2
    dataset.to_netcdf("run/reconstruction.nc")
    reporting.make_report(RunFolder("run"), quiet=True)
    said = capsys.readouterr().err
    assert "modelled.nc has images of another cloud than the result" in said
    assert "the result is that of iteration 2, the history has 3: the later ones are left out" in said
    assert "modelled mean" not in Path("run/report.html").read_text()
    assert main(["report", "run"]) == 0
    assert "rendering the images of the recovered cloud" in capsys.readouterr().out
    assert np.array_equal(read_extinction("run/modelled.nc")[1], dataset.extinction.transpose("x", "y", "z"))
    assert "modelled mean" in Path("run/report.html").read_text()


def test_a_report_compares_with_no_other_truth(folder, capsys):
    assert main("reconstruct run.toml --quiet --no-report --output run".split()) == 0
    grid, extinction = read_extinction("cloud.nc")
    write_extinction("cloud.nc", grid, 2 * extinction)
    assert main(["report", "run"]) == 0 and "is not the truth that the run knew" in capsys.readouterr().err
    assert not Path("run/figures/scatter.png").exists()


def test_the_error_in_cloud_is_in_proportion_to_the_cloud(random):
    """No cloud's brightness is built in: one a hundred times as thin has its own number."""
    extinction = random.uniform(0, 60, (6, 6, 6)) * (random.random((6, 6, 6)) > 0.5)
    error = random.uniform(1, 5, extinction.shape)
    assert reporting._in_cloud(error / 100, extinction / 100) == pytest.approx(
        reporting._in_cloud(error, extinction) / 100
    )


def test_haze_is_no_cloud_that_an_error_is_told_of():
    extinction, error = np.full((4, 4, 4), 0.1), np.full((4, 4, 4), 9.0)
    extinction[1:3, 1:3, 1:3], error[1:3, 1:3, 1:3] = 50.0, 2.0
    assert reporting._in_cloud(error, extinction) == 2.0


def test_thin_clouds_have_a_typical_error():
    """Of 0.3 km^-1 at most."""
    grid = Grid((2, 2, 2), (0.1, 0.1, 0.1))
    extinction = np.array([0.0, 0.3] * 4).reshape(2, 2, 2)
    result = xr.Dataset({"extinction_standard_error": (("x", "y", "z"), np.full((2, 2, 2), 0.05))})
    history = {"cost": np.ones(1), "paths": np.ones(1), "seconds": np.ones(1)}
    shown = reporting._Shown(grid, extinction, result, {}, history)
    assert reporting._numbers(shown)["typical standard error in cloud"] == "0.05 km⁻¹"
