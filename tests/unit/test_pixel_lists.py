"""Lists of pixels that people give."""

import numpy as np
import pytest

import cloudtomo_cl as ct

GRID = ct.Grid((3, 4, 5), (0.1, 0.1, 0.1))
SCENE = ct.Scene(GRID, ct.Sun(30.0))
VIEWS = [
    ct.OrthographicView(width=0.6, zenith=0.0, pixels=(8, 8)),
    ct.OrthographicView(width=0.6, zenith=20.0, pixels=(3, 2)),
]
WRONG = pytest.mark.parametrize(
    "pixels, message",
    [
        ([[0, 1], [1_000_000, 0]], r"pixels\[1\] is of view 1000000: there are views 0 to 1"),
        ([[2, 0]], r"pixels\[0\] is of view 2: there are views 0 to 1"),
        ([[-1, 0]], r"pixels\[0\] is of view -1"),
        ([[0, 63], [1, 6]], r"pixels\[1\] is pixel 6 of view 1, which has pixels 0 to 5"),
        ([[0, -1]], r"pixels\[0\] is pixel -1 of view 0, which has pixels 0 to 63"),
        ([[0, 2**32]], r"pixels\[0\] is pixel 4294967296 of view 0"),
        (np.arange(6), r"pixels has shape \(6,\): it must be \(pixels, 2\)"),
        ([[0, 1, 2]], r"pixels has shape \(1, 3\)"),
        ([[0.0, 1.0]], "pixels is of type float64: it must be integers"),
        ([[False, True]], "pixels is of type bool"),
        ([], "the list of pixels is empty"),
        (np.zeros((0, 2), int), "the list of pixels is empty"),
    ],
)


@pytest.fixture(scope="module")
def operator(device):
    return ct.RadianceOperator(SCENE, VIEWS, device)


@WRONG
def test_wrong_ones_are_refused_by_an_operator(device, pixels, message):
    with pytest.raises(ct.DataError, match=message):
        ct.RadianceOperator(SCENE, VIEWS, device, pixels)


@WRONG
def test_wrong_ones_are_refused_by_an_operator_of_other_pixels(operator, pixels, message):
    with pytest.raises(ct.DataError, match=message):
        operator.of_pixels(pixels)


@pytest.mark.parametrize("kind", [np.int8, np.uint32, np.int64, np.uint64, list])
def test_the_last_pixel_of_each_view_may_be_listed(operator, kind):
    pixels = [[0, 63], [1, 5]]
    given = pixels if kind is list else np.array(pixels, kind)
    np.testing.assert_array_equal(operator.of_pixels(given).pixels, pixels)
