"""The Python examples of the documentation run as they stand."""

import re
from dataclasses import replace
from pathlib import Path

import pytest
from matplotlib import pyplot

import cloudtomo_cl as ct

README = Path(__file__).parents[2] / "README.md"
PYTHON = README.parent / "docs" / "how-to" / "python.md"
OWN = README.parent / "docs" / "tutorial" / "own-prior-and-solver.md"


def test_python_example_recovers_a_cloud(capsys):
    (example,) = re.findall(r"```python\n(.*?)```", README.read_text(), flags=re.DOTALL)
    # The limit is for readers; what is tested is that it runs.
    assert "time_limit=20" in example
    exec(compile(example.replace("time_limit=20", "time_limit=2"), str(README), "exec"), {})
    assert re.fullmatch(r"eps [\d.]+, largest extinction \d+ km\^-1\n", capsys.readouterr().out)


def examples(page=PYTHON):
    return re.findall(r"<!-- tested .*?```python\n(.*?)```", page.read_text(), flags=re.DOTALL)


# Fewer paths and iterations than readers are shown.
QUICKER = {
    "stages=ct.automatic_stages(cloud.grid)[:1]": "stages=quick",
    "samples=512, seed=2": "samples=256, seed=2",
    "range(1, 9)": "range(1, 6)",
    "iterations=8": "iterations=4",
}


def quicker(example):
    for slow, quick in QUICKER.items():
        example = example.replace(slow, quick)
    return example


def test_what_is_made_quicker_is_there():
    text = "".join([*examples(), *examples(OWN)])
    assert not [slow for slow in QUICKER if slow not in text]


def test_notebook_goes_from_xarray_to_images_and_back(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    pyplot.switch_backend("agg")
    grid = ct.Grid(shape=(8, 8, 8), spacing=(0.1, 0.1, 0.1))
    ct.write_extinction("cloud.nc", grid, ct.cumulus(grid, seed=1))
    # What is tested is that it runs, and that the cost falls.
    names = {"quick": [replace(ct.automatic_stages(grid)[0], iterations=4)]}
    for example in examples()[1:]:
        exec(compile(quicker(example), str(PYTHON), "exec"), names)
    assert names["images"].radiance.sizes == {"view": 9, "row": 32, "column": 32}
    assert len(names["costs"]) == len(names["result"].history)
    assert names["costs"][-1][2] < names["costs"][0][2]
    labels = [label for figure in map(pyplot.figure, pyplot.get_fignums()) for label in words(figure)]
    assert any("mean radiance of a pixel" in label for label in labels) and any("[km]" in label for label in labels)
    told = capsys.readouterr().out
    assert "RadianceOperator(9 views, 9216 pixels, 8 x 8 x 8 voxels of 0.1 x 0.1 x 0.1 km" in told
    assert "W m^-2 sr^-1" in told and "eps" in told
    pyplot.close("all")


def words(figure):
    """What is written at the axes."""
    return [text for axes in figure.axes for text in (axes.get_xlabel(), axes.get_ylabel(), axes.get_title())]


def test_scipy_example_comes_closer_to_the_cloud(capsys):
    exec(compile(quicker(examples()[0]), str(PYTHON), "exec"), {})
    start, end = re.fullmatch(r"eps ([\d.]+) at the start, ([\d.]+) in the end\n", capsys.readouterr().out).groups()
    assert float(end) < 0.8 < float(start)


def test_wavelengths_go_into_one_file(tmp_path, monkeypatch, capsys):
    pytest.importorskip("miepython", reason="Mie tables need miepython")
    monkeypatch.chdir(tmp_path)
    page = README.parent / "docs" / "how-to" / "wavelengths.md"
    (example,) = examples(page)
    exec(compile(example, str(page), "exec"), {})
    assert capsys.readouterr().out.startswith("(865.0, 2130.0) Measurements(1 views of 8 x 8 pixels, 2130 nm, ")


@pytest.fixture(scope="module")
def own_images():
    names = {}
    exec(compile(examples(OWN)[0], str(OWN), "exec"), names)
    return names


@pytest.mark.parametrize("number", [1, 2, 3], ids=["lsqr", "ODL", "total variation"])
def test_own_solvers_and_priors_come_closer_to_the_cloud(own_images, number, capsys):
    if number == 2:
        pytest.importorskip("odl", reason="ODL, of the extra test, is not installed")
    exec(compile(quicker(examples(OWN)[number]), str(OWN), "exec"), dict(own_images))
    start, end = re.fullmatch(r"eps ([\d.]+) [a-z ]+, ([\d.]+) in the end\n", capsys.readouterr().out).groups()
    assert float(end) < 0.8 < float(start)
