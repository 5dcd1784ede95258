"""Feeds malformed settings and files to the command line, and checks how it answers.

    python scripts/fuzz.py [--cases 2500] [--seed 0] [--seconds 120]

Every case starts from a tiny scene that works and spoils one of its files: settings (types,
keys, numbers, text), clouds, images, checkpoints, priors, run folders (bytes, variables, dimensions,
types, units, values); how is in spoiling.py. The answer must be exit status 0 with a result that can be read, or 2
with a message and no file that was not there before; never a traceback, never a hang.

Cases run in a process of their own, so that a crash or a hang is counted and the next case
begins afresh. A case is a function of the seed and its number: --first N --cases 1 repeats one.
"""

from __future__ import annotations

import argparse
import collections
import contextlib
import io
import json
import os
import random
import select
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Any

from spoiling import spoil, spoilt_bytes, spoilt_settings, spoilt_text, toml

SCENE: dict[str, Any] = {
    "cloud": {
        "file": "cloud.nc",
        "single_scattering_albedo": 0.99,
        "phase_function": {"type": "henyey-greenstein", "g": 0.5},
    },
    "surface": {"albedo": 0.1},
    "air": {"extinction": 0.01},
    "boundary": {"horizontal": "open"},
    "sun": {"zenith": 30.0, "azimuth": 10.0, "irradiance": 1.0},
    "view": [
        {
            "type": "perspective",
            "position": [1.0, 0.2, 1.5],
            "target": [0.2, 0.2, 0.2],
            "up": [0, 0, 1],
            "field_of_view": 40.0,
            "pixels": [4, 3],
        },
        {"type": "orthographic", "zenith": 20.0, "azimuth": 40.0, "width": 0.6, "pixels": [4, 4]},
    ],
}
RUN: dict[str, Any] = {
    "measurements": {"file": "images.nc"},
    "truth": {"file": "cloud.nc"},
    "grid": {"shape": [4, 4, 4], "spacing": [0.1, 0.1, 0.1], "origin": [0.0, 0.0, 0.0]},
    "run": {"seed": 1, "time_limit": 0.05, "checkpoint_interval": 1.0},
    "stage": [{"grid": [2, 2, 2], "pixels": 0.5, "samples": 4, "iterations": 1, "window": 2, "prior_weight": 1.0}],
    "prior": {"type": "smoothness", "smoothness": 1e-4, "monotonicity": 0.1, "c1": 0.2, "c2": 0.05, "threshold": 0.01},
    "solver": {
        "type": "adam",
        "step_size": 0.1,
        "parametrisation": "square-root",
        "floor": 0.01,
        "start": 2.0,
        "iterate_average_window": 3,
    },
}
RENDER = ["render", "scene.toml", "--samples", "4", "--output", "new.nc"]
LEARN = ["prior", "learn", "cloud.nc", "--components", "1", "--rounds", "2", "--output", "new.nc"]
RECONSTRUCT = ["reconstruct", "run.toml", "--output", "new"]


def scene_case(folder: Path, rng: random.Random) -> list[str]:
    (folder / "scene.toml").write_bytes(spoilt_settings(SCENE, rng))
    return RENDER


def run_case(folder: Path, rng: random.Random) -> list[str]:
    (folder / "run.toml").write_bytes(spoilt_settings(RUN, rng))
    return RECONSTRUCT


def cloud_case(folder: Path, rng: random.Random) -> list[str]:
    spoil(folder / "cloud.nc", rng)
    return rng.choice([RENDER, ["cloud", "cloud.nc"], ["cloud", "cloud.nc", "--output", "new.nc"], LEARN])


def prior_case(folder: Path, rng: random.Random) -> list[str]:
    spoil(folder / "prior.nc", rng)
    (folder / "run.toml").write_text(toml({**RUN, "prior": {"type": "patches", "file": "prior.nc"}}))
    return RECONSTRUCT


def images_case(folder: Path, rng: random.Random) -> list[str]:
    spoil(folder / "images.nc", rng)
    text = rng.choice([toml(RUN), '[measurements]\nfile = "images.nc"\n[run]\ntime_limit = 0.05\n'])
    (folder / "run.toml").write_text(text)
    return RECONSTRUCT


def checkpoint_case(folder: Path, rng: random.Random) -> list[str]:
    path = folder / "old" / "checkpoint.npz"
    path.write_bytes(spoilt_bytes(path.read_bytes(), rng))
    return ["reconstruct", "run.toml", "--output", "old", "--resume"]


