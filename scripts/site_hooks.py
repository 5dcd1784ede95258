"""What the documentation site does beyond Markdown (hooks of mkdocs, see mkdocs.yml).

Pages of the API are made from the public names in cloudtomo_cl/__init__.pyi, one for each package that they come
from, so none can be forgotten. The navigation lists folders. Equations become MathML, which browsers draw by
themselves: pages need neither a script nor the network.
"""

from __future__ import annotations

import ast
import html
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

TOP = Path(__file__).resolve().parents[1]
STUB = TOP / "cloudtomo_cl" / "__init__.pyi"
API = "reference/api"
_EQUATION = re.compile(r'<(span|div) class="arithmatex">\\([(\[])(.*?)\\[)\]]</\1>', flags=re.DOTALL)


def public_names() -> dict[str, list[str]]:
    """The public names by the page that shows them: the sub-package (or module) that each is imported from."""
    pages: dict[str, list[str]] = {}
    for statement in ast.parse(STUB.read_text(encoding="utf-8")).body:
        if isinstance(statement, ast.ImportFrom):
            page = (statement.module or "").partition(".")[0]
            pages.setdefault(page, []).extend(name.asname or name.name for name in statement.names)
    return {page: sorted(names, key=str.lower) for page, names in sorted(pages.items())}


def api_page(page: str, names: list[str]) -> str:
    """The Markdown of one page of the API."""
    head = f"# {page}\n\nPublic names of `import cloudtomo_cl as ct` that are defined in `cloudtomo_cl.{page}`.\n"
    return head + "".join(f"\n::: cloudtomo_cl.{name}\n" for name in names)


def pages_of(folder: str) -> list[str]:
    """The pages of a folder of docs/: its index, then the others in the order in which the index links to them."""
    if folder == f"{API}/":
        return [f"{API}/{page}.md" for page in public_names()]
    index = (TOP / "docs" / folder / "index.md").read_text(encoding="utf-8")
    linked = dict.fromkeys(["index.md", *re.findall(r"\]\(([\w-]+\.md)\)", index)])
    return [folder + page for page in linked]


def _expanded(entry: Any) -> Iterator[Any]:
    if isinstance(entry, str):
        yield from pages_of(entry) if entry.endswith("/") else [entry]
    else:
        for title, content in entry.items():
            inner = content if isinstance(content, list) else [content]
            yield {title: [page for part in inner for page in _expanded(part)]}


def on_config(config: Any) -> Any:
    """The navigation with the pages of its folders."""
    config.nav = [page for entry in config.nav for page in _expanded(entry)]
    return config


def on_files(files: Any, config: Any) -> Any:
    """The pages of the API, which lie in no folder."""
    from mkdocs.structure.files import File

    for page, names in public_names().items():
        files.append(File.generated(config, f"{API}/{page}.md", content=api_page(page, names)))
    return files


def on_page_content(content: str, **_: Any) -> str:
    """Equations as MathML."""
    from latex2mathml.converter import convert

    def drawn(match: re.Match[str]) -> str:
        display = "block" if match[2] == "[" else "inline"
        return convert(html.unescape(match[3]).strip(), display=display)

    return _EQUATION.sub(drawn, content)
