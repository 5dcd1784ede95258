"""The gradient's virtual collisions: path by path against the reference's."""

import numpy as np
import pytest
from scenes import ABOVE, ESTIMATORS, SCENES, extinction_of

from cloudtomo_cl.errors import DataError
from cloudtomo_cl.reference.gradient import path_deposits
from cloudtomo_cl.transport.radiance import RadianceOperator
from cloudtomo_cl.transport.virtual_collisions import virtual_limit

SEED, STREAM, SAMPLES = 8, 2, 4
LIMIT = 9.0  # km^-1: paths meet one to three virtual droplets


def deposits_of_the_kernels(operator, extinction, pixel, sample, limit):
    """Of one path: only its half counts, and that half has no other."""
    alone = operator.of_pixels(operator.pixels[[pixel]])
    rendering = alone.render(extinction, 2, SEED, STREAM, store_paths=True, first_sample=sample - sample % 2)
    return alone.gradient(rendering, np.eye(2)[[sample % 2]], limit).get()


def deposits_of_the_reference(operator, extinction, virtual, pixel, sample, **options):
    view, index = (int(number) for number in operator.pixels[pixel])
    sides, branches = operator.estimator != "plain", operator.estimator == "branches"
    given = (operator.views[view], SEED, STREAM, view, index, sample, sides)
    return path_deposits(operator.scene, extinction, virtual, *given, with_branches=branches, **options)


def compare(operator, extinction, mask, limit=LIMIT, **options):
    """Every deposit of a path within 1e-3 of its largest. Rounding turns a path in a hundred aside (test_paths.py), and
    more of those that have a second one: 95 %, not all."""
    virtual = np.where(mask, np.maximum(limit - extinction, 0), -1)
    same, collisions = [], 0
    for pixel in range(len(operator.pixels)):
        for sample in range(SAMPLES):
            found = deposits_of_the_kernels(operator, extinction, pixel, sample, limit)
            path = deposits_of_the_reference(operator, extinction, virtual, pixel, sample, **options)
            expected = path.real + path.virtual
            same.append(np.abs(found - expected).max() <= 1e-3 * np.abs(expected).max() + 1e-9)
            collisions += path.collisions
            assert (found[~mask] == 0).all()
    assert collisions > len(same) / 4
    assert np.mean(same) >= 0.95, same


@pytest.mark.parametrize("estimator", ESTIMATORS)
@pytest.mark.parametrize("scene", SCENES.values(), ids=SCENES)
def test_deposits_are_those_of_the_reference(device, scene, estimator):
    operator = RadianceOperator(scene, [ABOVE], device, estimator=estimator)
    compare(operator, extinction_of(scene), np.ones(scene.grid.shape, bool))


def test_deposits_with_a_mask_are_those_of_the_reference(device):
    """Of which some voxels hold nothing: they are not skipped."""
    scene = SCENES["ground"]
    extinction = extinction_of(scene)
    mask = (extinction > 0) | (np.indices(extinction.shape).sum(axis=0) % 2 == 0)
    assert (extinction[mask] == 0).any() and not mask.all()
    compare(RadianceOperator(scene, [ABOVE], device, mask=mask), extinction, mask)


def test_truncated_deposits_are_those_of_the_reference(device):
    scene = SCENES["forward peak"]
    operator = RadianceOperator(scene, [ABOVE], device, truncation=0.02)
    compare(operator, extinction_of(scene), np.ones(scene.grid.shape, bool), truncation=0.02)


def test_deposits_with_a_radius_in_every_voxel_are_those_of_the_reference(device, random):
    scene = SCENES["phase table"]
    radius = random.uniform(5.0, 20.0, scene.grid.shape).astype(np.float32).astype(float)
    operator = RadianceOperator(scene, [ABOVE], device, effective_radius=radius)
    compare(operator, extinction_of(scene), np.ones(scene.grid.shape, bool), effective_radius=radius)


def test_the_gradient_does_not_depend_on_how_launches_are_cut(device, monkeypatch):
    scene = SCENES["air, ground, periodic"]
    gradients = []
    for items, part in ((1 << 18, 1 << 20), (400, 128)):
        monkeypatch.setattr("cloudtomo_cl.transport.virtual_collisions._PART", part)
        operator = RadianceOperator(scene, [ABOVE], device)
        operator._pace.work_items = items
        rendering = operator.render(extinction_of(scene), 100, SEED, STREAM, store_paths=True)
        gradients.append(operator.gradient(rendering, np.ones((9, 2))).get())
    assert len(rendering._launches) > 1
    np.testing.assert_array_equal(*gradients)


@pytest.mark.parametrize("limit", [-1.0, np.nan, np.inf])
def test_a_limit_that_is_none_is_refused(device, limit):
    operator = RadianceOperator(SCENES["ground"], [ABOVE], device)
    rendering = operator.render(extinction_of(operator.scene), 2, store_paths=True)
    with pytest.raises(DataError, match="virtual_limit"):
        operator.gradient(rendering, np.ones((9, 2)), limit)


@pytest.mark.parametrize("collisions", [0.01, 0.3, 5.0])
def test_voxels_brought_to_the_limit_are_met_as_often_as_wanted(random, collisions):
    extinction, lengths = random.uniform(0, 30, 50) * (random.random(50) > 0.2), random.random(50) * 0.1
    limit = virtual_limit(extinction, lengths, collisions)
    assert np.sum(np.maximum(limit - extinction, 0) * lengths) == pytest.approx(collisions)


def test_what_no_path_crosses_has_no_limit():
    assert virtual_limit(np.ones(3), np.zeros(3), 0.1) == 0.0
