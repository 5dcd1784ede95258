"""Progress in notebooks and scripts: a callback for `reconstruct`."""

from __future__ import annotations

import html
import time
from typing import TYPE_CHECKING, Any

from rich.console import Console

from cloudtomo_cl.arguments import NUMBER, Kind, require_kinds
from cloudtomo_cl.commands.progress import ReconstructionProgress, duration

if TYPE_CHECKING:
    from cloudtomo_cl.inversion.records import IterationRecord

# Seconds between two looks of a notebook: each is a message to the browser.
_BETWEEN = 0.5
_RECORD = Kind("an IterationRecord", lambda record: hasattr(record, "iterations") and hasattr(record, "cost"))


class ProgressDisplay:
    """Shows how far a recovery is: in a notebook one line that changes, on a terminal a live bar, elsewhere lines.

    `with ct.ProgressDisplay() as show: ct.reconstruct(..., callback=show)`

    A notebook needs no widgets for it: the line is a display of IPython's that is updated.

    Parameters
    ----------
    time_limit : seconds, of `reconstruct`: for the time that is left

    Raises
    ------
    InvalidArgumentError : time_limit is no number; what is shown is no record of an iteration
    """

    def __init__(self, time_limit: float | None = None) -> None:
        require_kinds("ProgressDisplay", time_limit=(time_limit, NUMBER.or_none()))
        self._console = Console(markup=False, emoji=False)
        self._progress = _quiet(time_limit) if in_notebook(self._console) else None
        self._lines = ReconstructionProgress(self._console, time_limit) if self._progress is None else self._progress
        self._shown = 0.0
        self._display: Any = None
        self._last: IterationRecord | None = None

    def __enter__(self) -> ProgressDisplay:
        self._lines.__enter__()
        if self._progress is not None:
            from IPython.display import HTML, display  # type: ignore[import-not-found]

            self._display = display(HTML(_line("beginning", 0.0)), display_id=True)
        return self

    def __exit__(self, *details: object) -> None:
        if self._progress is not None and self._display is not None and self._last is not None:
            self._show(f"{self._progress.said(self._last)}  {duration(self._last.seconds)}", 1.0)
        self._lines.__exit__(*details)

    def __call__(self, record: IterationRecord) -> None:
        require_kinds("ProgressDisplay", record=(record, _RECORD))
        self._last = record
        self._lines(record)
        if self._progress is not None and time.monotonic() - self._shown >= _BETWEEN:
            done = (record.stage + (record.iteration + 1) / max(record.iterations, 1)) / max(record.stages, 1)
            self._show(self._progress.live(), done)

    def _show(self, text: str, done: float) -> None:
        from IPython.display import HTML

        self._shown = time.monotonic()
        self._display.update(HTML(_line(text, done)))


def in_notebook(console: Console) -> bool:
    """Whether what is shown goes to a notebook."""
    return console.is_jupyter


def _quiet(time_limit: float | None) -> ReconstructionProgress:
    """What knows the words, and prints none of them."""
    return ReconstructionProgress(Console(quiet=True, force_jupyter=False), time_limit)


def _line(text: str, done: float) -> Any:
    return f'<div><progress value="{done:.3f}" max="1"></progress> <code>{html.escape(text)}</code></div>'
