"""The Jacobian's structure: which entries there are, and that no derivative is lost."""

from dataclasses import replace

import numpy as np
import pytest

import cloudtomo_cl as ct
from cloudtomo_cl.errors import TransportError
from cloudtomo_cl.opencl.fixed_point import overflow
from cloudtomo_cl.opencl.layout import TILE_WIDTH
from cloudtomo_cl.scene.scene import Boundary
from cloudtomo_cl.transport.blocks import pixel_blocks, voxel_blocks
from cloudtomo_cl.transport.jacobian_average import JacobianAverage
from cloudtomo_cl.transport.table_gradient import TableGradient
from cloudtomo_cl.transport.tiles import about_how_many_entries, lines_of_sight, tiles_of

GRID = ct.Grid(shape=(11, 9, 10), spacing=(0.04, 0.05, 0.03), origin=(0.2, -0.1, 0.3))
SCENE = ct.Scene(grid=GRID, sun=ct.Sun(zenith=40.0, azimuth=30.0), surface=ct.Surface(albedo=0.2))
CAMERA = ct.PerspectiveView(position=(0.9, 0.4, 1.1), target=(0.4, 0.1, 0.4), field_of_view=30.0, pixels=(13, 11))
ABOVE = ct.OrthographicView(zenith=0.0, width=0.57, pixels=(12, 12))
OBLIQUE = ct.OrthographicView(zenith=60.0, azimuth=200.0, width=0.6, pixels=(9, 9))
RAYS = ct.RayView([(0.3, 0.1, 1.0), (0.5, 0.2, 1.0)], [(0.1, 0.0, -1.0), (-0.8, 0.1, -0.4)], (2, 1))
VIEWS = (CAMERA, ABOVE, OBLIQUE, RAYS)


@pytest.fixture(scope="module")
def extinction():
    return ct.cumulus(GRID, seed=4, peak=40.0)


def prepared(scene, extinction, device, samples=8):
    mask = extinction > 0
    operator = ct.RadianceOperator(scene, VIEWS, device, mask=mask)
    rendering = operator.render(extinction, samples, seed=3, stream=1, store_paths=True)
    sums = JacobianAverage(operator)
    sums.add(rendering, 1.0)
    return operator, rendering, sums


def pattern(structure):
    """Which entries the near field has: bool, shape (pixels, voxels)."""
    import pyopencl as cl

    start = np.empty(structure.pixels + 1, np.uint32)
    cl.enqueue_copy(structure.device.queue, start, structure.near.start)
    found = np.zeros((structure.pixels, structure.voxels), bool)
    columns = structure.near.columns.get()
    for row in range(structure.pixels):
        found[row, columns[start[row] : start[row + 1]]] = True
    return found


@pytest.mark.parametrize("horizontal", ["open", "periodic"])
def test_a_tile_is_around_the_line_of_sight(extinction, device, horizontal):
    """In every slab the voxel that the line goes through in its middle, and two on each side of it."""
    scene = replace(SCENE, boundary=Boundary(horizontal=horizontal))
    operator, _, sums = prepared(scene, extinction, device, samples=2)
    tiles = tiles_of(VIEWS, operator.pixels, scene, operator.mask)
    origins, directions = lines_of_sight(VIEWS, operator.pixels, scene)
    expected = np.zeros((len(origins), *GRID.shape), bool)
    reach, wraps = TILE_WIDTH // 2, horizontal == "periodic"
    for row, (tile, origin, direction) in enumerate(zip(tiles, origins, directions)):
        axis = tile["axis"]
        for slab in range(GRID.shape[axis]):
            middle = np.floor(origin + (slab + 0.5 - origin[axis]) / direction[axis] * direction).astype(int)
            middle[axis] = slab
            ranges = [np.arange(middle[n] - reach, middle[n] + reach + 1) if n != axis else [slab] for n in range(3)]
            for n in range(2):
                ranges[n] = np.mod(ranges[n], GRID.shape[n]) if wraps else ranges[n]
            ranges = [[i for i in some if 0 <= i < count] for some, count in zip(ranges, GRID.shape)]
            expected[row][np.ix_(*ranges)] = True
    found = pattern(sums.structure)
    # Single precision may round the line to the other side of a face.
    assert (found != expected[:, operator.mask]).mean() < 1e-3 and 0.05 < found.mean() < 0.9


@pytest.mark.parametrize("horizontal", ["open", "periodic"])
@pytest.mark.parametrize(("counted", "error"), [(1000, 0.0), (60, 0.3)])
def test_entries_are_counted_before_there_are_any(extinction, device, monkeypatch, horizontal, counted, error):
    """To know how much memory they take: all of these few pixels, or 60 of them (four standard errors)."""
    monkeypatch.setattr("cloudtomo_cl.transport.tiles._COUNTED", counted)
    scene = replace(SCENE, boundary=Boundary(horizontal=horizontal))
    operator, _, sums = prepared(scene, extinction, device, samples=2)
    found = about_how_many_entries(VIEWS, operator.pixels, scene, operator.mask)
    assert found == pytest.approx(sums.structure.near.count, rel=error)


