"""`--set key=value`: values that take the place of a settings file's, before the file is checked."""

from __future__ import annotations

import copy
import re
import sys
from collections.abc import Sequence
from typing import Any

from cloudtomo_cl.errors import SettingsError

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

_EXAMPLE = "write for instance --set prior.strength=0.5, or --set 'view[0].zenith=30'"


def with_overrides(tables: dict[str, Any], overrides: Sequence[str]) -> dict[str, Any]:
    """A copy of the tables in which every `key=value` is done.

    Parameters
    ----------
    tables : of a settings file
    overrides : a dotted key, with [index] for an entry of a list, then = and a TOML value; what is no
        TOML value is taken as text, so that the shell's quotes are enough

    Raises
    ------
    SettingsError : no key, a key inside of something that is no table, no such entry of a list, half a list or table,
        several keys
    """
    try:
        tables = copy.deepcopy(tables)
    except RecursionError:
        raise SettingsError("the settings' tables are nested too deeply to be settings of anything") from None
    for override in overrides:
        key, equals, text = override.partition("=")
        key = key.strip()
        if not equals or not re.fullmatch(r"[A-Za-z_]\w*(\[\d+\])*(\.[A-Za-z_]\w*(\[\d+\])*)*", key):
            raise SettingsError(f"--set {override}: is not key=value: {_EXAMPLE}")
        try:
            parts = [int(part) if part.isdigit() else part for part in re.findall(r"\w+", key)]
        except ValueError:  # more digits than Python takes
            raise SettingsError(f"--set {override[:60]}...: is not key=value: {_EXAMPLE}") from None
        node: Any = tables
        for position, part in enumerate(parts[:-1]):
            if isinstance(node, dict) and isinstance(part, str):
                node = node.setdefault(part, {})
            else:
                node = _entry(override, node, part)
            if not isinstance(node, (dict, list)):
                raise SettingsError(f"--set {override}: {'.'.join(map(str, parts[: position + 1]))} is no table")
        last = parts[-1]
        if isinstance(node, list):
            _entry(override, node, last)
        elif not isinstance(last, str):
            _entry(override, node, last)
        node[last] = _value(override, text.strip())
    return tables


def _entry(override: str, node: Any, part: Any) -> Any:
    if not isinstance(part, int):
        raise SettingsError(f"--set {override}: {part} lies in a list: say which entry, as in view[0].{part}")
    if not isinstance(node, list):
        raise SettingsError(f"--set {override}: [{part}] is an entry of a list, and there is no list: {_EXAMPLE}")
    if part >= len(node):
        raise SettingsError(f"--set {override}: there is no entry [{part}]: the list has {len(node)}, counted from 0")
    return node[part]


def _value(override: str, text: str) -> Any:
    try:
        tables = tomllib.loads(f"value = {text}")
    except RecursionError:
        return text
    except ValueError as error:  # no TOML, or a number with too many digits
        if re.match(r"[\[{\"']", text):
            raise SettingsError(
                f"--set {override}: begins like a list, a table or a text of TOML and is none ({error}): write for "
                "instance [0.5, 1.0], with a digit on both sides of a point"
            ) from None
        return text
    if len(tables) > 1:
        raise SettingsError(f"--set {override}: has more lines than one: give each key a --set of its own")
    return tables["value"]
