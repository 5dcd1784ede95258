"""The reference of every settings key, made from the classes that check them: docs/reference/settings.md.

The meaning is what the class's docstring says under Attributes, the allowed values and the default come from the
schema that settings files are checked with. So the page cannot say anything else than the code does.
"""

from __future__ import annotations

import dataclasses
import inspect
import json
import re
import types
import typing
from collections.abc import Iterator
from typing import Any

from pydantic import BaseModel, TypeAdapter
from pydantic_core import PydanticUndefined

from cloudtomo_cl.settings.tables import ReconstructSettings, RenderSettings

INTRODUCTION = """\
# Settings

Made by `python scripts/settings_reference.py` from the classes of the Python API, whose arguments these keys are.

Files are TOML. Lengths are in km, extinction in km^-1, angles in degrees, radiance in W m^-2 sr^-1, droplets' radii in
micrometres; x runs east, y north, z up, the ground is z = 0. Relative paths start at the settings file's folder.
`--set table.key=value` on the command line takes the place of a key, `--set 'view[0].zenith=30'` that of one in a list.
A wrong key is answered with its name and with what is allowed; `cloudtomo init` writes a file to start from.
"""
_FILES: tuple[tuple[type[BaseModel], str, str], ...] = (
    (RenderSettings, "The scene file of `cloudtomo render`", "scene"),
    (ReconstructSettings, "The run file of `cloudtomo reconstruct`", "run"),
)


def page() -> str:
    """docs/reference/settings.md."""
    parts = [INTRODUCTION]
    shown: set[type] = set()
    for model, title, _ in _FILES:
        parts.append(f"## {title}\n\n{_first_paragraph(model)}\n")
        for name, field in model.model_fields.items():
            need = "required" if field.is_required() else "optional"
            parts.extend(_table(name, field.annotation, field.metadata, need, shown))
    return "\n".join(parts).rstrip() + "\n"


def _table(name: str, annotation: Any, metadata: list[Any], need: str, shown: set[type]) -> Iterator[str]:
    """The section of one table of a file, with the kinds it may be of, and the tables inside it."""
    classes = _classes(annotation)
    is_list = "tuple" in str(annotation)
    heading = f"[[{name}]]" if is_list else f"[{name}]"
    classes_text = f", {len(classes)} types" if len(classes) > 1 else ""
    yield f"### `{heading}`\n\n{need.capitalize()}{classes_text}.\n"
    for kind in classes:
        if kind in shown:
            yield f"`{kind.__name__}`: see above.\n"
            continue
        shown.add(kind)
        yield from _section(kind, shown)


def _section(kind: type, shown: set[type]) -> Iterator[str]:
    yield f"**`{kind.__name__}`** {_first_paragraph(kind)}\n"
    yield "| key | value | default | meaning and unit |\n|---|---|---|---|\n" + "\n".join(_rows(kind)) + "\n"
    for field in dataclasses.fields(kind):
        for inner in _classes(_hints(kind)[field.name]):
            if inner not in shown:
                shown.add(inner)
                yield from _section(inner, shown)


def _rows(kind: type) -> Iterator[str]:
    schema = TypeAdapter(kind).json_schema()
    meanings = attribute_meanings(kind)
    # Keys that must be given come first, as in the class's arguments.
    for field in dataclasses.fields(kind):
        properties = schema["properties"][field.name]
        default = _default(field)
        value = _escape(_allowed(properties, schema))
        yield f"| `{field.name}` | {value} | {default} | {_escape(meanings.get(field.name, ''))} |"


def _escape(text: str) -> str:
    return text.replace("|", "\\|")


def default_value(field: Any) -> tuple[bool, Any]:
    """Whether a field of a settings class has a default, and which."""
    value = getattr(field.default, "default", field.default)
    missing = value is dataclasses.MISSING or value is PydanticUndefined
    return (False, None) if missing else (True, value)


def _default(field: Any) -> str:
    has_default, value = default_value(field)
    if not has_default:
        return "required"
    if value is None:
        return "none"
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        inner = ", ".join(f"{name} = {toml(part)}" for name, part in dataclasses.asdict(value).items())
        return f"`{{ {inner} }}`"
    return f"`{toml(value)}`"


