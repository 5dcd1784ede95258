"""What the live bar of a recovery says, and its last lines."""

import io
import logging
from dataclasses import replace

import pytest
from rich.console import Console

from cloudtomo_cl.commands import progress
from cloudtomo_cl.commands.progress import ReconstructionProgress
from cloudtomo_cl.commands.reconstruction import fit_text
from cloudtomo_cl.inversion.records import IterationRecord


def record(stage, iteration, seconds):
    return IterationRecord(stage, 2, iteration, 3, seconds, 1000, 1.0, 0.1, 0.0)


@pytest.fixture
def clock(monkeypatch):
    """Seconds that pass when a test says so."""
    now = [100.0]
    monkeypatch.setattr(progress.time, "monotonic", lambda: now[0])
    return now


def test_the_elapsed_time_goes_on_over_stages_of_the_same_length(clock):
    show = ReconstructionProgress(Console(file=io.StringIO()))
    said = []
    for stage in range(2):
        for iteration in range(3):
            clock[0] += 7.0
            show(record(stage, iteration, clock[0] - 100.0))
            said.append(show.live().rpartition("  ")[2])
    assert said == ["7 s", "14 s", "21 s", "28 s", "35 s", "42 s"]


def test_the_time_left_runs_down_between_iterations(clock):
    show = ReconstructionProgress(Console(file=io.StringIO()))
    clock[0] += 20.0
    show(record(0, 0, 20.0))
    assert "at most 40 s left" in show.live()
    clock[0] += 15.0
    assert "at most 25 s left" in show.live()


def test_what_is_done_before_an_iteration_ends_is_said(clock):
    logger = logging.getLogger("cloudtomo_cl.inversion.solvers.gauss_newton")
    with ReconstructionProgress(Console(file=io.StringIO(), force_terminal=True)) as show:
        logger.info("replaying the paths of iteration %d of %d", 2, 9)
        assert show.live() == "replaying the paths of iteration 2 of 9  0 s"
        show(record(0, 0, 1.0))
        assert "iteration    1" in show.live()
    logger.info("nobody listens any more")
    assert "iteration    1" in show.live()


@pytest.mark.parametrize(
    ("expected", "said", "advised"),
    [(None, False, False), (0.9, True, False), (0.01, True, True)],
    ids=["noise unknown", "fitted", "not fitted"],
)
def test_a_run_says_at_its_end_whether_images_are_fitted(expected, said, advised):
    text = fit_text(replace(record(1, 2, 30.0), expected_cost=expected))
    assert text.startswith("cost 1.0")
    assert ("expected by the images' noise alone" in text, "pointing_error" in text) == (said, advised)
