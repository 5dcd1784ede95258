"""Recovers scene C or F of the paper in its own camera set-up.

    python scripts/source_scenes.py c --data ../shared/data --output runs/scene-c --time-limit 600

Simulates nine views with the source's cameras (scene C: 76 x 76 pixels, 8192 samples; scene F:
86 x 86, 4096), then reconstructs with other random numbers. `--data` (or CLOUDTOMO_DATA) is the
folder that holds scene_c.nc and scene_f.nc.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class SourceScene:
    """The source's cameras: one at nadir and a ring of eight, all looking at one point. km, degrees."""

    centre: float
    height: float
    target_height: float
    ring_radius: float
    field_of_view: float
    pixels: int
    samples: int


SCENES = {
    "c": SourceScene(0.38, 1.647, 1.013, 0.50, 85.4, 76, 8192),
    "f": SourceScene(0.86, 2.16, 0.27, 1.02, 69.7, 86, 4096),
}


def settings(name: str, data: Path) -> str:
    """The scene's TOML."""
    scene = SCENES[name]
    target = (scene.centre, scene.centre, scene.target_height)
    return f"""[cloud]
file = "{data / f"scene_{name}.nc"}"
single_scattering_albedo = 1.0
phase_function = {{ type = "henyey-greenstein", g = 0.85 }}
[surface]
albedo = 0.01
[sun]
zenith = 0.0
[[view]]
type = "ring"
target = {[*target]}
height = {scene.height}
radius = {scene.ring_radius}
field_of_view = {scene.field_of_view}
pixels = {[scene.pixels, scene.pixels]}
"""


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene", choices=sorted(SCENES))
    parser.add_argument("--data", type=Path, default=os.environ.get("CLOUDTOMO_DATA", "../shared/data"))
    parser.add_argument("--output", type=Path, required=True)
    parser.add_argument("--time-limit", type=float, default=600.0, help="seconds of the reconstruction")
    parser.add_argument("--seed", type=int, default=2, help="of the reconstruction; the images have seed 1")
    arguments = parser.parse_args()
    cloud = (Path(arguments.data) / f"scene_{arguments.scene}.nc").resolve()
    if not cloud.is_file():
        print(f"{cloud} is not there: give its folder with --data, or in CLOUDTOMO_DATA", file=sys.stderr)
        return 2
    output: Path = arguments.output
    output.mkdir(parents=True, exist_ok=True)
    (output / "scene.toml").write_text(settings(arguments.scene, cloud.parent))
    (output / "run.toml").write_text(
        f'[measurements]\nfile = "images.nc"\n[truth]\nfile = "{cloud}"\n[run]\ntime_limit = {arguments.time_limit}\n'
    )
    samples = SCENES[arguments.scene].samples
    images = output / "images.nc"
    commands = [["reconstruct", output / "run.toml", "--seed", arguments.seed, "--output", output / "run"]]
    if not images.exists():
        commands.insert(0, ["render", output / "scene.toml", "--samples", samples, "--seed", 1, "--output", images])
    for command in commands:
        status = subprocess.run([sys.executable, "-m", "cloudtomo_cl", *map(str, command)]).returncode
        if status:
            return status
    return 0


if __name__ == "__main__":
    sys.exit(main())
