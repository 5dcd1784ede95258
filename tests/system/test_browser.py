"""The report in a real browser: turned and slid by a script, narrow and wide, in the light and in the dark."""

import json
import shutil

import numpy as np
import pytest

import cloudtomo_cl as ct
from cloudtomo_cl.report.page import report_page
from cloudtomo_cl.report.volume import AMBIENT, sunlight

BROWSERS = ("chromium", "chromium-browser", "google-chrome")
GRID = ct.Grid((8, 6, 10), (0.1, 0.1, 0.1), (1.0, 2.0, 0.5))
SUN = ct.Sun(zenith=50.0, azimuth=20.0)
TRUTH = ct.cumulus(GRID, seed=2, peak=40.0)


@pytest.fixture(scope="module")
def browser():
    api = pytest.importorskip("playwright.sync_api", reason="needs playwright: the extra viewers")
    found = next((path for path in map(shutil.which, BROWSERS) if path), None)
    if found is None:
        pytest.skip(f"needs a browser: {' or '.join(BROWSERS)}")
    options = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist"]
    with api.sync_playwright() as started:
        one = started.chromium.launch(executable_path=found, args=options)
        yield one
        one.close()


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    view = ct.OrthographicView(zenith=40, azimuth=90, width=1.0, pixels=(4, 4))
    images = ct.Measurements((view,), (np.ones((4, 4)),), (np.full((4, 4), 0.1),))
    text = report_page("title", "source", {"eps": "0.1"}, GRID, TRUTH * 0.8, {}, {}, TRUTH, images, images, sun=SUN)
    file = tmp_path_factory.mktemp("page") / "report.html"
    file.write_text(text, encoding="utf-8")
    return file


def opened(browser, path, width=1400, scheme="light"):
    page = browser.new_page(viewport={"width": width, "height": 900}, color_scheme=scheme, offline=True)
    wrong = []
    page.on("pageerror", lambda error: wrong.append(str(error)))
    page.on("console", lambda message: wrong.append(message.text) if message.type == "error" else None)
    page.goto(path.as_uri())
    page.wait_for_function("document.getElementById('stages').dataset.azimuth")
    assert not wrong
    return page


@pytest.mark.parametrize("width", [1400, 400])
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_the_page_fits_and_draws_both_clouds(browser, path, width, scheme):
    page = opened(browser, path, width, scheme)
    assert page.evaluate("document.documentElement.scrollWidth") == width
    assert not page.locator("#flat").is_visible() and page.locator(".stage").count() == 2
    for number in range(2):
        opaque = page.evaluate(f"""() => {{
            const gl = stages[{number}].layers[1], size = gl.canvas.width, data = new Uint8Array(4 * size * size);
            gl.readPixels(0, 0, size, size, gl.RGBA, gl.UNSIGNED_BYTE, data);
            return data.filter((value, n) => n % 4 === 3 && value > 50).length / size / size;
        }}""")
        assert 0.002 < opaque < 0.5
    page.close()


def test_dragging_and_keys_turn_the_clouds(browser, path):
    page = opened(browser, path)
    stage = page.locator(".stage").first
    before, box = stage.screenshot(), stage.bounding_box()
    page.mouse.move(box["x"] + 100, box["y"] + 100)
    page.mouse.down()
    page.mouse.move(box["x"] + 140, box["y"] + 80, steps=4)
    page.mouse.up()
    page.wait_for_function("document.getElementById('stages').dataset.azimuth === '230.0'")
    assert page.locator("#stages").get_attribute("data-zenith") == "72.0" and stage.screenshot() != before
    stage.press("ArrowLeft")
    page.wait_for_function("document.getElementById('stages').dataset.azimuth === '225.0'")
    page.close()


def test_the_slider_shows_the_voxels_of_its_layer(browser, path):
    page = opened(browser, path)
    page.locator("#slice").fill("4")
    assert page.locator("#where").text_content() == "z = 0.950 km (layer 5 of 10)"
    canvas = page.locator("#panels canvas").first
    box = canvas.bounding_box()
    # The lower left corner of the map is the south-western voxel.
    page.mouse.move(box["x"] + 56, box["y"] + box["height"] - 46)
    assert page.locator("#value").text_content().startswith("x 1.050, y 2.050, z 0.950 km: true ")
    page.close()


def test_the_script_lights_as_the_picture_for_papers_does(browser, path):
    page = opened(browser, path)
    light = np.array(json.loads(page.evaluate("JSON.stringify(Array.from(sunlight(volumes[0].data)))")))
    expected = AMBIENT + (1 - AMBIENT) * sunlight(GRID, TRUTH, SUN)
    assert np.allclose(light.reshape(GRID.shape), expected, atol=1e-4)
    page.close()
