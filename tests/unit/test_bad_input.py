"""What users get wrong, and what the command line says: one row a mistake, all with exit status 2 and no new file."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

import cloudtomo_cl as ct
from cloudtomo_cl.commands.cli import main

SCENE = """
[cloud]
file = "cloud.nc"
[sun]
zenith = 30.0
[[view]]
type = "perspective"
position = [2.0, 0.2, 1.5]
target = [0.2, 0.2, 0.2]
field_of_view = 40.0
pixels = [4, 3]
[[view]]
type = "orthographic"
zenith = 0.0
width = 0.6
pixels = [3, 3]
"""
RUN = """
[measurements]
file = "images.nc"
[solver]
inner_iterations = 5
[[stage]]
grid = [4, 4, 4]
samples = 4
iterations = 1
"""
RENDER = "render scene.toml --samples 4 --quiet --output new.nc"
RECONSTRUCT = "reconstruct run.toml --output new"
GRID = ct.Grid(shape=(4, 4, 4), spacing=(0.1, 0.1, 0.1))


@pytest.fixture(scope="module")
def inputs(tmp_path_factory):
    folder = tmp_path_factory.mktemp("inputs")
    extinction = np.zeros(GRID.shape, np.float32)
    extinction[1:3, 1:3, 1:3] = 10.0
    ct.write_extinction(folder / "cloud.nc", GRID, extinction)
    (folder / "scene.toml").write_text(SCENE)
    (folder / "run.toml").write_text(RUN)
    options = ["--samples", "16", "--quiet", "--output", str(folder / "images.nc")]
    assert main(["render", str(folder / "scene.toml"), *options]) == 0
    return folder


@pytest.fixture
def folder(inputs, tmp_path, monkeypatch):
    shutil.copytree(inputs, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def answer(folder, capsys, command):
    """The message of a command that must fail and leave everything as it was."""
    before = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    assert main(command.split()) == 2
    assert {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()} == before
    return capsys.readouterr().err


def change(path, edit):
    """Edits a netCDF file."""
    with xr.open_dataset(path) as opened:
        data = opened.load()
    edited = edit(data)
    data = data if edited is None else edited
    path.unlink()
    data.to_netcdf(path)


def with_values(name, index, value):
    def edit(data):
        values = data[name].values.copy()
        values[index] = value
        return data.assign({name: (data[name].dims, values, data[name].attrs)})

    return edit


def with_attribute(owner, name, value):
    def edit(data):
        (data if owner is None else data[owner]).attrs[name] = value

    return edit


CLOUDS = {
    "nan": (with_values("extinction", (3, 2, 1), np.nan), "extinction at voxel (1, 2, 3) is nan: it must be finite"),
    "infinite": (with_values("extinction", (0, 0, 0), np.inf), "extinction at voxel (0, 0, 0) is inf"),
    "negative": (with_values("extinction", (1, 0, 0), -1.0), "extinction at voxel (0, 0, 1) is -1.0"),
    "beyond any cloud": (with_values("extinction", (1, 1, 1), 1e9), "an optical depth of 1e+08 across 0.1 km (at most"),
    "all zero": (with_values("extinction", ..., 0.0), "zero in every voxel: there is no cloud"),
    "neither rising nor falling": (with_values("z", 1, 0.01), "z must rise or fall from each point to the next"),
    "uneven": (with_values("x", 3, 0.36), "x is not uniform"),
    "unit of length": (with_attribute("x", "units", "mile"), "x has units 'mile', allowed are km"),
    "unit of extinction": (with_attribute("extinction", "units", "g m-3"), "extinction has units 'g m-3'"),
    "below the ground": (lambda data: data.drop_vars("z_bounds").assign_coords(z=data.z - 1), "z must be at least 0"),
    "no extinction": (lambda data: data.drop_vars("extinction"), "no variable extinction(x, y, z)"),
    "another dimension": (lambda data: data.rename(x="lon"), "extinction has dimensions (z, y, lon)"),
}


@pytest.mark.parametrize("case", CLOUDS)
def test_a_wrong_cloud_is_named(folder, capsys, case):
    edit, message = CLOUDS[case]
    change(folder / "cloud.nc", edit)
    assert message in answer(folder, capsys, RENDER)


SCENES = {
    "sun below the horizon": ("zenith = 30.0", "zenith = 100.0", "sun.zenith must be less than 90, is 100.0"),
    "sun on the horizon": ("zenith = 30.0", "zenith = 90.0", "sun.zenith must be less than 90, is 90.0"),
    "sun beyond all numbers": (
        "zenith = 30.0",
        "zenith = 30.0\nirradiance = 1e308",
        "sun.irradiance must be less than or equal to 1000000000000, is 1e+308",
    ),
    "air beyond any air": (
        "[sun]",
        "[air]\nextinction = 1e30\n[sun]",
        "air.extinction must be less than or equal to 10000, is 1e+30",
    ),
    "missing key": ("zenith = 30.0", "", "sun.zenith is missing"),
    "misspelt key": ("zenith = 30.0", "zenit = 30.0", "sun.zenit is no known key: did you mean zenith?"),
    "contradictory keys": (
        "zenith = 0.0",
        "zenith = 0.0\nposition = [0.0, 0.0, 2.0]",
        "view[1] is wrong: give either position and target, or zenith and azimuth",
    ),
    "view in the ground": ("1.5]", "-0.5]", "view[0] is wrong: position lies below the ground"),
    "view without pixels": ("pixels = [4, 3]", "pixels = [0, 3]", "view[0].pixels[0] must be greater than or equal"),
    "view that looks away": (
        "target = [0.2, 0.2, 0.2]",
        "target = [4.0, 0.2, 1.5]",
        "view 0 looks past the domain (x 0 to 0.4, y 0 to 0.4, z 0 to 0.4 km) with every pixel",
    ),
}


@pytest.mark.parametrize("case", SCENES)
def test_a_wrong_scene_is_named(folder, capsys, case):
    old, new, message = SCENES[case]
    assert old in SCENE
    (folder / "scene.toml").write_text(SCENE.replace(old, new, 1))
    assert message in answer(folder, capsys, RENDER)


@pytest.mark.parametrize("horizontal", ["open", "periodic"])
def test_a_grazing_sun_is_allowed(folder, horizontal):
    """Any zenith below 90 degrees."""
    text = SCENE.replace("zenith = 30.0", "zenith = 89.999")
    (folder / "scene.toml").write_text(text + f'[boundary]\nhorizontal = "{horizontal}"\n')
    assert main(RENDER.split()) == 0
    for image in ct.read_measurements("new.nc").images:
        assert np.isfinite(image).all() and (image >= 0).all()


def test_a_view_beside_the_cloud_may_look_at_the_ground(folder):
    text = SCENE.replace("target = [0.2, 0.2, 0.2]", "target = [4.0, 0.2, 0.0]") + "[surface]\nalbedo = 0.3\n"
    (folder / "scene.toml").write_text(text)
    assert main(RENDER.split()) == 0


IMAGES = {
    "narrower than stored": (with_values("image_width", 0, 3), "view 0 has 3 x 3 pixels by image_width and image_"),
    "wider than stored": (with_values("image_width", 0, 9), "image_width is [9, 3]: each must be a whole number"),
    "infinite": (with_values("radiance", (1, 0, 0), np.inf), "images of view 1 are not finite at row 0, column 0"),
    "negative error": (with_values("radiance_standard_error", (0, 0, 0), -1.0), "standard_errors of view 0 are negat"),
    "another unit": (with_attribute("radiance", "units", "mW"), "radiance has units 'mW', allowed are W m-2 sr-1"),
    "settings that are a number": (with_attribute(None, "settings", 5), "the attribute settings is not a JSON table"),
    "settings that are a list": (
        with_attribute(None, "settings", [1, 2]),
        "the attribute settings is not a JSON table",
    ),
    "scene that is a number": (with_attribute(None, "settings", '{"scene": 5}'), "what it stores as scene"),
    "scene that is wrong": (with_attribute(None, "settings", '{"scene": {"sun": 5}}'), "images.nc"),
    "view from its target": (
        lambda data: data.assign(position=data.target),
        "view 0 is not possible: perspective: Value error, position and target are the same point",
    ),
}


@pytest.mark.parametrize("case", IMAGES)
def test_wrong_images_are_named(folder, capsys, case):
    edit, message = IMAGES[case]
    change(folder / "images.nc", edit)
    assert message in answer(folder, capsys, RECONSTRUCT)


RUNS = {
    "views of another size": (
        '[[view]]\ntype = "orthographic"\nzenith = 0.0\nwidth = 0.6\npixels = [5, 5]\n' * 2,
        "view: the views do not fit",
    ),
    "another number of views": (
        '[[view]]\ntype = "orthographic"\nzenith = 0.0\nwidth = 0.6\npixels = [3, 3]\n',
        "2 images for 1 views",
    ),
    "grid beyond any memory": ("[grid]\nshape = [1000000, 1000000, 1000000]\nspacing = [1, 1, 1]\n", "voxels"),
    "truth elsewhere": ('[truth]\nfile = "nowhere.nc"\n', "truth.file is wrong: there is no file"),
    "prior of text": ('[prior]\nstrength = "much"\n', 'prior.strength must be a number, is "much"'),
    "checkpoints at negative times": ("[run]\ncheckpoint_interval = -1\n", "run.checkpoint_interval must be greater"),
}


@pytest.mark.parametrize("case", RUNS)
def test_a_wrong_run_is_named(folder, capsys, case):
    text, message = RUNS[case]
    (folder / "run.toml").write_text(RUN + text)
    assert message in answer(folder, capsys, RECONSTRUCT)


@pytest.mark.parametrize("content", ["[]", "5", "null", '{"files": 5}', '{"files": {"truth": 5}}', "{", "[" * 100_000])
def test_a_report_of_damaged_settings_is_refused(folder, capsys, content):
    (folder / "run").mkdir()
    extinction = ct.read_extinction("cloud.nc")[1]
    from cloudtomo_cl.commands.run_folder import RunFolder

    RunFolder("run").write_reconstruction(GRID, extinction, extinction > 0, {})
    (folder / "run" / "settings.json").write_text(content)
    assert "settings.json: are no settings of a run" in answer(folder, capsys, "report run")


@pytest.mark.parametrize("content", ["", "stage,cost\n", "stage,cost\n0,1\n", "a\x00b\n", "stage\n1,2\n"])
def test_a_report_of_a_damaged_history_is_refused(folder, capsys, content):
    (folder / "run").mkdir()
    extinction = ct.read_extinction("cloud.nc")[1]
    from cloudtomo_cl.commands.run_folder import RunFolder

    RunFolder("run").write_reconstruction(GRID, extinction, extinction > 0, {})
    (folder / "run" / "settings.json").write_text(json.dumps({"files": {}}))
    (folder / "run" / "history.csv").write_text(content)
    assert "history.csv" in answer(folder, capsys, "report run")


# ---- disks


@pytest.fixture
def small_disk(tmp_path):
    """A disk of 40 kB, where one may be mounted."""
    place = tmp_path / "disk"
    place.mkdir()
    mounted = shutil.which("mount") and subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "size=40k", "tmpfs", str(place)], capture_output=True
    )
    if not mounted or mounted.returncode != 0:
        pytest.skip("no disk can be mounted here: that needs root")
    yield place
    subprocess.run(["umount", str(place)], check=True)


def read_only(place):
    subprocess.run(["mount", "-o", "remount,ro", str(place)], check=True)


@pytest.mark.parametrize("command", ["render", "reconstruct", "cloud"])
def test_a_full_disk_is_named(folder, small_disk, capsys, command):
    filler = small_disk / "filler"
    with pytest.raises(OSError), open(filler, "wb", buffering=0) as file:
        while True:
            file.write(bytes(4096))
    options = {
        "render": ["render", "scene.toml", "--samples", "4", "--output", str(small_disk / "new.nc")],
        "reconstruct": ["reconstruct", "run.toml", "--output", str(small_disk / "new")],
        "cloud": ["cloud", "cloud.nc", "--output", str(small_disk / "new.nc")],
    }[command]
    assert main(options) == 2
    message = capsys.readouterr().err
    assert "No space left" in message or "could not be written" in message
    left = [path.name for path in small_disk.rglob("*") if path.is_file() and path.stat().st_size and path != filler]
    assert not left


@pytest.mark.parametrize("command", ["render", "reconstruct", "cloud"])
def test_a_read_only_disk_is_named(folder, small_disk, capsys, command):
    read_only(small_disk)
    options = {
        "render": ["render", "scene.toml", "--samples", "4", "--output", str(small_disk / "new.nc")],
        "reconstruct": ["reconstruct", "run.toml", "--output", str(small_disk / "new")],
        "cloud": ["cloud", "cloud.nc", "--output", str(small_disk / "new.nc")],
    }[command]
    assert main(options) == 2
    assert "could not be written" in capsys.readouterr().err


def test_a_disk_that_fills_up_during_a_run_keeps_the_last_checkpoint(folder):
    """The largest file that may be written is as large as the first checkpoints: later ones fail."""
    code = (
        "import resource, sys, cloudtomo_cl.inversion.checkpoint as c\n"
        "from cloudtomo_cl.commands.cli import main\n"
        "write = c.Checkpoint.write\n"
        "def limited(self, path):\n"
        "    if len(self.history) >= 3:\n"
        "        resource.setrlimit(resource.RLIMIT_FSIZE, (1000, resource.RLIM_INFINITY))\n"
        "    write(self, path)\n"
        "c.Checkpoint.write = limited\n"
        "sys.exit(main(sys.argv[1:]))\n"
    )
    run = RUN.replace("\niterations = 1", "\niterations = 6") + "[run]\ncheckpoint_interval = 0.0\nuncertainty = 0\n"
    (folder / "run.toml").write_text(run.replace("grid = [4, 4, 4]", "grid = [4, 4, 4]\nwindow = 100"))
    command = [sys.executable, "-c", code, *RECONSTRUCT.split()]
    # SIGXFSZ is ignored by Python: writing fails with an error.
    result = subprocess.run(command, capture_output=True, text=True, timeout=120, env={**os.environ})
    assert result.returncode == 2 and "Traceback" not in result.stderr, result.stderr
    assert "could not be written" in result.stderr and "--resume" in result.stderr
    from cloudtomo_cl.inversion.checkpoint import read_checkpoint

    assert len(read_checkpoint(folder / "new" / "checkpoint.npz").history) < 3
    assert not list(Path("new").glob(".*.partial"))
    assert main([*RECONSTRUCT.split(), "--resume", "--quiet", "--no-report"]) == 0
