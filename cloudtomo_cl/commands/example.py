"""What `cloudtomo init example` makes: a small cloud, its images, and settings that recover it in half a minute."""

from __future__ import annotations

from pathlib import Path

from cloudtomo_cl.clouds.generate import cumulus
from cloudtomo_cl.commands import rendering, stopping
from cloudtomo_cl.commands.init import run_file, scene_file
from cloudtomo_cl.commands.provenance import source, versions
from cloudtomo_cl.errors import DataError
from cloudtomo_cl.files.extinction import write_extinction
from cloudtomo_cl.files.whole import written_whole
from cloudtomo_cl.scene.grid import Grid

_GRID = Grid(shape=(16, 16, 16), spacing=(0.05, 0.05, 0.05))  # km
_SEED, _SAMPLES = 1, 256
# s; nothing about a recovery says when it is good enough for a first look.
TIME_LIMIT = 30.0
_FILES = ("cloud.nc", "scene.toml", "images.nc", "run.toml")


def write_example(folder: Path, overwrite: bool, quiet: bool) -> None:
    """Writes cloud.nc, scene.toml, images.nc and run.toml into a folder, which is made.

    Raises
    ------
    DataError : one of these files is there already and is not to be replaced, or they cannot be written
    """
    there = [name for name in _FILES if (folder / name).exists()]
    if there and not overwrite:
        raise DataError(f"{folder}: holds {there[0]} already: choose another --output, or add --overwrite")
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise DataError(f"{folder}: could not be made ({error.strerror}): choose another --output") from None
    cloud, scene, images, run = (folder / name for name in _FILES)
    made = {"generator": "cumulus", "seed": _SEED}
    attributes = {"source": source(), "settings": made, "versions": versions()}
    write_extinction(cloud, _GRID, cumulus(_GRID, seed=_SEED), attributes)
    stopping.check()
    _write(scene, scene_file(cloud, folder))
    if not quiet:
        print(f"{cloud} and {scene} are written; rendering nine images of the cloud ...")
    request = rendering.Request(
        scene, _SAMPLES, None, _SEED, images, None, False, overrides=(), device=None, quiet=True, overwrite=overwrite
    )
    job = rendering.prepare(request)
    rendering.deliver(job, rendering.execute(job))
    stopping.check()
    _write(run, _within_the_limit(run_file(images, cloud, folder)))


def _write(path: Path, text: str) -> None:
    with written_whole(path) as partial:
        partial.write_text(text, encoding="utf-8")


def _within_the_limit(text: str) -> str:
    """The settings with a time limit in place of the comment about one."""
    lines = text.splitlines(keepends=True)
    for number, line in enumerate(lines):
        if line.startswith("# [run]"):
            lines[number] = line.removeprefix("# ")
        elif line.startswith("# time_limit = "):
            _, _, meaning = line.removeprefix("# ").partition("#")
            code = f"time_limit = {TIME_LIMIT}"
            lines[number] = f"{code:<33} #{meaning}"
    return "".join(lines)
