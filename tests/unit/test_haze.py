"""Haze beside clouds goes; clouds stay, thin ones too."""

import numpy as np
import pytest

from cloudtomo_cl.inversion.haze import without_haze
from cloudtomo_cl.inversion.voxels import Voxels
from cloudtomo_cl.scene.grid import Grid

GRID = Grid((24, 9, 9), (0.02, 0.02, 0.04))
DENSE, THIN = 100.0, 3.0


def scene(dense=DENSE):
    """A dense cloud, clear air or haze, and a thin cloud, a grid's length apart."""
    extinction = np.zeros(GRID.shape)
    extinction[2:7, 2:7, 2:7] = dense
    extinction[17:22, 2:7, 2:7] = THIN
    return extinction


class Seen:
    """A data term by which each voxel's extinction is known to a standard deviation, km^-1, around what it is.

    A unit of 1: the term without a voxel of extinction b rises by (b / deviation)^2 / 2.
    """

    def __init__(self, extinction, deviation):
        self.extinction, self.deviation = extinction, deviation

    def gradient(self, x):
        return (x - self.extinction) / self.deviation**2


def cleared(extinction, mask=None, deviation=1e6):
    """By images that hardly see a voxel, unless said otherwise."""
    mask = np.ones(GRID.shape, bool) if mask is None else mask
    found = np.zeros(GRID.shape)
    found[mask] = without_haze(extinction[mask], Voxels(GRID, mask), Seen(extinction[mask], deviation), 1.0)
    return found


def test_haze_beside_a_dense_cloud_goes():
    hazy = scene()
    hazy[7, 2:7, 2:7] = 0.02 * DENSE
    np.testing.assert_array_equal(cleared(hazy), scene())


def test_an_edge_of_half_the_extinction_stays():
    soft = scene()
    soft[7, 2:7, 2:7] = 0.5 * DENSE
    np.testing.assert_array_equal(cleared(soft), soft)


def test_a_thin_cloud_away_from_the_dense_one_stays():
    # Of the whole scene's mean extinction it is 3 %.
    np.testing.assert_array_equal(cleared(scene())[17:], scene()[17:])


def test_what_is_haze_beside_a_dense_cloud_is_none_beside_a_thin_one():
    hazy = scene(dense=THIN)
    hazy[7, 2:7, 2:7] = 0.02 * DENSE
    np.testing.assert_array_equal(cleared(hazy), hazy)


@pytest.mark.parametrize("factor", [1e-3, 1e3])
def test_the_unit_of_extinction_does_not_matter(factor):
    hazy = scene() + 0.08 * np.random.default_rng(1).random(GRID.shape) * DENSE
    np.testing.assert_array_equal(cleared(factor * hazy) > 0, cleared(hazy) > 0)


def test_clear_sky_stays_clear():
    np.testing.assert_array_equal(cleared(np.zeros(GRID.shape)), 0)


def test_voxels_outside_of_the_mask_are_clear():
    mask = np.zeros(GRID.shape, bool)
    mask[7:9] = True
    hazy = scene()
    hazy[7, 2:7, 2:7] = 0.02 * DENSE
    # Of the dense cloud nothing is in the mask: what is left is no haze beside anything.
    np.testing.assert_array_equal(cleared(hazy, mask)[7], hazy[7])


@pytest.mark.parametrize("significance, stays", [(1.3, False), (1.5, True)])
def test_a_thin_cloud_beside_a_dense_one_stays_where_images_tell(significance, stays):
    """Voxels of b standard deviations raise the data term by b^2 / 2 each: by 0.85 and 1.13 of its unit."""
    hazy = scene()
    hazy[7, 2:7, 2:7] = 0.02 * DENSE
    found = cleared(hazy, deviation=0.02 * DENSE / significance)
    np.testing.assert_array_equal(found, hazy if stays else scene())
