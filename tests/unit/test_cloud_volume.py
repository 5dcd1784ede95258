"""Crop, pad, rotate, coarsen and tile keep what they must."""

import numpy as np
import pytest

from cloudtomo_cl.clouds.volume import CloudVolume, uniform_layers
from cloudtomo_cl.errors import DataError
from cloudtomo_cl.scene.droplets import extinction_from_water
from cloudtomo_cl.scene.grid import Grid

OPEN = (None, None)


@pytest.fixture
def cloud():
    """4 x 6 x 8 voxels of random extinction; a third of them clear."""
    generator = np.random.default_rng(5)
    extinction = generator.uniform(-5, 10, (4, 6, 8)).clip(0).astype(np.float32)
    radius = np.where(extinction > 0, generator.uniform(5, 20, extinction.shape), np.nan).astype(np.float32)
    return CloudVolume(Grid((4, 6, 8), (0.02, 0.03, 0.04), (0.1, 0.2, 0.4)), extinction, radius)


def test_what_was_padded_is_cropped_again(cloud):
    padded = cloud.padded([(1, 2), (3, 0), (2, 1)])
    assert padded.grid.shape == (7, 9, 11) and padded.grid.origin == (0.08, 0.11, 0.32)
    lower, extent = cloud.grid.origin, cloud.grid.extent
    again = padded.cropped([(start, start + edge) for start, edge in zip(lower, extent)])
    assert again.grid == cloud.grid and np.array_equal(again.extinction, cloud.extinction)
    assert np.array_equal(again.effective_radius, cloud.effective_radius, equal_nan=True)


def test_a_voxel_stays_at_its_place_in_a_crop(cloud):
    crop = cloud.cropped([(0.12, 0.16), OPEN, (None, 0.6)])
    assert np.allclose(crop.grid.centres(0), [0.13, 0.15]) and crop.grid.shape == (2, 6, 5)
    assert np.array_equal(crop.extinction, cloud.extinction[1:3, :, :5])


def test_rotation_turns_x_towards_y(cloud):
    turned = cloud.rotated(90)
    assert turned.grid.shape == (6, 4, 8) and turned.grid.spacing == (0.03, 0.02, 0.04)
    # What lies farthest east at the southern edge comes to lie farthest north at the eastern edge.
    assert np.array_equal(turned.extinction[-1, -1], cloud.extinction[-1, 0])
    assert np.array_equal(turned.rotated(270).extinction, cloud.extinction)


def test_coarsening_keeps_optical_depth_and_water(cloud):
    coarse = cloud.coarsened((2, 3, 4))
    assert coarse.grid.shape == (2, 2, 2) and coarse.grid.extent == pytest.approx(cloud.grid.extent)
    blocks = cloud.optical_depth.reshape(2, 2, 2, 3).mean(axis=(1, 3))
    assert np.allclose(coarse.optical_depth, blocks)
    water = (cloud.extinction * np.nan_to_num(cloud.effective_radius)).sum() / 24
    assert (coarse.extinction * coarse.effective_radius).sum() == pytest.approx(water, rel=1e-5)


def test_tiles_repeat(cloud):
    tiled = cloud.tiled(3, 2)
    assert tiled.grid.shape == (12, 12, 8) and np.array_equal(tiled.extinction[4:8, 6:], cloud.extinction)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda cloud: cloud.cropped([(5.0, 6.0), OPEN, OPEN]), "no voxel has its centre between x = 5.0 and 6.0"),
        (lambda cloud: cloud.padded([(0, 0), (0, 0), (11, 0)]), "room for 10"),
        (lambda cloud: cloud.rotated(45), "no multiple of 90"),
        (lambda cloud: cloud.coarsened((3, 1, 1)), "do not divide by 3; pad x=0:2"),
        (lambda cloud: cloud.tiled(0, 1), "at least 1"),
    ],
)
def test_what_cannot_be_done_is_said(cloud, change, message):
    with pytest.raises(DataError, match=message):
        change(cloud)


def test_uniform_layers_keep_integrals():
    generator = np.random.default_rng(2)
    edges = np.cumsum(np.concatenate([[0.3], generator.uniform(0.01, 0.2, 12)]))
    density = generator.uniform(size=(3, 12))
    new, (resampled,) = uniform_layers(edges, [density])
    assert np.ptp(np.diff(new)) < 1e-12 and np.diff(new)[0] <= np.diff(edges).min() + 1e-12
    assert np.allclose(resampled @ np.diff(new), density @ np.diff(edges))


def test_extinction_of_a_known_cloud():
    # Liquid water path 100 g m^-2 of 10 um droplets has optical depth 15 (for instance Stephens 1978).
    assert extinction_from_water(np.array(0.1), np.array(10.0)) == pytest.approx(15.0)


def test_the_summary_tells_cover_and_depth(cloud):
    clear = CloudVolume(cloud.grid, np.zeros(cloud.grid.shape, np.float32))
    clear.extinction[0, 0, 2] = 10.0
    summary = clear.summary()
    assert summary["cover"].startswith("4.2%") and "largest 0.4" in summary["vertical optical depth"]
    assert summary["cloud base and top"] == "0.48 and 0.52 km"
