"""Requests to stop: Ctrl-C, and the signals that machines send before they stop a program."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any

# SIGTERM: kill, batch systems at the end of their time; SIGHUP: a terminal that was closed.
_NAMES = ("SIGINT", "SIGTERM", "SIGHUP")


def exit_status(signal_number: int) -> int:
    """The exit status of a program that a signal stopped, as shells have it."""
    return 128 + signal_number


@contextmanager
def _handled(handler: Any, names: tuple[str, ...]) -> Iterator[None]:
    """Sets a handler for the signals that are not ignored already (as SIGHUP is under nohup)."""
    before: dict[int, Any] = {}
    # Python takes signals in its main thread only.
    if threading.current_thread() is threading.main_thread():
        for name in names:
            number = getattr(signal, name, None)
            if number is not None and signal.getsignal(number) not in (signal.SIG_IGN, None):
                before[number] = signal.signal(number, handler)
    try:
        yield
    finally:
        for number, old in before.items():
            signal.signal(number, old)


@contextmanager
def ending_tidily() -> Iterator[None]:
    """Lets SIGTERM and SIGHUP end the program as an exception does: what is half-written is removed."""

    def leave(number: int, frame: FrameType | None) -> None:
        raise SystemExit(exit_status(number))

    with _handled(leave, ("SIGTERM", "SIGHUP")):
        yield


class StopRequest:
    """Whether somebody asked to stop: for `reconstruct(stop=...)`.

    The first signal asks, so that the iteration is finished; the second one stops at once.

    Attributes
    ----------
    signal_number : of the signal that asked; none yet
    """

    def __init__(self) -> None:
        self.signal_number: int | None = None

    def __call__(self) -> bool:
        return self.signal_number is not None

    @contextmanager
    def listening(self) -> Iterator[StopRequest]:
        """Takes the signals while in this context."""

        def ask(number: int, frame: FrameType | None) -> None:
            if self.signal_number is not None:
                raise KeyboardInterrupt if number == signal.SIGINT else SystemExit(exit_status(number))
            self.signal_number = number
            # Not print: the signal may have come in the middle of one.
            os.write(2, b"\ncloudtomo reconstruct: finishing the iteration (once more stops at once)\n")

        with _handled(ask, _NAMES):
            yield self
