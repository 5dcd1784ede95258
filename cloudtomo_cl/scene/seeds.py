"""Seeds: which random numbers a run takes."""

from __future__ import annotations

import operator
from typing import Any

from cloudtomo_cl.errors import DataError

# Kernels take seeds of 32 bits, unsigned.
SEEDS = 2**32


def checked_seed(seed: Any, name: str = "seed") -> int:
    """A whole number that kernels take as it is. DataError if it is none, or beyond 32 bits."""
    try:
        number = operator.index(seed)
    except TypeError:
        number = -1
    if not 0 <= number < SEEDS:
        raise DataError(f"{name} is {seed!r}: it must be a whole number from 0 to {SEEDS - 1}")
    return number
