"""The command line: files, messages, exit status."""

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from cloudtomo_cl import commands
from cloudtomo_cl.cli import main
from cloudtomo_cl.config import read_reconstruct_settings, read_render_settings
from cloudtomo_cl.config import views as expanded
from cloudtomo_cl.grid import Grid
from cloudtomo_cl.io import read_extinction, write_extinction, write_rays
from cloudtomo_cl.optimizer import Optimizer
from cloudtomo_cl.prior import Prior
from cloudtomo_cl.sensors import RayView

SCENE = """
[cloud]
file = "cloud.nc"
phase_function = { type = "henyey-greenstein", g = 0.5 }
[surface]
albedo = 0.1
[sun]
zenith = 30.0
[[view]]
type = "perspective"
position = [2.0, 0.2, 1.5]
target = [0.3, 0.3, 0.3]
field_of_view = 40.0
pixels = [6, 4]
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
[[stage]]
grid = [6, 6, 6]
samples = 8
iterations = 3
"""
GENERATE = "cloud --generate cumulus --shape 8 8 8 --spacing 0.1 0.1 0.1 --seed 1 --output".split()


def write_inputs(folder):
    """A cloud of 6 x 6 x 6 voxels, a scene file and a run file."""
    extinction = np.zeros((6, 6, 6), np.float32)
    extinction[2:4, 2:4, 2:5] = 8.0
    write_extinction(folder / "cloud.nc", Grid((6, 6, 6), (0.1, 0.1, 0.1)), extinction)
    (folder / "scene.toml").write_text(SCENE)
    (folder / "run.toml").write_text(RUN)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """The working folder, with the inputs."""
    write_inputs(tmp_path)
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture(scope="module")
def rendered(tmp_path_factory):
    """Images of the cloud, rendered once, as bytes."""
    folder = tmp_path_factory.mktemp("rendered")
    write_inputs(folder)
    output = folder / "images.nc"
    assert main(["render", str(folder / "scene.toml"), "--samples", "16", "--quiet", "--output", str(output)]) == 0
    return output.read_bytes()


def fails(capsys, *arguments):
    """The message of a command that must fail with exit status 2 and no traceback."""
    assert main([str(argument) for argument in arguments]) == 2
    message = capsys.readouterr().err
    assert "Traceback" not in message
    return message


@pytest.mark.parametrize("module", ["pyopencl", "xarray", "matplotlib", "scipy.ndimage"])
def test_help_waits_for_no_slow_import(module):
    code = f"import sys, cloudtomo_cl.cli as c; c.parser().format_help(); sys.exit({module!r} in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], timeout=60).returncode == 0


@pytest.mark.parametrize("command", ["devices", "cloud", "init", "render", "reconstruct", "report", "validate"])
