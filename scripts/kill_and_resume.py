"""Kills a small reconstruction with SIGKILL at random moments, resumes it until it ends, and
compares the bits with those of a run that nobody disturbed.

    python scripts/kill_and_resume.py [--kills 25] [--seed 0] [--folder DIR]

Every moment is drawn anew: a fifth of the kills strike before the first iteration of a process, the
others some iterations later, half of them within milliseconds of a checkpoint that is being
written. Exit status 0 if extinction and history have the same bits, but for the history's seconds.
"""

from __future__ import annotations

import argparse
import random
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
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
pixels = [10, 10]
[[view]]
type = "orthographic"
zenith = 50.0
width = 1.2
pixels = [10, 10]
[[view]]
type = "orthographic"
zenith = 50.0
azimuth = 180.0
width = 1.2
pixels = [10, 10]
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
grid = [3, 3, 3]
pixels = 0.5
samples = 8
iterations = 40
window = 10
[[stage]]
grid = [6, 6, 6]
samples = 8
iterations = 60
window = 30
"""

# Iterations after which a process is struck at the latest.
_FARTHEST = 20


def command(folder: Path, output: str, *options: str) -> list[str]:
    arguments = ["reconstruct", str(folder / "run.toml"), "--output", str(folder / output), "--quiet", "--no-report"]
    return [sys.executable, "-m", "cloudtomo_cl", *arguments, *options]


def prepare(folder: Path) -> None:
    """A cloud, its images, and the settings."""
    grid = ct.Grid(shape=(6, 6, 6), spacing=(0.16, 0.16, 0.16))
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


def strike(process: subprocess.Popen[bytes], folder: Path, start: float, left: int, rng: random.Random) -> bool:
    """Kills at a random moment; False if the run ended before.

    start : seconds that a process takes to its first checkpoint
    left : iterations that this one has before it
    """

    def wait_until(reached: Callable[[], object]) -> None:
        while process.poll() is None and not reached():
            time.sleep(0.001)

    if rng.random() < 0.2:
        end = time.monotonic() + rng.uniform(0.0, start)
        wait_until(lambda: time.monotonic() > end)
    else:
        last = reached(folder) + rng.randrange(min(left, _FARTHEST))
        at_a_write, pause = rng.random() < 0.6, rng.random()
        wait_until(lambda: reached(folder) > last)
        if at_a_write:
            wait_until(lambda: list(folder.glob(".checkpoint.npz.*")))
        time.sleep(pause * (0.003 if at_a_write else 0.1))
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
        process = subprocess.Popen(command(folder, "undisturbed"))
        while process.poll() is None and not (folder / "undisturbed" / "checkpoint.npz").exists():
            time.sleep(0.002)
        begun = time.monotonic()
        if process.wait() != 0:
            return 1
        return compare(folder, options.kills, random.Random(options.seed), begun - start)


def compare(folder: Path, kills: int, rng: random.Random, start: float) -> int:
    """Kills and resumes; as a run ends before its kills are over, another one is begun."""
    expected = bits(folder / "undisturbed")
    iterations = len(expected[1])
    print(f"undisturbed: {iterations} iterations", flush=True)
    done, runs, same, leftovers = 0, 0, 0, 0
    while done < kills or runs == 0:
        output = f"killed{runs}"
        moments = []
        while True:
            left = iterations - reached(folder / output)
            process = subprocess.Popen(command(folder, output, "--resume"))
            if done < kills and left > 0 and strike(process, folder / output, start, left, rng):
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
        verdict = "same bits" if equal else "DIFFERS"
        print(f"{output}: killed {len(moments)} times, at iterations {moments}: {verdict}", flush=True)
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
