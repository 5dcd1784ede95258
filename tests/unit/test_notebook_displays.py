"""What notebooks show: short words, small pictures, a line of progress."""

import io
import re
import sys
import types
from base64 import b64decode
from dataclasses import replace

import numpy as np
import pytest
import xarray as xr
from matplotlib.image import imread

import cloudtomo_cl as ct
from cloudtomo_cl.commands import notebook
from cloudtomo_cl.commands.run_folder import RunFolder
from cloudtomo_cl.inversion.problem import Problem
from cloudtomo_cl.inversion.records import History, Reconstruction
from cloudtomo_cl.scene.cards import MOST_PICTURES, card, png

GRID = ct.Grid((6, 5, 4), (0.1, 0.1, 0.1))
# A terminal of 80 times 24.
SCREEN = 1920
RECORDS = [ct.IterationRecord(0, 2, n, 20, float(n), 1000 * n, 1.0 / n, 0.1, 0.0, 0.5, -0.1) for n in range(1, 21)]


@pytest.fixture(scope="module")
def operator():
    views = tuple(ct.OrthographicView(zenith=z, width=0.8, pixels=(6, 5)) for z in (0.0, 30.0))
    return ct.RadianceOperator(ct.Scene(GRID, ct.Sun(zenith=20.0)), views)


@pytest.fixture(scope="module")
def rendering(operator):
    return operator.render(np.full(GRID.shape, 3.0, np.float32), samples=8, seed=1)


@pytest.fixture(scope="module")
def result():
    extinction = np.zeros(GRID.shape, np.float32)
    extinction[5, 0, 1] = 7.0
    return Reconstruction(GRID, extinction, extinction > 0, RECORDS, [1.0], 0.1 * extinction)


def pictures(text):
    return [imread(io.BytesIO(b64decode(data))) for data in re.findall(r"base64,([^\"]+)", text)]


def test_a_picture_is_the_image_and_clear_where_nothing_is_known():
    image = np.array([[0.0, 1.0, 2.0], [4.0, 8.0, np.nan]])
    read = imread(io.BytesIO(png(image, 4.0)))
    assert read.shape == (2, 3, 4) and read[1, 2, 3] == 0 and read[0, 0, 3] == 1
    assert np.allclose(read[..., 0], np.nan_to_num(image / 4).clip(0, 1), atol=1 / 255)


def test_a_card_has_text_and_not_markup_and_few_pictures():
    text = card("a < b", {"name": "<script>"}, [("x", np.ones((2, 2)))] * 9)
    assert "<script" not in text and "a &lt; b" in text and len(pictures(text)) == MOST_PICTURES
    assert "and 3 more" in text


def test_objects_have_cards_with_pictures(rendering, result):
    measurements = ct.Measurements.rendered(rendering._operator, rendering)
    cloud = ct.CloudVolume(GRID, result.extinction)
    for thing, count in ((rendering, 2), (measurements, 2), (result, 1), (cloud, 1), (measurements.views[0], 0)):
        assert len(pictures(thing._repr_html_())) == count


def test_a_cloud_is_shown_with_north_up_and_east_on_the_right(result):
    (picture,) = pictures(result._repr_html_())
    assert np.argwhere(picture[..., 0] > 0.5).tolist() == [[4, 5]]


@pytest.mark.parametrize("cost, fits", [(1.2, True), (50.0, False)])
def test_a_result_says_when_its_images_are_not_fitted(result, cost, fits):
    last = replace(RECORDS[-1], cost=cost, expected_cost=1.0)
    told = replace(result, history=[*RECORDS, last])
    for text in (repr(told), told._repr_html_()):
        assert ("not fitted" in text) == (not fits)


def test_no_word_is_longer_than_a_screen(operator, rendering, result):
    directions = np.tile([0.0, 0.1, -1.0], (400, 1))
    rays = ct.RayView(np.ones((400, 3)), directions, (20, 20))
    angle = np.linspace(0, 180, 500)
    function = ct.TabulatedPhaseFunction(angle, np.full((20, 500), 1 / (4 * np.pi)), range(1, 21), [1.0] * 20)
    table = ct.DropletTable(function, (2.0,) * 20, 672.0, 0.1, 1.33, 0.0)
    measurements = ct.Measurements.rendered(operator, rendering)
    problem = Problem.of(operator.scene, measurements, mask=np.ones(GRID.shape, bool), device=operator.device)
    things = [rays, function, table, rendering, result, result.history, measurements, operator, problem, problem.voxels]
    things += [
        ct.Scene(GRID, ct.Sun(3.0), ct.Cloud(phase_function=function)),
        problem.linearise(np.ones(120), samples=8),
        ct.Checkpoint({}, "CPU", 1, 3, 4.0, [1.0], [{"cost": 1.0}] * 50, {"mask": np.ones(1000, bool)}),
    ]
    for thing in things:
        assert len(repr(thing)) <= SCREEN, (type(thing), len(repr(thing)))


