"""Every gradient against finite differences, of one cloud on coarse, middle and fine voxels.

Both sides of a difference have the same random numbers. The replayed gradient is unbiased: what it differs
by must be noise. Those by the radiance table are biased by its cells
(docs/measurements/derivatives.md): how much is stated with each test.
"""

from dataclasses import replace

import numpy as np
import pyopencl.array
import pytest
from scipy import stats

from cloudtomo_cl.inversion.priors import Prior
from cloudtomo_cl.inversion.smoothness import PriorOperator
from cloudtomo_cl.scene.grid import Grid, resample
from cloudtomo_cl.scene.phase import HenyeyGreenstein
from cloudtomo_cl.scene.scene import Cloud, Scene, Sun, Surface
from cloudtomo_cl.scene.sensors import OrthographicView
from cloudtomo_cl.transport.jacobian_average import JacobianAverage
from cloudtomo_cl.transport.radiance import RadianceOperator
from cloudtomo_cl.transport.table_gradient import TableGradient

FINE = Grid(shape=(8, 8, 6), spacing=(0.04, 0.04, 0.05), origin=(0.0, 0.0, 0.1))
SHAPES = [(2, 2, 2), (4, 4, 3), (8, 8, 6)]
VIEWS = [OrthographicView(width=0.5, pixels=(6, 6), zenith=zenith, azimuth=40) for zenith in (0, 50)]
PIXELS = 72
PRIORS = {
    "smoothness": Prior(smoothness=0.1, sparsity=0.0),
    "monotonicity": Prior(smoothness=0.0, monotonicity=1.0, sparsity=0.0),
    "sparsity": Prior(smoothness=0.0, sparsity=1.0),
}


def cloud(shape):
    """km^-1; optical thickness up to 5, thicker above, with a clear corner; and the scene."""
    x, y, z = np.meshgrid(*[(np.arange(n) + 0.5) / n * 2 - 1 for n in FINE.shape], indexing="ij")
    values = 30 * np.exp(-2 * (x**2 + y**2 + (z - 0.2) ** 2)) * (x + y < 1.3)
    grid = replace(FINE, shape=shape, spacing=tuple(e / n for e, n in zip(FINE.extent, shape)))
    scene = Scene(grid, Sun(zenith=30, azimuth=10), Cloud(0.98, HenyeyGreenstein(g=0.7)), surface=Surface(0.1))
    return scene, resample(values, shape).astype(np.float32)


def changes(values):
    """Relative changes, for directions of the extinction: of the whole cloud, of halves, of every second voxel."""
    i, j, k = np.indices(values.shape)
    n = values.shape
    return {
        "whole": np.ones(n),
        "upper half": (k >= n[2] // 2).astype(float),
        "one side": (i >= n[0] // 2).astype(float),
        "chequered": ((i + j + k) % 2).astype(float),
    }


def difference(operator, values, change, step, samples, iteration=0):
    """Derivative of every pixel's radiance along a change, km^-1."""
    more, less = (operator.render(values + s * change, samples, 33, iteration).mean for s in (step, -step))
    return (more - less) / (2 * step)


@pytest.mark.parametrize("estimator", ["plain", "side-flights"])
@pytest.mark.parametrize("shape", SHAPES)
def test_the_replayed_gradient(device, shape, estimator):
    """12 batches of 36,000 paths: the mean difference is zero by Student's t at a significance of 1e-4 per direction.

    A step of 0.1 of the extinction leaves an error of (step x optical depth)^2 / 6: 4 % for the thickest flights,
    under 1 % for most, inside the standard errors.
    """
    scene, values = cloud(shape)
    operator = RadianceOperator(scene, VIEWS, device, estimator=estimator)
    adjoint = np.full((PIXELS, 2), 0.5)
    gradients = [
        operator.gradient(operator.render(values, 500, 33, batch, store_paths=True), adjoint).get()
        for batch in range(12)
    ]
    for name, share in changes(values).items():
        change = share * values
        found = np.array([np.sum(gradient * change) for gradient in gradients])
        expected = np.array([difference(operator, values, change, 0.1, 500, batch).sum() for batch in range(12)])
        error = stats.sem(found - expected)
        print(f"{name}: {found.mean():.5f}, differences {expected.mean():.5f}, standard error {error:.5f}")
        assert stats.ttest_1samp(found - expected, 0.0).pvalue > 1e-4, name


@pytest.mark.parametrize("shape", SHAPES)
def test_the_gradient_and_the_jacobian_by_the_table(device, shape):
    """Their known bias: on these grids the gradient's slopes are 0.87, 1.00 and 1.10, the Jacobian's 0.94, 1.03 and
    1.14 for the whole cloud (of 1e7 paths); the Jacobian's neighbours also mix light at the images' edges. Noise
    adds 3 % (differences, whole) to 8 % (other directions, one view).
    """
    scene, values = cloud(shape)
    operator = RadianceOperator(scene, VIEWS, device, mask=np.ones(shape, bool))
    table, sums, gradients = TableGradient(operator), JacobianAverage(operator), []
    for iteration in range(8):
        rendering = operator.render(values, 600, 3, iteration + 1, store_paths=True)
        if iteration % 2:
            sums.add(rendering, 1 / max(1, iteration // 2))  # the first is not in the average
        else:
            gradients.append(table.gradient(rendering, np.full((PIXELS, 2), 0.5))[0].get())
    jacobian, gradient = sums.jacobian, np.mean(gradients[1:], axis=0)
    for name, share in changes(values).items():
        change = share * values
        expected = difference(operator, values, change, 0.15, 10_000 if name == "whole" else 4000)
        found = jacobian @ change.ravel()
        print(f"{name}: {np.sum(gradient * change):.4f}, {found.sum():.4f}, differences {expected.sum():.4f}")
        allowed = 0.2 if name == "whole" else 0.3
        assert np.sum(gradient * change) == pytest.approx(expected.sum(), rel=allowed), name
        assert found.sum() == pytest.approx(expected.sum(), rel=allowed), name
        by_view = (pixels.reshape(2, -1).sum(axis=1) for pixels in (found, expected))
        np.testing.assert_allclose(*by_view, rtol=0.4, err_msg=name)


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("prior", PRIORS.values(), ids=PRIORS)
def test_priors(device, random, shape, prior):
    """Central differences along random directions: within 0.1 % of the gradient's length, which is more than single
    precision and curvature leave. Empty voxels stay empty: there the priors on cloud have a kink."""
    values = (random.uniform(2, 40, shape) * (random.random(shape) > 0.3)).astype(np.float32)
    operator = PriorOperator(prior, shape, device)

    def at(extinction):
        on_device = pyopencl.array.to_device(device.queue, extinction.astype(np.float32))
        return operator.value_and_gradient(on_device, weight=1, noise=0.7)

    _, gradient = at(values)
    for _ in range(3):
        direction = random.normal(size=shape) * (values > 0)
        expected = (at(values + 0.1 * direction)[0] - at(values - 0.1 * direction)[0]) / 0.2
        size = np.linalg.norm(gradient.get()) * np.linalg.norm(direction)
        assert np.sum(gradient.get() * direction) == pytest.approx(expected, abs=1e-3 * size)
