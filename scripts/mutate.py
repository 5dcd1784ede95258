"""Changes one operator in each function of the numerics, and lists what no test notices.

    python scripts/mutate.py                                  # one mutant of each Python function
    python scripts/mutate.py --files 'kernels/**/*' --minutes 60
    python scripts/mutate.py --again survived                 # after tests were added

+ becomes -, < becomes <=, `and` becomes `or`, 0 becomes 1, `minimum` becomes `maximum`, an argument changes its
sign, and so on (scripts/mutants). Which mutants: by --seed. Each is tested in a copy of the tree, with the tests
that TESTS names for its file, until one fails. What was found is kept in runs/mutants-SEED.jsonl: a run that is
started again goes on where it was. docs/measurements/mutations.md tells what survived, and why.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from fnmatch import fnmatch
from pathlib import Path
from typing import Any

from mutants import kernels, python
from mutants.mutant import Mutant

TOP = Path(__file__).resolve().parents[1]
FILES = ("cloudtomo_cl/inversion/**/*.py", "cloudtomo_cl/transport/*.py", "cloudtomo_cl/scene/*.py")
UNIT, KERNELS, SYSTEM = "tests/unit/test_", "tests/kernels/test_", "tests/system/test_"
# Derivatives by the radiance table.
TABLE = (KERNELS + "jacobian", KERNELS + "radiance_table")
# The tests of a file, quick ones first; the first pattern that fits. A star stands for whatever is there.
TESTS: dict[str, tuple[str, ...]] = {
    "*/messages.py": (UNIT + "answers_in_python", UNIT + "config"),
    "*/files/stored_settings.py": (UNIT + "files", UNIT + "misread_images", UNIT + "wavelengths"),
    "*/files/vti.py": (UNIT + "viewers",),
    "*/files/wavelengths.py": (UNIT + "wavelengths",),
    "*/settings/scenes.py": (UNIT + "wavelengths", SYSTEM + "spectrum"),
    "*/report/directions.py": (UNIT + "volume",),
    "*/report/volume.py": (UNIT + "volume",),
    "*/commands/example.py": (UNIT + "commands_for_people",),
    "*/commands/history_file.py": (UNIT + "runfolder",),
    "*/commands/notebook.py": (UNIT + "notebook_displays",),
    "*/scene/cards.py": (UNIT + "notebook_displays",),
    "*/scene/poses.py": (UNIT + "poses",),
    "*/scene/droplets.py": (UNIT + "droplets", UNIT + "phase_files", UNIT + "mie"),
    "*/scene/formations.py": (UNIT + "formations", UNIT + "config"),
    "*/scene/grid.py": (UNIT + "grid", UNIT + "clouds", UNIT + "carve", UNIT + "files", UNIT + "measurements"),
    "*/scene/measurements.py": (UNIT + "measurements", UNIT + "carve", UNIT + "noise", UNIT + "files"),
    "*/scene/masks.py": (UNIT + "masks", UNIT + "python_arrays"),
    "*/scene/metrics.py": (UNIT + "metrics",),
    "*/scene/noise.py": (UNIT + "noise",),
    "*/scene/phase.py": (UNIT + "phase_functions", UNIT + "phase_files", UNIT + "droplets", KERNELS + "phase"),
    "*/scene/arrays.py": (UNIT + "missing", UNIT + "python_arrays"),
    "*/scene/pixel_errors.py": (UNIT + "pixel_errors", KERNELS + "pooled_errors"),
    "*/scene/pixels.py": (UNIT + "pixel_lists", UNIT + "measurements", UNIT + "carve", *TABLE),
    "*/scene/scene.py": (UNIT + "scene", UNIT + "config", KERNELS + "walk", KERNELS + "exact", KERNELS + "flux"),
    "*/scene/sensors.py": (UNIT + "projection", UNIT + "sensors", UNIT + "formations", UNIT + "config",
                           KERNELS + "camera", UNIT + "carve"),
    "*/scene/box.py": (UNIT + "carve", UNIT + "sensors", UNIT + "volume"),
    "*/scene/visibility.py": (UNIT + "carve", UNIT + "measurements", UNIT + "projection"),
    "*/scene/water.py": (UNIT + "droplets", UNIT + "mie"),
    "*/transport/adaptive.py": (KERNELS + "adaptive",),
    "*/transport/audit.py": (KERNELS + "audit", UNIT + "device_errors"),
    "*/transport/radiance_table.py": (*TABLE, KERNELS + "finite_differences", UNIT + "memory"),
    "*/transport/table_*.py": (*TABLE, KERNELS + "finite_differences", KERNELS + "fast_and_plain"),
    "*/transport/flux.py": (KERNELS + "flux", UNIT + "memory"),
    "*/transport/gradient.py": (KERNELS + "gradient", KERNELS + "audit", KERNELS + "radiance_table"),
    "*/transport/medium.py": (UNIT + "bad_input", KERNELS + "exact"),
    "*/transport/device_scene.py": (KERNELS + "skipping", KERNELS + "phase", KERNELS + "walk", UNIT + "bad_input",
                                    KERNELS + "exact"),
    "*/transport/empty_blocks.py": (KERNELS + "skipping",),
    "*/transport/rendering_memory.py": (UNIT + "memory", UNIT + "in_parts"),
    "*/transport/device_pixels.py": (UNIT + "pixel_lists", KERNELS + "camera", KERNELS + "virtual_collisions"),
    "*/transport/path_sums.py": (KERNELS + "paths", KERNELS + "accumulate", KERNELS + "random_numbers"),
    "*/transport/radiance.py": (KERNELS + "exact", UNIT + "memory", KERNELS + "random_numbers", KERNELS + "gradient",
                                KERNELS + "audit", UNIT + "device_errors"),
    "*/transport/*": (*TABLE, KERNELS + "finite_differences", KERNELS + "tallies", SYSTEM + "problem"),
    "*/inversion/carving.py": (UNIT + "carve", SYSTEM + "carving"),
    "*/inversion/checks.py": (UNIT + "memory", UNIT + "bad_input", SYSTEM + "inversion"),
    "*/inversion/checkpoint.py": (UNIT + "checkpoint", UNIT + "learn_prior", SYSTEM + "resume"),
    "*/inversion/conjugate_gradients.py": (UNIT + "conjugate_gradients", UNIT + "uncertainty"),
    "*/inversion/*terms.py": (UNIT + "conjugate_gradients", UNIT + "uncertainty"),
    "*/inversion/vectors.py": (UNIT + "conjugate_gradients",),
    "*/inversion/data_term.py": (UNIT + "data_term",),
    "*/inversion/solvers/descent.py": (KERNELS + "optimizer", UNIT + "stages", SYSTEM + "inversion"),
    "*/inversion/objective.py": (UNIT + "objective", UNIT + "uncertainty", KERNELS + "optimizer", SYSTEM + "inversion"),
    "*/inversion/*priors.py": (UNIT + "own_prior", UNIT + "patch_prior", SYSTEM + "inversion"),
    "*/inversion/smoothness.py": (KERNELS + "prior", UNIT + "uncertainty", KERNELS + "finite_differences"),
    "*/inversion/patch*.py": (UNIT + "patch_prior",),
    "*/inversion/halo.py": (UNIT + "patch_prior",),
    "*/inversion/stencil.py": (UNIT + "patch_prior",),
    "*/inversion/learning.py": (UNIT + "learn_prior",),
    "*/commands/prior.py": (UNIT + "learn_prior",),
    "*/inversion/mixture*.py": (UNIT + "patch_prior", UNIT + "learn_prior"),
    "*/inversion/relative_prior.py": (UNIT + "patch_prior",),
    "*/inversion/pixels.py": (UNIT + "measurements", UNIT + "objective", SYSTEM + "inversion"),
    "*/inversion/run.py": (UNIT + "divergence", SYSTEM + "inversion", SYSTEM + "resume"),
    "*/inversion/stages.py": (UNIT + "stages", SYSTEM + "inversion"),
    "*/inversion/uncertainty.py": (UNIT + "uncertainty", SYSTEM + "inversion"),
    "*/inversion/solvers/*": (UNIT + "solver_state", UNIT + "objective", UNIT + "config", UNIT + "stages",
                              SYSTEM + "inversion", SYSTEM + "resume"),
    "*/inversion/linear_model.py": (UNIT + "uncertainty", SYSTEM + "problem", SYSTEM + "inversion"),
    "*/inversion/problem.py": (SYSTEM + "problem", SYSTEM + "inversion"),
    "*/inversion/*": (UNIT + "uncertainty", UNIT + "objective", UNIT + "stages", UNIT + "memory", SYSTEM + "inversion",
                      SYSTEM + "resume"),
    "kernels/*rng.h": (KERNELS + "random_numbers",),
    "kernels/*accumulate.h": (KERNELS + "accumulate",),
    "kernels/*arithmetic.h": (KERNELS + "arithmetic",),
    "kernels/*camera.h": (KERNELS + "camera",),
    "kernels/*phase.h": (KERNELS + "phase",),
    "kernels/*grid.h": (KERNELS + "walk", KERNELS + "skipping"),
    "kernels/prior.cl": (KERNELS + "prior",),
    "kernels/optimizer.cl": (KERNELS + "optimizer",),
    "kernels/flux.cl": (KERNELS + "flux",),
    "kernels/replay.cl": (KERNELS + "gradient", KERNELS + "finite_differences"),
    "kernels/*replayed.h": (KERNELS + "gradient", KERNELS + "finite_differences", *TABLE),
    "kernels/*budget.h": (KERNELS + "audit", KERNELS + "flux"),
    "kernels/derivatives.*": (*TABLE, KERNELS + "finite_differences"),
    "kernels/radiance_table.h": (*TABLE, KERNELS + "finite_differences"),
    "kernels/jacobian.cl": (*TABLE, KERNELS + "finite_differences", SYSTEM + "problem"),
    "kernels/near_field.*": (*TABLE, KERNELS + "finite_differences", SYSTEM + "problem"),
    "kernels/products.cl": (*TABLE, SYSTEM + "problem"),
    "kernels/*": (KERNELS + "tallies", KERNELS + "walk",
                  KERNELS + "paths", KERNELS + "exact", KERNELS + "properties", KERNELS + "gradient",
                  *TABLE, KERNELS + "flux", KERNELS + "audit"),
}  # fmt: skip
# A mutant may be so much slower than the code before it counts as noticed, and so many seconds in any case.
SLOWER, GRACE = 3.0, 30.0
STATUSES = ("killed", "survived", "invalid")  # invalid: does not compile, or has no tests


def tests_of(path: str, top: Path = TOP) -> list[str]:
    """The test files of a source file."""
    names = next((tests for pattern, tests in TESTS.items() if fnmatch(path, pattern)), ())
    found = [name + ".py" for name in names if (top / (name + ".py")).is_file()]
    if not found:
        raise SystemExit(f"no tests are known for {path}: add them to TESTS in scripts/mutate.py")
    return found


def sources(patterns: list[str]) -> list[str]:
    """What is to be changed, from the top of the repository."""
    found = {path.relative_to(TOP).as_posix() for pattern in patterns for path in TOP.glob(pattern)}
    return sorted(path for path in found if Path(path).suffix in (".py", ".cl", ".h"))


def chosen(paths: list[str], seed: int, per_function: int) -> list[Mutant]:
    """Some mutants of every function, in an order of their own."""
    found = []
    for path in paths:
        text = (TOP / path).read_text(encoding="utf-8")
        language = python if path.endswith(".py") else kernels
        for of_function in language.mutants(path, text):
            # By the function alone: what changes elsewhere does not change the choice.
            draw = random.Random(f"{seed} {path} {of_function[0].function} {of_function[0].fingerprint}")
            found += draw.sample(of_function, min(per_function, len(of_function)))
    random.Random(seed).shuffle(found)
    return found


class Copy:
    """A copy of the tree, in which one file at a time is changed."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        listed = subprocess.run(
            ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"],
            cwd=TOP, capture_output=True, check=True,
        ).stdout.decode()  # fmt: skip
        for name in filter(None, listed.split("\0")):
            if (TOP / name).is_file():
                (folder / name).parent.mkdir(parents=True, exist_ok=True)
                shutil.copy2(TOP / name, folder / name)
        self._seconds: dict[str, float] = {}

    def _run(self, tests: list[str], limit: float) -> tuple[str, str]:
        # Without bytecode: two mutants of one second and size would be taken for each other.
        environment = {**os.environ, "PYTHONPATH": str(self.folder), "PYTHONDONTWRITEBYTECODE": "1"}
        command = [sys.executable, "-m", "pytest", "-x", "-q", "--tb=line", "-p", "no:cacheprovider", *tests]
        with subprocess.Popen(
            command, cwd=self.folder, env=environment, text=True, start_new_session=True,
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
        ) as process:  # fmt: skip
            try:
                output, _ = process.communicate(timeout=limit)
            except subprocess.TimeoutExpired:
                os.killpg(process.pid, signal.SIGKILL)
                return "killed", f"took more than {limit:.0f} s"
        if process.returncode == 0:
            return "survived", ""
        if "BuildError" in output or "SyntaxError" in output:
            return "invalid", "does not compile"
        lines = [line for line in output.splitlines() if line.startswith(("FAILED", "ERROR"))]
        return "killed", (lines or output.splitlines() or ["no output"])[-1][:200]

    def passing(self, tests: list[str]) -> list[str]:
        """Those that pass without a mutant; others could notice nothing."""
        for test in tests:
            if test not in self._seconds:
                start = time.monotonic()
                status, why = self._run([test], 3600)
                self._seconds[test] = time.monotonic() - start if status == "survived" else 0.0
                if status != "survived":
                    print(f"left out, for it fails without a mutant: {test}: {why}", flush=True)
        return [test for test in tests if self._seconds[test]]

    def test(self, mutant: Mutant) -> tuple[str, str]:
        """Status (killed, survived, invalid) and what noticed it."""
        tests = self.passing(tests_of(mutant.path))
        limit = SLOWER * sum(self._seconds[test] for test in tests) + GRACE
        if not tests:
            return "invalid", "no test passes without it"
        place = self.folder / mutant.path
        text = place.read_text(encoding="utf-8")
        place.write_text(mutant.applied(text), encoding="utf-8")
        try:
            return self._run(tests, limit)
        finally:
            place.write_text(text, encoding="utf-8")


