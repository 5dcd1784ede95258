"""The radiance table against rays and fluxes, and the gradient by it against the score function's and differences.

What photons bring is unbiased. The table has cells of a voxel and about 0.17 sr, so the gradient is right up to a bias:
what is tested is that it is small, and that nothing else is wrong.
"""

import weakref
from dataclasses import replace

import numpy as np
import pyopencl.array
import pytest
from scenes import TABLE
from scipy import stats

from cloudtomo_cl import memory
from cloudtomo_cl.errors import DataError
from cloudtomo_cl.scene.grid import Grid
from cloudtomo_cl.scene.phase import HenyeyGreenstein
from cloudtomo_cl.scene.pixels import neighbours
from cloudtomo_cl.scene.scene import Air, Boundary, Cloud, Scene, Sun, Surface
from cloudtomo_cl.scene.sensors import OrthographicView, RayView
from cloudtomo_cl.transport.cells import Cells
from cloudtomo_cl.transport.directions import AZIMUTHS, BINS, EDGES, scattering_matrix
from cloudtomo_cl.transport.flux import FluxOperator
from cloudtomo_cl.transport.jacobian_average import JacobianAverage
from cloudtomo_cl.transport.radiance import RadianceOperator
from cloudtomo_cl.transport.radiance_table import table_footprint
from cloudtomo_cl.transport.table_builder import RadianceTableBuilder
from cloudtomo_cl.transport.table_gradient import TableGradient

GRID = Grid(shape=(5, 5, 5), spacing=(0.05, 0.05, 0.05), origin=(0.0, 0.0, 0.1))
VIEWS = [OrthographicView(width=0.4, pixels=(6, 6), zenith=zenith, azimuth=40) for zenith in (0, 50)]
SCENES = {
    "overhead sun": Scene(GRID, Sun(zenith=0), Cloud(phase_function=HenyeyGreenstein(g=0.85))),
    "oblique, absorbing, ground": Scene(
        GRID, Sun(zenith=50, azimuth=200), Cloud(0.9, HenyeyGreenstein(g=0.7)), surface=Surface(0.3)
    ),
    "air, periodic": Scene(
        GRID, Sun(zenith=30, azimuth=10), Cloud(phase_function=HenyeyGreenstein(g=0.5)), Air(1.0),
        boundary=Boundary(horizontal="periodic"),
    ),
}  # fmt: skip


def extinction():
    """km^-1; a smooth cloud with a clear corner."""
    x, y, z = np.meshgrid(*[np.arange(5) - 2.0] * 3, indexing="ij")
    return (30 * np.exp(-(x**2 + y**2 + (z - 0.5) ** 2) / 4)).astype(np.float32) * (x + y + z < 4)


def gradients(operator, values, samples, iterations, adjoint):
    """Mean of the gradients by the radiance table."""
    table = TableGradient(operator)
    found = []
    for iteration in range(iterations):
        rendering = operator.render(values, samples, 3, iteration + 1, store_paths=True)
        found.append(table.gradient(rendering, adjoint)[0].get())
    return np.mean(found, axis=0)


@pytest.mark.parametrize("scene", SCENES.values(), ids=SCENES)
def test_gradients_are_close_to_the_score_functions(device, scene):
    """The score function's by 10^6 paths, the other's by half as many; over voxels with cloud: direction within 15
    degrees (20 over ground, where the table has more noise), length within 25 %."""
    values, mask = extinction(), np.ones(GRID.shape, bool)
    operator = RadianceOperator(scene, VIEWS, device, mask=mask)
    adjoint = np.full((72, 2), 0.5)
    expected = np.zeros(GRID.shape)
    for iteration in range(4):
        rendering = operator.render(values, 4000, 8, iteration + 1, store_paths=True)
        expected += operator.gradient(rendering, adjoint).get() / 4
    found = gradients(operator, values, 1000, 6, adjoint)
    cloud = values > 1
    a, b = found[cloud], expected[cloud]
    assert a @ b / np.sqrt((a @ a) * (b @ b)) > np.cos(np.radians(20 if scene.surface.albedo else 15))
    assert 0.75 < np.sqrt((a @ a) / (b @ b)) < 1.25