@pytest.mark.parametrize("horizontal", ["open", "periodic"])
def test_no_derivative_is_lost(extinction, device, horizontal):
    """Sums over all pixels, and over the voxels of each block, are those of the gradient of equal adjoints."""
    scene = replace(SCENE, boundary=Boundary(horizontal=horizontal))
    operator, rendering, sums = prepared(scene, extinction, device)
    table, pixels = TableGradient(operator), len(operator.pixels)
    gradient, _ = table.gradient(rendering, np.full((pixels, 2), 0.5))
    blocks = sums.structure.far.voxel_blocks
    expected = np.bincount(blocks.of, gradient.get()[operator.mask])
    found = np.bincount(blocks.of, sums.jacobian.T @ np.ones(pixels))
    np.testing.assert_allclose(found, expected, rtol=1e-3, atol=1e-4 * np.abs(expected).max())


def test_each_pixels_near_field_is_its_own(extinction, device):
    """What gradients of single pixels have in their tiles, but for the far field's share."""
    operator, rendering, sums = prepared(SCENE, extinction, device)
    near = pattern(sums.structure)
    jacobian = sums.jacobian.T @ np.eye(len(operator.pixels), dtype=np.float32)[:, ::40]
    far = np.abs(sums._far.get()).max()
    for column, row in enumerate(range(0, len(operator.pixels), 40)):
        adjoint = np.zeros((len(operator.pixels), 2))
        adjoint[row] = 0.5
        table = TableGradient(operator)
        gradient, _ = table.gradient(rendering, adjoint)
        own = gradient.get()[operator.mask]
        largest = np.abs(own).max()
        np.testing.assert_allclose(jacobian[near[row], column], own[near[row]], atol=1.01 * far + 1e-5 * largest)


def test_averages_weigh_renderings_by_their_rate(extinction, device, random):
    operator, first, sums = prepared(SCENE, extinction, device)
    x = random.normal(size=sums.structure.voxels)
    alone = sums.jacobian @ x
    second = operator.render(0.5 * extinction, 8, seed=3, stream=2, store_paths=True)
    sums.add(second, 0.25)
    other = JacobianAverage(operator)
    other.add(first, 1.0)
    other.add(second, 1.0)
    np.testing.assert_allclose(sums.jacobian @ x, 0.75 * alone + 0.25 * (other.jacobian @ x), rtol=1e-3, atol=1e-7)


def test_launches_and_blocks_of_rows_change_no_bit(extinction, device, monkeypatch, random):
    x = random.normal(size=int((extinction > 0).sum()))
    found = []
    for slots, launch in ((1 << 24, 1 << 18), (1000, 1 << 10)):
        monkeypatch.setattr("cloudtomo_cl.transport.jacobian_average.SLOTS_AT_ONCE", slots)
        monkeypatch.setattr("cloudtomo_cl.opencl.device._FIRST_LAUNCH", launch)
        found.append(prepared(SCENE, extinction, device)[2].jacobian @ x)
    np.testing.assert_array_equal(*found)


def test_blocks_have_each_member_once():
    mask = np.ones((5, 6, 7), bool)
    mask[0] = False
    pixels = np.concatenate([[(view, n) for n in range(30)] for view in (0, 1)]).astype(np.uint32)
    views = [ct.OrthographicView(zenith=0.0, width=1.0, pixels=(6, 5))] * 2
    for blocks, count in ((pixel_blocks(views, pixels), 60), (voxel_blocks(mask, 10), mask.sum())):
        assert sorted(blocks.members) == list(range(count)) and blocks.sizes.sum() == count
        for n in range(len(blocks)):
            assert (blocks.of[blocks.members[blocks.start[n] : blocks.start[n + 1]]] == n).all()


def test_blocks_of_voxels_grow_with_the_number_of_pixels(monkeypatch):
    mask = np.ones((16, 16, 16), bool)
    monkeypatch.setattr("cloudtomo_cl.transport.blocks.MOST_PAIRS", 64 * 100)
    assert len(voxel_blocks(mask, 10)) == 512 and len(voxel_blocks(mask, 100)) == 64


def test_a_single_voxel_is_a_block():
    assert len(voxel_blocks(np.ones((1, 1, 1), bool), 96)) == 1


@pytest.mark.parametrize(("place", "what"), [(0, "the radiance table"), (1, "the Jacobian")])
def test_sums_that_overflow_are_told_in_the_same_words(extinction, device, monkeypatch, place, what):
    """As if the kernels had found one: their flags are the arrays of one number; the table's comes first."""
    zeros, flags = type(device).zeros, []

    def one_raised(own, shape, kind):
        made = zeros(own, shape, kind)
        if shape == 1 and kind == np.uint32:
            flags.append(made)
            made.fill(len(flags) == place + 1)
        return made

    monkeypatch.setattr(type(device), "zeros", one_raised)
    with pytest.raises(TransportError) as caught:
        prepared(SCENE, extinction, device, samples=2)
    assert str(caught.value) == str(overflow(what)) and what in str(overflow(what))
