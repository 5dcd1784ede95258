"""A solver's state as arrays, and back: by the names of its fields."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field, fields, is_dataclass, replace
from typing import Any, TypeVar

import numpy as np

from cloudtomo_cl.errors import DataError

_State = TypeVar("_State")


def not_saved(**options: Any) -> Any:
    """A field of a state that checkpoints leave out, since it can be computed again."""
    return field(metadata={"saved": False}, **options)


def of_any_length(**options: Any) -> Any:
    """A field that is an array whose first dimension may have any length."""
    return field(metadata={"any_length": True}, **options)


def arrays_of(state: Any, prefix: str = "") -> dict[str, np.ndarray]:
    """The fields of a state as arrays on the host, by "name", or "name.inner" where a field has fields itself."""
    arrays: dict[str, np.ndarray] = {}
    for name, value in _saved(state):
        if is_dataclass(value):
            arrays |= arrays_of(value, f"{prefix}{name}.")
        else:
            arrays[prefix + name] = np.array(value)
    return arrays


def restored(state: _State, arrays: Mapping[str, np.ndarray]) -> _State:
    """The state that `arrays_of` took apart.

    Parameters
    ----------
    state : state of the same problem from `Solver.init`: `arrays` must have the same fields, types and shapes

    Raises
    ------
    DataError : a field is missing, unknown, or has another type or shape than it must, or is not finite
    """
    expected, found = set(arrays_of(state)), set(arrays)
    if expected != found:
        wrong = [f"lacks {name}" for name in sorted(expected - found)]
        wrong += [f"has an unknown {name}" for name in sorted(found - expected)]
        raise DataError("the state " + ", ".join(wrong))
    return _restored(state, arrays, "")


def _restored(state: Any, arrays: Mapping[str, np.ndarray], prefix: str) -> Any:
    changes: dict[str, Any] = {}
    for name, value in _saved(state):
        if is_dataclass(value):
            changes[name] = _restored(value, arrays, f"{prefix}{name}.")
        else:
            free = bool(_field(state, name).metadata.get("any_length"))
            array = _check(prefix + name, arrays[prefix + name], np.array(value), free)
            changes[name] = array.copy() if array.ndim else array.item()
    return replace(state, **changes)


def _check(name: str, array: np.ndarray, like: np.ndarray, any_length: bool = False) -> np.ndarray:
    same_shape = array.shape == like.shape
    if any_length and array.ndim == like.ndim:
        same_shape = array.shape[1:] == like.shape[1:]
    if not same_shape or array.dtype != like.dtype:
        wanted = f"{like.dtype} {('any', *like.shape[1:]) if any_length else like.shape}"
        raise DataError(f"{name} of the state is {array.dtype} {array.shape}: it must be {wanted}")
    if array.dtype.kind == "f" and not np.isfinite(array).all():
        raise DataError(f"{name} of the state is not finite")
    return array


def _saved(state: Any) -> list[tuple[str, Any]]:
    """Names and values of the fields that checkpoints hold, without None, which follows from the settings."""
    values = [(one.name, getattr(state, one.name)) for one in fields(state) if one.metadata.get("saved", True)]
    return [(name, value) for name, value in values if value is not None]


def _field(state: Any, name: str) -> Any:
    return next(one for one in fields(state) if one.name == name)