def results(path: Path) -> dict[str, dict[str, Any]]:
    """What was found before, by mutant; a later line replaces an earlier one."""
    lines = path.read_text(encoding="utf-8").splitlines() if path.exists() else []
    return {entry["key"]: entry for entry in map(json.loads, lines)}


def run(mutants: list[Mutant], journal: Path, minutes: float) -> None:
    """Tests mutants until all are done or the time is up."""
    end = time.monotonic() + 60 * minutes
    journal.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix="cloudtomo-mutants-") as folder:
        copy = Copy(Path(folder))
        for number, mutant in enumerate(mutants, start=1):
            if time.monotonic() > end:
                print(f"time is up: {len(mutants) - number + 1} mutants are left", flush=True)
                return
            start = time.monotonic()
            status, why = copy.test(mutant)
            before, after = mutant.shown((TOP / mutant.path).read_text(encoding="utf-8"))
            entry = {
                "key": mutant.key, "path": mutant.path, "function": mutant.function, "line": mutant.line,
                "status": status, "why": why, "before": before, "after": after,
                "seconds": round(time.monotonic() - start, 1),
            }  # fmt: skip
            with journal.open("a", encoding="utf-8") as file:
                file.write(json.dumps(entry) + "\n")
            print(f"{number}/{len(mutants)} {status} {mutant.path}:{mutant.line} {mutant.function} {why}", flush=True)


