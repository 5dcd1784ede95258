"""The tutorial's notebooks run as they stand, cell by cell, and show what they show."""

import ast
import json
from pathlib import Path

import pytest

NOTEBOOKS = sorted((Path(__file__).parents[2] / "docs" / "tutorial" / "notebooks").glob("*.ipynb"))

QUICKER = {
    "time_limit=20": "time_limit=1",
    "0.1, seed=1": "0.5, seed=1",
    "range(1, 9)": "range(1, 3)",
    "iterations=8": "iterations=1",
    "samples=256": "samples=32",
    "samples=512": "samples=64",
}


def cells(path):
    return ["".join(cell["source"]) for cell in json.loads(path.read_text())["cells"] if cell["cell_type"] == "code"]


def run(code, names):
    """Runs a cell; returns what a notebook would show of its last line."""
    tree = ast.parse(code)
    last = tree.body.pop() if isinstance(tree.body[-1], ast.Expr) else None
    exec(compile(tree, "cell", "exec"), names)
    return None if last is None else eval(compile(ast.Expression(last.value), "cell", "eval"), names)


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_runs(path, tmp_path, monkeypatch):
    from matplotlib import pyplot

    monkeypatch.chdir(tmp_path)
    pyplot.switch_backend("agg")
    names, shown = {}, []
    for code in cells(path):
        # The limits are for readers, and so is that much work; what is tested is that it runs.
        for slow, quick in QUICKER.items():
            code = code.replace(slow, quick)
        shown.append(run(code, names))
    assert names["result"].extinction.max() > 0 and pyplot.get_fignums()
    for value in shown:
        for text in (repr(value), getattr(value, "_repr_html_", lambda: "")()):
            assert len(text) < 200_000
    assert not list(tmp_path.iterdir())  # nothing is left behind
    pyplot.close("all")


def test_there_are_three_without_outputs():
    """Outputs would be of another version before long."""
    assert len(NOTEBOOKS) == 3
    for path in NOTEBOOKS:
        assert all(not cell.get("outputs") for cell in json.loads(path.read_text())["cells"])
