"""The replayed gradient: against the reference path by path, and against finite differences."""

import numpy as np
import pytest
from scenes import (
    ABOVE,
    CAMERA,
    ESTIMATORS,
    PERIODIC,
    SCENES,
    extinction_of,
    kernel_paths,
    optics,
    radiances,
    reference_paths,
)
from scipy import stats

from cloudtomo_cl.errors import DataError
from cloudtomo_cl.scene.grid import Grid
from cloudtomo_cl.scene.scene import Air, Scene, Sun, Surface
from cloudtomo_cl.scene.sensors import OrthographicView, PerspectiveView
from cloudtomo_cl.transport.radiance import RadianceOperator
from cloudtomo_cl.transport.rendering import pooled

SEED, ITERATION, SAMPLES = 8, 2, 8


def compare_with_reference(scene, random, operator, **options):
    """Radiances of the paths, and the gradient of a random combination of pixels."""
    extinction = extinction_of(scene)
    rendering = operator.render(extinction, SAMPLES, seed=SEED, stream=ITERATION, store_paths=True)
    paths = reference_paths(scene, extinction, operator, SAMPLES, SEED, ITERATION, **options)
    expected_radiance = radiances(paths)
    agree = np.abs(kernel_paths(rendering) - expected_radiance) <= 1e-3 * np.abs(expected_radiance)
    # A pixel's half that holds a path which rounding turned aside (test_paths.py) is left out.
    whole = np.column_stack([agree[0::2].all(axis=0), agree[1::2].all(axis=0)])
    assert whole.mean() > 0.8
    adjoint = random.normal(size=whole.shape) * whole
    expected = np.zeros(scene.grid.shape)
    for sample, row in enumerate(paths):
        for pixel, contributions in enumerate(row):
            for contribution in contributions:
                expected += adjoint[pixel, sample % 2] * contribution.derivative / (SAMPLES // 2)
    # Without virtual collisions, of which tests/kernels/test_virtual_collisions.py is.
    found = operator.gradient(rendering, adjoint, virtual_limit=0).get()
    assert np.abs(expected).max() > 0
    np.testing.assert_allclose(found, expected, atol=1e-3 * np.abs(expected).max())


@pytest.mark.parametrize("estimator", ESTIMATORS)
@pytest.mark.parametrize("scene", SCENES.values(), ids=SCENES)
def test_gradients_are_those_of_the_reference(device, random, scene, estimator):
    compare_with_reference(scene, random, RadianceOperator(scene, [ABOVE, CAMERA], device, estimator=estimator))


@pytest.mark.parametrize("estimator", ESTIMATORS)
def test_droplets_of_a_radius_in_every_voxel_are_those_of_the_reference(device, random, estimator):
    scene = SCENES["phase table"]
    radius = random.uniform(5.0, 20.0, scene.grid.shape).astype(np.float32).astype(float)
    operator = RadianceOperator(scene, [ABOVE, CAMERA], device, estimator=estimator, effective_radius=radius)
    compare_with_reference(scene, random, operator, effective_radius=radius)


@pytest.mark.parametrize("estimator", ESTIMATORS)
def test_truncated_estimates_are_those_of_the_reference(device, random, estimator):
    scene = SCENES["forward peak"]
    operator = RadianceOperator(scene, [ABOVE, CAMERA], device, estimator=estimator, truncation=0.02)
    compare_with_reference(scene, random, operator, truncation=0.02)


def test_gradients_scale_with_the_suns_irradiance(device):
    bright = Scene(SCENES["ground"].grid, Sun(20, 45, irradiance=3.0), optics(0.85), surface=Surface(0.6))
    results = []
    for scene in (SCENES["ground"], bright):
        operator = RadianceOperator(scene, [ABOVE], device)
        rendering = operator.render(extinction_of(scene), 20, store_paths=True)
        results.append(operator.gradient(rendering, np.ones((9, 2))).get())
    np.testing.assert_allclose(results[1], 3 * results[0], rtol=1e-5, atol=1e-7)


# --- finite differences -----------------------------------------------------------------

GRID = Grid(shape=(4, 3, 3), spacing=(0.15, 0.15, 0.15), origin=(0.0, 0.0, 0.1))
# Narrow views of the cloud's middle, so that each voxel matters to most paths.
VIEWS = [
    OrthographicView(width=0.15, pixels=(2, 2), zenith=30, azimuth=60),
    PerspectiveView((0.3, -0.5, 0.9), (0.3, 0.225, 0.325), 15.0, (2, 2)),
]
VOXELS = {
    "inside": (1, 1, 1), "the cloud's edge": (2, 1, 1), "the domain's boundary": (1, 1, 2), "empty": (3, 1, 1)
}  # fmt: skip
DIFFERENTIATED = {
    "isotropic": Scene(GRID, Sun(zenith=0), optics(0.0)),
    "forward peak": Scene(GRID, Sun(zenith=35, azimuth=20), optics(0.85)),
    "air": Scene(GRID, Sun(zenith=35, azimuth=20), optics(0.85, 0.9), Air((2.0, 1.0, 0.5, 0.2), 0.8)),
    "ground": Scene(GRID, Sun(zenith=35, azimuth=20), optics(0.6), surface=Surface(0.7)),
    "periodic": Scene(GRID, Sun(zenith=60, azimuth=20), optics(0.7, 0.9), boundary=PERIODIC),
}
BATCHES, PER_BATCH = 16, 2000


def cloud():
    """Extinction, km^-1: a cloud that does not fill the domain, its optical thickness about 1.5."""
    values = np.random.default_rng(4).uniform(2, 5, GRID.shape)
    values[3, 1] = 0.0
    values[0, 0, 0] = 0.0
    return values.astype(np.float32).astype(float)


def directions(extinction):
    """Changes of the extinction, km^-1: of single voxels, and of all in proportion; of an empty one by 1."""
    for name, voxel in VOXELS.items():
        change = np.zeros(GRID.shape)
        change[voxel] = extinction[voxel] or 1.0
        yield name, change
    yield "the whole cloud", extinction


STEP = {"the whole cloud": 0.1, "empty": 0.5}  # else 0.4


@pytest.mark.parametrize("estimator", ESTIMATORS)
@pytest.mark.parametrize("scene", DIFFERENTIATED.values(), ids=DIFFERENTIATED)
def test_gradients_are_those_of_finite_differences(device, scene, estimator):
    """16 batches of 16,000 paths, each with its own random numbers, which both sides share.

    The difference between the two, over the batches, must be zero by Student's t at a
    significance of 1e-4 per direction. A central step of 0.4 of the extinction of a voxel
    leaves an error of (step x length)^2 / 6, at most 2 % of the derivative, inside the
    standard errors; most derivatives here are 10 to 50 standard errors large. In the empty voxel a step to one side,
    of second order.
    """
    operator = RadianceOperator(scene, VIEWS, device, estimator=estimator)
    weights = np.linspace(0.5, 1.5, len(operator.pixels))
    adjoint = np.column_stack([weights, weights]) / 2
    extinction = cloud()

    def cost(values, batch):
        return weights @ operator.render(values, PER_BATCH, seed=21, stream=batch).mean

    gradients, here = [], []
    for batch in range(BATCHES):
        rendering = operator.render(extinction, PER_BATCH, 21, batch, store_paths=True)
        gradients.append(operator.gradient(rendering, adjoint).get())
        here.append(weights @ rendering.mean)
    for name, change in directions(extinction):
        step = STEP.get(name, 0.4)
        steps, factors = ((1, 2), (4, -1)) if name == "empty" else ((1, -1), (1, -1))
        costs = [[cost(extinction + n * step * change, batch) for n in steps] for batch in range(BATCHES)]
        differences = (np.array(costs) @ factors - sum(factors) * np.array(here)) / (2 * step)
        found = np.array([np.sum(gradient * change) for gradient in gradients])
        error = stats.sem(found - differences)
        print(f"{name}: {found.mean():.5f}, differences {differences.mean():.5f}, standard error {error:.5f}")
        assert stats.ttest_1samp(found - differences, 0.0).pvalue > 1e-4, name


def test_gradients_are_in_proportion_to_adjoints_however_small(device):
    grid = Grid((4, 4, 4), (0.2, 0.2, 0.2))
    views = [OrthographicView(zenith=0.0, width=0.9, pixels=(8, 8))]
    operator = RadianceOperator(Scene(grid=grid, sun=Sun(zenith=20.0)), views, device)
    rendering = operator.render(np.full(grid.shape, 5.0), 8, store_paths=True)
    adjoint = np.ones((len(operator.pixels), 2))
    one = operator.gradient(rendering, adjoint).get()
    for scale in (1e-30, 1e25):
        np.testing.assert_allclose(operator.gradient(rendering, scale * adjoint).get(), scale * one, rtol=1e-5)
    assert not operator.gradient(rendering, 5e-324 * adjoint).get().any()
    for wrong in (1e30, 1e300, np.inf, np.nan):
        with pytest.raises(DataError, match="adjoint"):
            operator.gradient(rendering, wrong * adjoint)


def test_two_renderings_as_one_have_no_gradient(device):
    """Their paths would be those of the first, half of them all."""
    scene = SCENES["forward peak"]
    operator = RadianceOperator(scene, [ABOVE], device)
    first, second = (
        operator.render(extinction_of(scene), 8, store_paths=True, first_sample=sample) for sample in (0, 8)
    )
    with pytest.raises(DataError, match="kept no paths"):
        operator.gradient(pooled(first, second), np.ones((9, 2)))


def test_a_rendering_is_replayed_by_paths_of_its_own_estimator(device):
    """Also by an operator of another one."""
    scene = SCENES["forward peak"]
    operator, adjoint = RadianceOperator(scene, [ABOVE], device), np.ones((9, 2))
    other = operator.without_branches()
    for maker in (operator, other):
        rendering = maker.render(extinction_of(scene), 8, store_paths=True)
        np.testing.assert_array_equal(
            operator.gradient(rendering, adjoint).get(), other.gradient(rendering, adjoint).get()
        )


def test_an_operator_without_branches_has_the_paths_of_side_flights(device):
    scene = SCENES["forward peak"]
    extinction = extinction_of(scene)
    operator = RadianceOperator(scene, [ABOVE], device)
    expected = RadianceOperator(scene, [ABOVE], device, estimator="side-flights").render(extinction, 8)
    np.testing.assert_array_equal(operator.without_branches().render(extinction, 8).halves, expected.halves)
    assert operator.estimator == "branches" and not np.array_equal(operator.render(extinction, 8).mean, expected.mean)
    plain = RadianceOperator(scene, [ABOVE], device, estimator="plain")
    assert plain.without_branches() is plain


def test_renderings_of_other_estimators_are_pooled_by_the_share_that_is_given(device):
    scene = SCENES["forward peak"]
    operator = RadianceOperator(scene, [ABOVE], device)
    first, second = (one.render(extinction_of(scene), 8, 1) for one in (operator, operator.without_branches()))
    both = pooled(first, second, 0.8)
    np.testing.assert_allclose(both.mean, 0.8 * first.mean + 0.2 * second.mean)
    np.testing.assert_allclose(both.halves, 0.8 * first.halves + 0.2 * second.halves)
    np.testing.assert_allclose(
        both.standard_error**2, (0.8 * first.standard_error) ** 2 + (0.2 * second.standard_error) ** 2
    )
    assert both.samples == 16
