"""Every command on a disk of 200 kB: old files stay, nothing is half, and the message says which disk is full."""

import os
import shutil
import subprocess

import pytest

from cloudtomo_cl.commands.cli import main

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
"""
RUN = """
[measurements]
file = "images.nc"
[[stage]]
grid = [6, 6, 6]
samples = 8
iterations = 2
"""
CLOUD = "cloud --generate cumulus --shape 6 6 6 --spacing 0.1 0.1 0.1 --seed 1 --quiet --output"
PERIODIC = '--set boundary.horizontal="periodic"'


@pytest.fixture(scope="module")
def inputs(tmp_path_factory):
    folder = tmp_path_factory.mktemp("inputs")
    (folder / "scene.toml").write_text(SCENE)
    (folder / "run.toml").write_text(RUN)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        assert main([*CLOUD.split(), "cloud.nc"]) == 0
        assert main("render scene.toml --samples 8 --quiet --output images.nc --png previews".split()) == 0
        assert main(f"flux scene.toml --photons 5000 --quiet --output fluxes.nc {PERIODIC}".split()) == 0
        assert main("cloud cloud.nc --png cloud.png --quiet".split()) == 0
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
@pytest.mark.parametrize(
    ("command", "old"),
    [
        (f"{CLOUD} {{disk}}/cloud.nc", ["cloud.nc"]),
        ("cloud cloud.nc --png {disk}/cloud.png --quiet", ["cloud.png"]),
        ("render scene.toml --samples 8 --quiet --output {disk}/images.nc", ["images.nc"]),
        ("flux scene.toml --photons 5000 --quiet --output {disk}/fluxes.nc " + PERIODIC, ["fluxes.nc"]),
        ("init render --output {disk}/scene.toml --quiet", ["scene.toml"]),
        ("validate --only slab --photons 1000 --quiet --output {disk}/table.csv", []),
    ],
    ids=["cloud", "picture", "render", "flux", "init", "validate"],
)
def test_a_full_disk_keeps_the_old_file_and_is_named(inputs, disk, monkeypatch, capsys, command, old, left):
    monkeypatch.chdir(inputs)
    for name in old:
        shutil.copy(inputs / name, disk / name)
    fill(disk, left)
    before = contents(disk)
    status = main([*command.format(disk=disk).split(), "--overwrite"])
    message = capsys.readouterr().err
    if status == 0:
        # A small file still found its place.
        assert left and not list(disk.glob(".*"))
        return
    assert status == 2 and f"the disk of {disk} is full" in message and "Traceback" not in message, message
    assert contents(disk) == before and not list(disk.glob(".*"))
