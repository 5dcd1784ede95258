"""The parts of scripts/gpu_check.py: each in a process of its own, for a driver that crashes takes its process along.

python -m gpu.parts gpu.timed [--quick]      # one part, by itself; CLOUDTOMO_DEVICE chooses the device
"""

from __future__ import annotations

import argparse
import importlib
import os
import select
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from gpu.rows import Row, failed, read

SCRIPTS = Path(__file__).resolve().parents[1]


@dataclass(frozen=True)
class Part:
    """A part of the check.

    Attributes
    ----------
    module : its function `rows(quick)` yields them
    seconds, quick_seconds : after which it is ended; what it has printed by then counts
    on_cpu : it runs on the machine's CPU, beside the device
    """

    module: str
    seconds: float
    quick_seconds: float
    on_cpu: bool = False


# An H200 whose kernels were built took 85 s for all but the tests (80 s) and the CPU's speed. A rehearsal's are for a
# machine that does other things besides.
PARTS = {
    "device": Part("gpu.described", 15, 60),
    "bits": Part("gpu.compared", 120, 120),
    "audits": Part("gpu.audited", 60, 90),
    "speed": Part("gpu.timed", 75, 240),
    "speed of the CPU": Part("gpu.timed", 100, 240, on_cpu=True),
    "recovery": Part("gpu.recovered", 90, 180),
    "kernels": Part("gpu.profiled", 30, 120),
    "registers": Part("gpu.limited", 40, 60),
    "tests": Part("gpu.tested", 90, 240),
    "mitsuba": Part("gpu.rivalled", 60, 120),
}


def rows(name: str, part: Part, quick: bool, environment: dict[str, str]) -> Iterator[Row]:
    """Runs a part; yields its rows as they come, one that says so if it failed, and how long it took."""
    budget = part.quick_seconds if quick else part.seconds
    paths = os.pathsep.join(filter(None, [str(SCRIPTS), str(SCRIPTS.parent), os.environ.get("PYTHONPATH", "")]))
    command = [sys.executable, "-W", "ignore", "-m", "gpu.parts", part.module, *(["--quick"] if quick else [])]
    start = time.monotonic()
    process = subprocess.Popen(
        command, env={**os.environ, **environment, "PYTHONPATH": paths}, stdout=subprocess.PIPE,
        stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    assert process.stdout is not None and process.stderr is not None
    ended, errors = False, ""
    os.set_blocking(process.stderr.fileno(), False)
    while not ended:
        left = start + budget - time.monotonic()
        ready, _, _ = select.select([process.stdout, process.stderr], [], [], max(left, 0.0))
        if not ready:
            break
        if process.stderr in ready:
            errors = (errors + (process.stderr.read() or ""))[-2000:]
        if process.stdout in ready:
            line = process.stdout.readline()
            ended = not line
            yield from read(line)
        elif process.poll() is not None:
            ended = True
    if not ended:
        process.kill()
    status = process.wait()
    errors += process.stderr.read() or ""
    if not ended:
        yield failed(name, f"ended after its {budget:g} s; what is above was done by then")
    elif status:
        last = (errors.strip().splitlines() or ["without a word"])[-1]
        yield failed(name, f"status {status}: {last}")
    yield Row(name, "seconds", round(time.monotonic() - start, 1), "s")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("module")
    parser.add_argument("--quick", action="store_true")
    arguments = parser.parse_args()
    for row in importlib.import_module(arguments.module).rows(arguments.quick):
        row.print()
    return 0


if __name__ == "__main__":
    sys.exit(main())
