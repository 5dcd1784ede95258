"""Requests to stop: Ctrl-C, and the signals that machines send before they stop a program.

A handler that raises would do so anywhere, also inside a library that holds a lock, which the way out then waits for.
Here handlers do nothing. The first signal is noted, and looked at in safe places (`check`); the second one ends the
program at once, from a thread of its own, whatever the main one waits for.
"""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any

from cloudtomo_cl.errors import Interrupted
from cloudtomo_cl.files.whole import remove_unfinished

# SIGTERM: kill, batch systems at the end of their time; SIGHUP: a terminal that was closed.
_NAMES = ("SIGINT", "SIGTERM", "SIGHUP")
_END = 0  # no signal has this number


def exit_status(signal_number: int) -> int:
    """The exit status of a program that a signal stopped, as shells have it."""
    return 128 + signal_number


class StopRequest:
    """Whether somebody asked to stop: for `reconstruct(stop=...)`.

    Attributes
    ----------
    signal_number : of the signal that asked; none yet
    answer : what the program says when it is asked
    """

    def __init__(self, name: str = "cloudtomo") -> None:
        self.name = name
        self.signal_number: int | None = None
        self.answer = "stopping"

    def __call__(self) -> bool:
        return self.signal_number is not None

    def take(self, number: int) -> None:
        """Notes a signal; the second one ends the program."""
        if self.signal_number is not None:
            _end_at_once(exit_status(number))
        self.signal_number = number
        # Not print, whose lock the main thread may hold; and the terminal may be gone.
        with suppress(OSError):
            os.write(2, f"\n{self.name}: {self.answer} (once more stops at once)\n".encode())


_current = StopRequest()


def current() -> StopRequest:
    """The one of the command that runs."""
    return _current


def check(*_: Any) -> None:
    """A safe place. Raises Interrupted if somebody asked to stop. Takes what callbacks of progress are called with."""
    if _current.signal_number is not None:
        raise Interrupted("interrupted", exit_status(_current.signal_number))


@contextmanager
def listening(name: str) -> Iterator[StopRequest]:
    """Takes the signals while in this context, but for those that are ignored already (as SIGHUP is under nohup).

    name : of the program, as it calls itself
    """
    global _current
    before, request = _current, StopRequest(name)
    _current = request
    try:
        # Python takes signals in its main thread only.
        if threading.current_thread() is threading.main_thread():
            with _watched(request):
                yield request
        else:
            yield request
    finally:
        _current = before


@contextmanager
def _watched(request: StopRequest) -> Iterator[None]:
    """Lets a thread take the signals. The system tells it by a pipe, also while the main thread is inside a library."""
    reader, writer = os.pipe()
    os.set_blocking(writer, False)
    thread = threading.Thread(target=_watch, args=(reader, request), name="signals", daemon=True)
    thread.start()
    old_pipe = signal.set_wakeup_fd(writer, warn_on_full_buffer=False)
    handlers: dict[int, Any] = {}
    for name in _NAMES:
        number = getattr(signal, name, None)
        if number is not None and signal.getsignal(number) not in (signal.SIG_IGN, None):
            handlers[number] = signal.signal(number, _do_nothing)
            # Libraries wait for children of theirs (PoCL for its linker), and take an interrupted call for a failure.
            if hasattr(signal, "siginterrupt"):
                signal.siginterrupt(number, False)
    try:
        yield
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
        signal.set_wakeup_fd(old_pipe)
        os.write(writer, bytes([_END]))
        thread.join()
        os.close(reader)
        os.close(writer)


def _do_nothing(*_: Any) -> None:
    """A handler, so that the signal does not end the program."""


def _watch(reader: int, request: StopRequest) -> None:
    while True:
        for number in os.read(reader, 1):
            if number == _END:
                return
            if number in {getattr(signal, name, None) for name in _NAMES}:
                request.take(number)


def _end_at_once(status: int) -> None:
    """Ends the program without waiting for anything."""
    remove_unfinished()
    os._exit(status)
