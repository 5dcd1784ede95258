"""Sums whose bits do not follow from the number of threads."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, TypeVar

_Function = TypeVar("_Function", bound=Callable[..., Any])


def with_one_blas_thread(function: _Function) -> _Function:
    """A decorator: BLAS cuts sums of long vectors by its number of threads, SciPy's minimisers use it, and a run that
    is resumed on another machine must go on with the same bits. What is large is multiplied on the device."""

    @functools.wraps(function)
    def limited(*arguments: Any, **keywords: Any) -> Any:
        from threadpoolctl import threadpool_limits

        with threadpool_limits(limits=1, user_api="blas"):
            return function(*arguments, **keywords)

    return limited  # type: ignore[return-value]
