"""Ranks that are threads of one process, one for each device."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

import numpy as np

from cloudtomo_cl.parallel.ranks import Ranks

_Result = TypeVar("_Result")


class _Meeting:
    """A place where threads wait for each other and see the values that each has brought."""

    def __init__(self, size: int) -> None:
        self.barrier = threading.Barrier(size)
        self.brought: list[Any] = [None] * size
        self.lock = threading.Lock()


class ThreadRanks(Ranks):
    """One of several threads that meet; `shared_by_threads` makes them."""

    def __init__(self, meeting: _Meeting, rank: int) -> None:
        self._meeting, self.rank = meeting, rank
        self.size = self.on_node = len(meeting.brought)
        self.place = rank

    def _met(self, value: Any, combine: Callable[[list[Any]], _Result]) -> _Result:
        """What `combine` makes of all ranks' values; no rank goes on, and changes its value, before it has ended."""
        meeting = self._meeting
        meeting.brought[self.rank] = value
        meeting.barrier.wait()
        result = combine(meeting.brought)
        meeting.barrier.wait()
        return result

    def all(self, value: Any) -> list[Any]:
        return self._met(value, list)

    def first(self, value: Any) -> Any:
        return self.all(value)[0]

    def any(self, flag: bool) -> bool:
        return any(self.all(bool(flag)))

    def _added(self, values: np.ndarray) -> np.ndarray:
        self.sent += values.nbytes
        return self._met(values, _added_up)

    def joined(self, rows: np.ndarray, counts: Sequence[int]) -> np.ndarray:
        self.sent += rows.nbytes
        return self._met(rows, _one_after_the_other)

    def exchange(self, parts: Sequence[np.ndarray]) -> list[np.ndarray]:
        self.sent += sum(part.nbytes for part in parts) - parts[self.rank].nbytes
        return self._met(parts, lambda brought: [others[self.rank].copy() for others in brought])

    def in_turn(self, work: Callable[[], _Result]) -> _Result:
        def alone() -> _Result:
            with self._meeting.lock:
                return work()

        return self.together(alone)


def _added_up(values: list[np.ndarray]) -> np.ndarray:
    return np.sum(values, axis=0)


def _one_after_the_other(rows: list[np.ndarray]) -> np.ndarray:
    return np.concatenate(rows)


def shared_by_threads(size: int, work: Callable[[Ranks], _Result]) -> _Result:
    """Calls `work` in `size` threads, each with its rank; returns the result of the first thread.

    If threads raise errors, the first one in the order of ranks is raised. Python raises Ctrl-C here, in the thread
    that waits: the others end at their next exchange, and then it is raised.
    """
    from threadpoolctl import threadpool_limits

    meeting = _Meeting(size)
    results: list[Any] = [None] * size
    failures: list[BaseException | None] = [None] * size
    # Threads that end say so here: Python up to 3.12 takes a thread for ended if Ctrl-C interrupts `join`.
    ended = [threading.Event() for _ in range(size)]

    def run(rank: int) -> None:
        try:
            results[rank] = work(ThreadRanks(meeting, rank))
        except BaseException as error:
            failures[rank] = error
            if not getattr(error, "told_by_all", False):
                meeting.barrier.abort()  # others must not wait for this thread
        finally:
            ended[rank].set()

    threads = [threading.Thread(target=run, args=(rank,), name=f"rank {rank}") for rank in range(size)]
    # BLAS has one number of threads for the whole process: a thread that resets it would change others' results.
    with threadpool_limits(limits=1, user_api="blas"):
        try:
            for thread in threads:
                thread.start()
            for event in ended:
                event.wait()
        except BaseException:
            meeting.barrier.abort()
            for thread, event in zip(threads, ended):
                if thread.ident is not None:  # it was started
                    event.wait()
                    thread.join()
            raise
        for thread in threads:
            thread.join()
    raised = [error for error in failures if error is not None]
    for error in raised:
        # Threads that found the barrier broken did so because of another thread's error.
        if not isinstance(error, threading.BrokenBarrierError):
            raise error
    if raised:
        raise raised[0]
    return results[0]
