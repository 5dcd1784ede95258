"""Arguments of public functions: what kind of object each must be. A wrong one is answered, not tripped over."""

from __future__ import annotations

import operator
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from numbers import Real
from typing import Any, get_args

from cloudtomo_cl.errors import InvalidArgumentError

# Characters of a value that is shown.
_SHOWN = 60


@dataclass(frozen=True)
class Kind:
    """What an argument may be.

    Attributes
    ----------
    words : the same in words, to follow "it must be"
    fits : function that tells whether a value is of this kind
    """

    words: str
    fits: Callable[[Any], bool]

    def or_(self, other: Kind) -> Kind:
        """The same, or another one."""
        return Kind(f"{self.words}, or {other.words}", lambda value: self.fits(value) or other.fits(value))

    def or_none(self) -> Kind:
        """The same, or None."""
        return Kind(f"{self.words}, or None", lambda value: value is None or self.fits(value))


def a(*classes: Any, hint: str = "") -> Kind:
    """An object of one of some classes; of a union of classes, of any in it.

    hint : how to come by one, to follow the classes' names
    """
    kinds = tuple(kind for given in classes for kind in _members(given))
    return Kind(_named(kinds) + (f" ({hint})" if hint else ""), lambda value: isinstance(value, kinds))


def many(*classes: Any) -> Kind:
    """A tuple or list of objects of some classes, or another sequence of them."""
    one = a(*classes)
    return Kind(f"a tuple or list, each entry {one.words}", lambda value: is_sequence_of(one, value))


def several(count: int, one: Kind) -> Kind:
    """A tuple or list of so many of a kind, or another sequence of them."""
    return Kind(
        f"a tuple or list of {count}, each {one.words}",
        lambda value: is_sequence_of(one, value) and len(value) == count,
    )


def place(count: int) -> Kind:
    """The number of one of so many, which from the end are -1, -2 ..., as everywhere in Python."""
    return Kind(f"0 to {count - 1}", lambda value: WHOLE.fits(value) and -count <= value < count)


def able(words: str, *methods: str) -> Kind:
    """An object, not its class, that has some methods.

    words : what such objects are
    """
    return Kind(
        words,
        lambda value: not isinstance(value, type) and all(callable(getattr(value, name, None)) for name in methods),
    )


CALLABLE = Kind("a function", callable)


def _is_number(value: Any) -> bool:
    """Also one of xarray or NumPy that has no dimension."""
    if isinstance(value, Real):
        return not isinstance(value, bool) and not _is_too_large(value)
    return getattr(value, "shape", None) == () and getattr(getattr(value, "dtype", None), "kind", "") in tuple("iuf")


def _is_too_large(value: Any) -> bool:
    try:
        float(value)
    except OverflowError:
        return True
    return False


def _is_whole(value: Any) -> bool:
    try:
        operator.index(value)
    except TypeError:
        return False
    return not isinstance(value, bool)


NUMBER = Kind("a number", _is_number)
NUMBERS = Kind("a tuple or list of numbers", lambda value: is_sequence_of(NUMBER, value))


def _is_truth(value: Any) -> bool:
    if getattr(getattr(value, "dtype", None), "kind", "") == "b":
        return getattr(value, "shape", None) == ()
    return isinstance(value, bool) or (_is_whole(value) and value in (0, 1))


TRUTH = Kind("True or False", _is_truth)
WHOLE = Kind("a whole number", _is_whole)
MAPPING = Kind("a dict, or another mapping", lambda value: isinstance(value, Mapping))
PATH = Kind("the name of a file, a str or a Path", lambda value: isinstance(value, (str, os.PathLike)))


def require_kinds(function: str, **arguments: tuple[Any, Kind]) -> None:
    """Checks the kinds of a function's arguments.

    Parameters
    ----------
    function : what callers call it
    arguments : by their names, the value that each has and the kind that it must be of

    Raises
    ------
    InvalidArgumentError : an argument is of another kind
    """
    for name, (value, kind) in arguments.items():
        if not kind.fits(value):
            raise InvalidArgumentError(f"{function}: {name} is {_shown(value)}: it must be {kind.words}")


def is_sequence_of(one: Kind, value: Any) -> bool:
    if isinstance(value, (str, bytes, dict)) or getattr(value, "shape", None) == ():
        return False
    if not (hasattr(value, "__len__") and hasattr(value, "__getitem__")):
        return False
    return all(map(one.fits, value))


def _members(kind: Any) -> tuple[type, ...]:
    """A class, or those of a union, which may be annotated."""
    if isinstance(kind, type):
        return (kind,)
    return tuple(one for part in get_args(kind) if isinstance(part, type) or get_args(part) for one in _members(part))


def _named(kinds: tuple[type, ...]) -> str:
    names = [f"{'an' if kind.__name__[0] in 'AEIO' else 'a'} {kind.__name__}" for kind in kinds]
    return " or ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else names)


def _shown(value: Any) -> str:
    """A value in a few words."""
    if value is None:
        return "None"
    if isinstance(value, type):
        return f"the class {value.__name__}, not an object of it"
    if isinstance(value, int) and _is_too_large(value):
        return "a whole number beyond 1e308"
    if isinstance(value, (str, bytes, int, float)):
        text = repr(value)
        text = text if len(text) <= _SHOWN else f"{text[: _SHOWN - 3]}..."
        return f"{text}, of type {type(value).__name__}"
    if isinstance(value, (tuple, list)):
        held = sorted({type(one).__name__ for one in value})[:3]
        return f"a {type(value).__name__} of {', '.join(held)}" if held else f"an empty {type(value).__name__}"
    return f"of type {type(value).__name__}"
