"""Runs the tests on every OpenCL implementation that is installed, and compares what they compute.

    python scripts/portability.py [--only NAME] [--tests PATH ...] [--limit 300] [--total 3600]

An implementation is an .icd file of OCL_ICD_VENDORS (a folder; /etc/OpenCL/vendors by default), or
the PoCL that came with pyopencl, which is the first. Each runs in processes of its own that see no
other one. A test that hangs its process fails, and the next begins in a new one; one that crashes it
begins the new one, and fails if it crashes that, too (drivers spoil memory long before they fall
over: how often that was is printed). Oclgrind interprets kernels and looks for races, for memory that
is not theirs or was never written: there a choice of small tests runs (SIMULATED). Printed is a table,
in Markdown; exit status 0 if all agree.

docs/how-to/devices.md says what to install.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import select
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
VENDORS = "OCL_ICD_VENDORS"
# The tests that compute on the device, and those of them that an interpreter ends in minutes.
TESTS = [
    *(f"tests/kernels/test_{name}.py" for name in (
        "accumulate", "audit", "camera", "optimizer", "paths", "phase", "prior", "random_numbers", "skipping", "walk",
    )),
    "tests/system/test_repeat.py",
]  # fmt: skip
SIMULATED = [
    "tests/kernels/test_random_numbers.py::test_the_words_of_a_key_take_their_places",
    "tests/kernels/test_optimizer.py",
    "tests/kernels/test_prior.py",
]
# Where kernels take long to compile: of every kind some, and no scenes of several minutes.
SMALLER = [
    *(f"tests/kernels/test_{name}.py" for name in (
        "accumulate", "audit", "camera", "optimizer", "paths", "prior", "random_numbers",
    )),
    "tests/kernels/test_jacobian.py::test_launches_and_blocks_of_rows_change_no_bit",
]  # fmt: skip
# A simulator's checks: none of them is on by itself.
CHECKS = {
    "OCLGRIND_DATA_RACES": "1", "OCLGRIND_UNIFORM_WRITES": "1", "OCLGRIND_UNINITIALIZED": "1",
    "OCLGRIND_MAX_ERRORS": "100",
    # Its check of what was never written does not know LLVM's `freeze`, which optimised code has.
    "OCLGRIND_BUILD_OPTIONS": "-cl-opt-disable -disable-llvm-passes",
}  # fmt: skip
SAMPLES = {False: 400, True: 2}  # paths for each of the 32 pixels; on a simulator


@dataclass
class Implementation:
    """What one implementation is, and how it fared."""

    icd: str
    index: int
    platform: str
    device: str
    version: str
    accumulation: str
    outcomes: dict[str, str] = field(default_factory=dict)
    pages: dict[str, str] = field(default_factory=dict)
    crashes: int = 0
    reports: int | None = None
    comparison: dict[str, float] | None = None

    @property
    def name(self) -> str:
        return f"{self.platform}, {self.device}"

    @property
    def simulates(self) -> bool:
        return self.platform == "Oclgrind"

    @property
    def tests(self) -> list[str]:
        return SIMULATED if self.simulates else SMALLER if self.platform == "rusticl" else TESTS

    def count(self, outcome: str) -> int:
        return sum(found == outcome for found in self.outcomes.values())

    def environment(self, log: Path) -> dict[str, str]:
        """Of processes that are to run on it."""
        # pyopencl would keep Oclgrind's programs, whatever it is to check.
        checks = {**CHECKS, "OCLGRIND_LOG": str(log), "PYOPENCL_NO_CACHE": "1"} if self.simulates else {}
        return {**_environment(self.icd), **checks, "CLOUDTOMO_DEVICE": str(self.index)}


def _environment(icd: str) -> dict[str, str]:
    # ocl-icd, which pyopencl brings along, takes a single file, too. Rusticl hides devices until they are asked for.
    return {**os.environ, VENDORS: icd, "RUSTICL_ENABLE": os.environ.get("RUSTICL_ENABLE", "llvmpipe")}


# ---- in processes of their own


def list_worker() -> None:
    import pyopencl

    from cloudtomo_cl.opencl.devices import list_devices

    versions = {platform.name.strip(): platform.version.strip() for platform in pyopencl.get_platforms()}
    print(json.dumps([[d.index, d.platform, d.name, versions[d.platform], d.accumulation] for d in list_devices()]))


def mind_the_simulator() -> None:
    """Oclgrind's check for values that were never written does not see clEnqueueFillBuffer, and takes a new
    buffer for an older, smaller one at its address: buffers are written instead, and none is given back."""
    import pyopencl as cl

    kept = []

    class Buffer(cl.Buffer):  # type: ignore[misc, valid-type]
        def __init__(self, *arguments: Any, **options: Any) -> None:
            super().__init__(*arguments, **options)
            kept.append(self)

    def fill(queue: Any, buffer: Any, pattern: Any, offset: int, size: int, wait_for: Any = None) -> Any:
        values = np.tile(np.frombuffer(np.asarray(pattern).tobytes(), np.uint8), size // np.asarray(pattern).nbytes)
        return cl.enqueue_copy(queue, buffer, values, dst_offset=offset, wait_for=wait_for)

    if "OCLGRIND_UNINITIALIZED" in os.environ:
        cl.enqueue_fill_buffer, cl.Buffer = fill, Buffer


def test_worker(tests: list[str], done: list[str]) -> None:
    """A line of JSON as each test begins, and one as it ends."""
    import pytest

    mind_the_simulator()

    answers = os.fdopen(os.dup(1), "w")

    def answer(**values: Any) -> None:
        print(json.dumps(values), file=answers, flush=True)

    class Tell:
        def pytest_collection_modifyitems(self, items: list[Any]) -> None:
            items[:] = [item for item in items if item.nodeid not in done]
            answer(collected=[item.nodeid for item in items])

        def pytest_runtest_logstart(self, nodeid: str) -> None:
            answer(begun=nodeid)

        def pytest_runtest_logreport(self, report: Any) -> None:
            if report.when == "call" or report.outcome != "passed":
                answer(test=report.nodeid, outcome=report.outcome, page=report.longreprtext[-2000:])

    with open(os.devnull, "w") as nothing:
        os.dup2(nothing.fileno(), 1)
        pytest.main(["-q", "-p", "no:cacheprovider", *tests], plugins=[Tell()])


def compare_worker(samples: int, file: str) -> None:
    """Radiances of paths, an image, and both gradients of two small scenes, into a file."""
    import cloudtomo_cl as ct
    from cloudtomo_cl.opencl.devices import choose_device
    from cloudtomo_cl.transport.table_gradient import TableGradient

    mind_the_simulator()
    device = choose_device()
    grid = ct.Grid((5, 4, 6), (0.1, 0.12, 0.08), origin=(0.0, 0.0, 0.3))
    random = np.random.default_rng(7)
    extinction = (random.uniform(2, 20, grid.shape) * (random.random(grid.shape) > 0.3)).astype(np.float32)
    scenes = {
        "open": ct.Scene(grid, ct.Sun(30.0, 20.0), ct.Cloud(1.0, ct.HenyeyGreenstein(0.85)), surface=ct.Surface(0.2)),
        "periodic": ct.Scene(
            grid, ct.Sun(60.0, 100.0), ct.Cloud(0.95, ct.HenyeyGreenstein(0.3)), ct.Air(0.5), ct.Surface(0.5),
            ct.Boundary(horizontal="periodic"),
        ),
    }  # fmt: skip
    views = [
        ct.OrthographicView(zenith=20.0, azimuth=50.0, width=0.7, pixels=(4, 4)),
        ct.PerspectiveView((0.9, -0.4, 1.5), (0.25, 0.24, 0.5), 30.0, (4, 4)),
    ]
    results: dict[str, np.ndarray] = {}
    given_of = {}
    for name, scene in scenes.items():
        operator = ct.RadianceOperator(scene, views, device, mask=np.ones(grid.shape, bool))
        rendering = operator.render(extinction, samples, seed=3, stream=5, store_paths=True)
        adjoint = np.column_stack([np.linspace(0.5, 1.5, len(operator.pixels))] * 2)
        results[f"{name} paths"] = np.concatenate([paths.get()[0] for _, paths in rendering._launches])
        results[f"{name} image"] = rendering.mean
        results[f"{name} gradient"] = operator.gradient(rendering, adjoint).get()
        given_of[name] = (operator, rendering, adjoint)
    np.savez(file, **results)
    # Last, and what there is has been kept: this is where drivers fall over.
    for name, (operator, *given) in given_of.items():
        results[f"{name} adjoint"] = TableGradient(operator).gradient(*given)[0].get()
    np.savez(file, **results)


# ---- supervision


def implementations(empty: str) -> list[Implementation]:
    """All that are installed, pyopencl's own first; `empty` is a folder without files."""

    def devices(icd: str) -> list[Implementation]:
        answer = subprocess.run(
            [sys.executable, __file__, "--worker", "list"], env=_environment(icd), stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL, text=True, timeout=300,
        )  # fmt: skip
        return [Implementation(icd, *device) for device in json.loads(answer.stdout or "[]")]

    folder = Path(os.environ.get(VENDORS, "/etc/OpenCL/vendors"))
    files = [folder] if folder.is_file() else sorted(folder.glob("*.icd"))
    # With a folder, ocl-icd shows pyopencl's own, too; with a file, that one alone.
    return [implementation for icd in (empty, *map(str, files)) for implementation in devices(icd)]


