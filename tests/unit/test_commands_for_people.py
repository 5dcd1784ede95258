"""Budgets that add up, scenes that go on, blind tests, completion, schemas: what people meet on the command line."""

import json
import re
import subprocess

import numpy as np
import pytest
import xarray as xr

import cloudtomo_cl as ct
from cloudtomo_cl.commands import example
from cloudtomo_cl.commands.cli import COMMANDS, main
from cloudtomo_cl.settings.tables import read_reconstruct_settings

GRID = ct.Grid((6, 6, 6), (0.1, 0.1, 0.1))


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    extinction = ct.cumulus(GRID, seed=1)
    ct.write_extinction("cloud.nc", GRID, extinction, effective_radius=np.where(extinction > 0, 8.4, np.nan))
    assert main("init render --cloud cloud.nc --quiet".split()) == 0
    return tmp_path


def test_fluxes_of_the_scene_that_init_writes(folder, capsys):
    assert main("flux scene.toml --photons 2e4".split()) == 0
    told = capsys.readouterr()
    assert 'has no [boundary]: horizontal = "periodic" is taken' in told.err
    budget = re.findall(r"^(?:reflected|absorbed|surface) +([\d.]+)", told.out, flags=re.MULTILINE)
    incident = np.cos(np.radians(30))
    assert len(budget) == 3 and sum(map(float, budget)) == pytest.approx(incident, rel=1e-3)
    assert f"of {incident:.5f} W m^-2 that come in" in told.out


def test_fluxes_with_sides_that_somebody_has_opened_are_refused(folder, capsys):
    assert main(["flux", "scene.toml", "--photons", "100", "--set", 'boundary.horizontal="open"']) == 2
    assert "open sides over a reflecting surface" in capsys.readouterr().err


def test_init_says_what_becomes_of_the_droplets_radii(folder):
    text = (folder / "scene.toml").read_text()
    assert "# The file has its droplets' effective radii, 8.4 to 8.4 um" in text
    assert "cloudtomo mie --wavelength 672 --effective-radius 8 9 --count 2 --output mie.nc" in text
    ct.write_extinction("plain.nc", GRID, ct.cumulus(GRID, seed=1))
    assert main("init render --cloud plain.nc --output plain.toml --quiet".split()) == 0
    assert "radii" not in (folder / "plain.toml").read_text()


def test_blind_images_keep_nothing_of_the_cloud(folder):
    assert main("render scene.toml --samples 8 --seed 7 --blind --quiet --output images.nc".split()) == 0
    with xr.open_dataset("images.nc") as dataset:
        assert not set(dataset.variables) & {"extinction", "effective_radius", "x", "y", "z"}
        assert set(json.loads(dataset.attrs["settings"])) == {"scene"}
        assert "cloud.nc" not in str(dataset.attrs) and "8.4" not in str(dataset.attrs)
    assert main("init reconstruct --quiet".split()) == 0
    command = "reconstruct run.toml --no-report --quiet --output run --set solver.iterations=1"
    assert main([*command.split(), "--set", "run.time_limit=1"]) == 0
    assert ct.read_extinction("run/reconstruction.nc")[0].shape == GRID.shape


def test_an_example_is_recovered_by_one_more_command(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["init", "example"]) == 0
    (command,) = re.findall(r"^  (cloudtomo reconstruct .*)$", capsys.readouterr().out, flags=re.MULTILINE)
    settings = read_reconstruct_settings(tmp_path / "example" / "run.toml")
    assert settings.solver.iterations == example.ITERATIONS and settings.run.time_limit is None  # the same everywhere
    assert main([*command.split()[1:], "--no-report", "--set", "run.time_limit=1"]) == 0
    assert re.search(r"eps [\d.]+  delta", capsys.readouterr().out)
    assert main(["init", "example"]) == 2 and "holds cloud.nc already" in capsys.readouterr().err


def test_a_run_keeps_one_seed_and_counts_as_the_screen_does(folder, capsys):
    assert main("render scene.toml --samples 8 --quiet --output images.nc".split()) == 0
    assert main("init reconstruct --quiet".split()) == 0
    command = "reconstruct run.toml --seed 5 --no-report --output run --set run.time_limit=0.01"
    assert main(command.split()) == 0
    settings = json.loads((folder / "run" / "settings.json").read_text())
    assert settings["settings"]["run"]["seed"] == 5 and "seed" not in settings
    header, first, *_ = [line.split(",") for line in (folder / "run" / "history.csv").read_text().splitlines()]
    line = dict(zip(header, first))
    assert (line["stage"], line["iteration"]) == ("1", "1")
    assert list(settings["history"]) == header and settings["history"]["seconds"]["units"] == "s"
    assert all(column["units"] and column["long_name"] for column in settings["history"].values())
    assert f"stage 1/{line['stages']}  iteration    1" in capsys.readouterr().out


def test_errors_come_in_the_order_of_what_was_typed(folder, capsys):
    (folder / "there.nc").touch()
    for command in ("render", "flux", "cloud", "reconstruct"):
        assert main(f"{command} missing.toml --output there.nc".split()) == 2
        assert "missing.toml" in capsys.readouterr().err


@pytest.mark.parametrize("shell", ["bash", "zsh", "tcsh"])
def test_every_command_is_completed(capsys, shell):
    with pytest.raises(SystemExit) as stop:
        main(["--print-completion", shell])
    script = capsys.readouterr().out
    assert stop.value.code == 0 and all(name in script for name in COMMANDS) and "target-error" in script
    if shell == "bash":
        assert subprocess.run(["bash", "-n"], input=script, text=True).returncode == 0


@pytest.mark.parametrize("kind", ["render", "reconstruct"])
def test_a_schema_has_every_table(folder, kind):
    assert main(["init", kind, "--schema", "s.json", "--quiet"]) == 0
    schema = json.loads((folder / "s.json").read_text())
    expected = {
        "render": {"cloud", "sun", "view", "noise"},
        "reconstruct": {"measurements", "stage", "prior", "solver"},
    }
    assert set(schema["properties"]) >= expected[kind]
    assert main(["init", kind, "--schema", "s.json", "--quiet"]) == 2  # it is there already


def test_nobody_is_sent_to_a_name_that_is_not_ours():
    from cloudtomo_cl.commands.cli import parser

    texts = [parser().format_help(), *(module.DESCRIPTION + module.EXAMPLES for module in COMMANDS.values())]
    assert not any("pip install 'cloudtomo" in text or "pip install cloudtomo" in text for text in texts)
