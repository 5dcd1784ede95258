"""The documentation holds together: links, names of pages, decisions, and the site that is built from it."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

import cloudtomo_cl as ct

TOP = Path(__file__).parents[2]
DOCS = TOP / "docs"
PAGES = sorted(DOCS.rglob("*.md"))
TEXTS = [*sorted(TOP.glob("*.md")), *PAGES]
FOLDERS = sorted(path.parent.name for path in DOCS.glob("*/index.md"))
SOURCES = [
    path
    for folder, kinds in (("cloudtomo_cl", "py"), ("kernels", "cl h"), ("scripts", "py sh c"), ("tests", "py"))
    for kind in kinds.split()
    for path in sorted((TOP / folder).rglob(f"*.{kind}"))
]
# Names of version 0.1 that have others now; settings.md is made from the code, and the glossary tells synonyms.
RETIRED = (
    r"\[optimizer\]|optimizer\.|image_memory|decay[12]|keep_paths|halving|radiance field|field of radiance|"
    r"gradient = \"field\"|bad pixels"
)


def name(path):
    return path.relative_to(TOP).as_posix()


def without_code(text):
    return re.sub(r"^```.*?^```$", "", text, flags=re.DOTALL | re.MULTILINE)


def anchors(path):
    """Those of the headings, as the hosting page and the site make them."""
    headings = re.findall(r"^#+ (.*)$", without_code(path.read_text(encoding="utf-8")), flags=re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def targets(path):
    """The places of links that do not leave the project."""
    found = re.findall(r"\]\(([^)\s]+)\)", without_code(path.read_text(encoding="utf-8")))
    return [target for target in found if "://" not in target]


@pytest.mark.parametrize("path", TEXTS, ids=name)
def test_links_lead_somewhere(path):
    for target in targets(path):
        file, _, anchor = target.partition("#")
        page = (path.parent / file).resolve() if file else path
        assert page.exists(), f"{name(path)} links to {target}, which is not there"
        assert not anchor or anchor in anchors(page), f"{name(path)} links to {target}, a heading that is not there"


def test_comments_name_pages_that_exist():
    found = [(name(path), page) for path in SOURCES for page in re.findall(r"docs/[\w/-]+\.md", path.read_text())]
    assert found
    assert not [(path, page) for path, page in found if not (TOP / page).exists()]


@pytest.mark.parametrize("folder", FOLDERS)
def test_an_index_links_to_every_page_of_its_folder(folder):
    pages = {path.name for path in (DOCS / folder).glob("*.md")} - {"index.md"}
    assert pages <= set(targets(DOCS / folder / "index.md"))


@pytest.mark.parametrize(
    "path", sorted(set((DOCS / "decisions").glob("*.md")) - {DOCS / "decisions" / "index.md"}), ids=name
)
def test_a_decision_has_a_question_and_an_outcome(path):
    text = path.read_text(encoding="utf-8")
    assert text.count("**Question.**") == 1
    assert text.count("**Outcome.**") == 1


@pytest.mark.parametrize("path", [p for p in PAGES if p.name not in ("settings.md", "glossary.md")], ids=name)
def test_pages_use_the_names_of_today(path):
    assert not re.findall(RETIRED, path.read_text(encoding="utf-8"))


def test_the_readme_and_the_tutorial_show_the_same_example():
    readme, tutorial = (
        re.findall(r"^```python\n.*?^```$", path.read_text(encoding="utf-8"), flags=re.DOTALL | re.MULTILINE)
        for path in (TOP / "README.md", DOCS / "tutorial" / "first-recovery.md")
    )
    assert readme == tutorial


def test_the_scripts_that_pages_name_exist():
    found = {script for path in TEXTS for script in re.findall(r"scripts/\w+\.(?:py|sh|c)", path.read_text("utf-8"))}
    assert found
    assert not [script for script in found if not (TOP / script).exists()]


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """The site, built; warnings (links, anchors, parameters that are not in a signature) are errors."""
    for package in ("mkdocs", "material", "mkdocstrings", "latex2mathml"):
        pytest.importorskip(package, reason="the site needs pip install '.[docs]'")
    folder = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(folder)]
    environment = {**os.environ, "NO_MKDOCS_2_WARNING": "1"}
    done = subprocess.run(command, cwd=TOP, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return folder


def test_every_public_name_has_its_place_in_the_site(site):
    text = "".join(path.read_text(encoding="utf-8") for path in (site / "reference" / "api").glob("*.html"))
    assert not [public for public in ct.__all__ if not re.search(rf'<h2 id="cloudtomo_cl\.[\w.]*\b{public}"', text)]


def test_the_site_needs_no_network(site):
    loads = re.compile(r"""<(?:(?:script|img|iframe)[^>]* src|link[^>]*stylesheet[^>]*)=["']?(?:https?:)?//""")
    assert not [page for page in site.rglob("*.html") if loads.search(page.read_text(encoding="utf-8"))]


def test_equations_are_drawn(site):
    page = (site / "explanation" / "cost.html").read_text(encoding="utf-8")
    assert "<math" in page
    assert r"\frac" not in page
