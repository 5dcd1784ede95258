"""What `cloudtomo init example` makes: a small cloud, its images, and settings that recover it in a minute."""

from __future__ import annotations

from pathlib import Path

from cloudtomo_cl.clouds.generate import cumulus
from cloudtomo_cl.commands import rendering, stopping
from cloudtomo_cl.commands.new_settings import run_file, scene_file
from cloudtomo_cl.commands.provenance import source, versions
from cloudtomo_cl.errors import DataError
from cloudtomo_cl.files.extinction import write_extinction
from cloudtomo_cl.files.whole import written_whole
from cloudtomo_cl.scene.grid import Grid

_GRID = Grid(shape=(16, 16, 16), spacing=(0.05, 0.05, 0.05))  # km
_SEED, _SAMPLES = 1, 256
# On the finest grid: enough for a first look. A time limit would make the cloud depend on the machine, and end the
# first run of all, which compiles the kernels, before it has got anywhere.
ITERATIONS = 12
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
    _write(run, _with_few_iterations(run_file(images, cloud, folder)))


def _write(path: Path, text: str) -> None:
    with written_whole(path) as partial:
        partial.write_text(text, encoding="utf-8")


def _with_few_iterations(text: str) -> str:
    """The settings with the solver and its number of iterations in place of the comments about them."""
    lines, is_solver = [], False
    for line in text.splitlines(keepends=True):
        is_solver = (is_solver or line.startswith("# [solver]")) and not line.startswith("# [[stage]]")
        code, _, meaning = line.removeprefix("# ").partition("#")
        if is_solver and line.startswith("# iterations "):
            code = f"iterations = {ITERATIONS}"
        if is_solver and line.startswith(("# iterations ", "# type = ")):
            line = f"{code:<33} #{meaning}"
        elif is_solver and line.startswith("# [solver]"):
            line = code
        lines.append(line)
    return "".join(lines)