def test_a_rendering_becomes_a_dataset(rendering):
    dataset = rendering.to_dataset()
    assert dataset.radiance.sizes == {"view": 2, "row": 5, "column": 6} and dataset.radiance.units == "W m-2 sr-1"
    assert np.array_equal(dataset.radiance.values.ravel(), rendering.mean)
    assert ct.read_measurements(dataset).views == rendering._operator.views


def test_a_result_becomes_a_dataset(result):
    dataset = result.to_dataset()
    assert dataset.extinction.dims == ("z", "y", "x") and dataset.history_cost.dims == ("step",)
    assert dataset.extinction_standard_error.sel(x=0.55, y=0.05, z=0.15, method="nearest") == pytest.approx(0.7)
    assert np.array_equal(ct.read_extinction(dataset)[1], result.extinction)
    assert all("units" in variable.attrs for variable in dataset.data_vars.values())
    assert dataset.history_seconds.units == "s" and dataset.history_cost.units == "1"


def test_a_results_dataset_describes_its_variables_as_its_file_does(result, tmp_path):
    dataset = result.to_dataset()
    folder = RunFolder(tmp_path)
    folder.write_reconstruction(GRID, result.extinction, result.mask, {}, standard_error=result.standard_error)
    with xr.open_dataset(folder.files.reconstruction) as file:
        for name in ("extinction", "mask", "extinction_standard_error"):
            assert dataset[name].attrs == file[name].attrs and dataset[name].dims == file[name].dims, name


def test_a_history_is_a_table_and_gives_its_columns(result):
    history = result.history
    assert history[-1] is RECORDS[-1] and history.columns["cost"].tolist() == [1.0 / n for n in range(1, 21)]
    lines = repr(history).splitlines()
    assert len(lines) == 12 and lines[0].split()[:2] == ["stage", "iteration"] and lines[6].split() == ["..."]
    assert history._repr_html_().count("<tr>") == 12
    unknown = History([ct.IterationRecord(0, 1, 0, 1, 1.0, 1, 1.0, 0.1, 0.0)])
    assert np.isnan(unknown.columns["epsilon"]).all() and "None" not in repr(unknown)


@pytest.mark.parametrize(
    ("cost", "error", "expected", "fitted"),
    [(1.2, 0.1, 1.0, True), (9.0, 0.1, 1.0, False), (9.0, 4.0, 1.0, True), (9.0, 0.1, None, True)],
)
def test_a_cost_is_fitted_that_noise_explains(cost, error, expected, fitted):
    """Within its own error; nothing is said where the images' noise is not known."""
    record = ct.IterationRecord(0, 1, 0, 1, 1.0, 1, cost, error, 0.0, expected_cost=expected)
    assert record.is_fitted == fitted


class Displayed:
    """Stands in for what IPython's display gives."""

    def __init__(self):
        self.texts = []

    def update(self, html):
        self.texts.append(html)


def test_progress_in_a_notebook_is_a_line_that_changes(monkeypatch):
    shown = Displayed()
    module = types.ModuleType("IPython.display")
    module.HTML = str
    module.display = lambda html, display_id: shown.update(html) or shown
    monkeypatch.setitem(sys.modules, "IPython", types.ModuleType("IPython"))
    monkeypatch.setitem(sys.modules, "IPython.display", module)
    monkeypatch.setattr(notebook, "in_notebook", lambda _: True)
    monkeypatch.setattr(notebook, "_BETWEEN", 0.0)
    with ct.ProgressDisplay() as show:
        for record in RECORDS:
            show(record)
    assert "beginning" in shown.texts[0] and 'value="0.050"' in shown.texts[1]
    assert len(shown.texts) == 22 and 'value="1.000"' in shown.texts[-1] and "eps 0.500  20 s" in shown.texts[-1]


def test_progress_elsewhere_is_lines(capsys):
    with ct.ProgressDisplay(time_limit=9.0) as show:
        show(RECORDS[0])
    assert "stage 1/2  iteration    2  cost 1.0 ± 0.1  eps 0.500  1 s" in capsys.readouterr().out
