"""How optically deep voxels are divided."""

import numpy as np
import pytest

from cloudtomo_cl.transport.cells import Cells, most_cells

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