def toml(value: Any) -> str:
    """A value as TOML writes it: JSON, which is TOML for all that settings hold."""
    return json.dumps(value)


def _allowed(schema: dict[str, Any], whole: dict[str, Any]) -> str:
    """What a JSON schema allows, in words."""
    if "$ref" in schema:
        return f"table {schema['$ref'].rpartition('/')[2]}"
    for key in ("anyOf", "oneOf"):
        if key in schema:
            options = [_allowed(option, whole) for option in schema[key] if option.get("type") != "null"]
            return " or ".join(dict.fromkeys(options))
    if "const" in schema:
        return f"`{toml(schema['const'])}`"
    if "enum" in schema:
        return ", ".join(f"`{toml(option)}`" for option in schema["enum"])
    if schema.get("type") == "array":
        if "prefixItems" in schema:
            items = list(dict.fromkeys(_allowed(item, whole) for item in schema["prefixItems"]))
            return f"{len(schema['prefixItems'])} of: {'; '.join(items)}"
        return f"list of: {_allowed(schema.get('items', {}), whole)}"
    names = {"number": "number", "integer": "integer", "boolean": "`true` or `false`", "string": "text"}
    text = "path" if schema.get("format") == "path" else names.get(schema.get("type", ""), "value")
    limits = (
        ("minimum", "at least"),
        ("exclusiveMinimum", "above"),
        ("maximum", "at most"),
        ("exclusiveMaximum", "below"),
        ("multipleOf", "a multiple of"),
    )
    words = [f"{phrase} {schema[key]:g}" for key, phrase in limits if key in schema]
    return f"{text} {', '.join(words)}" if words else text


def attribute_meanings(kind: type) -> dict[str, str]:
    """What a class's docstring says under Attributes: `name, other : meaning`, continued on indented lines."""
    meanings: dict[str, str] = {}
    names: list[str] = []
    # A class that extends another explains its own keys only.
    texts = [inspect.getdoc(ancestor) or "" for ancestor in reversed(kind.__mro__[:-1])]
    sections = [text.partition("Attributes\n----------\n")[2].partition("\n\n")[0] for text in texts]
    for line in "\n".join(sections).splitlines():
        match = re.fullmatch(r"(\w+(?:, \w+)*) : (.*)", line)
        if match:
            names = match[1].split(", ")
            meanings.update(dict.fromkeys(names, match[2].strip()))
        else:
            for name in names:
                meanings[name] += f" {line.strip()}"
    if "type" in {field.name for field in dataclasses.fields(kind)}:
        meanings.setdefault("type", "which of the types this is")
    return meanings


def _first_paragraph(kind: type) -> str:
    return " ".join((inspect.getdoc(kind) or "").partition("\n\n")[0].split())


def _hints(kind: type) -> dict[str, Any]:
    return typing.get_type_hints(kind, include_extras=True)


def _classes(annotation: Any) -> list[type]:
    """The settings classes in an annotation, each once, in their order."""
    if isinstance(annotation, type) and dataclasses.is_dataclass(annotation):
        return [annotation]
    if isinstance(annotation, types.GenericAlias) or typing.get_origin(annotation) is not None:
        found = [kind for argument in typing.get_args(annotation) for kind in _classes(argument)]
        return list(dict.fromkeys(found))
    return []


def undocumented() -> list[str]:
    """Keys of the settings that no docstring explains: none, if the page is to be of use."""
    missing, seen = [], set()

    def visit(kind: type) -> None:
        if kind in seen:
            return
        seen.add(kind)
        meanings = attribute_meanings(kind)
        for field in dataclasses.fields(kind):
            if not meanings.get(field.name):
                missing.append(f"{kind.__name__}.{field.name}")
            for inner in _classes(_hints(kind)[field.name]):
                visit(inner)

    for model, _, _ in _FILES:
        for field in model.model_fields.values():
            for kind in _classes(field.annotation):
                visit(kind)
    return missing
