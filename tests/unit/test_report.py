"""The report's page holds all it shows, and nothing from elsewhere."""

import base64
import json
import re
from html.parser import HTMLParser

import numpy as np
import pytest

from cloudtomo_cl.commands.progress import with_error
from cloudtomo_cl.report.page import report_page
from cloudtomo_cl.scene.grid import Grid
from cloudtomo_cl.scene.measurements import Measurements
from cloudtomo_cl.scene.sensors import OrthographicView

GRID = Grid((6, 5, 8), (0.1, 0.2, 0.3), (1.0, 2.0, 3.0))
TRUTH = np.random.default_rng(1).uniform(-50, 90, GRID.shape).clip(0)


def page(grid=GRID, truth=TRUTH, **more):
    settings, figures = {"key": "<script>alert(1)</script>"}, {"maps": b"a picture"}
    return report_page("a & b", "source", {"eps": "0.5"}, grid, truth * 0.8, figures, settings, truth, **more)


def volumes(text):
    return json.loads(re.search(r"^const cloud = (.*);$", text, flags=re.MULTILINE)[1])


def test_nothing_is_loaded_from_elsewhere():
    links = []

    class Links(HTMLParser):
        def handle_starttag(self, tag, attributes):
            links.extend(value for name, value in attributes if name in ("src", "href"))

    Links().feed(page())
    assert links and all(link.startswith("data:") for link in links)


def test_the_volumes_are_those_of_the_run():
    cloud = volumes(page())
    assert cloud["shape"] == [6, 5, 8] and cloud["origin"] == [1, 2, 3]
    assert cloud["spacing"] == pytest.approx([0.1, 0.2, 0.3])
    for volume, expected in zip(cloud["volumes"], (TRUTH, TRUTH * 0.8)):
        values = np.frombuffer(base64.b64decode(volume["data"]), "<u2").reshape(GRID.shape) * cloud["step"]
        assert np.allclose(values, expected, atol=TRUTH.max() / 2**16)
    assert [volume["name"] for volume in cloud["volumes"]] == ["true", "recovered"]


def test_large_volumes_are_shown_coarser():
    grid = Grid((100, 100, 90), (0.1, 0.1, 0.1))
    cloud = volumes(page(grid, np.ones(grid.shape)))
    assert cloud["shape"] == [50, 50, 45] and cloud["spacing"] == pytest.approx([0.2, 0.2, 0.2])


def test_text_is_not_markup():
    text = page()
    assert "a &amp; b" in text and "<script>alert" not in text


def test_a_difference_of_two_standard_errors_is_told():
    view = OrthographicView(zenith=10, width=1, pixels=(3, 2))
    measured, modelled = (
        Measurements((view,), (np.full((2, 3), mean),), (np.full((2, 3), error),))
        for mean, error in ((2.0, 0.3), (1.0, 0.4))
    )
    cells = ["0", "2.000", "1.000", "-50.00 %", "50.0 %", "4", "0.0%"]
    assert "".join(f"<td>{cell}</td>" for cell in cells) in page(measurements=measured, modelled=modelled)


def test_what_is_left_out_is_said():
    assert '<p class="note">a &lt; b</p>' in page(notes=["a < b"])


@pytest.mark.parametrize(
    ("value", "error", "text"),
    [
        (0.0155012, 2.2e-5, "0.01550 ± 0.00002"),
        (126.3, 187.0, "100 ± 200"),
        (13.77, 0.8, "13.8 ± 0.8"),
        (1.0, 0.0975, "1.0 ± 0.1"),
        (-0.04, 0.3, "0.0 ± 0.3"),
        (2.5, 0.0, "2.5 ± 0"),
        (2.59e16, 3e14, "(2.59 ± 0.03)e+16"),
        (3.0, 4e8, "(0 ± 4)e+08"),
    ],
)
def test_numbers_have_the_digits_that_their_errors_leave(value, error, text):
    assert with_error(value, error) == text