def report_case(folder: Path, rng: random.Random) -> list[str]:
    name = rng.choice(["settings.json", "history.csv", "reconstruction.nc"])
    path = folder / "old" / name
    if name == "reconstruction.nc":
        spoil(path, rng)
    elif name == "settings.json" and rng.random() < 0.5:
        files = [5, [], {"truth": 5}, {"truth": ""}, {"truth": "."}, {"measurements": "\x00"}, {"truth": "x" * 5000}]
        path.write_text(json.dumps(rng.choice([[], 5, None, "text", {"files": rng.choice(files)}])))
    else:
        path.write_bytes(spoilt_text(path.read_bytes(), rng))
    return ["report", "old"]


def arguments_case(folder: Path, rng: random.Random) -> list[str]:
    words = list(rng.choice([RENDER, RECONSTRUCT, ["cloud", "cloud.nc", "--output", "new.nc"], ["report", "old"]]))
    words += rng.choice([[], ["--crop", "x=0:1"], ["--device", "9"], ["--seed", "1"], ["--resume"], ["--overwrite"]])
    words += rng.choice([[], ["--coarsen", "2", "2", "2"], ["--png", "new.png"], ["--spacing", "nan", "1", "1"]])
    for _ in range(rng.choice([0, 1, 2])):
        place = rng.randrange(1, len(words))
        words[place] = rng.choice(
            ["", "-1", "nan", "1e30", "0", "3", "\u2603", "old", ".", "/dev/null", "cloud.nc", "--", "x=:", str(2**70)]
        )
    return words


CASES: list[tuple[Callable[[Path, random.Random], list[str]], int]] = [
    (scene_case, 8), (run_case, 8), (cloud_case, 5), (images_case, 5), (checkpoint_case, 2), (report_case, 2),
    (arguments_case, 2), (prior_case, 2),
]  # fmt: skip


_DRAWN = 10


class Bench:
    """Runs cases, each in a fresh copy of the same small inputs."""

    def __init__(self, folder: Path) -> None:
        from cloudtomo_cl.commands import cli, fluxes, modelled, reconstruction, rendering
        from cloudtomo_cl.opencl.devices import choose_device
        from cloudtomo_cl.report import plots

        self.folder = folder
        self.main = cli.main
        device, choose = choose_device(), choose_device
        # Opened and built once: the cases are about what users give.
        for module in (fluxes, reconstruction, rendering):
            module.choose_device = lambda name=None, *ranks: device if name is None else choose(name, *ranks)
        # The images of a report are rendered with millions of paths, and its figures take seconds: the cases
        # of reports are those that make one, and few of them draw.
        modelled.PATHS = 1000
        self.template = folder / "template"
        if not self.template.exists():
            self.prepare()
        self.plots, self.draw = plots, plots.save_figures
        self.make_report, self.reconstruction = reconstruction.make_report, reconstruction

    def prepare(self) -> None:
        import numpy as np

        from cloudtomo_cl.files.extinction import write_extinction
        from cloudtomo_cl.scene.grid import Grid

        self.template.mkdir()
        extinction = np.zeros((4, 4, 4), np.float32)
        extinction[1:3, 1:3, 1:3] = 10.0
        write_extinction(self.template / "cloud.nc", Grid((4, 4, 4), (0.1, 0.1, 0.1)), extinction)
        (self.template / "scene.toml").write_text(toml(SCENE))
        (self.template / "run.toml").write_text(toml(RUN))
        images = ["--samples", "16", "--quiet", "--output", "images.nc"]
        run = ["--no-report", "--quiet", "--output", "old"]
        for command in ([*RENDER[:2], *images], [*RECONSTRUCT[:2], *run], [*LEARN[:-1], "prior.nc", "--quiet"]):
            with _inside(self.template):
                if self.main(command) != 0:
                    raise SystemExit("the inputs that the cases start from do not work")

    def run(self, seed: int, number: int) -> dict[str, Any]:
        """One case: its command, exit status, and what is wrong with the answer, if anything."""
        rng = random.Random(f"{seed} {number}")
        kind = rng.choices([case for case, _ in CASES], [weight for _, weight in CASES])[0]
        folder = self.folder / "case"
        shutil.rmtree(folder, ignore_errors=True)
        shutil.copytree(self.template, folder)
        with _inside(folder):
            command = kind(folder, rng)
            before = _listing(folder)
            self.reconstruction.make_report = self.make_report if kind is report_case else lambda *_, **__: None
            self.plots.save_figures = self.draw if number % _DRAWN == 0 else lambda *_, **__: []
            output, errors = io.StringIO(), io.StringIO()
            start, wrong = time.monotonic(), ""
            with contextlib.redirect_stdout(output), contextlib.redirect_stderr(errors):
                try:
                    status = self.main(command)
                except SystemExit as left:
                    status = left.code
                except BaseException:  # noqa: B036
                    status, wrong = -1, traceback.format_exc()
            seconds = time.monotonic() - start
            message = errors.getvalue()
            wrong = wrong or self.judge(status, message, before, _listing(folder), command)
        return {
            "number": number, "kind": kind.__name__, "command": " ".join(command)[:200], "status": status,
            "seconds": seconds, "wrong": wrong, "message": message[-2000:],
        }  # fmt: skip

    def judge(
        self, status: Any, message: str, before: dict[str, bytes], after: dict[str, bytes], command: list[str]
    ) -> str:
        """What is wrong with an answer; nothing if it is in order."""
        if status not in (0, 2):
            return f"exit status {status}"
        if "Traceback" in message:
            return "a traceback in the message"
        if status == 2 and not message.strip():
            return "no message"
        if any(name.endswith(".partial") for name in after):
            return "a partial file is left"
        if status == 2 and after != before:
            changed = sorted(name for name in {*before, *after} if before.get(name) != after.get(name))
            return f"failed, but changed {changed}"
        if status == 0 and "new.nc" in after and command[0] == "cloud":
            from cloudtomo_cl.files.extinction import read_extinction

            read_extinction("new.nc")
        return ""


