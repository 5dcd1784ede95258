"""Radiances and gradients against exact results: closed forms, energy, reciprocity."""

import numpy as np
import pytest

from cloudtomo_cl.reference.scattering import henyey_greenstein
from cloudtomo_cl.scene.grid import Grid
from cloudtomo_cl.scene.phase import HenyeyGreenstein
from cloudtomo_cl.scene.scene import Air, Boundary, Cloud, Scene, Sun, Surface
from cloudtomo_cl.scene.sensors import OrthographicView, PerspectiveView, RayView
from cloudtomo_cl.transport.radiance import RadianceOperator

# Where a result is random, it may lie this many standard errors away: a probability of
# 6e-5 per comparison for a normal distribution, with fixed seeds.
SIGMAS = 4.0
PERIODIC = Boundary(horizontal="periodic")

ONE_VOXEL = Grid(shape=(1, 1, 1), spacing=(1.0, 1.0, 0.5))
EXTINCTION = 3.0
# Of second order is this share of the first, or less: far below the standard error.
ALBEDO = 1e-4


def slab(sun_zenith, g):
    """One periodic voxel that scatters once, seen from straight above; and its radiance in closed form.

    L = F0 albedo f(sun, nadir) / (1 + 1 / mu0) (1 - exp(-tau (1 + 1 / mu0)))
    """
    scene = Scene(
        ONE_VOXEL,
        Sun(zenith=sun_zenith, irradiance=2.0),
        Cloud(single_scattering_albedo=ALBEDO, phase_function=HenyeyGreenstein(g=g)),
        boundary=PERIODIC,
    )
    mu0 = np.cos(np.radians(sun_zenith))
    slant, tau = 1 + 1 / mu0, EXTINCTION * 0.5
    source = 2.0 * ALBEDO * henyey_greenstein(-mu0, g)
    return scene, source / slant * (1 - np.exp(-tau * slant)), source * 0.5 * np.exp(-tau * slant)


NADIR = OrthographicView(width=1.0, pixels=(1, 1), zenith=0)


@pytest.mark.parametrize("sun_zenith, g", [(0, 0.85), (60, 0.85), (60, -0.5), (75, 0.0)])
def test_radiance_of_single_scattering_in_one_voxel(device, sun_zenith, g):
    scene, expected, _ = slab(sun_zenith, g)
    operator = RadianceOperator(scene, [NADIR], device, estimator="plain")
    rendering = operator.render(np.full((1, 1, 1), EXTINCTION), 200_000)
    assert rendering.standard_error[0] < 5e-3 * expected
    assert abs(rendering.mean[0] - expected) < SIGMAS * rendering.standard_error[0]


@pytest.mark.parametrize("sun_zenith, g", [(0, 0.85), (60, -0.5)])
def test_gradient_of_single_scattering_in_one_voxel(device, sun_zenith, g):
    scene, _, expected = slab(sun_zenith, g)
    operator = RadianceOperator(scene, [NADIR], device, estimator="plain")
    batches = []
    for iteration in range(20):
        rendering = operator.render(np.full((1, 1, 1), EXTINCTION), 50_000, stream=iteration, store_paths=True)
        batches.append(operator.gradient(rendering, np.full((1, 2), 0.5)).get().item())
    standard_error = np.std(batches, ddof=1) / np.sqrt(len(batches))
    assert standard_error < 0.05 * expected
    assert abs(np.mean(batches) - expected) < SIGMAS * standard_error


@pytest.mark.parametrize("estimator", ["plain", "side-flights", "branches"])
@pytest.mark.parametrize("boundary", [Boundary(), PERIODIC], ids=["open", "periodic"])
def test_an_empty_domain_shows_its_sunlit_ground(device, boundary, estimator):
    # L = albedo / pi mu0 F0, the same in every pixel, also beside an open domain.
    grid = Grid(shape=(2, 2, 2), spacing=(0.1, 0.1, 0.1), origin=(0, 0, 0.3))
    scene = Scene(grid, Sun(zenith=50, azimuth=20, irradiance=1.7), surface=Surface(0.4), boundary=boundary)
    views = [OrthographicView(width=1.0, pixels=(4, 4), zenith=40), PerspectiveView((0, 0, 1), (0.3, 0, 0), 60, (4, 4))]
    rendering = RadianceOperator(scene, views, device, estimator=estimator).render(np.zeros((2, 2, 2)), 4000)
    expected = 0.4 / np.pi * np.cos(np.radians(50)) * 1.7
    # Every path has the same single contribution, above the threshold of the roulette.
    np.testing.assert_allclose(rendering.mean, expected, rtol=1e-6)


def test_an_empty_domain_over_a_black_ground_is_dark(device):
    scene = Scene(ONE_VOXEL, Sun(zenith=30))
    rendering = RadianceOperator(scene, [NADIR], device).render(np.zeros((1, 1, 1)), 1000)
    assert np.all(rendering.mean == 0)


CLOUD_GRID = Grid(shape=(4, 4, 3), spacing=(0.25, 0.25, 0.2), origin=(0, 0, 0.1))


