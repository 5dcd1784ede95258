"""Progress on the console: a live bar on a terminal, plain lines elsewhere."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Protocol

import numpy as np
from rich.console import Console
from rich.progress import BarColumn, Progress, ProgressColumn, Task, TaskID, TextColumn, TimeRemainingColumn
from rich.text import Text

from cloudtomo_cl.commands import stopping

if TYPE_CHECKING:
    from cloudtomo_cl.inversion.records import IterationRecord

_PLAIN_LINE_SECONDS = 10.0


class Done(Protocol):
    """Called with how much is done so far."""

    def __call__(self, done: int, /) -> None: ...


@contextmanager
def rendering(console: Console, total: int, unit: str = "samples") -> Iterator[Done]:
    """Shows how much of a total is done: samples per pixel, photons ..."""
    if console.is_terminal:
        columns = (TextColumn("rendering"), BarColumn(), TextColumn("{task.completed}/{task.total} " + unit))
        with Progress(*columns, TimeRemainingColumn(), console=console, transient=True) as bar:
            task = bar.add_task("rendering", total=total)
            yield _stoppable(lambda done: bar.update(task, completed=done))
        return
    start = shown = time.monotonic()

    def line(done: int) -> None:
        nonlocal shown
        now = time.monotonic()
        if now - shown >= _PLAIN_LINE_SECONDS and done < total:
            shown = now
            left = (now - start) * (total - done) / max(done, 1)
            console.print(f"rendering: {done}/{total} {unit}, {duration(left)} left")

    yield _stoppable(line)


@contextmanager
def counting(console: Console, what: str) -> Iterator[Callable[[int, int], None]]:
    """Shows how many of a number of things are done; called with both."""
    if console.is_terminal:
        columns = (TextColumn(what), BarColumn(), TextColumn("{task.completed}/{task.total}"), TimeRemainingColumn())
        with Progress(*columns, console=console, transient=True) as bar:
            task = bar.add_task(what, total=None)
            yield _stoppable(lambda done, total: bar.update(task, completed=done, total=total))
        return
    start = shown = time.monotonic()

    def line(done: int, total: int) -> None:
        nonlocal shown
        now = time.monotonic()
        if now - shown >= _PLAIN_LINE_SECONDS and done < total:
            shown = now
            console.print(f"{what}: {done}/{total}, {duration((now - start) * (total - done) / done)} left")

    yield _stoppable(line)


def _stoppable(show: Callable[..., None]) -> Callable[..., None]:
    """What is called between launches and sizes is called in a safe place: there a request to stop is looked at."""

    def shown(*done: int) -> None:
        stopping.check()
        show(*done)

    return shown


def duration(seconds: float) -> str:
    """Seconds as a person says them."""
    if seconds < 100:
        return f"{seconds:.0f} s"
    minutes, seconds = divmod(round(seconds), 60)
    return f"{minutes} min {seconds:02d} s" if minutes < 60 else f"{minutes // 60} h {minutes % 60:02d} min"


# From here on a number is shown with a power of ten.
_LONGEST = 1e7


def with_error(value: float, error: float) -> str:
    """A number to the last digit that its standard error leaves, and that: 0.01550 ± 0.00002, 130 ± 20.

    Numbers that are longer than that are in powers of ten: (2.6 ± 0.3)e+16.
    """
    if np.isfinite(error) and _LONGEST <= max(abs(value), error) < np.inf:
        power = int(np.floor(np.log10(max(abs(value), error))))
        return f"({with_error(value / 10.0**power, error / 10.0**power)})e+{power:02d}"
    if not (0 < error < np.inf and np.isfinite(value)):
        return f"{value:.5g} ± {error:.1g}"
    digits = -int(np.floor(np.log10(error)))
    # Rounding may carry: 0.097 is 0.1.
    digits = -int(np.floor(np.log10(round(error, digits))))
    return f"{round(value, digits) + 0.0:.{max(digits, 0)}f} ± {round(error, digits):.{max(digits, 0)}f}"


class ReconstructionProgress:
    """A callback of `reconstruct`: stage, iteration, cost with its noise, error, paths per second, time left.

    Without a time limit the time left is the most that the present stage can take: when it ends
    depends on the cost.
    """

    def __init__(self, console: Console, time_limit: float | None = None) -> None:
        self._console = console
        self._time_limit = time_limit
        self._last: IterationRecord | None = None
        self._printed: IterationRecord | None = None
        self._stage_start = 0.0
        self._shown = time.monotonic()
        self._bar: Progress | None = None
        self._task: TaskID | None = None
        self._start = self._at_last = time.monotonic()
        # What is done until the first record, and between stages.
        self._doing: str | None = "beginning"
        self._messages = _Messages(self._do)
        self._level = logging.NOTSET

    def __enter__(self) -> ReconstructionProgress:
        if self._console.is_terminal:
            self._bar = Progress(BarColumn(bar_width=10), _Live(self), console=self._console, transient=True)
            self._bar.start()
            self._task = self._bar.add_task("", total=None)
        logger = logging.getLogger("cloudtomo_cl.inversion")
        logger.addHandler(self._messages)
        self._level = logger.level
        logger.setLevel(logging.INFO)
        return self

    def __exit__(self, *_: object) -> None:
        logger = logging.getLogger("cloudtomo_cl.inversion")
        logger.removeHandler(self._messages)
        logger.setLevel(self._level)
        if self._bar is not None:
            self._bar.stop()
        if self._last is not None:
            self._line(self._last)

    def go_on(self, before: Sequence[IterationRecord]) -> None:
        """Takes the iterations of a run that was interrupted, for the pace of the present stage."""
        if before:
            self._last = self._printed = before[-1]
            self._stage_start = max((old.seconds for old in before if old.stage < self._last.stage), default=0.0)

    def __call__(self, record: IterationRecord) -> None:
        if self._last is not None and record.stage != self._last.stage:
            self._line(self._last)
            self._stage_start = self._last.seconds
        self._last, self._doing, self._at_last = record, None, time.monotonic()
        if self._bar is not None and self._task is not None:
            self._bar.update(self._task, completed=record.iteration + 1, total=record.iterations)
        elif time.monotonic() - self._shown >= _PLAIN_LINE_SECONDS:
            self._line(record)

    def _line(self, record: IterationRecord) -> None:
        """A line that stays; not twice for the same iteration."""
        if self._bar is None and record is self._printed:
            return
        self._printed = record
        self._shown = time.monotonic()
        self._console.print(f"{self.said(record)}  {duration(record.seconds)}", highlight=False, soft_wrap=True)

    def said(self, record: IterationRecord) -> str:
        """Stage, iteration, cost, and the error if it is known."""
        text = (
            f"stage {record.stage + 1}/{record.stages}  iteration {record.iteration + 1:>4}  "
            f"cost {with_error(record.cost, record.cost_standard_error)}"
        )
        return text if record.epsilon is None else f"{text}  eps {record.epsilon:.3f}"

    def _left(self, record: IterationRecord) -> str:
        since = time.monotonic() - self._at_last
        pace = (record.seconds - self._stage_start) / (record.iteration + 1)
        stage_left = max(max(record.iterations - record.iteration - 1, 0) * pace - since, 0.0)
        if self._time_limit is None:
            return f"at most {duration(stage_left)} left in this stage"
        return f"at most {duration(max(self._time_limit - record.seconds - since, 0.0))} left"

    def _do(self, what: str) -> None:
        self._doing = what

    def live(self) -> str:
        """What the bar says now: it is asked several times a second, also where no iteration ends for minutes."""
        elapsed = duration(time.monotonic() - self._start)
        if self._last is None or self._doing is not None:
            return f"{self._doing or 'beginning'}  {elapsed}"
        speed = f"{self._last.paths / max(self._last.seconds, 1e-3):.2g} paths/s"
        return f"{self.said(self._last)}  {speed}  {self._left(self._last)}  {elapsed}"


class _Live(ProgressColumn):
    """A column that asks what to say whenever it is drawn."""

    def __init__(self, progress: ReconstructionProgress) -> None:
        super().__init__()
        self._progress = progress

    def render(self, task: Task) -> Text:
        return Text(self._progress.live())


class _Messages(logging.Handler):
    """Hands on what the recovery says that it does."""

    def __init__(self, take: Callable[[str], None]) -> None:
        super().__init__(logging.INFO)
        self._take = take

    def emit(self, record: logging.LogRecord) -> None:
        self._take(record.getMessage())
