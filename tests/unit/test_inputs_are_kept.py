"""No command writes over a file that it reads, also where it may replace files."""

import os

import numpy as np
import pytest

import cloudtomo_cl as ct
from cloudtomo_cl.commands.cli import main
from cloudtomo_cl.settings.inputs import input_files

GRID = ct.Grid(shape=(4, 4, 4), spacing=(0.1, 0.1, 0.1))
SCENE = """
[cloud]
file = "cloud.nc"
phase_function = { type = "table", file = "mie.nc" }
[sun]
zenith = 30.0
[[view]]
type = "rays"
file = "rays.nc"
"""
RUN = """
[measurements]
file = "run/modelled.nc"
[truth]
file = "cloud.nc"
[prior]
file = "prior.nc"
"""
ALIASES = {"the file itself": None, "a symbolic link": os.symlink, "a hard link": os.link}


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    extinction = np.zeros(GRID.shape, np.float32)
    extinction[1:3, 1:3, 1:3] = 10.0
    ct.write_extinction("cloud.nc", GRID, extinction)
    isotropic = ct.TabulatedPhaseFunction((0.0, 90.0, 180.0), (((1 / (4 * np.pi),) * 3),), (10.0,), (1.0,))
    ct.write_phase_function("mie.nc", ct.DropletTable(isotropic, (2.1,), 672.0, 0.1, 1.33, 1e-8))
    ct.write_rays("rays.nc", ct.RayView(np.array([[0.2, 0.2, 2.0]]), np.array([[0.0, 0.0, -1.0]])))
    (tmp_path / "scene.toml").write_text(SCENE)
    (tmp_path / "run.toml").write_text(RUN)
    (tmp_path / "run").mkdir()
    return tmp_path


def refused(folder, capsys, *words):
    """The message of a command that must fail and leave everything as it was."""
    before = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    assert main(list(words)) == 2
    assert {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()} == before
    return capsys.readouterr().err


@pytest.mark.parametrize("alias", ALIASES.values(), ids=ALIASES)
@pytest.mark.parametrize("name", ["cloud.nc", "mie.nc", "rays.nc"])
def test_render_keeps_what_its_scene_names(folder, capsys, name, alias):
    output = name
    if alias is not None:
        output = "other.nc"
        alias(folder / name, folder / output)
    said = refused(folder, capsys, "render", "scene.toml", "--output", output, "--overwrite")
    assert f"{output}: this command reads it" in said and "would write over it: choose another --output" in said


@pytest.mark.parametrize(
    "words",
    [
        "flux scene.toml --set boundary.horizontal=periodic --output cloud.nc",
        "cloud cloud.nc --coarsen 2 2 2 --output cloud.nc",
        "cloud cloud.nc --vti cloud.vti",
        "init render --cloud cloud.nc --output cloud.nc",
        "init reconstruct --measurements cloud.nc --output cloud.nc",
        "init reconstruct --measurements images.nc --truth cloud.nc --output cloud.nc",
        "prior learn cloud.nc --output cloud.nc",
    ],
)
def test_other_commands_keep_what_they_read(folder, capsys, words):
    os.link(folder / "cloud.nc", folder / "cloud.vti")
    assert "cloud.nc, and would write over it" in refused(folder, capsys, *words.split(), "--overwrite").replace(
        "reads it, and", "reads it as cloud.nc, and"
    )


def test_a_scene_that_a_file_keeps_is_not_replaced_by_its_images(folder, capsys):
    for name in ("images.nc", "fluxes.nc"):
        command = "render" if name == "images.nc" else "flux"
        many = ["--samples", "2"] if command == "render" else ["--photons", "100"]
        periodic = ["--set", "boundary.horizontal=periodic"]
        assert main([command, "scene.toml", *many, *periodic, "--output", name, "--quiet"]) == 0
        assert f"{name}: this command reads it, and" in refused(
            folder, capsys, command, name, "--output", name, "--overwrite"
        )


@pytest.mark.parametrize("option", ["--overwrite", "--resume"])
def test_a_run_keeps_its_measurements(folder, capsys, option):
    words = ["--set", "boundary.horizontal=periodic", "--samples", "2", "--output", "run/modelled.nc", "--quiet"]
    assert main(["render", "scene.toml", *words]) == 0
    words = ["reconstruct", "run.toml", "--output", "run", "--set", "prior={}", option]
    assert "modelled.nc: this command reads it, and would write over it" in refused(folder, capsys, *words)


def test_all_files_that_settings_name_are_found(folder):
    (folder / "prior.nc").touch()
    named = {path.name for path in input_files(folder / "run.toml", ["view=[{type='rays', file='rays.nc'}]"])}
    assert named == {"run.toml", "modelled.nc", "cloud.nc", "prior.nc", "rays.nc"}
    assert input_files(folder / "cloud.nc") == (folder / "cloud.nc",)
