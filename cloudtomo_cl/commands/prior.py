"""`cloudtomo prior`: mixtures of patches for the patch prior. Imports what is slow when it runs."""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from cloudtomo_cl.commands import options, stopping
from cloudtomo_cl.errors import DataError, printable

if TYPE_CHECKING:
    import numpy as np

    from cloudtomo_cl.inversion.learning import LearntMixture
    from cloudtomo_cl.scene.grid import Grid

HELP = "learn from clouds what clouds look like"

DESCRIPTION = """\
Learn from clouds what small pieces of clouds look like, for recoveries of others like them.

CLOUD is netCDF with extinction, as `cloudtomo cloud` writes it of large-eddy simulations in any format. Each cloud is
measured by its own mean extinction, and its patches of 5 x 5 x 3 voxels are turned and mirrored about the vertical.
Clouds whose voxels have one height over width, to a tenth, are learnt from together; there is a mixture of Gaussians
for each such shape, and a recovery takes that for the shape most like that of its voxels."""

EXAMPLES = """\
examples:
  cloudtomo prior learn les-1.nc les-2.nc les-3.nc --output prior.nc
  cloudtomo prior learn les.nc --components 10 --seed 1 --output prior.nc

and in the settings of a recovery:
  [prior]
  file = "prior.nc"
"""

# As `Learning` has them (a test compares): help does not wait for NumPy.
COMPONENTS, PATCHES, ROUNDS = 30, 60_000, 25
_MOST_COMPONENTS, _MOST_PATCHES, _MOST_ROUNDS = 1_000, 100_000_000, 10_000


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of the command; they are the parameters of `run`."""
    parser.add_argument("action", choices=["learn"], metavar="learn", help="what to do")
    parser.add_argument("clouds", nargs="+", type=Path, metavar="CLOUD", help="to learn from, netCDF")
    parser.add_argument("--output", type=Path, required=True, metavar="FILE", help="where the mixtures go, netCDF")
    parser.add_argument(
        "--components", type=_whole(_MOST_COMPONENTS), default=COMPONENTS, metavar="N",
        help=f"Gaussians of patches with cloud, in each mixture (default {COMPONENTS})",
    )  # fmt: skip
    parser.add_argument(
        "--patches", type=_whole(_MOST_PATCHES), default=PATCHES, metavar="N",
        help=f"patches to learn from, at most, for each shape of voxels (default {PATCHES})",
    )  # fmt: skip
    parser.add_argument(
        "--rounds", type=_whole(_MOST_ROUNDS), default=ROUNDS, metavar="N",
        help=f"of expectation maximisation (default {ROUNDS})",
    )  # fmt: skip
    parser.add_argument("--seed", type=options.seed, default=0, help="of what is drawn (default 0)")
    options.add_overwrite(parser)
    options.add_quiet(parser)


def _whole(most: int) -> Callable[[str], int]:
    """A reader of whole numbers from 1."""

    def number(text: str) -> int:
        if not text.isdecimal() or not 1 <= int(text) <= most:
            raise argparse.ArgumentTypeError(f"{text!r} is no whole number from 1 to {most}")
        return int(text)

    return number


def run(
    action: str,
    clouds: list[Path],
    output: Path,
    components: int,
    patches: int,
    rounds: int,
    seed: int,
    overwrite: bool,
    quiet: bool,
) -> None:
    """Learns mixtures of clouds, writes them, and says what they are of."""
    from rich.console import Console

    from cloudtomo_cl.commands import progress
    from cloudtomo_cl.commands.provenance import source, versions
    from cloudtomo_cl.files.netcdf import require_file
    from cloudtomo_cl.inversion.learning import Learning, learnt_mixtures, mixture_file

    assert action == "learn"
    for cloud in clouds:
        require_file(cloud)
    options.check_outputs(overwrite, output=output, inputs=clouds)
    given = [_read(cloud) for cloud in clouds]
    console = Console(markup=False, emoji=False, quiet=quiet)
    with progress.counting(console, "rounds of learning") as show:
        learnt = learnt_mixtures(given, Learning(components, patches, rounds), seed, show)
    settings = {
        "clouds": [cloud.name for cloud in clouds],
        "components": components,
        "patches": patches,
        "rounds": rounds,
        "seed": seed,
    }
    attributes = {"source": source(), "versions": versions(), "settings": settings}
    mixture_file(learnt).write(output, attributes)
    for line in (*map(_line, learnt), f"{output} is written; in the settings of a recovery:", *_settings(output)):
        console.print(printable(line), highlight=False, soft_wrap=True)


def _read(path: Path) -> tuple[Grid, np.ndarray]:
    """Of a cloud at several wavelengths the first: by its own mean extinction it is much the same at all."""
    from cloudtomo_cl.files.extinction import read_extinction
    from cloudtomo_cl.files.netcdf import load_dataset
    from cloudtomo_cl.files.wavelengths import wavelengths_of

    stopping.check()
    dataset = load_dataset(path)
    if "extinction" not in dataset.variables:
        raise DataError(
            f"{path}: holds no extinction: make it one of those with cloudtomo cloud {path} --output cloud.nc"
        )
    try:
        return read_extinction(dataset, next(iter(wavelengths_of(path, dataset)), None))
    except DataError as error:
        raise DataError(str(error).replace("the Dataset", str(path), 1)) from None


def _line(learnt: LearntMixture) -> str:
    clouds = "1 cloud" if len(learnt.clouds) == 1 else f"{len(learnt.clouds)} clouds"
    return (
        f"voxels {learnt.aspect:.3g} times as high as wide: {clouds}, {learnt.patches} patches, "
        f"{len(learnt.mixture) - 1} components and one of clear air"
    )


def _settings(output: Path) -> tuple[str, str]:
    """The lines of a settings file; JSON's quotes are TOML's."""
    return "[prior]", f"file = {json.dumps(str(output), ensure_ascii=False)}"
