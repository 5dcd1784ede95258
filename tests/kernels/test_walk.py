"""The walk from voxel to voxel, flights, and transmittance, against sorted face crossings."""

import numpy as np
import pytest

from cloudtomo_cl.opencl.layout import scene_struct
from cloudtomo_cl.reference import flights as reference
from cloudtomo_cl.scene.grid import Grid
from cloudtomo_cl.scene.scene import Air, Boundary, Scene, Sun
from cloudtomo_cl.transport.device_scene import profiles

GRID = Grid(shape=(4, 3, 5), spacing=(0.1, 0.07, 0.05), origin=(1.0, -2.0, 0.3))
MOST = 256


def scene(periodic=False, air=None):
    boundary = Boundary(horizontal="periodic" if periodic else "open")
    return Scene(grid=GRID, sun=Sun(zenith=0), boundary=boundary, air=air)


def unit(vectors):
    vectors = np.atleast_2d(np.asarray(vectors, float))
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def voxel_lengths(probe, case, positions, directions):
    """km per ray and voxel, from the kernels and from the reference; shape (rays, voxels) each.

    Positions are in voxel units from the domain's corner. They and the directions are rounded
    first, so that both sides see the same rays.
    """
    positions = np.atleast_2d(np.asarray(positions)).astype(np.float32)
    directions = unit(directions).astype(np.float32)
    rays, voxels = len(positions), int(np.prod(GRID.shape))
    index, length, number = probe(
        "probe_crossings", rays, scene_struct(case), positions, directions, np.uint32(MOST),
        results=[np.zeros((rays, MOST), np.int32), np.zeros((rays, MOST), np.float32), np.zeros(rays, np.uint32)],
    )  # fmt: skip
    assert number.max() < MOST
    found, expected = np.zeros((rays, voxels)), np.zeros((rays, voxels))
    for ray in range(rays):
        np.add.at(found[ray], index[ray, : number[ray]], length[ray, : number[ray]])
        crossed, _, lengths = reference.voxel_crossings(
            GRID,
            positions[ray].astype(float) * GRID.spacing + GRID.origin,
            directions[ray].astype(float),
            case.boundary.horizontal == "periodic",
        )
        np.add.at(expected[ray], np.ravel_multi_index(crossed.T, GRID.shape), lengths)
    return found, expected


def rays(random, count, inside):
    """Random rays; from outside of the domain they are aimed at points in it."""
    targets = random.uniform(0, GRID.shape, (count, 3))
    if inside:
        return targets, unit(random.normal(size=(count, 3)))
    # From a sphere around the domain, in voxel units.
    positions = np.array(GRID.shape) / 2 + 8 * unit(random.normal(size=(count, 3)))
    return positions, unit((targets - positions) * GRID.spacing)


# Positions are held in voxel units in single precision: at 10 voxels from the corner they are
# good to 1e-6 voxels; along a slanted ray a length can be ten times worse.
TOLERANCE = 2e-6


@pytest.mark.parametrize("inside", [True, False], ids=["from inside", "from outside"])
def test_crossing_lengths_in_an_open_domain(probe, random, inside):
    positions, directions = rays(random, 300, inside)
    found, expected = voxel_lengths(probe, scene(), positions, directions)
    assert np.all(expected.sum(axis=1) > 0)
    np.testing.assert_allclose(found, expected, atol=TOLERANCE)


@pytest.mark.parametrize("inside", [True, False], ids=["from inside", "from outside"])
def test_crossing_lengths_in_a_periodic_domain(probe, random, inside):
    positions, directions = rays(random, 300, inside)
    directions = directions[np.abs(directions[:, 2]) > 0.05]
    positions = positions[: len(directions)]
    if not inside:
        positions[:, 2] = np.where(directions[:, 2] > 0, -3.0, 9.0)
    found, expected = voxel_lengths(probe, scene(periodic=True), positions, directions)
    assert np.all(expected.sum(axis=1) > 0)
    # Rays enter up to 100 voxels away from the corner.
    np.testing.assert_allclose(found, expected, atol=10 * TOLERANCE)


@pytest.mark.parametrize("periodic", [False, True], ids=["open", "periodic"])
@pytest.mark.parametrize("inside", [True, False], ids=["from inside", "from outside"])
def test_crossing_lengths_of_vertical_rays(probe, periodic, inside):
    position = [[1.3, 2.6, 2.2], [1.3, 2.6, 2.2]] if inside else [[1.3, 2.6, -1.0], [1.3, 2.6, 7.0]]
    found, expected = voxel_lengths(probe, scene(periodic), position, [[0, 0, 1], [0, 0, -1]])
    assert np.all(expected.sum(axis=1) > 0)
    np.testing.assert_allclose(found, expected, atol=TOLERANCE)


@pytest.mark.parametrize("inside", [True, False], ids=["from inside", "from outside"])
def test_crossing_lengths_of_horizontal_rays_in_an_open_domain(probe, inside):
    directions = [[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0]]
    positions = [[1.3, 1.6, 2.2]] * 4 if inside else [[-2, 1.6, 2.2], [6, 1.6, 2.2], [1.3, -1, 2.2], [1.3, 4, 2.2]]
    found, expected = voxel_lengths(probe, scene(), positions, directions)
    np.testing.assert_allclose(expected.sum(axis=1)[[0, 2]], [0.4 - 0.13 * inside, 0.21 - 0.112 * inside])
    np.testing.assert_allclose(found, expected, atol=TOLERANCE)


def total_lengths(probe, case, positions, directions):
    found, expected = voxel_lengths(probe, case, positions, directions)
    return found.sum(axis=1), expected.sum(axis=1)