def report(entries: list[dict[str, Any]]) -> Iterator[str]:
    """How many were noticed, and those that were not."""
    counts = Counter(entry["status"] for entry in entries)
    yield f"{len(entries)} mutants: " + ", ".join(f"{counts[status]} {status}" for status in STATUSES)
    for entry in sorted(entries, key=lambda entry: (entry["path"], entry["line"])):
        if entry["status"] == "survived":
            yield f"{entry['path']}:{entry['line']} {entry['function']}"
            yield f"    - {entry['before']}"
            yield f"    + {entry['after']}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--files", nargs="+", default=list(FILES), help="patterns, from the top of the repository")
    parser.add_argument("--seed", type=int, default=1, help="which mutants (default: 1)")
    parser.add_argument("--per-function", type=int, default=1, help="mutants of each function (default: 1)")
    parser.add_argument("--most", type=int, help="mutants at most, chosen by the seed")
    parser.add_argument("--minutes", type=float, default=600, help="no mutant begins later than this (default: 600)")
    parser.add_argument("--again", choices=["survived", "killed"], help="test those once more that had this status")
    parser.add_argument("--list", action="store_true", help="show what was found, and run nothing")
    options = parser.parse_args()
    journal = TOP / "runs" / f"mutants-{options.seed}.jsonl"
    mutants = chosen(sources(options.files), options.seed, options.per_function)[: options.most]
    known = results(journal)
    left = [one for one in mutants if one.key not in known or known[one.key]["status"] == options.again]
    if not options.list:
        run(left, journal, options.minutes)
    known = results(journal)
    print("\n".join(report([known[one.key] for one in mutants if one.key in known])))


if __name__ == "__main__":
    main()