def cloud():
    random = np.random.default_rng(6)
    return random.uniform(2, 12, CLOUD_GRID.shape) * (random.random(CLOUD_GRID.shape) > 0.4)


def all_effects(sun_zenith, sun_azimuth):
    return Scene(CLOUD_GRID, Sun(sun_zenith, sun_azimuth), Cloud(0.98), Air(0.3), Surface(0.3), PERIODIC)


@pytest.mark.parametrize("estimator", ["plain", "side-flights", "branches"])
def test_reflection_is_reciprocal(device, estimator):
    # In a periodic domain, the mean reflectance L / mu0 stays when sun and sensor change
    # places (Di Girolamo 1999). Each image covers one period exactly: 1 km across, and for
    # the oblique view 0.5 km in the image, which is 1 km on the horizontal.
    oblique = OrthographicView(width=1.0, pixels=(2, 1), zenith=60, azimuth=0)
    found = []
    for sun, view in [((60, 0), NADIR), ((0, 0), oblique)]:
        operator = RadianceOperator(all_effects(*sun), [view], device, estimator=estimator)
        pixels = len(operator.pixels)
        rendering = operator.render(cloud(), 120_000 // pixels)
        mu0 = np.cos(np.radians(sun[0]))
        found.append((rendering.mean.mean() / mu0, np.sqrt(np.sum(rendering.standard_error**2)) / pixels / mu0))
    (first, first_error), (second, second_error) = found
    assert max(first_error, second_error) < 0.02 * first
    assert abs(first - second) < SIGMAS * np.hypot(first_error, second_error)


@pytest.mark.parametrize(
    "scene", [all_effects(40, 30), Scene(CLOUD_GRID, Sun(20), surface=Surface(0.5))], ids=["periodic", "open"]
)
@pytest.mark.parametrize("estimator", ["side-flights", "branches"])
def test_estimators_have_the_same_mean(device, scene, estimator):
    view = OrthographicView(width=0.8, pixels=(1, 1), zenith=35, azimuth=200)
    plain, other = (
        RadianceOperator(scene, [view], device, estimator=one).render(cloud(), 150_000, seed=seed)
        for seed, one in enumerate(["plain", estimator])
    )
    error = np.hypot(plain.standard_error, other.standard_error)
    assert np.all(error < 0.02 * plain.mean)
    assert np.all(np.abs(plain.mean - other.mean) < SIGMAS * error)


@pytest.mark.parametrize("estimator", ["plain", "side-flights", "branches"])
def test_a_white_cloud_over_a_white_ground_returns_all_light(device, estimator):
    # Nothing absorbs and nothing leaves but upwards: 2 pi times the integral of L mu over mu
    # is F0 mu0 (overhead sun, layers: the radiance depends on the zenith angle only).
    grid = Grid(shape=(1, 1, 2), spacing=(1, 1, 0.5), origin=(0, 0, 0.2))
    scene = Scene(grid, Sun(zenith=0), Cloud(1.0), Air(0.4), Surface(1.0), PERIODIC)
    nodes, weights = np.polynomial.legendre.leggauss(6)
    mu, weights = (nodes + 1) / 2, weights / 2
    views = [OrthographicView(width=1.0, pixels=(1, 1), zenith=float(np.degrees(np.arccos(m)))) for m in mu]
    rendering = RadianceOperator(scene, views, device, estimator=estimator).render(np.array([[[1.5, 3.0]]]), 20_000)
    flux = 2 * np.pi * np.sum(weights * mu * rendering.mean)
    error = 2 * np.pi * np.sqrt(np.sum((weights * mu * rendering.standard_error) ** 2))
    assert error < 0.01
    assert abs(flux - 1) < SIGMAS * error


@pytest.mark.parametrize(
    "view",
    [
        OrthographicView(width=0.2, pixels=(2, 2), zenith=0),
        OrthographicView(0.2, (2, 2), position=(0.5, 0.5, 700.0), target=(0.5, 0.5, 0)),
        RayView([(0.5, 0.5, 700.0), (0.4, 0.6, 70.0)], [(0, 0, -1)] * 2),
        PerspectiveView((0.5, 0.5, 60.0), (0.5, 0.5, 0.0), 0.2, (2, 2)),
    ],
    ids=["orthographic", "orthographic from a place", "rays", "camera"],
)
def test_views_from_space_see_the_ground_through_all_of_the_air(device, view):
    """Air that only absorbs: the ground's radiance, A / pi, is lost down and up again."""
    scene = Scene(
        Grid(shape=(2, 2, 2), spacing=(0.5, 0.5, 0.5)), Sun(zenith=0), air=Air((0.02, 0.005), 0.0, levels=(0, 10, 50)),
        surface=Surface(0.5),
    )  # fmt: skip
    mean = RadianceOperator(scene, [view], device).render(np.zeros((2, 2, 2)), 20000).mean.mean()
    # A path gets through the 0.4 of air with probability exp(-0.4) = 0.67: 0.4 % of error.
    assert mean == pytest.approx(0.5 / np.pi * np.exp(-2 * 0.4), rel=0.02)
