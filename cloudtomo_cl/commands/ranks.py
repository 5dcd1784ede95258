"""The ranks of a command, of `mpiexec -n 4 cloudtomo ...`, `srun` or `--device 0,1`, and how they end together.

The first rank talks and writes; the others compute, and speak only if something fails on
them alone.
"""

from __future__ import annotations

import os
import sys
import threading
import traceback
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager, redirect_stderr, redirect_stdout
from typing import TYPE_CHECKING, Any, TypeVar

from cloudtomo_cl.commands import stopping
from cloudtomo_cl.errors import Interrupted
from cloudtomo_cl.parallel.launched import launched_rank, launched_ranks

if TYPE_CHECKING:
    from cloudtomo_cl.parallel.ranks import Ranks

_Result = TypeVar("_Result")
# Seconds that a rank which has failed waits for the others to fail, too, before it ends them.
_GRACE = 3.0
_current = threading.local()  # which has `ranks`, while a command runs


def current() -> Ranks:
    """Those of the command that runs, in this thread of it."""
    from cloudtomo_cl.parallel.ranks import ALONE

    return getattr(_current, "ranks", ALONE)


@contextmanager
def _among(ranks: Ranks) -> Iterator[None]:
    before = current()
    _current.ranks = ranks
    try:
        yield
    finally:
        _current.ranks = before


def on_devices(work: Callable[..., _Result], options: dict[str, Any]) -> _Result:
    """Does a command's work with its options; with `--device 0,1` in a thread for each of these, as ranks.

    Under MPI ranks take one each of those that are named.
    """
    from cloudtomo_cl.opencl.devices import named_devices
    from cloudtomo_cl.parallel.threads import shared_by_threads

    names = named_devices(options["device"])
    if len(names) == 1 or current().size > 1:
        return work(**_as_rank(options))

    def run(ranks: Ranks) -> _Result:
        with _among(ranks):
            return work(**_as_rank(options))

    return shared_by_threads(len(names), run)


def _as_rank(options: dict[str, Any]) -> dict[str, Any]:
    """The options, for a rank that says nothing unless it is the first."""
    return options | {"quiet": options["quiet"] or not current().is_first}


def check_together() -> None:
    """A safe place that all ranks come to. Raises Interrupted on all if somebody asked one of them to stop."""
    number = max(current().all(stopping.current().signal_number or 0))
    if number:
        raise interrupted("interrupted", stopping.exit_status(number))


def interrupted(text: str, status: int) -> Interrupted:
    """An error that all ranks raise, so that the first one tells it."""
    error = Interrupted(text, status)
    error.told_by_all = True  # type: ignore[attr-defined]
    return error


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
    ranks, error_stream = launched_ranks(), sys.stderr

    def tell(text: str, error: BaseException | None) -> None:
        if ranks.is_first:
            print(text, file=error_stream)
        elif not getattr(error, "told_by_all", False):
            print(f"{ranks.name}: {text}", file=error_stream)

    status = 0
    try:
        with ExitStack() as stack:
            if not ranks.is_first:
                stack.enter_context(_silent())
            if shares:
                stack.enter_context(_among(ranks))
            if shares or ranks.is_first:
                status = work(tell)
    except BaseException:
        if ranks.size > 1:
            traceback.print_exc(file=error_stream)
            status = 1
        raise
    finally:
        ranks.ended(status, _GRACE)
    return status


@contextmanager
def _silent() -> Iterator[None]:
    with open(os.devnull, "w", encoding="utf-8") as nowhere, redirect_stdout(nowhere), redirect_stderr(nowhere):
        yield
