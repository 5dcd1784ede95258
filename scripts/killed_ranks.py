"""Recoveries with two ranks, one of which is killed at a random moment: do all end, and is the run resumed as it was?

    python scripts/killed_ranks.py --kills 10 --seed 7        # some 2 minutes on free cores

Needs mpi4py and mpiexec. Exit status 1 if a process goes on for more than 10 seconds, a checkpoint cannot be read, or a
resume with one, two or three ranks ends with other bits than a run that nobody killed.
"""

from __future__ import annotations

import argparse
import random
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import psutil

import cloudtomo_cl as ct

LONGEST, PATIENCE = 10.0, 300.0  # s
CLOUD = "cloud --generate cumulus --shape 8 8 8 --spacing 0.1 0.1 0.1 --seed 3 --output cloud.nc"
SCENE = """[cloud]\nfile = "cloud.nc"\n[sun]\nzenith = 30.0\n[[view]]\ntype = "ring"\ncount = 2\nheight = 2.2
target = [0.4, 0.4, 0.4]\nradius = 1.2\nfield_of_view = 24.0\npixels = [11, 11]\n"""
RUN = """[measurements]\nfile = "images.nc"\n[run]\nuncertainty = 0\ncheckpoint_interval = 0.01\n[[stage]]
grid = [8, 8, 8]\nsamples = 64\niterations = 12\n"""


def command(words: str, ranks: int, mpiexec: list[str]) -> list[str]:
    launcher = [*mpiexec, "-n", str(ranks)] if ranks > 1 else []
    return [*launcher, sys.executable, "-m", "cloudtomo_cl", *words.split(), "--quiet"]


def of_python(process: psutil.Process) -> list[psutil.Process]:
    """The ranks that a launcher has started."""
    return [one for one in process.children(recursive=True) if one.name().startswith("python")]


def killed(run: list[str], folder: Path, checkpoint: Path, rng: random.Random) -> float:
    """Starts a run, kills a rank after the first checkpoint; returns seconds until all have ended."""
    process = subprocess.Popen(run, cwd=folder, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    until = time.monotonic() + PATIENCE
    while not checkpoint.exists() and time.monotonic() < until:
        time.sleep(0.01)
    ranks = of_python(psutil.Process(process.pid))
    time.sleep(rng.uniform(0, 2.0))
    since = time.monotonic()
    rng.choice(ranks).send_signal(signal.SIGKILL)
    process.wait(PATIENCE)
    psutil.wait_procs(ranks, PATIENCE)
    return time.monotonic() - since


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kills", type=int, default=10)
    parser.add_argument("--seed", type=int, default=0, help="of moments, ranks, and numbers of ranks that resume")
    parser.add_argument("--mpiexec", nargs="+", default=["mpiexec"], help="and its options")
    options = parser.parse_args()
    rng, wrong = random.Random(options.seed), 0
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        (folder / "scene.toml").write_text(SCENE)
        (folder / "run.toml").write_text(RUN)
        words = "reconstruct run.toml --seed 2 --no-report --output "
        for first in (CLOUD, "render scene.toml --samples 64 --output images.nc", words + "whole"):
            subprocess.run(command(first, 1, []), cwd=folder, check=True, stdout=subprocess.DEVNULL)
        expected = ct.read_extinction(folder / "whole" / "reconstruction.nc")[1]
        for kill in range(options.kills):
            name, ranks = f"run{kill}", rng.choice((1, 2, 3))
            checkpoint = folder / name / "checkpoint.npz"
            seconds = killed(command(words + name, 2, options.mpiexec), folder, checkpoint, rng)
            with np.load(checkpoint) as file:
                done = [key for key in file.files if file[key] is not None]
            subprocess.run(command(f"{words}{name} --resume", ranks, options.mpiexec), cwd=folder, check=True)
            same = np.array_equal(ct.read_extinction(folder / name / "reconstruction.nc")[1], expected)
            wrong += seconds > LONGEST or not done or not same
            print(f"kill {kill}: all ended after {seconds:.1f} s; {ranks} ranks resume: same bits {same}", flush=True)
    print(f"{options.kills} kills (seed {options.seed}): {wrong} faults")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