def run_tests(implementation: Implementation, tests: list[str], limit: float, total: float, log: Path) -> None:
    """Runs tests until all are done or the time is over; processes that crash or hang are replaced."""
    end = time.monotonic() + total
    missing: set[str] = set()
    began = None
    while True:
        done = list(implementation.outcomes)
        process = subprocess.Popen(
            [sys.executable, __file__, "--worker", "test", "--tests", *tests], cwd=ROOT,
            env=implementation.environment(log), stdin=subprocess.PIPE, stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL, text=True,
        )  # fmt: skip
        assert process.stdin is not None and process.stdout is not None
        process.stdin.write(json.dumps(done))
        process.stdin.close()
        running = None
        while True:
            left = min(limit, end - time.monotonic())
            ready, _, _ = select.select([process.stdout], [], [], max(left, 0.0))
            line = process.stdout.readline() if ready else None
            if not line:
                break
            answer = json.loads(line)
            if "collected" in answer:
                missing = set(answer["collected"])
            elif "begun" in answer:
                running = answer["begun"]
            else:
                implementation.outcomes[answer["test"]] = answer["outcome"]
                missing.discard(answer["test"])
                if answer["outcome"] == "failed":
                    implementation.pages[answer["test"]] = answer["page"]
                    print(f"  failed: {answer['test']}", flush=True)
        process.kill()
        process.wait()
        over = time.monotonic() >= end
        if not missing or running is None:
            return
        crashed = line is not None
        implementation.crashes += crashed
        if running in missing and crashed and running != began and not over:
            print(f"  crashed, once more: {running}", flush=True)
            began = running
        elif running in missing:
            outcome = "not run" if over else "crashed" if crashed else f"no end in {limit:.0f} s"
            implementation.outcomes[running] = outcome
            print(f"  {outcome}: {running}", flush=True)
            missing.discard(running)
        if over:
            implementation.outcomes |= dict.fromkeys(missing, "not run")
            return


