"""The examples of docs/reference/sensors.md are right."""

import re
from pathlib import Path

import numpy as np
import pytest

from cloudtomo_cl.files.measurements import write_rays
from cloudtomo_cl.scene import formations, sensors
from cloudtomo_cl.settings.tables import read_render_settings, views

PAGE = Path(__file__).parents[2] / "docs" / "reference" / "sensors.md"
TABLES = re.findall(r"```toml\n(.*?)```", PAGE.read_text(), flags=re.DOTALL)
HEAD = '[cloud]\nfile = "cloud.nc"\n[sun]\nzenith = 60.0\n'
RAYS = sensors.RayView([(0, 0, 1), (0.1, 0, 1)], [(0, 0, -1), (0, 0.1, -1)])


def read_views(folder, tables):
    (folder / "cloud.nc").touch()
    write_rays(folder / "rays.nc", RAYS)
    (folder / "scene.toml").write_text(HEAD + "\n".join(tables))
    return views(read_render_settings(folder / "scene.toml").view)


def test_every_sensor_has_an_example(tmp_path):
    kinds = {type(view) for view in read_views(tmp_path, TABLES)}
    assert kinds == set(sensors.AffineView.__subclasses__()) | {sensors.RayView}


@pytest.mark.parametrize(("kind", "count"), [("perspective", 1), ("ring", 9), ("string", 5), ("scans", 9), ("rays", 1)])
def test_a_table_stands_for_its_views(tmp_path, kind, count):
    table = next(table for table in TABLES if f'type = "{kind}"' in table)
    assert len(read_views(tmp_path, [table])) == count


def test_views_keep_the_order_of_their_tables(tmp_path):
    ring, rays = (next(t for t in TABLES if f'type = "{kind}"' in t) for kind in ("ring", "rays"))
    found = read_views(tmp_path, [rays, ring])
    assert found[0] == RAYS
    assert found[1:] == formations.RingOfViews((0.4, 0.4, 0.6), 2.0, 0.5, 60.0, (48, 48)).views()


def test_the_all_sky_example_runs():
    (example,) = re.findall(r"```python\n(.*?)```", PAGE.read_text(), flags=re.DOTALL)
    names = {}
    exec(compile(example, str(PAGE), "exec"), names)
    assert np.isnan(names["image"][0, 0])
    assert np.nanmax(names["image"]) > 0
