"""Standard output and error while a command runs: what is written there never decides over the run.

A terminal may be closed, a pipe's reader may have seen enough, a log's disk may be full. What can then not be shown
is lost, and nothing else.
"""

from __future__ import annotations

import errno
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any

# Of a pipe whose reader ended, a terminal that was closed, a descriptor that never was open: nobody is left to tell.
_NOBODY_READS = (errno.EPIPE, errno.EIO, errno.EBADF, errno.ENXIO)


class Stream:
    """A text stream that goes silent instead of failing.

    Attributes
    ----------
    lost : the error that made it silent, if somebody may want to know: a file's disk is full
    """

    def __init__(self, stream: Any) -> None:
        self._stream = stream
        self.lost: OSError | None = None
        self._silent = stream is None

    def write(self, text: str) -> int:
        """As of any text stream."""
        if not self._silent:
            try:
                self._stream.write(text)
            except (OSError, ValueError) as error:  # ValueError: it is closed
                self._fall_silent(error)
        return len(text)

    def flush(self) -> None:
        """As of any text stream."""
        if not self._silent:
            try:
                self._stream.flush()
            except (OSError, ValueError) as error:
                self._fall_silent(error)

    def isatty(self) -> bool:
        """Whether a terminal is there."""
        try:
            return not self._silent and self._stream.isatty()
        except (OSError, ValueError):
            return False

    def __getattr__(self, name: str) -> Any:
        if self._stream is None:
            raise AttributeError(name)
        return getattr(self._stream, name)

    def _fall_silent(self, error: Exception) -> None:
        self._silent = True
        if isinstance(error, OSError) and error.errno not in _NOBODY_READS:
            self.lost = error
        # What is left in its buffer goes nowhere, when the interpreter flushes it in the end.
        with suppress(OSError, ValueError, AttributeError):
            nowhere = os.open(os.devnull, os.O_WRONLY)
            os.dup2(nowhere, self._stream.fileno())
            os.close(nowhere)


@contextmanager
def forgiving(program: str) -> Iterator[None]:
    """Makes standard output and error forgive while in this context, and in the end says what was lost.

    program : its name, as it calls itself
    """
    before = sys.stdout, sys.stderr
    out, err = Stream(sys.stdout), Stream(sys.stderr)
    sys.stdout, sys.stderr = out, err  # type: ignore[assignment]
    try:
        yield
    finally:
        out.flush()
        if out.lost is not None:
            err.write(f"{program}: standard output could not be written ({out.lost.strerror}): the rest is lost\n")
        err.flush()
        sys.stdout, sys.stderr = before


def open_missing_descriptors() -> None:
    """Opens those of 0, 1 and 2 that a program was started without: the next file to be opened would take their place,
    and hold what libraries say on standard error."""
    for descriptor in (0, 1, 2):
        try:
            os.fstat(descriptor)
        except OSError:
            # The lowest one that is free is this one.
            os.open(os.devnull, os.O_RDONLY if descriptor == 0 else os.O_WRONLY)


def flush() -> None:
    """Writes what is left of standard output and error, as far as anybody takes it."""
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError, ValueError):
            if stream is not None:
                stream.flush()
