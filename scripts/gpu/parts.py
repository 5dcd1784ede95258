"""The parts of scripts/gpu_check.py: each in a process of its own, for a driver that crashes takes its process along.

    python -m gpu.parts NAME [--quick]      # one part, by itself; CLOUDTOMO_DEVICE chooses the device
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
    module : of this package; its function `rows(quick)` yields them
    seconds, quick_seconds : after which it is ended; what it has printed by then counts
    on_cpu : it runs on the machine's CPU, beside the device
    """

    module: str
    seconds: float
    quick_seconds: float
    on_cpu: bool = False


PARTS = {
    "device": Part("described", 60, 60),
    "bits": Part("compared", 60, 120),
    "audits": Part("audited", 45, 90),
    "speed": Part("timed", 100, 240),
    "speed of the CPU": Part("timed", 60, 240, on_cpu=True),
    "recovery": Part("recovered", 120, 120),
    "kernels": Part("profiled", 60, 120),
    "registers": Part("limited", 60, 60),
    "tests": Part("tested", 125, 240),
    "mitsuba": Part("rivalled", 60, 120),
}


def rows(name: str, quick: bool, environment: dict[str, str]) -> Iterator[Row]:
    """Runs a part; yields its rows as they come, and at last one that says if it failed, and how long it took."""
    part = PARTS[name]
    budget = part.quick_seconds if quick else part.seconds
    paths = os.pathsep.join(filter(None, [str(SCRIPTS), str(SCRIPTS.parent), os.environ.get("PYTHONPATH", "")]))
    command = [sys.executable, "-W", "ignore", "-m", "gpu.parts", name, *(["--quick"] if quick else [])]
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
    parser.add_argument("part", choices=PARTS)
    parser.add_argument("--quick", action="store_true")
    arguments = parser.parse_args()
    module = importlib.import_module(f"gpu.{PARTS[arguments.part].module}")
    for row in module.rows(arguments.quick):
        row.print()
    return 0


if __name__ == "__main__":
    sys.exit(main())
