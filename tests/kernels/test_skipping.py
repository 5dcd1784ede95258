"""Walks that skip what is clear."""

import numpy as np
import pytest
from scenes import ABOVE, CAMERA, PERIODIC, RAYS, kernel_paths, optics

from cloudtomo_cl.errors import DataError
from cloudtomo_cl.scene.grid import Grid
from cloudtomo_cl.scene.scene import Boundary, Scene, Sun, Surface
from cloudtomo_cl.transport import empty_blocks
from cloudtomo_cl.transport.empty_blocks import empty_distances, empty_shift, occupied_blocks
from cloudtomo_cl.transport.radiance import RadianceOperator

GRID = Grid(shape=(9, 12, 9), spacing=(0.034, 0.027, 0.04), origin=(0.5, -0.2, 0.2))


@pytest.fixture
def sparse(random):
    """km^-1; a few droplets in a clear domain."""
    extinction = np.zeros(GRID.shape, np.float32)
    extinction[3:6, 5:8, 3:6] = random.uniform(5, 40, (3, 3, 3))
    extinction[8, 0, 8] = 60
    return extinction


@pytest.mark.parametrize("periodic", [False, True], ids=["open", "periodic"])
def test_distances_are_those_to_the_nearest_occupied_voxel(random, periodic):
    occupied = random.random((7, 5, 6)) > 0.97
    found = empty_distances(occupied, periodic)
    voxels, shape = np.argwhere(occupied), np.array(occupied.shape)
    for voxel in np.ndindex(*occupied.shape):
        apart = np.abs(voxels - voxel)
        if periodic:
            apart[:, :2] = np.minimum(apart[:, :2], shape[:2] - apart[:, :2])
        assert found[voxel] == min(apart.max(axis=1).min(), 5 if periodic else 255)


def test_walks_through_a_clear_periodic_domain_wrap_once_at_most():
    assert empty_distances(np.zeros((2, 7, 40), bool), True).max() == 2
    assert empty_distances(np.zeros((40, 70, 5), bool), True).max() == 32
    assert empty_distances(np.zeros((2, 7, 40), bool), False).min() == 255


def test_a_block_is_occupied_if_any_of_its_voxels_is():
    occupied = np.zeros((5, 4, 3), bool)
    occupied[4, 1, 2] = True  # the blocks at the ends are smaller
    expected = np.zeros((3, 2, 2), bool)
    expected[2, 0, 1] = True
    np.testing.assert_array_equal(occupied_blocks(occupied, 1), expected)


@pytest.mark.parametrize(
    ("shape", "horizontal", "shift"),
    [
        ((64, 3, 64), "open", 0),
        ((3, 65, 3), "open", 1),
        ((512, 300, 7), "open", 3),
        ((512, 256, 7), "periodic", 3),
        ((512, 300, 7), "periodic", 2),
        ((512, 255, 7), "periodic", 0),
    ],
)
def test_large_grids_are_skipped_by_blocks_that_fill_a_periodic_domain(shape, horizontal, shift):
    scene = Scene(Grid(shape=shape, spacing=(0.1, 0.1, 0.1)), Sun(zenith=0), boundary=Boundary(horizontal))
    assert empty_shift(scene) == shift


@pytest.mark.parametrize("horizontal", ["open", "periodic"])
@pytest.mark.parametrize("zenith", [0, 65])
def test_paths_are_the_same_with_and_without_blocks(device, random, monkeypatch, horizontal, zenith):
    grid = Grid(shape=(24, 20, 21), spacing=(0.017, 0.02, 0.019), origin=(0.5, -0.2, 0.2))
    scene = Scene(
        grid, Sun(zenith=zenith, azimuth=70), optics(0.85), surface=Surface(0.3), boundary=Boundary(horizontal)
    )
    extinction = np.zeros(grid.shape, np.float32)
    extinction[7:13, 9:14, 6:12] = random.uniform(5, 40, (6, 5, 6))
    extinction[23, 0, 20] = 60
    views = [ABOVE, CAMERA, RAYS]
    walking = RadianceOperator(scene, views, device).render(extinction, 40, store_paths=True)
    monkeypatch.setattr(empty_blocks, "_MOST_BLOCKS", 6)
    assert empty_shift(scene) == 2
    skipping = RadianceOperator(scene, views, device, mask=extinction > 0).render(extinction, 40, store_paths=True)
    found, expected = kernel_paths(skipping), kernel_paths(walking)
    assert (expected != 0).mean() > 0.3
    assert np.mean(np.abs(found - expected) <= 1e-3 * expected) >= 0.99


@pytest.mark.parametrize("horizontal", ["open", "periodic"])
@pytest.mark.parametrize("zenith", [0, 65])
def test_paths_are_the_same_with_and_without(device, sparse, horizontal, zenith):
    # Up to rounding, which sends a path in a hundred another way (see test_paths).
    scene = Scene(
        GRID, Sun(zenith=zenith, azimuth=70), optics(0.85), surface=Surface(0.3), boundary=Boundary(horizontal)
    )
    views = [ABOVE, CAMERA, RAYS]
    walking = RadianceOperator(scene, views, device).render(sparse, 40, store_paths=True)
    skipping = RadianceOperator(scene, views, device, mask=sparse > 0).render(sparse, 40, store_paths=True)
    found, expected = kernel_paths(skipping), kernel_paths(walking)
    assert (expected != 0).mean() > 0.3
    assert np.mean(np.abs(found - expected) <= 1e-3 * expected) >= 0.99


def test_gradients_inside_a_mask_are_the_same(device, sparse):
    scene = Scene(GRID, Sun(zenith=30, azimuth=70), optics(0.85), boundary=PERIODIC)
    mask, gradients = sparse > 0, []
    for operator in (RadianceOperator(scene, [CAMERA], device), RadianceOperator(scene, [CAMERA], device, mask=mask)):
        rendering = operator.render(sparse, 200, store_paths=True)
        gradients.append(operator.gradient(rendering, np.ones((9, 2)), virtual_limit=0).get()[mask])
    np.testing.assert_allclose(gradients[0], gradients[1], atol=0.02 * np.abs(gradients[0]).max())


def test_extinction_outside_of_the_mask_is_refused(device, sparse):
    operator = RadianceOperator(Scene(GRID, Sun(zenith=0)), [ABOVE], device, mask=sparse == 0)
    with pytest.raises(DataError, match="outside of the mask"):
        operator.render(sparse, 2)


def test_an_extinction_put_on_the_device_before_gives_the_same_image(device, sparse):
    operator = RadianceOperator(Scene(grid=GRID, sun=Sun(zenith=30)), [ABOVE], device)
    expected = operator.render(sparse, 8, seed=3).mean
    np.testing.assert_array_equal(operator.render(operator.on_device(sparse), 8, seed=3).mean, expected)


def test_gradients_do_not_take_a_field_that_skips_clear_voxels(device, sparse):
    operator = RadianceOperator(Scene(grid=GRID, sun=Sun(zenith=30)), [ABOVE], device)
    with pytest.raises(DataError, match="gradient"):
        operator.render(operator.on_device(sparse), 8, store_paths=True)


def test_a_field_of_another_scene_is_refused(device, sparse):
    of_one_sun, of_another = (RadianceOperator(Scene(grid=GRID, sun=Sun(zenith=z)), [ABOVE], device) for z in (30, 40))
    with pytest.raises(DataError, match="another scene"):
        of_another.render(of_one_sun.on_device(sparse), 8)
