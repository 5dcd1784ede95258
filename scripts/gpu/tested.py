"""The kernels' tests on the device: a selection, as much of it as a minute and a half holds."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from gpu.rows import Row, failed

_PART = "tests"
_ROOT = Path(__file__).resolve().parents[2]
# Those of single functions first; then whole paths against the reference, what is summed, what depends on launches.
_FILES = (
    "random_numbers", "arithmetic", "accumulate", "phase", "walk", "camera", "optimizer", "prior", "audit", "paths",
    "skipping", "tallies", "virtual_collisions", "radiance_table", "jacobian", "flux", "gradient",
)  # fmt: skip
_SECONDS, _QUICK_SECONDS, _QUICK_FILES = 80.0, 220.0, 8


def rows(quick: bool) -> Iterator[Row]:
    try:
        import pytest
    except ImportError:
        yield failed(_PART, "pytest is not installed")
        return
    told = Told(time.monotonic() + (_QUICK_SECONDS if quick else _SECONDS))
    files = [f"tests/kernels/test_{name}.py" for name in (_FILES[:_QUICK_FILES] if quick else _FILES)]
    os.chdir(_ROOT)
    quiet = os.dup(1)
    with open(os.devnull, "w") as nothing:
        os.dup2(nothing.fileno(), 1)
        pytest.main(["-q", "-p", "no:cacheprovider", *files], plugins=[told])
    sys.stdout.flush()
    os.dup2(quiet, 1)
    for outcome in ("passed", "failed", "skipped", "not run"):
        count = told.outcomes.count(outcome)
        note = "the time was over" if outcome == "not run" and count else ""
        yield Row(_PART, outcome, float(count), "tests", note, count == 0 if outcome == "failed" else None)
    for page in told.pages:
        yield failed(_PART, page)


class Told:
    """A plugin of pytest's that gathers outcomes, and lets nothing begin after its end.

    Parameters
    ----------
    end : by time.monotonic
    """

    def __init__(self, end: float) -> None:
        self.end = end
        self.outcomes: list[str] = []
        self.pages: list[str] = []

    def pytest_runtest_setup(self, item: Any) -> None:
        import pytest

        if time.monotonic() > self.end:
            pytest.skip("the time is over")

    def pytest_runtest_logreport(self, report: Any) -> None:
        if report.when != "call" and report.outcome == "passed":
            return
        over = report.skipped and "the time is over" in report.longreprtext
        self.outcomes.append("not run" if over else report.outcome)
        if report.failed:
            self.pages.append(f"{report.nodeid}: {report.longreprtext[-250:]}")
