"""Masks: bool, or the 0 and 1 of files; anything else is refused."""

import numpy as np
import pytest
import xarray as xr

import cloudtomo_cl as ct
from cloudtomo_cl.scene.masks import checked_mask
from cloudtomo_cl.transport.jacobian_average import JacobianAverage

GRID = ct.Grid((3, 4, 5), (0.1, 0.1, 0.1))
SCENE = ct.Scene(GRID, ct.Sun(30.0))
VIEW = ct.OrthographicView(width=0.6, zenith=0.0, pixels=(4, 4))
MASK = np.arange(60).reshape(GRID.shape) % 4 == 0
OF_NUMBERS = pytest.mark.parametrize("kind", [np.int8, np.uint8, np.int64, np.float32])


@OF_NUMBERS
def test_numbers_become_bool(kind):
    found = checked_mask(MASK.astype(kind), GRID)
    assert found.dtype == bool
    np.testing.assert_array_equal(found, MASK)


@OF_NUMBERS
def test_cloud_outside_of_a_mask_of_numbers_is_refused_by_a_rendering(device, kind):
    operator = ct.RadianceOperator(SCENE, [VIEW], device, mask=MASK.astype(kind))
    with pytest.raises(ct.DataError, match="outside of the mask"):
        operator.render(np.full(GRID.shape, 5.0), 2)


def test_a_mask_of_numbers_gives_the_same_image_and_derivatives(device):
    found = []
    for mask in (MASK, MASK.astype(np.int8)):
        operator = ct.RadianceOperator(SCENE, [VIEW], device, mask=mask)
        rendering = operator.render(5.0 * MASK, 8, store_paths=True)
        sums = JacobianAverage(operator)
        sums.add(rendering, 1.0)
        found.append(
            (rendering.mean, operator.gradient(rendering, np.ones((16, 2))).get(), sums.jacobian @ np.ones(15))
        )
    for one, other in zip(*found):
        np.testing.assert_array_equal(one, other)


def test_the_mask_of_a_file_comes_in_our_order():
    written = xr.DataArray(MASK.T.astype(np.int8), dims=("z", "y", "x"))
    np.testing.assert_array_equal(checked_mask(written, GRID), MASK)


def test_voxels_of_a_mask_of_numbers_lie_where_they_should():
    voxels = ct.Voxels(GRID, MASK.astype(int))
    np.testing.assert_array_equal(voxels.on_grid(np.ones(len(voxels))), MASK)


@pytest.mark.parametrize(
    "mask, message",
    [
        (np.zeros(GRID.shape, bool), "the mask is empty"),
        (np.ones((4, 4, 5), bool), r"mask has shape \(4, 4, 5\), the grid \(3, 4, 5\)"),
        (np.where(MASK, 5.0, 0.0), r"mask at voxel \(0, 0, 0\) is 5.0: .* give mask=extinction > 0"),
        (MASK.astype(str), "mask is of type <U5: it must be bool, or numbers 0 and 1"),
    ],
    ids=["empty", "shape", "values", "type"],
)
def test_others_are_refused_where_they_are_given(device, mask, message):
    with pytest.raises(ct.DataError, match=message):
        ct.RadianceOperator(SCENE, [VIEW], device, mask=mask)
