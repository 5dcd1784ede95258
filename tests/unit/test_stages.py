"""Schedules, and when a stage ends."""

import numpy as np
import pytest

from cloudtomo_cl.inversion.solvers.descent import Adam
from cloudtomo_cl.inversion.solvers.gauss_newton import GaussNewton
from cloudtomo_cl.inversion.stages import automatic_stages, has_settled
from cloudtomo_cl.scene.grid import Grid


@pytest.mark.parametrize("shape", [(38, 38, 38), (86, 86, 27), (6, 6, 6), (3, 2, 1), (300, 2, 50)])
def test_the_last_stage_has_the_full_grid_and_images(shape):
    last = automatic_stages(Grid(shape=shape, spacing=(1, 1, 1)))[-1]
    assert last.grid == shape and last.pixels == 1


def test_stages_grow():
    grids = [stage.grid for stage in automatic_stages(Grid(shape=(86, 86, 27), spacing=(1, 1, 1)))]
    assert len(grids) > 3 and all(a < b and c <= d for (a, _, c), (b, _, d) in zip(grids, grids[1:]))


@pytest.mark.parametrize("spacing", [(1, 1, 2), (1, 1, 0.4), (3, 1, 1)])
def test_coarse_voxels_are_cubes(spacing):
    grid = Grid(shape=(60, 60, 60), spacing=spacing)
    for stage in automatic_stages(grid)[:-1]:
        sides = np.divide(grid.extent, stage.grid)
        free = [4 < voxels < 60 for voxels in stage.grid]  # else as cubic as the grid allows
        assert sides[free].max() < 1.15 * sides[free].min(), stage.grid


@pytest.mark.parametrize("shape", [(60, 60, 60), (86, 86, 27), (8, 8, 200), (300, 2, 50)])
@pytest.mark.parametrize("spacing", [(1, 1, 1), (1, 1, 2), (1, 1, 0.1), (0.02, 0.04, 0.02)])
def test_the_first_stage_is_coarse_whatever_the_shape_of_voxels(shape, spacing):
    first = automatic_stages(Grid(shape=shape, spacing=spacing))[0]
    assert 5 <= max(first.grid) <= 12


def test_a_grid_of_cubes_stays_in_proportion():
    grids = [stage.grid for stage in automatic_stages(Grid(shape=(38, 38, 38), spacing=(0.02, 0.02, 0.02)))]
    assert grids == [(6, 6, 6), (11, 11, 11), (21, 21, 21), (38, 38, 38)]


def test_descents_have_more_iterations_than_gauss_newton():
    grid = Grid(shape=(38, 38, 38), spacing=(1, 1, 1))
    newton, adam = automatic_stages(grid), automatic_stages(grid, Adam())
    assert all(10 * few.iterations < many.iterations for few, many in zip(newton, adam))


def test_iterations_are_those_of_the_last_stage():
    grid = Grid(shape=(38, 38, 38), spacing=(1, 1, 1))
    *before, last = automatic_stages(grid, GaussNewton(iterations=77))
    assert last.iterations == 77 and tuple(before) == automatic_stages(grid)[:-1]


def test_a_falling_cost_has_not_settled():
    assert not has_settled(np.linspace(10, 5, 40), np.full(40, 0.1), window=20)


def test_a_constant_cost_has_settled(random):
    assert has_settled(5 + 0.1 * random.normal(size=40), np.full(40, 0.1), window=20)


def test_a_fall_within_the_noise_has_settled():
    assert has_settled(np.linspace(10, 9.9, 40), np.full(40, 5.0), window=20)


def test_slow_progress_shows_over_longer_windows():
    # Over 20 iterations the fall is within the noise, over 100 it is not.
    costs = np.linspace(10, 7, 300)
    assert has_settled(costs[-40:], np.full(40, 1.0), window=20)
    assert not has_settled(costs, np.full(300, 1.0), window=20)


def test_two_windows_are_needed():
    assert not has_settled(np.full(39, 5.0), np.full(39, 0.1), window=20)
