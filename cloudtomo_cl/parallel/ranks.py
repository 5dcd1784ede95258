"""The ranks that share a computation, and what they tell each other; one rank alone tells nobody anything.

What is computed has the same bits with any number of ranks (docs/decisions/ranks.md): floating-point sums are each
made whole by one rank, sums that several ranks add to are integers, and what is small is computed by all alike.
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
# Integers are added in halves of so many bits where their sum might leave 64.
_HALF = 32


class Ranks:
    """One rank alone; the others (`mpi.MPIRanks`, `threads.ThreadRanks`) are made of it.

    All ranks call the same methods in the same order: each of these calls is one that all wait for.

    Attributes
    ----------
    rank, size : this one, counted from 0, of how many
    place, on_node : this one among those of its machine, and how many these are
    sent : bytes of arrays that this rank has handed to others, as if each were told once
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
        """For messages."""
        return f"rank {self.rank} of {self.size}"

    @property
    def cores(self) -> int:
        """Of this machine's, those that are this rank's to use."""
        try:
            return len(os.sched_getaffinity(0))
        except AttributeError:  # macOS, Windows
            return os.cpu_count() or 1

    def all(self, value: Any) -> list[Any]:
        """The values of all ranks, in their order; small ones, of any type."""
        return [value]

    def first(self, value: Any) -> Any:
        """The value of the first rank."""
        return value

    def any(self, flag: bool) -> bool:
        """Whether it is true on some rank."""
        return bool(flag)

    def sum(self, values: np.ndarray) -> np.ndarray:
        """Sums over ranks of integers of 64 bits, exact; the least one where a sum does not fit.

        The array is given away: the sums may take its place, for both may be large.
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
        """The rows of all ranks one after the other; `counts` says how many each has."""
        return rows

    def exchange(self, parts: Sequence[np.ndarray]) -> list[np.ndarray]:
        """Hands a part to every rank; returns what each has handed to this one. Arrays of rows, alike but in number."""
        return list(parts)

    def dealt(self, blocks: np.ndarray) -> Shares:
        """Deals things out.

        blocks : the block of each, counted from 0, shape (things,), which stays together; one rank gets all, whatever
            they say
        """
        if self.size == 1:
            return Shares(self, len(blocks))
        # In turn, for what costs much lies together; turned from round to round, for images have rows.
        numbers = np.asarray(blocks, np.int64)
        return Shares(self, len(blocks), ((numbers + numbers // self.size) % self.size).astype(np.uint16))

    def part(self, count: int) -> range:
        """This rank's part of so many things in a row."""
        return range(count * self.rank // self.size, count * (self.rank + 1) // self.size)

    def together(self, work: Callable[[], _Result]) -> _Result:
        """What `work` returns, or the error of a rank whose work has failed: then every rank raises one.

        In between, `work` must not wait for other ranks.
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
        """As `together`; threads of one process do it one after the other, for libraries that know no threads."""
        return self.together(work)

    def require_same(self, array: np.ndarray, what: str) -> None:
        """TransportError if an array that all ranks compute alike differs between them."""
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
        """Waits for the others before the process ends.

        One that failed, so that its exit status is not 0, ends those that are at work still after so many seconds of
        `grace`: they wait for it.
        """


@dataclass(frozen=True, eq=False)
class Shares:
    """Which rank has which of some things.

    Attributes
    ----------
    ranks : among whom they are dealt out
    count : of all things
    owner : of each, shape (count,); none where one rank has all
    """

    ranks: Ranks = field(repr=False)
    count: int
    owner: np.ndarray | None = field(default=None, repr=False)

    @cached_property
    def own(self) -> np.ndarray:
        """Those of this rank, in their order."""
        return np.arange(self.count) if self.owner is None else np.flatnonzero(self.owner == self.ranks.rank)

    def __len__(self) -> int:
        return self.count if self.owner is None else len(self.own)

    def taken(self, values: np.ndarray) -> np.ndarray:
        """This rank's rows of an array (count, ...)."""
        return values if self.owner is None else values[self.own]

    def gathered(self, rows: np.ndarray) -> np.ndarray:
        """From every rank's rows the array (count, ...), the same on all ranks."""
        if self.owner is None:
            return rows
        result = np.empty((self.count, *rows.shape[1:]), rows.dtype)
        order, counts = self._order
        result[order] = self.ranks.joined(rows, counts)
        return result

    @cached_property
    def _order(self) -> tuple[np.ndarray, list[int]]:
        """All things, rank by rank, and how many each rank has."""
        assert self.owner is not None
        return np.argsort(self.owner, kind="stable"), np.bincount(self.owner, minlength=self.ranks.size).tolist()


ALONE = Ranks()


def _told(error: Exception) -> tuple[str, str, int]:
    """An error as other ranks get it."""
    kind = type(error).__name__ if isinstance(error, CloudtomoError) else DeviceError.__name__
    text = str(error) if isinstance(error, CloudtomoError) else f"{type(error).__name__}: {error}"
    return kind, text, getattr(error, "status", 0)


def _error(kind: str, text: str, status: int) -> CloudtomoError:
    return Interrupted(text, status) if kind == Interrupted.__name__ else getattr(errors, kind)(text)
