"""What is wrong with settings, in sentences: one line for each key."""

from __future__ import annotations

import dataclasses
import difflib
import functools
import json
from typing import Any, TypeVar

from pydantic import TypeAdapter, ValidationError

from cloudtomo_cl.errors import InvalidSettingError

_Class = TypeVar("_Class", bound=type)

# More mistakes than this at once are one: of the whole file.
_MOST_MISTAKES = 50


def answering(kind: _Class) -> _Class:
    """A decorator of pydantic dataclasses: in Python, too, a wrong argument is answered as the same key in a file is.

    InvalidSettingError, which is a ValueError, takes the place of pydantic's. Within tables, pydantic's own stay.
    """
    original = kind.__init__  # type: ignore[misc]

    @functools.wraps(original)
    def init(self: Any, *arguments: Any, **keywords: Any) -> None:
        try:
            original(self, *arguments, **keywords)
        except ValidationError as error:
            raise InvalidSettingError(_of_class(kind, arguments, keywords, error), error.errors()) from None

    kind.__init__ = init  # type: ignore[misc]
    return kind


def _of_class(kind: type, arguments: tuple[Any, ...], keywords: dict[str, Any], error: ValidationError) -> str:
    """A line for each argument that is wrong."""
    names = [field.name for field in dataclasses.fields(kind)]
    if len(arguments) > len(names):
        return f"{kind.__name__}: takes {len(names)} arguments ({', '.join(names)}), {len(arguments)} are given"
    given = {**dict(zip(names, arguments)), **keywords}
    errors: list[Any] = [{**entry, "loc": _named(entry["loc"], names)} for entry in error.errors()]
    lines = _lines(errors, given, TypeAdapter(kind).json_schema())
    if not lines:  # of the whole
        lines = [f"is wrong: {entry.get('ctx', {}).get('error', entry['msg'])}" for entry in errors]
    return error_text(kind.__name__, lines)


def _named(location: tuple[int | str, ...], names: list[str]) -> tuple[int | str, ...]:
    """With the name of an argument that was given by its place."""
    if location and isinstance(location[0], int):
        return (names[location[0]], *location[1:])
    return location


def error_text(file: str, lines: list[str]) -> str:
    return "\n".join(f"{file}: {line}" for line in lines)


def lines_of(error: ValidationError, tables: dict[str, Any], schema: dict[str, Any]) -> list[str]:
    """One line for each key that is wrong: its name, what is wrong, what is allowed."""
    return _lines(error.errors(), tables, schema)


def _lines(errors: list[Any], tables: dict[str, Any], schema: dict[str, Any]) -> list[str]:
    wrong: dict[str, list[Any]] = {}
    for entry in errors[:_MOST_MISTAKES]:
        wrong.setdefault(_dotted(entry["loc"], tables, entry["type"]), []).append(entry)
    lines = []
    for key, entries in wrong.items():
        # Where a key may have one of several types, only the type that was meant is of interest.
        deeper = any(other.startswith((f"{key}.", f"{key}[")) for other in wrong)
        meant = [entry for entry in entries if not entry["type"].endswith("_type")]
        if deeper and (len(meant) < len(entries) or entries[0]["type"] == "too_short"):
            continue
        messages = [_message(entry, key, schema) for entry in meant or entries]
        lines.append(f"{key} {' or '.join(dict.fromkeys(messages))}".lstrip())
    return lines


def _dotted(location: tuple[int | str, ...], tables: Any, kind: str) -> str:
    """The key as its user knows it, for instance view[2].field_of_view.

    Pydantic's location also has the names of union members, which are no keys.
    """
    name, node = "", tables
    for position, part in enumerate(location):
        last = position == len(location) - 1
        if isinstance(part, int):
            name += f"[{part}]"
            node = node[part] if isinstance(node, (list, tuple)) and part < len(node) else None
        elif isinstance(node, dict) and (part in node or (last and kind == "missing")):
            name += f".{part}" if name else part
            node = node.get(part)
    return name


def _message(entry: Any, key: str, schema: dict[str, Any]) -> str:
    kind, value = entry["type"], entry["input"]
    if kind in ("extra_forbidden", "unexpected_keyword_argument"):
        allowed = sorted(_allowed_keys(schema, entry["loc"][:-1]))
        others = _types_with_key(schema, entry["loc"])
        if others:
            return f"is no key of type {entry['loc'][-2]!r}, but of {' and '.join(map(repr, others))}"
        nearest = difflib.get_close_matches(str(entry["loc"][-1]), allowed, n=1)
        hint = f": did you mean {nearest[0]}?" if nearest else ""
        return f"is no known key{hint} (allowed: {', '.join(allowed)})"
    if kind == "missing":
        return "is missing"
    if kind == "value_error":
        return f"is wrong: {entry['ctx']['error']}"
    if kind == "union_tag_not_found":
        return "needs a key type"
    if kind == "union_tag_invalid":
        return f"has type {entry['ctx']['tag']!r}: allowed are {entry['ctx']['expected_tags']}"
    if kind == "tuple_type" and isinstance(value, dict):
        return f"must be a list of tables: write [[{key}]]"
    if kind in ("dataclass_type", "model_type", "model_attributes_type", "dict_type"):
        return f"must be a table, is {_shown(value)}"
    if kind == "too_short" and not entry["ctx"]["actual_length"]:
        return "needs at least one entry"
    message = entry["msg"].replace("Input should be", "must be")
    for words, plainer in (("a valid array", "a list"), ("a valid integer", "an integer"), ("a valid", "a")):
        message = message.replace(words, plainer)
    return f"{message}, is {_shown(value)}"


def _shown(value: Any) -> str:
    text = json.dumps(value, default=str)
    return text if len(text) <= 60 else f"{text[:57]}..."


def _allowed_keys(schema: dict[str, Any], location: tuple[int | str, ...]) -> list[str]:
    """Keys of the table at a pydantic location, by the schema of the whole."""
    node = _resolved(schema, schema)
    for part in location:
        if "discriminator" in node:
            node = {"$ref": node["discriminator"]["mapping"][part]}
        elif isinstance(part, int):
            node = node["items"]
        else:
            node = node["properties"][part]
        node = _resolved(node, schema)
    return list(node["properties"])


def _types_with_key(schema: dict[str, Any], location: tuple[int | str, ...]) -> list[str]:
    """Other types of the table that a key was given in, which have this key."""
    node = _resolved(schema, schema)
    for part in location[:-1]:
        if "discriminator" in node:
            if part != location[-2]:
                node = _resolved({"$ref": node["discriminator"]["mapping"][part]}, schema)
                continue
            kinds = {kind: _resolved({"$ref": ref}, schema) for kind, ref in node["discriminator"]["mapping"].items()}
            return [kind for kind, table in kinds.items() if kind != part and location[-1] in table["properties"]]
        node = _resolved(node["items"] if isinstance(part, int) else node["properties"][part], schema)
    return []


def _resolved(node: dict[str, Any], schema: dict[str, Any]) -> dict[str, Any]:
    """Follows references, and the alternative that is not null."""
    while True:
        if "$ref" in node:
            node = schema["$defs"][node["$ref"].rpartition("/")[2]]
        elif "anyOf" in node:
            node = next(member for member in node["anyOf"] if member.get("type") != "null")
        else:
            return node
