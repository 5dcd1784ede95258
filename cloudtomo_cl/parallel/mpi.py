"""Ranks under MPI, by mpi4py."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Sequence
from functools import cache
from typing import Any

import numpy as np
from mpi4py import MPI

from cloudtomo_cl.parallel.ranks import Ranks

# Most numbers that one call of MPI adds up: libraries count them with 32 bits.
_AT_ONCE = 1 << 28
_POLL_SECONDS = 0.01
# MPI's predefined types for rows of 1, 2, 4 or 8 bytes.
_PLAIN_TYPES = {1: MPI.UINT8_T, 2: MPI.UINT16_T, 4: MPI.UINT32_T, 8: MPI.UINT64_T}


def world() -> tuple[Any, str]:
    """The communicator of all processes, and the name of the library."""
    return MPI.COMM_WORLD, MPI.Get_library_version().split(",")[0].split("\n")[0].strip()


class MPIRanks(Ranks):
    """The ranks of an mpi4py communicator, which is duplicated: messages of others do not mix with these."""

    def __init__(self, communicator: Any) -> None:
        self._communicator = communicator.Dup()
        self.rank, self.size = communicator.Get_rank(), communicator.Get_size()
        node = communicator.Split_type(MPI.COMM_TYPE_SHARED)
        self.place, self.on_node = node.Get_rank(), node.Get_size()
        sharing = node.allgather(_allowed_cores())
        self._sharing = sharing.count(sharing[self.place])
        node.Free()
        self.host = MPI.Get_processor_name()

    @property
    def name(self) -> str:
        return f"{super().name} ({self.host})"

    @property
    def cores(self) -> int:
        return max(super().cores // self._sharing, 1)

    def all(self, value: Any) -> list[Any]:
        return self._communicator.allgather(value)

    def first(self, value: Any) -> Any:
        return self._communicator.bcast(value)

    def any(self, flag: bool) -> bool:
        given, found = np.array([flag], np.int32), np.empty(1, np.int32)
        self._communicator.Allreduce(given, found, MPI.MAX)
        return bool(found[0])

    def _added(self, values: np.ndarray) -> np.ndarray:
        result = np.require(values, np.int64, ["C", "W"])
        flat = result.reshape(-1)
        for begin in range(0, flat.size, _AT_ONCE):
            self._communicator.Allreduce(MPI.IN_PLACE, flat[begin : begin + _AT_ONCE], MPI.SUM)
        self.sent += values.nbytes
        return result

    def joined(self, rows: np.ndarray, counts: Sequence[int]) -> np.ndarray:
        result = np.empty((sum(counts), *rows.shape[1:]), rows.dtype)
        row = _row_type(_row_bytes(rows))
        self._communicator.Allgatherv([_bytes(rows), len(rows), row], [_bytes(result), _places(counts), row])
        self.sent += rows.nbytes
        return result

    def exchange(self, parts: Sequence[np.ndarray]) -> list[np.ndarray]:
        counts = [len(part) for part in parts]
        found = self._communicator.alltoall(counts)
        given = np.concatenate(parts)
        result = np.empty((sum(found), *given.shape[1:]), given.dtype)
        row = _row_type(_row_bytes(given))
        self._communicator.Alltoallv([_bytes(given), _places(counts), row], [_bytes(result), _places(found), row])
        self.sent += given.nbytes - parts[self.rank].nbytes
        return np.split(result, np.cumsum(found)[:-1])

    def ended(self, status: int, grace: float) -> None:
        # No blocking barrier: a rank that waits in one keeps a core busy, which the first rank may need for a report.
        waiting, since = self._communicator.Ibarrier(), time.monotonic()
        while not waiting.Test():
            if status and time.monotonic() - since > grace:
                sys.stderr.flush()
                MPI.COMM_WORLD.Abort(status)
            time.sleep(_POLL_SECONDS)
        MPI.Finalize()


@cache
def _row_type(size: int) -> Any:
    """MPI's type for a row of `size` bytes of an array.

    Rows are counted instead of bytes, whose number may need 64 bits. MPI's predefined types are copied twice as fast as
    types made of them.
    """
    return _PLAIN_TYPES.get(size) or MPI.BYTE.Create_contiguous(size).Commit()


def _row_bytes(rows: np.ndarray) -> int:
    return rows.dtype.itemsize * int(np.prod(rows.shape[1:]))


def _bytes(rows: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(rows).reshape(-1).view(np.uint8)


def _places(counts: Sequence[int]) -> tuple[list[int], list[int]]:
    """The number of rows of each part, and its first row."""
    return list(counts), [0, *np.cumsum(counts)[:-1].tolist()]


def _allowed_cores() -> tuple[int, ...]:
    try:
        return tuple(sorted(os.sched_getaffinity(0)))
    except AttributeError:  # macOS, Windows
        return ()
