"""Kills a small reconstruction with SIGKILL at random moments, resumes it until it ends, and
compares the bits with those of a run that nobody disturbed.

    python scripts/kill_and_resume.py [--kills 25] [--seed 0] [--folder DIR]

Every moment is drawn anew: of how long the undisturbed run takes from its start to its end, or
of writing itself (half of the kills wait for a checkpoint that is being written and strike
within a few milliseconds of it). Exit status 0 if extinction and history have the same bits,
but for the seconds of the history.
"""

from __future__ import annotations

import argparse
import random
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

import cloudtomo_cl as ct

SCENE = """
[cloud]
file = "cloud.nc"
[surface]
albedo = 0.05
[sun]
zenith = 30.0
[[view]]
type = "orthographic"
zenith = 0.0
width = 1.2
pixels = [16, 16]
[[view]]
type = "orthographic"
zenith = 50.0
width = 1.2
pixels = [16, 16]
[[view]]
type = "orthographic"
zenith = 50.0
azimuth = 180.0
width = 1.2
pixels = [16, 16]
"""
# Checkpoints as often as it goes; stages end by themselves, or after their iterations.
RUN = """
[measurements]
file = "images.nc"
[truth]
file = "cloud.nc"
[run]
seed = 3
checkpoint_interval = 0.0
[[stage]]
grid = [4, 4, 4]
pixels = 0.5
samples = 32
iterations = 60
window = 10
[[stage]]
grid = [8, 8, 8]
pixels = 0.8
samples = 32
iterations = 60
window = 20
[[stage]]
grid = [12, 12, 12]
samples = 32
iterations = 80
window = 20
"""


def command(folder: Path, output: str, *options: str) -> list[str]:
    arguments = ["reconstruct", str(folder / "run.toml"), "--output", str(folder / output), "--quiet", *options]
    return [sys.executable, "-m", "cloudtomo_cl", *arguments]


def prepare(folder: Path) -> None:
    """A cloud, its images, and the settings."""
    grid = ct.Grid(shape=(12, 12, 12), spacing=(0.08, 0.08, 0.08))
    ct.write_extinction(folder / "cloud.nc", grid, ct.cumulus(grid, seed=3, peak=40.0))
    (folder / "scene.toml").write_text(SCENE)
    (folder / "run.toml").write_text(RUN)
    arguments = [str(folder / "scene.toml"), "--samples", "256", "--quiet", "--output", str(folder / "images.nc")]
    subprocess.run([sys.executable, "-m", "cloudtomo_cl", "render", *arguments], check=True)


def bits(folder: Path) -> tuple[bytes, list[list[str]]]:
    """Extinction, and the history without its seconds."""
    header, *lines = [line.split(",") for line in (folder / "history.csv").read_text().splitlines()]
    place = header.index("seconds")
    extinction = ct.read_extinction(folder / "reconstruction.nc")[1]
    return extinction.tobytes(), [line[:place] + line[place + 1 :] for line in lines]


def strike(process: subprocess.Popen[bytes], folder: Path, delay: float, at_a_write: bool, rng: random.Random) -> bool:
    """Kills after a delay, or at a write after it; False if the run ended before."""
    end = time.monotonic() + delay
    while time.monotonic() < end:
        if process.poll() is not None:
            return False
        time.sleep(0.002)
    if at_a_write:
        while process.poll() is None and not list(folder.glob(".checkpoint.npz.*")):
            pass
        time.sleep(rng.uniform(0.0, 0.004))
    if process.poll() is not None:
        return False
    process.kill()
    process.wait()
    return True


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--kills", type=int, default=25)
    parser.add_argument("--seed", type=int, default=0, help="of the moments")
    parser.add_argument("--folder", type=Path, help="keep the runs here")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        folder = options.folder or Path(temporary)
        folder.mkdir(parents=True, exist_ok=True)
        prepare(folder)
        start = time.monotonic()
        subprocess.run(command(folder, "undisturbed"), check=True)
        whole = time.monotonic() - start
        return compare(folder, options.kills, random.Random(options.seed), whole)


def compare(folder: Path, kills: int, rng: random.Random, whole: float) -> int:
    """Kills and resumes; as a run ends before its kills are over, another one is begun."""
    expected = bits(folder / "undisturbed")
    print(f"undisturbed: {len(expected[1])} iterations, {whole:.1f} s", flush=True)
    done, runs, same, leftovers = 0, 0, 0, 0
    while done < kills or runs == 0:
        output = f"killed{runs}"
        moments = []
        while True:
            options = ["--resume"]
            process = subprocess.Popen(command(folder, output, *options))
            if done < kills and strike(
                process, folder / output, rng.uniform(0.0, 0.4 * whole), rng.random() < 0.5, rng
            ):
                done += 1
                leftovers += len(list((folder / output).glob(".*.partial")))
                moments.append(reached(folder / output))
                continue
            if process.wait() != 0:
                print(f"{output}: exit status {process.returncode}: FAILED")
                return 1
            break
        found = bits(folder / output)
        equal = found == expected
        same += equal
        runs += 1
        print(f"{output}: killed {len(moments)} times, at iterations {moments}: {'same bits' if equal else 'DIFFERS'}")
        if not equal:
            first = np.frombuffer(found[0], np.float32) != np.frombuffer(expected[0], np.float32)
            print(f"  {first.sum()} voxels differ; {len(found[1])} iterations")
        stray = list((folder / output).glob(".*.partial"))
        if stray:
            print(f"  left behind: {stray}")
            return 1
    print(f"{done} kills ({leftovers} in the middle of a write), {runs} runs, {same} with the same bits")
    return 0 if same == runs else 1


def reached(folder: Path) -> int:
    """Iterations in the history at the time of death."""
    history = folder / "history.csv"
    return len(history.read_text().splitlines()) - 1 if history.exists() else 0


if __name__ == "__main__":
    sys.exit(main())
