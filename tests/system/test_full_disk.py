"""Every command on a disk of 200 kB: old files stay, nothing is half, and the message says which disk is full."""

import importlib.util
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from cloudtomo_cl.commands.cli import COMMANDS, main
from cloudtomo_cl.files.extinction import read_extinction
from cloudtomo_cl.files.phase import read_droplet_table

SCENE = """
[cloud]
file = "cloud.nc"
[sun]
zenith = 30.0
[[view]]
type = "orthographic"
zenith = 0.0
width = 0.8
pixels = [8, 8]
[[view]]
type = "orthographic"
zenith = 50.0
width = 0.8
pixels = [8, 8]
"""
RUN = """
[measurements]
file = "images.nc"
[run]
uncertainty = 2
[solver]
inner_iterations = 5
[[stage]]
grid = [6, 6, 6]
samples = 64
iterations = 2
"""
CLOUD = "cloud --generate cumulus --shape 6 6 6 --spacing 0.1 0.1 0.1 --seed 1 --quiet --output"
# Droplets that are small beside the wavelength: a second of work.
MIE = "mie --wavelength 2000 --effective-radius 2 --effective-variance 0.05 --quiet --output"
PRIOR = "prior learn cloud.nc --components 1 --rounds 1 --quiet --output"
PERIODIC = '--set boundary.horizontal="periodic"'

# A command, and what it replaces. Reconstructions and reports have tests of their own.
WRITES = {
    "cloud": (f"{CLOUD} {{disk}}/cloud.nc", ["cloud.nc"]),
    "cloud --png": ("cloud cloud.nc --png {disk}/cloud.png --quiet", ["cloud.png"]),
    "mie": (f"{MIE} {{disk}}/mie.nc", ["mie.nc"]),
    "mie --png": (f"{MIE} {{elsewhere}}/mie.nc --png {{disk}}/mie.png", ["mie.png"]),
    "prior": (f"{PRIOR} {{disk}}/prior.nc", ["prior.nc"]),
    "render": ("render scene.toml --samples 8 --quiet --output {disk}/images.nc", ["images.nc"]),
    "render --png": (
        "render scene.toml --samples 8 --quiet --output {elsewhere}/images.nc --png {disk}/previews", ["previews"]
    ),
    "flux": ("flux scene.toml --photons 5000 --quiet --output {disk}/fluxes.nc " + PERIODIC, ["fluxes.nc"]),
    "init render": ("init render --output {disk}/scene.toml --quiet", ["scene.toml"]),
    "init reconstruct": ("init reconstruct --output {disk}/run.toml --quiet", ["run.toml"]),
    "init example": ("init example --output {disk}/example --quiet", []),
    "validate": ("validate --only slab --photons 1000 --quiet --output {disk}/table.csv", []),
}  # fmt: skip


@pytest.fixture(scope="module")
def inputs(tmp_path_factory):
    folder = tmp_path_factory.mktemp("inputs")
    (folder / "scene.toml").write_text(SCENE)
    (folder / "run.toml").write_text(RUN)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        assert main([*CLOUD.split(), "cloud.nc"]) == 0
        assert main("render scene.toml --samples 256 --quiet --output images.nc --png previews".split()) == 0
        assert main(f"flux scene.toml --photons 5000 --quiet --output fluxes.nc {PERIODIC}".split()) == 0
        assert main("cloud cloud.nc --png cloud.png --quiet".split()) == 0
        assert main(f"{PRIOR} prior.nc".split()) == 0
        if importlib.util.find_spec("miepython"):
            assert main(f"{MIE} mie.nc --png mie.png".split()) == 0
        assert main("reconstruct run.toml --quiet --output run --no-report".split()) == 0
    return folder


