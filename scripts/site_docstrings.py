"""Reads this package's docstrings for the documentation site (an extension of griffe, see mkdocs.yml).

Their sections are those of numpydoc, but for one thing: a line is `name : meaning`, because the type stands in the
signature. numpydoc would take the meaning for the type. So each such line is split in two before it is read.
"""

from __future__ import annotations

import re
from typing import Any

from griffe import Extension

_SECTION = re.compile(r"^(Parameters|Attributes|Raises|Returns)\n-+\n", flags=re.MULTILINE)
_ITEM = re.compile(r"^(\w+(?:, \w+)*) : ", flags=re.MULTILINE)


def numpydoc(text: str) -> str:
    """A docstring as numpydoc has it; what is no list of names becomes a paragraph before the sections."""
    head, *sections = _SECTION.split(text)
    paragraphs, lists = [head.rstrip()], []
    for title, body in zip(sections[::2], sections[1::2]):
        items, _, rest = body.strip().partition("\n\n")
        if title != "Returns" and _ITEM.match(items):
            lists.append(f"{title}\n{'-' * len(title)}\n{_ITEM.sub(_split, items)}")
        else:
            rest = f"**{title}:** {_ITEM.sub(_listed, items)}\n\n{rest}"
        paragraphs.append(rest.strip())
    return "\n\n".join(part for part in paragraphs + lists if part)


def _split(item: re.Match[str]) -> str:
    return f"{item[1]}\n    "


def _listed(item: re.Match[str]) -> str:
    return f"\n\n- `{item[1]}`: "


class NameAndMeaning(Extension):
    """Rewrites every docstring as it is loaded."""

    def on_instance(self, *, obj: Any, **_: Any) -> None:
        """Of a module, class, function or attribute."""
        if not obj.is_alias and obj.docstring:
            obj.docstring.value = numpydoc(obj.docstring.value)
