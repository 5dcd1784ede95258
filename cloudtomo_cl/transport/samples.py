"""Which paths of every pixel a rendering has."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from cloudtomo_cl.errors import DataError
from cloudtomo_cl.opencl.layout import MOST_SAMPLES
from cloudtomo_cl.scene.seeds import checked_seed


def _whole(count: Any, name: str) -> int:
    try:
        number = int(count)
        if number == count:
            return number
    except (TypeError, ValueError, OverflowError):
        pass
    raise DataError(f"{name} is {count!r}: it must be a whole number, even")


@dataclass(frozen=True)
class Samples:
    """Paths of every pixel, which with its view and number are determined by these.

    Attributes
    ----------
    count : number of them
    seed, stream : what they are drawn with
    first : number of the first one
    """

    count: int
    seed: int
    stream: int
    first: int

    @classmethod
    def checked(cls, count: int, seed: int, stream: int, first: int) -> Samples:
        """They, as a rendering takes them.

        Raises
        ------
        DataError : count or first is odd, or beyond 2^32; seed or stream is no whole number of 32 bits
        """
        seed, stream = checked_seed(seed), checked_seed(stream, "stream")
        count, first = _whole(count, "samples"), _whole(first, "first_sample")
        if count < 2 or count % 2:
            raise DataError(f"samples is {count}: it must be even and at least 2 (halves are compared)")
        if first < 0 or first % 2:
            raise DataError(f"first_sample is {first}: it must be even and at least 0")
        if first + count > MOST_SAMPLES:
            raise DataError(f"{first + count} paths per pixel are more than the {MOST_SAMPLES} that there are")
        return cls(count, seed, stream, first)
