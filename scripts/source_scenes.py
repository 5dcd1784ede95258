"""Recovers scene C or F of the paper in its own camera set-up, and draws the figures of its supplement.

    python scripts/source_scenes.py c --data ../shared/data --output runs/scene-c --time-limit 600
    python scripts/source_scenes.py f --output runs/scene-f --monotonicity 1 --seeds 2 3 4 5 6
    python scripts/source_scenes.py c-like --output runs/quick --quick
    python scripts/source_scenes.py f --output runs/paper-f --as-in-the-paper --seeds 2 3 4

Simulates nine views with the source's cameras (scene C: 76 x 76 pixels, 8192 samples; scene F:
86 x 86, 4096), then reconstructs with other random numbers, by smoothness alone and, with
`--monotonicity`, by both priors of the source; renders a view that was not used, 50.4 degrees off
nadir, from the true and the recovered cloud; and draws (source_figures.py). `--data` (or
CLOUDTOMO_DATA) is the folder that holds scene_c.nc and scene_f.nc; c-like and f-like are generated
clouds on their grids. `--quick` halves voxels and pixels, `--coarsen` divides them by any number.
`--as-in-the-paper` recovers by the paper's own method (paper_method.py), without and with its
monotonicity prior; `--photons` and `--iterations` make that affordable. What is in the output folder already is
not made again, and a run that was stopped goes on: repeat the command.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
from dataclasses import dataclass
from math import cos, radians, sin
from pathlib import Path

from paper_method import METHODS, MOST_ITERATIONS, grids_of_stages, paper_settings, share_of_pixels
from source_figures import UNSEEN_FILES, draw


@dataclass(frozen=True)
class SourceScene:
    """The source's cameras: one at nadir and a ring of eight, all looking at one point. km, degrees.

    `stages` are voxels along x and z, `coarsened` says along which axes coarser grids have fewer, and `kind` is the
    generator's of a look-alike.
    """

    centre: float
    height: float
    target_height: float
    ring_radius: float
    field_of_view: float
    pixels: int
    samples: int
    shape: tuple[int, int, int]
    coarsened: tuple[bool, bool, bool]
    kind: str
    stages: tuple[tuple[int, int], ...]


SCENES = {
    "c": SourceScene(
        0.38, 1.647, 1.013, 0.50, 85.4, 76, 8192, (38, 38, 38), (True, True, True), "cumulus",
        tuple((n, n) for n in (4, 6, 8, 11, 16, 23, 32, 38)),
    ),
    "f": SourceScene(
        0.86, 2.16, 0.27, 1.02, 69.7, 86, 4096, (86, 86, 27), (True, True, False), "field",
        ((4, 4), (8, 8), (16, 16), (32, 27), (64, 27), (86, 27)),
    ),
}  # fmt: skip
SPACING = (0.02, 0.02, 0.04)
# Of the view that is not used, and its azimuth: half-way between two cameras of the ring.
UNSEEN_ZENITH, UNSEEN_AZIMUTH = 50.4, 22.5
SECONDS, QUICK_SECONDS = 600.0, 60.0


def scene_settings(scene: SourceScene, cloud: Path, views: str) -> str:
    """The scene's TOML."""
    return f"""[cloud]
file = "{cloud}"
single_scattering_albedo = 1.0
phase_function = {{ type = "henyey-greenstein", g = 0.85 }}
[surface]
albedo = 0.01
[sun]
zenith = 0.0
{views}field_of_view = {scene.field_of_view}
"""


def source_views(scene: SourceScene, pixels: int) -> str:
    target = [scene.centre, scene.centre, scene.target_height]
    return f"""[[view]]
type = "ring"
target = {target}
height = {scene.height}
radius = {scene.ring_radius}
pixels = {[pixels, pixels]}
"""


def unseen_view(scene: SourceScene, pixels: int) -> str:
    """A camera as far from the target as those of the ring."""
    distance = ((scene.height - scene.target_height) ** 2 + scene.ring_radius**2) ** 0.5
    across = distance * sin(radians(UNSEEN_ZENITH))
    position = [
        scene.centre + across * cos(radians(UNSEEN_AZIMUTH)),
        scene.centre + across * sin(radians(UNSEEN_AZIMUTH)),
        scene.target_height + distance * cos(radians(UNSEEN_ZENITH)),
    ]
    return f"""[[view]]
type = "perspective"
position = {position}
target = {[scene.centre, scene.centre, scene.target_height]}
pixels = {[pixels, pixels]}
"""


def unseen_steps(folder: Path, samples: int, seeds: tuple[int, int]) -> list[tuple[Path, list[object]]]:
    """The view that is not used, of a folder's unseen.toml, twice: how images differ is told by independent pairs."""
    files = zip(UNSEEN_FILES, seeds)
    command = ["render", folder / "unseen.toml", "--samples", samples]
    return [(folder / name, [*command, "--seed", seed, "--output", folder / name]) for name, seed in files]


def stage_settings(scene: SourceScene, shape: tuple[int, int, int]) -> str:
    """The source's stages on a grid; pixels and iterations as in automatic ones."""
    grids = sorted(set(grids_of_stages(scene.stages, shape)))
    tables = []
    for grid in grids:
        last = grid == grids[-1]
        share, iterations = share_of_pixels(grid, shape), 30 if last else 4
        tables.append(f"[[stage]]\ngrid = {[*grid]}\npixels = {share}\niterations = {iterations}\nwindow = 30\n")
    return "".join(tables)


