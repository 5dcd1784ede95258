"""The kernels' paths against the reference's, one by one.

Both draw the same random numbers, so a path is the same one up to rounding. Rounding grows
with the length of a path (to about 1e-5 after ten scatterings in a periodic domain), and where
it flips a discrete choice (which voxel a ray through an edge meets, whether an optical depth
is reached before a face, droplet or molecule, a roulette) the two go on along different
paths. Hence 99 %, not all, and 95 % of those that gather light at all.
"""

from dataclasses import replace

import numpy as np
import pytest
from scenes import (
    ABOVE,
    CAMERA,
    ESTIMATORS,
    PERIODIC,
    RADIOMETER,
    RADIOMETER_BELOW,
    RAYS,
    SCANNER,
    SCENES,
    extinction_of,
    kernel_paths,
    radiances,
    reference_paths,
)

from cloudtomo_cl.opencl.layout import MOST_BRANCHES
from cloudtomo_cl.reference import branches
from cloudtomo_cl.scene.scene import Surface
from cloudtomo_cl.transport.radiance import RadianceOperator

SEED, ITERATION, SAMPLES = 5, 9, 10


@pytest.mark.parametrize("estimator", ESTIMATORS)
@pytest.mark.parametrize("scene", SCENES.values(), ids=SCENES)
def test_paths_have_the_radiances_of_the_reference(device, scene, estimator):
    extinction = extinction_of(scene)
    views = [ABOVE, CAMERA, RAYS, SCANNER, RADIOMETER, RADIOMETER_BELOW]
    operator = RadianceOperator(scene, views, device, estimator=estimator)
    rendering = operator.render(extinction, SAMPLES, seed=SEED, stream=ITERATION, store_paths=True)
    found = kernel_paths(rendering)
    expected = radiances(reference_paths(scene, extinction, operator, SAMPLES, SEED, ITERATION))
    lit = (found != 0) | (expected != 0)
    assert lit.sum() > 30
    agree = np.abs(found - expected) <= 1e-3 * np.abs(expected)
    assert agree.mean() >= 0.99
    assert agree[lit].mean() >= 0.95


def test_a_path_has_so_many_branches_and_no_more(device, monkeypatch):
    """In a cloud where it would have more; radiances are the reference's."""
    scene = replace(SCENES["forward peak"], boundary=PERIODIC, surface=Surface(1.0))
    extinction = 2 * extinction_of(scene)
    operator = RadianceOperator(scene, [ABOVE], device, estimator="branches")
    made = []

    class Watched(branches.Branches):
        def __init__(self, scene):
            super().__init__(scene)
            made.append(self)

    monkeypatch.setattr("cloudtomo_cl.reference.paths.Branches", Watched)
    found = kernel_paths(operator.render(extinction, 4, SEED, ITERATION, store_paths=True))
    expected = radiances(reference_paths(scene, extinction, operator, 4, SEED, ITERATION))
    # Rounding grows along paths of some hundred scatterings.
    assert np.mean(np.abs(found - expected) <= 1e-2 * np.abs(expected)) >= 0.9
    assert max(one.begun for one in made) == MOST_BRANCHES
    assert not any(one.waiting for one in made)


def test_means_are_those_of_the_paths(device):
    scene = SCENES["forward peak"]
    operator = RadianceOperator(scene, [ABOVE], device)
    rendering = operator.render(extinction_of(scene), 64, store_paths=True)
    paths = kernel_paths(rendering)
    np.testing.assert_allclose(rendering.halves[:, 0], paths[0::2].mean(axis=0), rtol=1e-6)
    np.testing.assert_allclose(rendering.halves[:, 1], paths[1::2].mean(axis=0), rtol=1e-6)
    np.testing.assert_allclose(rendering.standard_error, paths.std(axis=0, ddof=1) / 8, rtol=1e-5)


def test_paths_do_not_depend_on_how_launches_are_cut(device):
    scene = SCENES["air, ground, periodic"]
    extinction = extinction_of(scene)
    whole = RadianceOperator(scene, [ABOVE], device)
    cut = RadianceOperator(scene, [ABOVE], device)
    cut._pace.work_items = 50
    first = whole.render(extinction, 40, store_paths=True)
    second = cut.render(extinction, 40, store_paths=True)
    assert len(second._launches) > len(first._launches)
    np.testing.assert_array_equal(kernel_paths(first), kernel_paths(second))
    np.testing.assert_array_equal(first.halves, second.halves)


def test_sums_do_not_depend_on_how_they_are_cut(device, monkeypatch):
    operator = RadianceOperator(SCENES["forward peak"], [ABOVE], device)
    first = operator.render(extinction_of(operator.scene), 40)
    monkeypatch.setattr("cloudtomo_cl.transport.path_sums._LONGEST_SUM", 7)
    second = operator.render(extinction_of(operator.scene), 40)
    np.testing.assert_array_equal(first.halves, second.halves)
    np.testing.assert_array_equal(first.standard_error, second.standard_error)


def test_all_paths_of_a_pixel_count_however_many_there_are(device):
    """More than the rounds after which a driver may end a loop (65,535 of Mesa's llvmpipe)."""
    operator = RadianceOperator(SCENES["forward peak"], [ABOVE], device, pixels=np.array([[0, 4]]))
    rendering = operator.render(extinction_of(operator.scene), 150_000, store_paths=True)
    assert rendering.mean == pytest.approx(kernel_paths(rendering).mean(dtype=float), rel=1e-6)


def test_a_pixel_has_the_same_paths_alone_and_among_others(device):
    scene = SCENES["forward peak"]
    extinction = extinction_of(scene)
    everything = RadianceOperator(scene, [ABOVE, CAMERA], device).render(extinction, 20)
    alone = RadianceOperator(scene, [ABOVE, CAMERA], device, pixels=np.array([[1, 4]])).render(extinction, 20)
    np.testing.assert_array_equal(alone.halves[0], everything.halves[9 + 4])
