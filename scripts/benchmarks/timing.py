"""CPU seconds, and ratios of what was measured in turn."""

from __future__ import annotations

import resource
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

Result = TypeVar("Result")


def cpu_seconds() -> float:
    """User and system time of this process so far, all threads together."""
    usage = resource.getrusage(resource.RUSAGE_SELF)
    return usage.ru_utime + usage.ru_stime


def timed(work: Callable[[], Result]) -> tuple[Result, float]:
    """What the work returns, and the CPU seconds that it took."""
    start = cpu_seconds()
    result = work()
    return result, cpu_seconds() - start


@dataclass(frozen=True)
class Line:
    """A line of the table.

    Attributes
    ----------
    row : its name, as --rows takes it
    what : what the number is
    values : one per repeat; empty if it could not be had
    goal : what the number should be, in words
    note : how it came about, or why there is none
    digits : after the decimal point
    """

    row: str
    what: str
    values: Sequence[float] = ()
    goal: str = ""
    note: str = ""
    digits: int = 1

    @property
    def number(self) -> str:
        """The median."""
        return f"{np.median(self.values):.{self.digits}f}" if len(self.values) else "-"

    @property
    def spread(self) -> str:
        """The least and the most of the repeats."""
        if len(self.values) < 2:
            return ""
        return f"{min(self.values):.{self.digits}f} .. {max(self.values):.{self.digits}f}"


class Disagreement(Exception):
    """Two programs that should compute the same thing do not: no ratio is worth printing."""


def require_agreement(what: str, ours: float, our_error: float, theirs: float, their_error: float) -> str:
    """Checks two estimates of one number, and says how they compare.

    Raises
    ------
    Disagreement : they are more than 4 standard errors, and more than 1 %, apart
    """
    error = float(np.hypot(our_error, their_error))
    text = f"{what} {ours:.5g} +- {our_error:.2g} against {theirs:.5g} +- {their_error:.2g}"
    if abs(ours - theirs) > max(4 * error, 0.01 * abs(theirs)):
        raise Disagreement(text)
    return text
