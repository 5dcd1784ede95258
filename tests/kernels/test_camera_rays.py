"""Derivatives along cameras' rays: the kernel against the reference, ray by ray, and the reference against differences.

Both use the same table, and the same random numbers, so a ray is the same one up to rounding; where it flips a discrete
choice (which voxel or cell a ray through an edge meets, whether the ground is reached) the two differ. Hence 97 %.
"""

import numpy as np
import pytest
from scenes import ABOVE, CAMERA, GRID, SCENES, extinction_of, kernel_paths

from cloudtomo_cl.reference.branches import BLOCKS_PER_EVENT
from cloudtomo_cl.reference.camera_rays import Table, ray_derivative
from cloudtomo_cl.reference.paths import first_ray
from cloudtomo_cl.reference.random import uniforms
from cloudtomo_cl.transport.cells import Cells
from cloudtomo_cl.transport.directions import AZIMUTHS, BINS, EDGES
from cloudtomo_cl.transport.radiance import RadianceOperator
from cloudtomo_cl.transport.table_builder import RadianceTableBuilder
from cloudtomo_cl.transport.table_gradient import rays

SEED, STREAM, SAMPLES = 5, 9, 24
LIT = ("forward peak", "ground", "air, ground, periodic", "air outside, open", "phase table")


def on_host(device, table, shape):
    """The reference's table, of one on a device."""
    places = np.empty((shape.sum(), 4), np.uint32)
    device.read(table.cells, places)
    diffuse, sunlight = table.diffuse.get(), table.sunlight.get()
    scattered, source = np.moveaxis(diffuse.reshape(-1, 2, BINS), 1, 0)
    return Table(shape, places[:, 1:].astype(int), source, scattered, sunlight, EDGES, AZIMUTHS)


def of_kernel(operator, builder, table, rendering, change):
    """Derivatives of the rays' radiances along a change of the extinction, shape (rays, pixels)."""
    device, pixels, found = operator.device, len(operator.pixels), []
    left, kernel = rays(rendering), device.kernel("derivatives", "gradient_rays", builder.features)
    for launch in operator.stored_launches(rendering):
        along = device.empty(launch.paths, np.float32)
        done = launch.run_rays(
            kernel, pixels, left, **table.arguments, adjoint=device.zeros((pixels, 2), np.float32),
            change=device.constant(change.astype(np.float32)), gradient=device.zeros(change.shape, np.int64),
            ray_tangent=along, weight=1.0,
        )  # fmt: skip
        found.append(along.get()[: done * pixels].reshape(-1, pixels))
        left -= done
    return np.concatenate(found)


@pytest.mark.parametrize("name", LIT)
@pytest.mark.parametrize("deeper", [1, 8])
def test_rays_have_the_derivatives_of_the_reference(device, random, name, deeper):
    """In voxels of a depth of 2 and of 16 at most, which are divided; some outside of the mask."""
    scene = SCENES[name]
    extinction = deeper * extinction_of(scene)
    mask = (extinction > 0) | (random.random(GRID.shape) > 0.5)
    operator = RadianceOperator(scene, [ABOVE, CAMERA], device, mask=mask)
    rendering = operator.render(extinction, SAMPLES, SEED, STREAM, store_paths=True)
    builder = RadianceTableBuilder(operator)
    table = builder.at(rendering)
    change = random.normal(size=GRID.shape).astype(np.float32)
    found, on_the_host, paths = (
        of_kernel(operator, builder, table, rendering, change),
        on_host(device, table, mask),
        kernel_paths(rendering),
    )
    expected = np.zeros_like(found)
    for sample, column in np.ndindex(found.shape):
        view, pixel = operator.pixels[column].astype(int)
        key = (SEED, STREAM, view, pixel, sample)
        position, direction = first_ray(scene, operator.views[view], pixel, uniforms(*key, 0))
        u = uniforms(*key, BLOCKS_PER_EVENT)
        ray = ray_derivative(
            scene, extinction, on_the_host, position, direction, -np.log(u[0]), u[1], paths[sample, column]
        )
        expected[sample, column] = np.sum(ray.derivative * change)
    scale = np.abs(expected).max()
    assert (np.abs(expected) > 1e-3 * scale).mean() > 0.2
    assert (np.abs(found - expected) <= 1e-3 * np.abs(expected) + 1e-5 * scale).mean() >= 0.97


def test_the_derivative_is_that_of_the_radiance(random):
    """By differences, of a ray through a thin cloud with the same source function: within 1e-5."""
    scene, mask = SCENES["forward peak"], np.ones(GRID.shape, bool)
    extinction = 0.1 * extinction_of(scene) + 0.1
    cells = Cells(random.integers(1, 4, (mask.sum(), 3)).astype(np.int32))
    source = random.random((len(cells), BINS))
    table = Table(mask, cells.parts, source, 0.3 * source, np.zeros(len(cells)), EDGES, AZIMUTHS)
    position, direction = np.array([0.61, -0.07, 0.9]), np.array([0.2, 0.15, -1.0]) / np.sqrt(1.0625)

    def at(values):
        return ray_derivative(scene, values, table, position, direction, 3.0, 0.0, 0.0)

    found, step = at(extinction).derivative, 1e-4
    crossed = np.argwhere(found != 0)
    assert len(crossed) > 3
    for voxel in map(tuple, crossed):
        change = np.zeros(GRID.shape)
        change[voxel] = step
        difference = (at(extinction + change).radiance - at(extinction - change).radiance) / (2 * step)
        assert found[voxel] == pytest.approx(difference, rel=1e-5, abs=1e-9)