@pytest.mark.parametrize("periodic", [False, True], ids=["open", "periodic"])
def test_lengths_of_rays_through_corners_and_edges_add_up(probe, periodic):
    # Through corners a rounding decides which of the neighbours is crossed over no length.
    diagonal = np.array(GRID.spacing)
    directions = [diagonal, -diagonal, diagonal * [1, -1, 1], diagonal * [0, 1, 1], diagonal * [1, 0, -1]]
    positions = [[-1, -1, -1], [5, 5, 5], [-1, 4, -1], [1.5, -1, -1], [-1, 1.5, 6]]
    found, expected = total_lengths(probe, scene(periodic), positions, directions)
    assert np.all(expected > 0.1)
    np.testing.assert_allclose(found, expected, atol=10 * TOLERANCE)


@pytest.mark.parametrize("periodic", [False, True], ids=["open", "periodic"])
@pytest.mark.parametrize("place", [[2.0, 1.5, 6.0], [2.0, 1.0, 6.0], [0.0, 1.5, 6.0], [0.0, 0.0, 6.0]])
def test_lengths_of_rays_inside_faces_add_up(probe, periodic, place):
    # Which side of the face is crossed is a matter of convention.
    found, _ = total_lengths(probe, scene(periodic), [place], [[0, 0, -1]])
    np.testing.assert_allclose(found, GRID.extent[2], atol=TOLERANCE)


MISSES = {
    "away from the domain": ([-1, 1, 2], [-1, 0, 0]),
    "up from above": ([2, 1, 7], [0, 0, 1]),
    "past a corner": ([9, 9, 9], [-1, -1, 0.5]),
    "vertical, west": ([-1, 1, 2], [0, 0, 1]),
    "vertical, east": ([4.5, 1, 2], [0, 0, 1]),
    "vertical, south": ([1, -1, 2], [0, 0, -1]),
    "vertical, north": ([1, 3.5, 2], [0, 0, -1]),
    "horizontal, below": ([-1, 1, -0.5], [1, 0, 0]),
    "horizontal, above": ([-1, 1, 5.5], [1, 0, 0]),
}


@pytest.mark.parametrize("position, direction", MISSES.values(), ids=MISSES)
def test_rays_that_miss_an_open_domain_cross_nothing(probe, position, direction):
    found, expected = total_lengths(probe, scene(), [position], [direction])
    assert found == expected == 0


def flights(probe, case, extinction, positions, directions, reach):
    """Columns: optical depth, collided, droplets, air, index, end (km from the domain's corner)."""
    count = len(positions)
    return probe(
        "probe_fly", count, scene_struct(case), np.float32(extinction), profiles(case),
        np.float32(positions), np.float32(directions), np.float32(reach), results=[np.zeros((count, 8), np.float32)],
    ).astype(float)  # fmt: skip


def random_extinction(random):
    """km^-1, a third of the voxels empty."""
    return (random.uniform(0, 30, GRID.shape) * (random.random(GRID.shape) > 0.33)).astype(np.float32).astype(float)


AIR = Air(extinction=(0.5, 0.4, 0.3, 0.2, 0.0))


@pytest.mark.parametrize("air", [None, AIR], ids=["no air", "air"])
@pytest.mark.parametrize("inside", [True, False], ids=["from inside", "from outside"])
def test_transmittance_along_a_ray(probe, random, inside, air):
    positions, directions = rays(random, 200, inside)
    extinction = random_extinction(random)
    case = scene(air=air)
    found = flights(probe, case, extinction, positions, directions, np.full(200, np.inf))
    starts = np.float32(positions).astype(float) * GRID.spacing + GRID.origin
    rounded = np.float32(directions).astype(float)
    expected = [reference.transmittance(case, extinction, start, d) for start, d in zip(starts, rounded, strict=True)]
    assert not found[:, 1].any()
    np.testing.assert_allclose(np.exp(-found[:, 0]), expected, rtol=1e-4)


@pytest.mark.parametrize("periodic", [False, True], ids=["open", "periodic"])
def test_flights_collide_where_their_optical_depth_is_reached(probe, random, periodic):
    positions, directions = rays(random, 300, True)
    positions, directions = np.float32(positions).astype(float), np.float32(directions).astype(float)
    extinction, case = random_extinction(random), scene(periodic, AIR)
    reach = np.float32(random.exponential(1.0, 300)).astype(float)
    found = flights(probe, case, extinction, positions, directions, reach)
    collisions = 0
    for row, position, direction, depth in zip(found, positions, directions, reach, strict=True):
        flight = reference.fly(case, extinction, position * GRID.spacing + GRID.origin, direction, depth)
        assert bool(row[1]) == (flight.voxel is not None)
        if flight.voxel is None:
            continue
        collisions += 1
        end = flight.position - GRID.origin
        if periodic:
            end[:2] %= GRID.extent[:2]
        np.testing.assert_allclose(row[5:], end, atol=10 * TOLERANCE)
        np.testing.assert_allclose(row[2], extinction[flight.voxel])
        np.testing.assert_allclose(row[3], case.air.profile(GRID)[flight.voxel[2]])
        assert row[4] == np.ravel_multi_index(flight.voxel, GRID.shape)
    assert collisions > 100


def test_flights_through_an_empty_domain_never_collide(probe, random):
    positions, directions = rays(random, 100, False)
    found = flights(probe, scene(), np.zeros(GRID.shape), positions, directions, np.full(100, 1e-7))
    assert not found[:, 1].any()
    assert np.all(np.isfinite(found))