def compute(implementation: Implementation, samples: int, folder: Path, limit: float) -> dict[str, np.ndarray] | None:
    file = folder / f"{samples}.npz"
    file.unlink(missing_ok=True)
    command = [sys.executable, __file__, "--worker", "compare", "--samples", str(samples), "--file", str(file)]
    environment = implementation.environment(folder / "log")
    with contextlib.suppress(subprocess.TimeoutExpired):
        subprocess.run(command, env=environment, timeout=limit, stderr=subprocess.DEVNULL)
    if not file.is_file():
        return None
    with np.load(file) as stored:
        return dict(stored)


def differences(found: dict[str, np.ndarray], expected: dict[str, np.ndarray]) -> dict[str, float]:
    """Share of the paths that differ by more than 1e-3, and sums of absolute differences as shares of the sums.

    NaN: not found.
    """

    def share(kind: str) -> float:
        names = [name for name in expected if name.endswith(kind)]
        if not found.keys() >= set(names):
            return np.nan
        return max(float(np.abs(found[n] - expected[n]).sum() / np.abs(expected[n]).sum()) for n in names)

    lit = {n: (found[n] != 0) | (expected[n] != 0) for n in expected if n.endswith("paths")}
    other = sum((np.abs(found[n] - expected[n]) > 1e-3 * np.abs(expected[n])).sum() for n in lit)
    return {
        "paths": float(other / sum(mask.sum() for mask in lit.values())),
        "image": share("image"),
        "gradient": share("gradient"),
        "adjoint": share("adjoint"),
    }


