"""What scripts/source_figures.py computes for the figures of the source."""

import sys
from pathlib import Path

import numpy as np
import pytest

from cloudtomo_cl.scene.grid import Grid
from cloudtomo_cl.scene.measurements import Measurements
from cloudtomo_cl.scene.metrics import epsilon
from cloudtomo_cl.scene.sensors import OrthographicView
from cloudtomo_cl.settings.tables import tomllib

SCRIPTS = Path(__file__).parents[2] / "scripts"


@pytest.fixture(scope="module")
def scripts():
    sys.path.insert(0, str(SCRIPTS))
    import source_figures
    import source_scenes

    sys.path.remove(str(SCRIPTS))
    return source_figures, source_scenes


def test_noise_of_two_images_is_no_difference_between_them(scripts, random):
    """The images' noise is 30 %, their difference 10 %: five standard errors of the estimate are 0.02."""
    true, recovered = (level + 0.3 * random.normal(size=(2, 200, 200)) for level in (1.0, 1.1))
    assert scripts[0].relative_difference(true, recovered)[0] == pytest.approx(0.1, abs=0.02)


def test_errors_by_depth_make_up_that_of_the_cloud(scripts, random):
    grid = Grid(shape=(9, 9, 9), spacing=(0.1, 0.1, 0.2))
    truth = np.zeros(grid.shape)
    truth[2:7, 2:7, 1:8] = random.random((5, 5, 7)) + 1
    recovered = np.where(truth > 0, truth + random.normal(size=grid.shape), 0)
    middles, errors, shares = scripts[0].error_by_depth(grid, recovered, truth)
    assert errors @ shares == pytest.approx(epsilon(recovered, truth))
    np.testing.assert_allclose(middles, [0.05, 0.15, 0.25])


def test_the_unseen_view_is_50_degrees_off_nadir_beyond_the_domain(scripts):
    _, module = scripts
    for scene in module.SCENES.values():
        view = tomllib.loads(module.unseen_view(scene, 20))["view"][0]
        line = np.subtract(view["position"], view["target"])
        assert np.degrees(np.arccos(line[2] / np.linalg.norm(line))) == pytest.approx(50.4)
        assert view["position"][2] > scene.shape[2] * module.SPACING[2]


def test_the_sources_stages_are_eight_and_six(scripts):
    _, module = scripts
    counts = {
        name: len(tomllib.loads(module.stage_settings(scene, scene.shape))["stage"])
        for name, scene in module.SCENES.items()
    }
    assert counts == {"c": 8, "f": 6}


def test_stages_are_counted_from_one_as_in_histories(scripts):
    """Two stages of one and two iterations; 10 paths each."""
    figures, _ = scripts
    view = OrthographicView(zenith=0, width=0.9, pixels=(8, 8))
    images = Measurements((view,), (np.ones((8, 8)),), (np.full((8, 8), 0.1),))
    history = {"stage": np.array([1.0, 2.0, 2.0]), "paths": np.array([10.0, 20.0, 30.0])}
    stages = tuple(figures.Stage(grid=(n, n, n)) for n in (2, 4))
    grid, full = Grid(shape=(4, 4, 4), spacing=(0.2, 0.2, 0.2)), np.ones((4, 4, 4))
    run = figures.Run(Path("."), "", 2, grid, full, full > 0, history, stages, images)
    figure = figures.new_figure(8, 6)
    figures.plot_stages(figure, run)
    voxels, paths = figure.axes[0].lines[0], figure.axes[3].lines[0]
    assert list(voxels.get_xdata()) == [1, 2] and list(voxels.get_ydata()) == [8, 64]
    assert list(paths.get_ydata()) == [10, 20]
