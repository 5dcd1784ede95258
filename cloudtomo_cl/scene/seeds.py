"""Seeds of the random numbers of a run."""

from __future__ import annotations

import operator
from typing import Any

from cloudtomo_cl.errors import DataError

# Number of seeds: kernels take unsigned integers of 32 bits.
SEEDS = 2**32


def checked_seed(seed: Any, name: str = "seed") -> int:
    """A seed as an int. Raises DataError if it is no whole number, or does not fit 32 bits."""
    try:
        number = operator.index(seed)
    except TypeError:
        number = -1
    if not 0 <= number < SEEDS:
        raise DataError(f"{name} is {seed!r}: it must be a whole number from 0 to {SEEDS - 1}")
    return number
