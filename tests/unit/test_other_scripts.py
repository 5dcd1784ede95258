"""What scripts/others_images.py, wrong_optics.py and paper_method.py compute, without a recovery."""

import re
import sys
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest

import cloudtomo_cl as ct
from cloudtomo_cl.settings.tables import read_reconstruct_settings

SCRIPTS = Path(__file__).parents[2] / "scripts"
VIEW = ct.OrthographicView(zenith=0, width=1.0, pixels=(60, 60))


@pytest.fixture(scope="module")
def scripts():
    sys.path.insert(0, str(SCRIPTS))
    import others_images
    import paper_method
    import source_scenes
    import wrong_optics

    sys.path.remove(str(SCRIPTS))
    return {module.__name__: module for module in (others_images, paper_method, source_scenes, wrong_optics)}


def test_renders_with_other_random_numbers_tell_the_standard_error_of_their_mean(scripts, random):
    """3600 pixels of 8 renders of noise 0.4: the root mean square of the errors has a standard error of 0.4 %."""
    renders = 1 + 0.4 * random.normal(size=(8, 60, 60))
    image, error = scripts["others_images"].image_of_renders(renders, 1024)
    assert np.sqrt(np.mean(error**2)) == pytest.approx(0.4 / np.sqrt(8), rel=0.03)
    assert image.mean() == pytest.approx(1, abs=0.02)


def measured(images, error):
    return ct.Measurements((VIEW,), (images,), (np.full(images.shape, error),))


def test_images_that_differ_by_noise_alone_agree(scripts, random):
    """Seven standard errors each."""
    first, second = (measured(1 + 0.1 * random.normal(size=(60, 60)), 0.1) for _ in range(2))
    told = scripts["others_images"].agreement(first, second)
    assert told["mean z"] == pytest.approx(0, abs=7 * told["its error"])
    assert told["mean z^2"] == pytest.approx(1, abs=7 * np.sqrt(2 / 3600))
    assert told["mean radiance / ours - 1"] == pytest.approx(0, abs=7 * told["error of that"])


def test_images_that_are_three_percent_brighter_do_not_agree(scripts, random):
    first, second = (measured(level + 0.1 * random.normal(size=(60, 60)), 0.1) for level in (1.03, 1.0))
    told = scripts["others_images"].agreement(first, second)
    assert told["mean radiance / ours - 1"] > 7 * told["error of that"]
    assert told["mean z"] > 7 * told["its error"]


def test_the_box_of_the_cloud_has_the_same_voxels_at_the_same_places(scripts, random):
    grid = ct.Grid(shape=(6, 7, 8), spacing=(0.1, 0.2, 0.3), origin=(1.0, 2.0, 0.5))
    extinction = np.zeros(grid.shape)
    extinction[2:5, 1:4, 3:8] = random.random((3, 3, 5)) + 1
    box, inside = scripts["others_images"].cropped(grid, extinction)
    for axis in range(3):
        places = np.flatnonzero(np.any(extinction > 0, axis=tuple({0, 1, 2} - {axis})))
        np.testing.assert_allclose(box.centres(axis), grid.centres(axis)[places])
    np.testing.assert_array_equal(inside, extinction[2:5, 1:4, 3:8])


def test_wrong_optics_differ_from_the_truth_in_one_thing(scripts):
    module = scripts["wrong_optics"]
    truth = module.true_scene(8)
    for name, scene in module.told(truth).items():
        different = [one.name for one in fields(scene) if getattr(scene, one.name) != getattr(truth, one.name)]
        assert len(different) == (0 if name in (module.TRUTH, module.OTHER_NUMBERS, module.NO_AIR) else 1), name


@pytest.mark.parametrize("name", ["sun 2 degrees lower", "sun 2 degrees aside"])
def test_the_wrong_sun_stands_two_degrees_off(scripts, name):
    module = scripts["wrong_optics"]
    sun = module.told(module.true_scene(8))[name].sun
    angle = np.degrees(np.arccos(sun.direction @ module.true_scene(8).sun.direction))
    assert angle == pytest.approx(2, abs=0.02)


def paper_run(scripts, folder, name, shape, **options):
    """The run settings that the paper's method makes, as `cloudtomo reconstruct` reads them."""
    method, stages = scripts["paper_method"].METHODS[name], scripts["source_scenes"].SCENES[name].stages
    (folder / "images.nc").touch()
    head = '[measurements]\nfile = "images.nc"\n'
    (folder / "run.toml").write_text(head + scripts["paper_method"].paper_settings(method, stages, shape, **options))
    return read_reconstruct_settings(folder / "run.toml")


@pytest.mark.parametrize(
    ("name", "shape", "photons", "step"),
    [
        ("c", (38, 38, 38), [3072, 1536, 768, 384, 192, 96, 48, 1024], 1.0),
        ("f", (86, 86, 27), [2048, 1024, 512, 256, 128, 1024], 0.3),
    ],
)
def test_the_papers_method_has_its_stages_photons_and_steps(scripts, tmp_path, name, shape, photons, step):
    """As the supplement and the public code have them."""
    run = paper_run(scripts, tmp_path, name, shape)
    assert [stage.samples for stage in run.stage] == photons
    assert run.stage[-1].grid == shape
    weights = [stage.prior_weight for stage in run.stage]
    np.testing.assert_allclose(weights, 5.0 ** np.arange(1 - len(photons), 1))
    solver = run.solver
    assert (solver.type, solver.gradient, solver.parametrisation) == ("adam", "replay", "extinction")
    assert (solver.step_size, solver.start, solver.floor) == (step, 2.0, 0.01)
    assert (solver.beta1, solver.beta2) == (0.9, 0.999)
    assert solver.step_length(8000) == pytest.approx(step)
    assert (solver.iterate_average_window, solver.image_average_window) == (1, 1)


@pytest.mark.parametrize(("name", "mu"), [("c", 0.5), ("f", 1.0)])
def test_the_papers_priors_are_its_own_two(scripts, tmp_path, name, mu):
    prior = paper_run(scripts, tmp_path, name, (20, 20, 20)).prior
    assert (prior.smoothness, prior.monotonicity, prior.sparsity, prior.reference) == (mu, 0.0, 0.0, 0.0)
    assert scripts["paper_method"].METHODS[name].monotonicity == mu
    assert (prior.c1, prior.c2, prior.threshold) == (0.2, 0.05, 0.01)


def test_a_coarser_grid_leaves_out_the_finer_stages_and_keeps_the_last_photons(scripts, tmp_path):
    run = paper_run(scripts, tmp_path, "c", (19, 19, 19), photons=0.25, iterations=50)
    assert [stage.grid[0] for stage in run.stage] == [4, 6, 8, 11, 16, 19]
    assert [stage.samples for stage in run.stage] == [768, 384, 192, 96, 48, 256]
    assert [stage.prior_weight for stage in run.stage][-2:] == [0.2, 1.0]
    assert {stage.iterations for stage in run.stage} == {50}


def test_tests_that_scripts_name_are_there():
    found = [
        named for path in SCRIPTS.rglob("*.py") for named in re.findall(r"tests/\w+/\w+\.py::\w+", path.read_text())
    ]
    assert found
    for file, name in (named.split("::") for named in found):
        assert f"def {name}(" in (SCRIPTS.parent / file).read_text(), f"{file} has no {name}"