def run_settings(arguments: argparse.Namespace, scene: SourceScene, shape: tuple[int, int, int]) -> str:
    """Tables of how to recover: time limit, and where asked for stages or the paper's method."""
    time_limit = arguments.time_limit
    if time_limit is None and not arguments.as_in_the_paper:
        time_limit = QUICK_SECONDS if arguments.quick else SECONDS
    tables = "" if time_limit is None else f"[run]\ntime_limit = {time_limit}\n"
    if arguments.as_in_the_paper:
        method = METHODS[arguments.scene[0]]
        return tables + paper_settings(method, scene.stages, shape, arguments.photons, arguments.iterations)
    return tables + (stage_settings(scene, shape) if arguments.source_stages else "")


def priors(arguments: argparse.Namespace) -> list[tuple[str, list[str]]]:
    """What the folders of runs begin with, and the settings that are theirs: without and with monotonicity."""
    monotonicity = arguments.monotonicity
    if arguments.as_in_the_paper and monotonicity is None:
        monotonicity = METHODS[arguments.scene[0]].monotonicity
    if monotonicity is None:
        return [("", [])]
    return [("", []), ("monotonicity-", ["prior.type=smoothness", f"prior.monotonicity={monotonicity}"])]


def parsed() -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene", choices=["c", "f", "c-like", "f-like"])
    parser.add_argument("--data", type=Path, default=os.environ.get("CLOUDTOMO_DATA", "../shared/data"))
    parser.add_argument("--output", type=Path, required=True)
    parser.add_argument("--images", type=Path, help="take these instead of rendering them")
    parser.add_argument("--quick", action="store_true", help="as --coarsen 2 --time-limit 60")
    parser.add_argument("--coarsen", type=int, default=1, metavar="N", help="voxels and pixels along an axis, by N (1)")
    parser.add_argument(
        "--time-limit", type=float, help="seconds of each reconstruction (600; quick: 60; as in the paper: none)"
    )
    parser.add_argument("--seeds", type=int, nargs="+", default=[2], help="of reconstructions (2); images have 1")
    parser.add_argument("--monotonicity", type=float, help="weight mu2 of runs with the monotonicity prior, too")
    parser.add_argument("--source-stages", action="store_true", help="eight (C) or six (F), as in the source")
    parser.add_argument("--as-in-the-paper", action="store_true", help="by the paper's method, with either prior")
    parser.add_argument("--photons", type=float, default=1.0, help="share of the paper's, by its method (1)")
    parser.add_argument("--iterations", type=int, default=MOST_ITERATIONS, help="of a stage at most, by its method")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="of all reconstructions")
    parser.add_argument("--figures-only", action="store_true", help="of the runs that are there")
    return parser.parse_args()


def main() -> int:
    arguments = parsed()
    output: Path = arguments.output
    if arguments.figures_only:
        draw(output)
        return 0
    scene = SCENES[arguments.scene[0]]
    like = arguments.scene.endswith("-like")
    source = (Path(arguments.data) / f"scene_{arguments.scene}.nc").resolve()
    if not like and not source.is_file():
        print(f"{source} is not there: give its folder with --data, or in CLOUDTOMO_DATA", file=sys.stderr)
        return 2
    output.mkdir(parents=True, exist_ok=True)
    reduction = max(arguments.coarsen, 2 if arguments.quick else 1)
    pixels, samples = scene.pixels // reduction, scene.samples // reduction**2
    coarser = [reduction if along else 1 for along in scene.coarsened]
    shape = tuple(n // by for n, by in zip(scene.shape, coarser))

    cloud = output / "cloud.nc"
    if like:
        spacing = [edge * by for edge, by in zip(SPACING, coarser)]
        made = ["cloud", "--generate", scene.kind, "--seed", 1, "--shape", *shape, "--spacing", *spacing]
    else:
        made = ["cloud", source, "--coarsen", *coarser]
    steps = [(cloud, [*made, "--output", cloud])]
    images = output / "images.nc" if arguments.images is None else arguments.images.resolve()
    (output / "scene.toml").write_text(scene_settings(scene, Path("cloud.nc"), source_views(scene, pixels)))
    if arguments.images is None:
        render = ["render", output / "scene.toml", "--samples", samples, "--seed", 1]
        steps.append((images, [*render, "--output", images]))
    (output / "unseen.toml").write_text(scene_settings(scene, Path("cloud.nc"), unseen_view(scene, pixels)))
    unseen_samples = 4096 // reduction**2
    steps += unseen_steps(output, unseen_samples, (3, 5))

    tables = f'[measurements]\nfile = "{os.path.relpath(images, output)}"\n[truth]\nfile = "cloud.nc"\n'
    (output / "run.toml").write_text(tables + run_settings(arguments, scene, shape))  # type: ignore[arg-type]
    for seed in arguments.seeds:
        for name, overrides in priors(arguments):
            folder = output / f"{name}seed-{seed}"
            run = ["reconstruct", output / "run.toml", "--seed", seed, "--output", folder, "--no-report", "--resume"]
            for override in [*overrides, *arguments.set]:
                run += ["--set", override]
            steps.append((folder / "modelled.nc", run))
            # Relative to the settings file: the same views of the recovered cloud.
            recovered = folder / "unseen.toml"
            steps += unseen_steps(folder, unseen_samples, (4, 6))
            folder.mkdir(exist_ok=True)
            recovered.write_text(scene_settings(scene, Path("reconstruction.nc"), unseen_view(scene, pixels)))
    for result, command in steps:
        if not result.exists():
            status = subprocess.run([sys.executable, "-m", "cloudtomo_cl", *map(str, command)]).returncode
            if status:
                return status
    draw(output)
    return 0


if __name__ == "__main__":
    sys.exit(main())