def test_clear_voxels_get_the_gradient_of_finite_differences(device):
    """Where the score function has none: within 20 %, summed over them."""
    scene, values, mask = SCENES["overhead sun"], extinction(), np.ones(GRID.shape, bool)
    operator = RadianceOperator(scene, VIEWS, device, mask=mask)
    clear = values == 0
    found = gradients(operator, values, 1000, 6, np.full((72, 2), 0.5))[clear].sum()
    step = 0.5
    more, less = (
        operator.render(v, 100_000, 5).mean.sum() for v in (np.where(clear, step, values).astype(np.float32), values)
    )
    assert 0.8 < found / ((more - less) / step) < 1.2


def test_the_tangent_is_what_images_change_by(device):
    """Along a growth of the whole cloud by 2 %, pooled over the pixels: within 15 %."""
    scene, values = SCENES["overhead sun"], extinction()
    operator = RadianceOperator(scene, VIEWS, device, mask=values > 0)
    table, change = TableGradient(operator), 0.02 * values
    on_device = pyopencl.array.to_device(device.queue, change)
    tangents = []
    for iteration in range(4):
        rendering = operator.render(values, 2000, 3, iteration + 1, store_paths=True)
        tangents.append(table.gradient(rendering, np.zeros((72, 2)), on_device)[1].sum())
    more, less = (operator.render(v, 200_000, 5).mean.sum() for v in (values + change, values - change))
    assert np.mean(tangents) == pytest.approx((more - less) / 2, rel=0.15)


def test_a_table_is_a_function_of_the_rendering(device):
    """Whatever it was made of before: nothing of it is to be stored."""
    scene, values = SCENES["overhead sun"], extinction()
    operator = RadianceOperator(scene, VIEWS, device, mask=values > 0)
    first, second = (operator.render(v, 100, 3, 1, store_paths=True) for v in (2 * values, values))
    used, fresh = TableGradient(operator), TableGradient(operator)
    used.gradient(first, np.ones((72, 2)))
    found, expected = (table.gradient(second, np.ones((72, 2)))[0].get() for table in (used, fresh))
    np.testing.assert_array_equal(found, expected)
    assert found.any()


def test_cells_of_directions_cover_the_sphere():
    ring = -np.diff(np.cos(np.radians(EDGES))) * 2 * np.pi
    assert ring.sum() == pytest.approx(4 * np.pi) and sum(AZIMUTHS) == BINS
    assert ring.max() / np.array(AZIMUTHS)[ring.argmax()] < 0.3


@pytest.mark.parametrize("phase_function", [HenyeyGreenstein(g=0.0), HenyeyGreenstein(g=0.85), TABLE])
def test_isotropic_light_scatters_into_isotropic_light(phase_function):
    np.testing.assert_allclose(scattering_matrix(phase_function).sum(axis=1), 1.0)


def test_a_field_needs_a_mask(device):
    with pytest.raises(DataError, match="mask"):
        RadianceTableBuilder(RadianceOperator(SCENES["overhead sun"], VIEWS, device))