def _listing(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@contextlib.contextmanager
def _inside(folder: Path) -> Any:
    before = os.getcwd()
    os.chdir(folder)
    try:
        yield
    finally:
        os.chdir(before)


# ---- many cases


def worker(seed: int, first: int, last: int, folder: Path) -> None:
    """A line of JSON for each case."""
    answers = os.fdopen(os.dup(1), "w")
    bench = Bench(folder)
    for number in range(first, last):
        print(json.dumps({"begun": number}), file=answers, flush=True)
        print(json.dumps(bench.run(seed, number)), file=answers, flush=True)


def supervise(seed: int, first: int, cases: int, limit: float, folder: Path) -> list[dict[str, Any]]:
    """Runs workers until all cases are done; a worker that crashes or hangs is replaced."""
    results: list[dict[str, Any]] = []
    number, last = first, first + cases
    while number < last:
        arguments = ["--worker", "--seed", str(seed), "--first", str(number), "--cases", str(last - number)]
        process = subprocess.Popen(
            [sys.executable, __file__, *arguments, "--folder", str(folder)], stdout=subprocess.PIPE, text=True,
            stderr=subprocess.DEVNULL,
        )  # fmt: skip
        try:
            assert process.stdout is not None
            begun = False
            while True:
                # The first case waits for the imports and the device.
                ready, _, _ = select.select([process.stdout], [], [], limit if begun else 1500)
                line = process.stdout.readline() if ready else None
                if not line:
                    process.kill()
                    status = process.wait()
                    wrong = "hangs" if line is None else f"the process died with {status}"
                    if number < last:
                        results.append(
                            {"number": number, "kind": "?", "status": None, "seconds": limit, "wrong": wrong}
                        )
                        number += 1
                    break
                answer = json.loads(line)
                begun = True
                if "begun" not in answer:
                    results.append(answer)
                    number += 1
                    if answer["wrong"]:
                        print(json.dumps(answer, indent=1), flush=True)
                    if len(results) % 250 == 0:
                        print(f"{len(results)} cases", flush=True)
                    if number == last:
                        process.wait()
                        break
        finally:
            process.kill()
            process.wait()
    return results


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cases", type=int, default=2500)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--seconds", type=float, default=300.0, help="a case that takes longer hangs")
    parser.add_argument("--folder", type=Path, help=argparse.SUPPRESS)
    parser.add_argument("--worker", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.worker:
        worker(options.seed, options.first, options.first + options.cases, options.folder)
        return 0
    # Told to end, it ends its worker and takes its folder away.
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        results = supervise(options.seed, options.first, options.cases, options.seconds, folder)
    kinds = collections.Counter((result["kind"], result["status"]) for result in results)
    for (kind, status), count in sorted(kinds.items(), key=str):
        print(f"{kind:<18}{'crash or hang' if status is None else f'exit status {status}'}: {count}")
    wrong = [result for result in results if result["wrong"]]
    slowest = max(results, key=lambda result: result["seconds"])
    print(f"{len(results)} cases, {len(wrong)} wrong, slowest {slowest['seconds']:.1f} s (case {slowest['number']})")
    for result in wrong:
        print(f"  case {result['number']}: {result['wrong'].strip().splitlines()[-1]}")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