@pytest.fixture(scope="module")
def small_disk(tmp_path_factory):
    """A disk of its own, of 200 kB."""
    folder = tmp_path_factory.mktemp("disk")
    if not hasattr(os, "geteuid") or os.geteuid() != 0 or shutil.which("mount") is None:
        pytest.skip("only root mounts a disk of 200 kB")
    mount = ["mount", "-t", "tmpfs", "-o", "size=200k", "tmpfs", str(folder)]
    if subprocess.run(mount, capture_output=True).returncode != 0:
        pytest.skip("this root may not mount a disk of 200 kB")
    yield folder
    subprocess.run(["umount", "-l", str(folder)], check=True)


@pytest.fixture
def disk(small_disk):
    yield small_disk
    for path in small_disk.iterdir():
        shutil.rmtree(path) if path.is_dir() else path.unlink()


def fill(disk, left):
    """Leaves so many bytes."""
    free = shutil.disk_usage(disk).free
    (disk / "filler").write_bytes(bytes(max(free - left, 0)))


def contents(folder):
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file() and path.name != "filler"}


@pytest.mark.parametrize("left", [0, 4096, 8192])
@pytest.mark.parametrize(("command", "old"), WRITES.values(), ids=WRITES)
def test_a_full_disk_keeps_the_old_file_and_is_named(inputs, disk, tmp_path, monkeypatch, capsys, command, old, left):
    if command.startswith("mie"):
        pytest.importorskip("miepython")
        monkeypatch.setattr("cloudtomo_cl.clouds.mie.droplet_table", lambda *_: read_droplet_table(inputs / "mie.nc"))
    monkeypatch.chdir(inputs)
    for name in old:
        copy = shutil.copytree if (inputs / name).is_dir() else shutil.copy
        copy(inputs / name, disk / name)
    fill(disk, left)
    before = contents(disk)
    status = main([*command.format(disk=disk, elsewhere=tmp_path).split(), "--overwrite"])
    message = capsys.readouterr().err
    if status == 0:
        # A small file still found its place.
        assert left and not list(disk.glob(".*"))
        return
    assert status == 2 and f"the disk of {disk} is full" in message and "Traceback" not in message, message
    assert contents(disk) == before and not list(disk.glob(".*"))


def test_every_command_that_writes_meets_a_full_disk_and_the_kill_script():
    path = Path(__file__).parents[2] / "scripts" / "kill_and_resume.py"
    spec = importlib.util.spec_from_file_location(path.stem, path)
    script = sys.modules[path.stem] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(script)
    writing = set(COMMANDS) - {"devices"}
    assert {name.split()[0] for name in WRITES} | {"reconstruct", "report"} == writing
    assert {name.split()[0] for name in script.COMMANDS} == writing


@pytest.mark.parametrize("left", [0, 20_000, 60_000])
def test_a_reconstruction_on_a_full_disk_goes_on_elsewhere(inputs, disk, tmp_path, monkeypatch, capsys, left):
    monkeypatch.chdir(inputs)
    fill(disk, left)
    command = ["reconstruct", "run.toml", "--quiet", "--no-report", "--resume", "--output"]
    assert main([*command, str(disk / "run")]) == 2
    message = capsys.readouterr().err
    assert f"the disk of {disk} is full" in message and "Traceback" not in message
    assert not list(disk.rglob(".*"))
    if (disk / "run").exists():
        shutil.copytree(disk / "run", tmp_path / "run")
    assert main([*command, str(tmp_path / "run")]) == 0
    found, expected = (read_extinction(folder / "run" / "reconstruction.nc")[1] for folder in (tmp_path, inputs))
    assert np.array_equal(found, expected)


def test_a_report_on_a_full_disk_leaves_the_result(inputs, disk, monkeypatch, capsys):
    monkeypatch.chdir(inputs)
    needless = shutil.ignore_patterns("figures", "modelled.nc", "checkpoint.npz")
    shutil.copytree(inputs / "run", disk / "run", ignore=needless)
    fill(disk, 8192)
    before = contents(disk / "run")
    assert main(["report", str(disk / "run"), "--quiet"]) == 2
    assert f"the disk of {disk} is full" in capsys.readouterr().err
    after = contents(disk / "run")
    after.pop(disk / "run" / "files.json", None), before.pop(disk / "run" / "files.json", None)
    assert after == before