def test_cells_without_memory_are_refused_before_they_are_made(device, monkeypatch):
    """Voxels have a cell each where the table is asked for; a deep cloud's have more."""
    operator = RadianceOperator(SCENES["overhead sun"], VIEWS, device, mask=np.ones(GRID.shape, bool))
    builder = RadianceTableBuilder(operator)
    rendering = operator.render(4 * extinction(), 2, 1, store_paths=True)
    cells = len(builder.at(rendering))
    assert cells > builder.columns
    there = table_footprint((builder.columns + cells) // 2)
    monkeypatch.setattr(memory, "free_memory", lambda: there.host + there.device * device.shares_memory)
    RadianceTableBuilder(operator)
    with pytest.raises(DataError, match=f"{cells} voxels and parts of such needs about"):
        builder.at(rendering)


@pytest.mark.parametrize("kind", ["gradient", "derivatives"])
def test_a_table_is_freed_before_the_next_is_made(device, monkeypatch, kind):
    """Two at a time would take twice the memory."""
    operator = RadianceOperator(SCENES["overhead sun"], VIEWS, device, mask=extinction() > 0)
    rendering = operator.render(extinction(), 2, 1, store_paths=True)
    made, at = [], RadianceTableBuilder.at

    def alone(builder, rendering):
        assert all(table() is None for table in made)
        table = at(builder, rendering)
        made.append(weakref.ref(table))
        return table

    monkeypatch.setattr(RadianceTableBuilder, "at", alone)
    by_table, sums = TableGradient(operator), JacobianAverage(operator)
    for _ in range(2):
        by_table.gradient(rendering, np.ones((72, 2))) if kind == "gradient" else sums.add(rendering, 1.0)
        assert made[-1]() is None
    assert len(made) == 2


def test_more_photons_than_there_are_numbers_are_refused(device):
    """Before any is walked; those that enter are numbered one by one."""
    operator = RadianceOperator(SCENES["oblique, absorbing, ground"], VIEWS, device, mask=np.ones(GRID.shape, bool))
    rendering = operator.render(extinction(), 2, store_paths=True)
    builder = RadianceTableBuilder(operator)
    with pytest.raises(DataError, match=r"and 8\d{9} that enter the domain: .* use fewer paths per pixel"):
        builder.at(replace(rendering, samples=2**27))


def test_neighbours_are_the_pixels_that_touch():
    """A corner of an image has 3 of them, an edge 5, a place inside 8; pixels that are not listed are none."""
    views = [OrthographicView(width=1.0, pixels=(4, 3), zenith=0, azimuth=0)] * 2
    pixels = np.array([(view, pixel) for view in (0, 1) for pixel in range(12)])
    matrix = neighbours(views, pixels).toarray()
    counts = (matrix > 0).sum(axis=1).reshape(2, 3, 4)
    np.testing.assert_array_equal(counts[1], [[4, 6, 6, 4], [6, 9, 9, 6], [4, 6, 6, 4]])
    np.testing.assert_allclose(matrix.sum(axis=1), 1, rtol=1e-6)
    assert not matrix[:12, 12:].any()
    few = neighbours(views, pixels[[0, 1, 6, 23]]).toarray()
    np.testing.assert_array_equal(few > 0, [[1, 1, 0, 0], [1, 1, 1, 0], [0, 1, 1, 0], [0, 0, 0, 1]])


def test_rays_have_no_neighbours():
    rays = RayView(np.zeros((3, 3)), np.tile([0.0, 0.0, -1.0], (3, 1)))
    np.testing.assert_array_equal(neighbours([rays], np.array([(0, 0), (0, 1), (0, 2)])).toarray(), np.eye(3))


def test_light_that_changes_inside_of_deep_voxels_is_followed(device, monkeypatch):
    """Along a cloud whose voxels are up to 40 deep: the score function's derivative within 10 % and 3 standard errors,
    where whole voxels miss a third and more."""
    scene, values = SCENES["overhead sun"], (26 * extinction()).astype(np.float32)
    operator = RadianceOperator(scene, VIEWS, device, mask=values > 0)
    adjoint, by_table = np.full((72, 2), 0.5), TableGradient(operator)
    cells, along = ("divided", "whole"), {"score": []}
    for stream in range(8):
        rendering = operator.render(values, 800, 3, stream, store_paths=True)
        along["score"].append(np.sum(values * operator.gradient(rendering, adjoint).get()))
        for cell in cells:
            if cell == "whole" and stream >= 4:
                continue  # it misses by many of these standard errors
            with monkeypatch.context() as patch:
                if cell == "whole":
                    patch.setattr("cloudtomo_cl.transport.cells._MOST_PARTS", 1)
                found = np.sum(values * by_table.gradient(rendering, adjoint)[0].get())
            along.setdefault(cell, []).append(found)
    mean, error = ({cell: of(found) for cell, found in along.items()} for of in (np.mean, stats.sem))
    for cell in cells:
        ratio, spread = mean[cell] / mean["score"], np.hypot(error[cell], error["score"]) / mean["score"]
        print(f"{cell}: {ratio:.3f} of the score function's, standard error {spread:.3f}")
        assert (abs(ratio - 1) < 0.1 + 3 * spread) == (cell == "divided"), cell


LIT = SCENES | {
    "bright ground": Scene(GRID, Sun(zenith=60, azimuth=20), Cloud(), surface=Surface(0.9)),
    "air outside": Scene(
        GRID, Sun(zenith=20, azimuth=130), Cloud(0.98), Air((2.0, 1.5, 1.0), 0.9, levels=(0, 0.15, 0.5, 1)),
        Surface(0.5),
    ),
}  # fmt: skip


def light(operator, values, photons, stream=0, parts=1):
    """Mean diffuse radiance over the sphere that photons bring to the voxels of the mask, sr^-1 for a sun of 1; with
    voxels divided into so many parts along each axis."""
    builder, voxels = RadianceTableBuilder(operator), int(operator.mask.sum())
    cells = Cells(np.full((voxels, 3), parts, np.int32))
    places = {"column": builder.column, "cells": operator.device.constant(cells.places)}
    sums = operator.device.zeros((len(cells), BINS), np.int64)
    medium = operator.on_device(values)
    unit = builder._photons.fill(medium, photons, 6, stream, places, sums)
    found = sums.get().reshape(voxels, -1).sum(axis=1)
    return found * unit / np.prod(operator.scene.grid.spacing) / (4 * np.pi)


@pytest.mark.parametrize("scene", LIT.values(), ids=LIT)
def test_photons_bring_the_light_that_rays_from_there_find(device, random, scene):
    """Over all voxels, clear ones among them: the mean within 4 standard errors, of 1 to 2 %."""
    values, mask = extinction(), np.ones(GRID.shape, bool)
    operator = RadianceOperator(scene, VIEWS, device, mask=mask)
    brought = [light(operator, values, 4000, stream).mean() * scene.sun.irradiance for stream in range(16)]
    directions = random.normal(size=(60_000, 3))
    origins = random.random((60_000, 3)) * GRID.extent + GRID.origin
    rays = RadianceOperator(scene, [RayView(origins=origins, directions=directions)], device).render(values, 4, 4).mean
    error = np.hypot(np.std(brought, ddof=1) / np.sqrt(16), rays.std() / np.sqrt(60_000))
    assert abs(np.mean(brought) - rays.mean()) < 4 * error and error < 0.03 * rays.mean()


def test_cells_of_a_voxel_have_its_light(device):
    """Photons walk through its cells, and leave there what they leave in a whole one."""
    values, mask = extinction(), np.ones(GRID.shape, bool)
    operator = RadianceOperator(SCENES["air, periodic"], VIEWS, device, mask=mask)
    whole, divided = (light(operator, values, 5000, parts=parts) for parts in (1, 3))
    np.testing.assert_allclose(divided, whole, rtol=1e-5)


def test_what_droplets_absorb_is_the_light_that_crosses_them(device):
    """Exact: absorbed are extinction x (1 - albedo) x (4 pi x mean radiance + direct sunlight).

    Fluxes by other photons; within 4 standard errors, of under 1 %, and 0.5 % that points of direct sunlight miss."""
    scene = Scene(GRID, Sun(zenith=40, azimuth=200), Cloud(0.8, HenyeyGreenstein(g=0.7)))
    values = np.minimum(extinction(), 12).astype(np.float32)
    operator = RadianceOperator(scene, VIEWS, device, mask=values > 0)
    rendering = operator.render(values, 2, store_paths=True)
    direct = RadianceTableBuilder(operator).at(rendering).sunlight.get() / 0.8  # of whole voxels
    assert len(direct) == (values > 0).sum()
    weight = values[values > 0] * 0.2 * np.prod(GRID.spacing) / np.prod(GRID.extent[:2])
    diffuse = [np.sum(weight * 4 * np.pi * light(operator, values, 20_000, stream)) for stream in range(12)]
    fluxes = FluxOperator(scene, device).compute(values, 500_000, seed=1).domain_mean("absorbed")
    error = np.hypot(np.std(diffuse, ddof=1) / np.sqrt(12), fluxes.standard_error)
    found = np.mean(diffuse) + np.sum(weight * direct)
    assert abs(found - fluxes.value) < 4 * error + 0.005 * fluxes.value and error < 0.01 * fluxes.value
