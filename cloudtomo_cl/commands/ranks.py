"""The ranks that a command was started with, `mpiexec -n 4 cloudtomo ...` or `srun`, and how they end together.

The first rank reads the terminal's wishes, talks and writes; the others compute, and speak only if something fails on
them alone.
"""

from __future__ import annotations

import os
import sys
import traceback
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager, redirect_stderr, redirect_stdout
from typing import TYPE_CHECKING, Any

from cloudtomo_cl.commands import stopping
from cloudtomo_cl.errors import Interrupted
from cloudtomo_cl.parallel.launched import launched_rank, launched_ranks

if TYPE_CHECKING:
    from cloudtomo_cl.parallel.ranks import Ranks

# Seconds that a rank which has failed waits for the others to fail, too, before it ends them.
_GRACE = 3.0
_current: Ranks | None = None


def current() -> Ranks:
    """Those of the command that runs."""
    from cloudtomo_cl.parallel.ranks import ALONE

    return ALONE if _current is None else _current


def check_together() -> None:
    """A safe place that all ranks come to. Raises Interrupted on all if somebody asked one of them to stop."""
    number = max(current().all(stopping.current().signal_number or 0))
    if number:
        error = Interrupted("interrupted", stopping.exit_status(number))
        error.told_by_all = current().size > 1  # type: ignore[attr-defined]
        raise error


def first_alone(work: Callable[[], Any]) -> None:
    """Lets the first rank do what one must do, such as writing files; if it fails, all raise its error."""
    current().together(work if current().is_first else lambda: None)


@contextmanager
def held_by_first(lock: Callable[[], AbstractContextManager[Any]]) -> Iterator[None]:
    """While in this context the first rank is in another one."""
    with ExitStack() as stack:
        first_alone(lambda: stack.enter_context(lock()))
        yield


@contextmanager
def silent_but_first() -> Iterator[None]:
    """Of the processes of a launcher only the first one prints; asked before MPI is."""
    with ExitStack() as stack:
        if launched_rank():
            stack.enter_context(_silent())
        yield


def run_shared(work: Callable[[Callable[[str, BaseException | None], None]], int], shares: bool) -> int:
    """Runs a command on all ranks, and ends all when one fails; returns the exit status.

    Parameters
    ----------
    work : the command; it is given what to tell its end with: a text, and the error that it is of
    shares : whether the command's work can be shared; if not, the first rank does it alone

    Raises
    ------
    MissingPackageError, SettingsError : as `launched_ranks`
    """
    global _current
    ranks, before, error_stream = launched_ranks(), _current, sys.stderr

    def tell(text: str, error: BaseException | None) -> None:
        if ranks.is_first:
            print(text, file=error_stream)
        elif not getattr(error, "told_by_all", False):
            print(f"{ranks.name}: {text}", file=error_stream)

    _current = ranks if shares else None
    status = 0
    try:
        with ExitStack() as stack:
            if not ranks.is_first:
                stack.enter_context(_silent())
            if shares or ranks.is_first:
                status = work(tell)
    except BaseException:
        if ranks.size > 1:
            traceback.print_exc(file=error_stream)
            status = 1
        raise
    finally:
        _current = before
        ranks.ended(status, _GRACE)
    return status


@contextmanager
def _silent() -> Iterator[None]:
    with open(os.devnull, "w", encoding="utf-8") as nowhere, redirect_stdout(nowhere), redirect_stderr(nowhere):
        yield
