"""How optically deep voxels are divided."""

import numpy as np
import pytest

from cloudtomo_cl.transport.cells import Cells, depth_within, largest_beside, most_cells

SPACING = (0.02, 0.02, 0.04)
EXTINCTION = np.array([0.0, 3.0, 60.0, 150.0, 400.0])


@pytest.fixture
def cells():
    return Cells.of(EXTINCTION, SPACING, asymmetry=0.85)


def test_thin_voxels_are_whole_and_deep_ones_divided_more_along_longer_edges(cells):
    assert (cells.parts[:2] == 1).all()
    assert (np.diff(cells.parts, axis=0) >= 0).all() and (cells.parts[2:, 2] > cells.parts[2:, 0]).all()


def test_cells_follow_from_optical_depths_alone():
    other = Cells.of(EXTINCTION / 10, tuple(10 * edge for edge in SPACING), asymmetry=0.85)
    np.testing.assert_array_equal(other.parts, Cells.of(EXTINCTION, SPACING, asymmetry=0.85).parts)


def test_there_are_no_more_cells_than_allowed():
    voxels = 20_000
    assert voxels < len(Cells.of(np.full(voxels, 1e4), SPACING, 0.85)) <= most_cells(voxels)


def test_cells_are_numbered_voxel_by_voxel(cells):
    assert (cells.places[:, 0] == np.flatnonzero(np.diff(cells.voxel, prepend=-1))).all()
    assert cells.counts.sum() == len(cells) == len(cells.voxel)


def test_cells_are_longer_along_the_axis_along_which_the_cloud_is_deeper():
    """A voxel at the top of a wide cloud: fine along the vertical alone."""
    within = np.array([[20.0, 20.0, 0.0]])
    extinction, spacing = np.array([300.0]), (0.02, 0.02, 0.02)
    deep, shallow = (Cells.of(extinction, spacing, 0.85, given).parts[0] for given in (within, 0 * within))
    assert deep[2] == shallow[2] and (deep[:2] < shallow[:2]).all()


def test_thin_voxels_beside_divided_ones_are_halved():
    """Not those with next to no droplets, nor beside thin ones."""
    extinction, beside = np.array([10.0, 0.01, 10.0]), np.array([400.0, 400.0, 10.0])
    parts = Cells.of(extinction, SPACING, 0.85, 0.0, beside).parts
    np.testing.assert_array_equal(parts, [[2, 2, 2], [1, 1, 1], [1, 1, 1]])


@pytest.mark.parametrize(("photons", "times"), [(1.0, 1), (100.0, 1), (200.0, 2), (400.0, 4)])
def test_more_photons_make_cells_finer_and_fewer_none_coarser(photons, times):
    """Voxels of an optical depth of 3 along x and y."""
    parts = Cells.of(np.array([60.0]), (0.05, 0.05, 0.3), 0.85, photons=photons).parts
    np.testing.assert_array_equal(parts, [[2 * times, 2 * times, 8]])


@pytest.fixture
def slab():
    """km^-1, shape (4, 5, 3): layers of 10, 20 and 30; and a column of none."""
    values = np.broadcast_to(np.array([10.0, 20.0, 30.0]), (4, 5, 3)).copy()
    values[0, 0] = 0
    return values


def test_depths_within_are_those_to_the_nearer_end_of_each_axis(slab):
    depth = depth_within(slab, (0.1, 0.2, 0.3), periodic=False)
    np.testing.assert_allclose(depth[1, 2, 1], [0.1 * 20, 0.2 * 2 * 20, 0.3 * 10])
    np.testing.assert_allclose(depth[1, 0, 2], [0.0, 0.0, 0.0])
    np.testing.assert_allclose(depth[3, 4, 1], [0.0, 0.0, 0.3 * 10])


def test_a_periodic_cloud_has_no_outside_beside(slab):
    depth = depth_within(slab, (0.1, 0.2, 0.3), periodic=True)
    np.testing.assert_allclose(depth[1, 2, 1], [0.3 * 10] * 3)


def test_the_largest_beside_is_that_of_six_neighbours(slab):
    slab[1, 2, 0] = 50
    beside = largest_beside(slab, periodic=False)
    assert beside[1, 3, 0] == beside[2, 2, 0] == beside[1, 2, 1] == 50
    assert beside[2, 3, 0] == 20 and beside[0, 0, 0] == 10
    slab[3, 1, 0] = 60
    assert largest_beside(slab, periodic=False)[0, 1, 0] == 20
    assert largest_beside(slab, periodic=True)[0, 1, 0] == 60
