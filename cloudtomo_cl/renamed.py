"""Names of earlier versions: each is answered with the one that took its place."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, TypeVar

from cloudtomo_cl.errors import DataError

_Function = TypeVar("_Function", bound=Callable[..., Any])
_Class = TypeVar("_Class", bound=type)


def renamed_arguments(**names: str) -> Callable[[_Function], _Function]:
    """A decorator: DataError for an argument that has another name now, `old="new"`."""

    def decorate(function: _Function) -> _Function:
        @functools.wraps(function)
        def checked(*arguments: Any, **keywords: Any) -> Any:
            for old in names.keys() & keywords.keys():
                raise DataError(f"{function.__qualname__}: the argument {old} is now {names[old]}")
            return function(*arguments, **keywords)

        return checked  # type: ignore[return-value]

    return decorate


def renamed_attributes(**names: str) -> Callable[[_Class], _Class]:
    """A decorator of classes: AttributeError for an attribute that has another name now, `old="new"`."""

    def decorate(kind: _Class) -> _Class:
        def missing(self: Any, name: str) -> Any:
            hint = f": it is now {names[name]}" if name in names else ""
            raise AttributeError(f"{type(self).__name__} has no attribute {name!r}{hint}")

        kind.__getattr__ = missing  # type: ignore[attr-defined]
        return kind

    return decorate
