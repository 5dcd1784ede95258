"""The ranks that share a computation, and their messages; a single rank sends none.

Results have the same bits with any number of ranks (docs/decisions/ranks.md): each floating-point sum is made whole by
one rank, sums over several ranks are sums of integers, and small computations are done by every rank.
"""

from __future__ import annotations

import os
import zlib
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, TypeVar

import numpy as np

from cloudtomo_cl import errors
from cloudtomo_cl.errors import CloudtomoError, DeviceError, Interrupted, TransportError

_Result = TypeVar("_Result")
# Bits of each half of an integer; integers are added by halves where their sum might not fit 64 bits.
_HALF = 32


class Ranks:
    """A single rank, and the base class of several ranks (`mpi.MPIRanks`, `threads.ThreadRanks`).

    All ranks must call the same methods in the same order: in every such call each rank waits for all others.

    Attributes
    ----------
    rank, size : number of this rank, counted from 0, and number of all ranks
    place, on_node : number of this rank among those of its machine, from 0, and how many the machine has
    sent : bytes of arrays that this rank has sent, each array counted once however many ranks receive it
    """

    rank, size = 0, 1
    place, on_node = 0, 1
    sent = 0

    @property
    def is_first(self) -> bool:
        """Whether this rank writes files and talks to people."""
        return self.rank == 0

    @property
    def name(self) -> str:
        """The rank's name in messages."""
        return f"rank {self.rank} of {self.size}"

    @property
    def cores(self) -> int:
        """Number of the machine's cores that this rank may use."""
        try:
            return len(os.sched_getaffinity(0))
        except AttributeError:  # macOS, Windows
            return os.cpu_count() or 1

    def all(self, value: Any) -> list[Any]:
        """The values that the ranks give, in the ranks' order; for small values of any type."""
        return [value]

    def first(self, value: Any) -> Any:
        """The value of the first rank."""
        return value

    def any(self, flag: bool) -> bool:
        """Whether `flag` is true on any rank."""
        return bool(flag)

    def sum(self, values: np.ndarray) -> np.ndarray:
        """Exact sums over ranks of 64-bit integers; the least 64-bit integer where a sum does not fit.

        The caller must not use the array `values` again: it may be large, so the sums may overwrite it.
        """
        if self.size == 1:
            return values
        largest = max(self.all(max(int(values.max(initial=0)), -int(values.min(initial=0)))))
        if largest * self.size < 2**63:
            return self._added(values)
        high, low = self._added(values >> _HALF), self._added(values & (2**_HALF - 1))
        high += low >> _HALF
        fits = np.abs(high) < 2 ** (63 - _HALF)
        return np.where(fits, (np.where(fits, high, 0) << _HALF) | (low & (2**_HALF - 1)), np.iinfo(np.int64).min)

    def _added(self, values: np.ndarray) -> np.ndarray:
        raise NotImplementedError

    def joined(self, rows: np.ndarray, counts: Sequence[int]) -> np.ndarray:
        """The rows of all ranks, one rank after the other; `counts` says how many rows each rank has."""
        return rows

    def exchange(self, parts: Sequence[np.ndarray]) -> list[np.ndarray]:
        """Sends a part to every rank; returns the parts for this rank. Arrays of rows that differ in length alone."""
        return list(parts)

    def dealt(self, blocks: np.ndarray) -> Shares:
        """Divides things among the ranks, by blocks that stay together; a single rank gets all.

        blocks : number of each thing's block, counted from 0, shape (things,)
        """
        if self.size == 1:
            return Shares(self, len(blocks))
        # Ranks take blocks in turn, since costly ones lie together. Each round begins one rank later: otherwise a rank
        # could always get the same columns of an image.
        numbers = np.asarray(blocks, np.int64)
        return Shares(self, len(blocks), ((numbers + numbers // self.size) % self.size).astype(np.uint16))

    def part(self, count: int) -> range:
        """This rank's part of `count` things in a row."""
        return range(count * self.rank // self.size, count * (self.rank + 1) // self.size)

    def together(self, work: Callable[[], _Result]) -> _Result:
        """The result of `work`; if it fails on some rank, every rank raises an error.

        `work` must not wait for other ranks.
        """
        if self.size == 1:
            return work()
        failure: Exception | None = None
        try:
            result = work()
        except Exception as error:
            failure = error
        if not self.any(failure is not None):
            return result
        told = self.all(None if failure is None else _told(failure))
        if failure is None:
            rank, (kind, text, status) = next((rank, one) for rank, one in enumerate(told) if one is not None)
            failure = _error(kind, f"rank {rank} of {self.size}: {text}", status)
        with suppress(Exception):  # errors of some libraries take no attributes
            failure.told_by_all = True  # type: ignore[attr-defined]
        raise failure

    def in_turn(self, work: Callable[[], _Result]) -> _Result:
        """As `together`, but ranks that are threads take turns: for libraries that do not allow threads."""
        return self.together(work)

    def require_same(self, array: np.ndarray, what: str) -> None:
        """Raises TransportError if an array that every rank has computed differs between ranks."""
        if self.size == 1:
            return
        digests = self.all(zlib.crc32(np.ascontiguousarray(array).tobytes()))
        odd = [rank for rank, digest in enumerate(digests) if digest != digests[0]]
        if odd:
            raise TransportError(
                f"{what} has other bits on rank {odd[0]} than on rank 0: run on nodes of one kind, with the same "
                "processors, drivers and packages"
            )

    def ended(self, status: int, grace: float) -> None:
        """Waits for the other ranks before the process ends.

        A rank that has failed (its exit status is not 0) stops those that are still at work after `grace` seconds:
        they wait for it.
        """


@dataclass(frozen=True, eq=False)
class Shares:
    """Which rank owns which of a number of things.

    Attributes
    ----------
    ranks : ranks that own them
    count : number of things
    owner : rank that owns each thing, shape (count,); None: one rank owns all
    """

    ranks: Ranks = field(repr=False)
    count: int
    owner: np.ndarray | None = field(default=None, repr=False)

    @cached_property
    def own(self) -> np.ndarray:
        """Numbers of the things that this rank owns, in their order."""
        return np.arange(self.count) if self.owner is None else np.flatnonzero(self.owner == self.ranks.rank)

    def __len__(self) -> int:
        return self.count if self.owner is None else len(self.own)

    def taken(self, values: np.ndarray) -> np.ndarray:
        """This rank's rows of an array (count, ...)."""
        return values if self.owner is None else values[self.own]

    def gathered(self, rows: np.ndarray) -> np.ndarray:
        """The array (count, ...) from the rows of all ranks; the same on every rank."""
        if self.owner is None:
            return rows
        result = np.empty((self.count, *rows.shape[1:]), rows.dtype)
        order, counts = self._order
        result[order] = self.ranks.joined(rows, counts)
        return result

    @cached_property
    def _order(self) -> tuple[np.ndarray, list[int]]:
        """The numbers of all things, rank by rank, and how many each rank owns."""
        assert self.owner is not None
        return np.argsort(self.owner, kind="stable"), np.bincount(self.owner, minlength=self.ranks.size).tolist()


ALONE = Ranks()


def _told(error: Exception) -> tuple[str, str, int]:
    """An error as it is sent to other ranks: kind, text and exit status."""
    kind = type(error).__name__ if isinstance(error, CloudtomoError) else DeviceError.__name__
    text = str(error) if isinstance(error, CloudtomoError) else f"{type(error).__name__}: {error}"
    return kind, text, getattr(error, "status", 0)


def _error(kind: str, text: str, status: int) -> CloudtomoError:
    return Interrupted(text, status) if kind == Interrupted.__name__ else getattr(errors, kind)(text)