def table(rows: list[Implementation]) -> str:
    lines = [
        "| implementation | version | accumulates by | passed | failed | skipped | not run "
        "| paths that differ | image | gradient (replay) | gradient (adjoint) | reports |",
        "|---|---|---|---|---|---|---|---|---|---|---|---|",
    ]
    return "\n".join(lines + [_line(row) for row in rows])


def _line(row: Implementation) -> str:
    bad = len(row.outcomes) - sum(row.count(outcome) for outcome in ("passed", "skipped", "not run"))
    compared = row.comparison
    values = (
        ["-"] * 4 if compared is None else [f"{compared[n]:.1e}" for n in ("paths", "image", "gradient", "adjoint")]
    )
    tests = [str(n) for n in (row.count("passed"), bad, row.count("skipped"), row.count("not run"))]
    reports = "-" if row.reports is None else str(row.reports)
    return f"| {' | '.join([row.name, row.version, row.accumulation, *tests, *values, reports])} |"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", action="append", help="a part of an implementation's name; may be given again")
    parser.add_argument("--tests", nargs="*", help=f"what pytest is to run; by default {' '.join(TESTS)}")
    parser.add_argument("--limit", type=float, default=300.0, help="seconds for one test, or for the comparison")
    parser.add_argument("--total", type=float, default=3600.0, help="seconds for one implementation's tests")
    parser.add_argument("--list", action="store_true", help="say what is installed, and stop")
    parser.add_argument("--worker", choices=["list", "test", "compare"], help=argparse.SUPPRESS)
    parser.add_argument("--samples", type=int, help=argparse.SUPPRESS)
    parser.add_argument("--file", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.worker == "list":
        list_worker()
    elif options.worker == "test":
        test_worker(options.tests, json.load(sys.stdin))
    elif options.worker == "compare":
        compare_worker(options.samples, options.file)
    else:
        return supervise(options)
    return 0


def supervise(options: argparse.Namespace) -> int:
    with tempfile.TemporaryDirectory() as empty, tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        rows = implementations(empty)
        for row in rows:
            print(f"{row.name}: {row.version}", flush=True)
        if options.list:
            return 0
        first = rows[0]
        chosen = [row for row in rows if not options.only or any(o.lower() in row.name.lower() for o in options.only)]
        expected = {s: compute(first, samples, folder, options.limit) for s, samples in SAMPLES.items()}
        for row in chosen:
            print(row.name, flush=True)
            log = folder / "log"
            found = compute(row, SAMPLES[row.simulates], folder, options.limit)
            reference = expected[row.simulates]
            if found is not None and reference is not None:
                row.comparison = differences(found, reference)
            run_tests(row, options.tests or row.tests, options.limit, options.total, log)
            if row.simulates:
                text = log.read_text() if log.is_file() else ""
                # A report's first line stands at the margin.
                row.reports = sum(bool(line.strip()) and not line.startswith("\t") for line in text.splitlines())
                print(text[:5000])
            if row.crashes:
                print(f"{row.crashes} crashes")
            for test, page in row.pages.items():
                print(f"---- {test}\n{page}\n")
    print(table(chosen))
    sound = all(
        row.comparison is not None and not row.reports and set(row.outcomes.values()) <= {"passed", "skipped"}
        for row in chosen
    )
    return 0 if sound else 1


if __name__ == "__main__":
    sys.exit(main())
