"""Phase functions: densities, their samplers, directions."""

from dataclasses import replace

import numpy as np
import pytest
from scenes import TABLE
from scipy import stats

from cloudtomo_cl.opencl.layout import scene_struct
from cloudtomo_cl.reference import random as reference_random
from cloudtomo_cl.reference import scattering as reference_scattering
from cloudtomo_cl.scene.grid import Grid
from cloudtomo_cl.scene.phase import DoubleHenyeyGreenstein, HenyeyGreenstein
from cloudtomo_cl.scene.scene import Cloud, Scene, Sun
from cloudtomo_cl.transport.device_scene import profiles

GAUSS_LEGENDRE = np.polynomial.legendre.leggauss(200)
ASYMMETRIES = [-0.5, 0.0, 1e-4, 0.3, 0.85, 0.99]
HENYEY_GREENSTEIN, RAYLEIGH, HENYEY_GREENSTEIN_SAMPLE, RAYLEIGH_SAMPLE = range(4)


def phase(probe, g, cosine=None, u=None):
    """Columns: both densities at `cosine`, and both samples for `u`."""
    values = np.asarray(cosine if cosine is not None else u, np.float32)
    other = values if cosine is not None and u is not None else np.full_like(values, 0.5)
    first, second = (values, other) if cosine is not None else (other, values)
    count = len(values)
    return probe("probe_phase", count, np.float32(g), first, second, results=[np.zeros((count, 4), np.float32)])


def sphere_quadrature(g):
    """Cosines and their weights for an integral over the sphere of a peak of width 1 - |g|.

    Gauss-Legendre in t, with cosine = the inverse distribution function of the peak, so that
    nodes crowd where the density is large. Cosines are rounded as the kernels hold them.
    """
    t, weight = GAUSS_LEGENDRE
    cosine = np.array([reference_scattering.sample_henyey_greenstein((x + 1) / 2, g) for x in t])
    cosine = cosine.astype(np.float32)
    return cosine, weight / 2 / reference_scattering.henyey_greenstein(cosine.astype(float), g)


# (1 - g)^2 of a float32 sum near 1 has lost log10(1 / (1 - g)^2) digits: at g = 0.99 the
# density itself is good to 1e-3 only, at one cosine; the integral averages over that.
@pytest.mark.parametrize("g", ASYMMETRIES)
def test_henyey_greenstein_integrates_to_1(probe, g):
    cosine, weight = sphere_quadrature(g)
    density = phase(probe, g, cosine=cosine)[:, HENYEY_GREENSTEIN]
    assert np.sum(weight * density) == pytest.approx(1, rel=2e-4)


@pytest.mark.parametrize("g", ASYMMETRIES)
def test_the_mean_cosine_of_henyey_greenstein_is_g(probe, g):
    cosine, weight = sphere_quadrature(g)
    density = phase(probe, g, cosine=cosine)[:, HENYEY_GREENSTEIN]
    assert np.sum(weight * density * cosine) == pytest.approx(g, abs=2e-4)


@pytest.mark.parametrize("power, expected", [(0, 1.0), (1, 0.0), (2, 0.4)])
def test_moments_of_rayleigh(probe, power, expected):
    cosine, weight = np.polynomial.legendre.leggauss(8)
    density = phase(probe, 0.0, cosine=cosine)[:, RAYLEIGH]
    assert 2 * np.pi * np.sum(weight * density * cosine**power) == pytest.approx(expected, abs=1e-6)


@pytest.mark.parametrize("g", ASYMMETRIES)
def test_sampled_cosines_of_henyey_greenstein_invert_its_distribution(probe, g):
    u = np.linspace(0.0005, 0.9995, 1000, dtype=np.float32)
    cosine = phase(probe, g, u=u)[:, HENYEY_GREENSTEIN_SAMPLE].astype(float)
    if abs(g) < 1e-3:
        # To first order in g, where the closed form cancels: the error is of order g^2.
        distribution = (1 + cosine) / 2 - 0.75 * g * (1 - cosine**2)
    else:
        distribution = (1 - g**2) / (2 * g) * (1 / np.sqrt(1 + g**2 - 2 * g * cosine) - 1 / (1 + g))
    # The kernel's cosine is a quotient over s^2 of terms of order 1, each good to about 2e-7;
    # that moves the distribution by as much times its slope.
    s = 1 + g * (2 * u.astype(float) - 1)
    slope = 2 * np.pi * reference_scattering.henyey_greenstein(cosine, g)
    assert np.all(np.abs(distribution - u) < 1e-6 + slope * 2e-7 * (1 + 1 / s**2))


def test_sampled_cosines_of_rayleigh_invert_its_distribution(probe):
    u = np.linspace(0.0005, 0.9995, 1000, dtype=np.float32)
    cosine = phase(probe, 0.0, u=u)[:, RAYLEIGH_SAMPLE].astype(float)
    np.testing.assert_allclose((3 * cosine + cosine**3 + 4) / 8, u, atol=3e-7)


@pytest.mark.parametrize("column, g", [(RAYLEIGH_SAMPLE, 0.0), *((HENYEY_GREENSTEIN_SAMPLE, g) for g in ASYMMETRIES)])
def test_sampled_cosines_run_from_backward_to_forward(probe, column, g):
    u = np.array([2.0**-33, 1 - 2.0**-24], np.float32)
    np.testing.assert_allclose(phase(probe, g, u=u)[:, column], [-1, 1], atol=1e-4)


def optics(g):
    """A scene with droplets of asymmetry g."""
    grid = Grid(shape=(1, 1, 1), spacing=(1, 1, 1))
    return Scene(grid, Sun(zenith=0), Cloud(phase_function=HenyeyGreenstein(g=g)))


def scattered(probe, particle, g, random, before, count):
    """`count` directions scattered out of `before`, and their densities."""
    numbers = reference_random.open_uniform(random.integers(0, 2**32, (count, 2), dtype=np.uint32))
    found = probe(
        "probe_scatter", count, scene_struct(optics(g)), profiles(optics(g)), np.int32(particle),
        np.tile(np.float32(before), (count, 1)), numbers, results=[np.zeros((count, 4), np.float32)],
    )  # fmt: skip
    return found[:, :3].astype(float), found[:, 3].astype(float)


DROPLET, MOLECULE, SURFACE = 0, -1, -2


@pytest.mark.parametrize(
    "particle, g", [(DROPLET, -0.5), (DROPLET, 0.0), (DROPLET, 0.85), (DROPLET, 0.99), (MOLECULE, 0.0), (SURFACE, 0.0)]
)
def test_scattered_directions_follow_their_density(probe, random, particle, g):
    # The distribution function of the cosine, put on the samples, must be uniform, and so must
    # the azimuth: chi-square over 40 bins, significance 1e-3 each, 10^5 samples.
    before = np.array([0.48, -0.6, 0.64])
    after, _ = scattered(probe, particle, g, random, before, 100_000)
    axis = np.array([0.0, 0.0, 1.0]) if particle == SURFACE else before
    across = np.cross(axis, [1.0, 0.0, 0.0])
    across /= np.linalg.norm(across)
    cosine = after @ axis
    azimuth = np.arctan2(after @ np.cross(axis, across), after @ across)
    distribution = {
        DROPLET: lambda c: (
            (1 + c) / 2 if g == 0 else (1 - g**2) / (2 * g) * (1 / np.sqrt(1 + g**2 - 2 * g * c) - 1 / (1 + g))
        ),
        MOLECULE: lambda c: (3 * c + c**3 + 4) / 8,
        SURFACE: lambda c: c**2,
    }[particle]
    shares = distribution(cosine)
    assert stats.chisquare(np.histogram(shares, np.linspace(0, 1, 41))[0]).pvalue > 1e-3
    assert stats.chisquare(np.histogram(azimuth, np.linspace(-np.pi, np.pi, 41))[0]).pvalue > 1e-3


def droplets_scattered(probe, phase_function, row, random, count):
    """Cosines of scattering by droplets and densities, by the kernels, out of a slanted direction."""
    case = replace(optics(0.0), cloud=Cloud(phase_function=phase_function))
    numbers = reference_random.open_uniform(random.integers(0, 2**32, (count, 2), dtype=np.uint32))
    before = np.array([0.48, -0.6, 0.64])
    found = probe(
        "probe_scatter", count, scene_struct(case), profiles(case), np.int32(row),
        np.tile(np.float32(before), (count, 1)), numbers, results=[np.zeros((count, 4), np.float32)],
    )  # fmt: skip
    return numbers[:, 0].astype(float), found[:, :3].astype(float) @ before, found[:, 3].astype(float)


OTHERS = {
    "two lobes": (DoubleHenyeyGreenstein(0.85, -0.6, 0.7), 0),
    "one lobe of two": (DoubleHenyeyGreenstein(0.85, -0.6, 0.0), 0),
    "table, first row": (TABLE, 0),
    "table, last row": (TABLE, 2),
}


@pytest.mark.parametrize("phase_function, row", OTHERS.values(), ids=OTHERS)
def test_cosines_of_other_phase_functions_follow_their_density(probe, probe_table, random, phase_function, row):
    """Chi-square over 40 bins of equal probability by the density in double precision: significance 1e-3."""
    chosen = probe_table if phase_function.type == "table" else probe
    _, cosine, _ = droplets_scattered(chosen, phase_function, row, random, 100_000)
    grid = np.cos(np.radians(np.linspace(180, 0, 200_001)))
    density = phase_function.density(grid, row) if phase_function.type == "table" else phase_function.density(grid)
    shares = np.concatenate([[0], np.cumsum(np.pi * np.diff(grid) * (density[1:] + density[:-1]))])
    found = np.interp(cosine, grid, shares / shares[-1])
    assert stats.chisquare(np.histogram(found, np.linspace(0, 1, 41))[0]).pvalue > 1e-3


@pytest.mark.parametrize("phase_function, row", OTHERS.values(), ids=OTHERS)
def test_cosines_and_densities_of_other_phase_functions_are_those_of_the_reference(
    probe, probe_table, random, phase_function, row
):
    case = replace(optics(0.0), cloud=Cloud(phase_function=phase_function))
    chosen = probe_table if phase_function.type == "table" else probe
    u, cosine, density = droplets_scattered(chosen, phase_function, row, random, 500)
    expected = [reference_scattering.sample_droplet(case, row, number) for number in u]
    np.testing.assert_allclose(cosine, expected, atol=2e-5)
    expected = [reference_scattering.droplet_density(case, row, c) for c in cosine]
    # A cosine's rounding of 1e-7 moves the sharpest peak by 1e-4.
    np.testing.assert_allclose(density, expected, rtol=1e-3)


@pytest.mark.parametrize("particle, g", [(DROPLET, 0.85), (DROPLET, -0.5), (MOLECULE, 0.0), (SURFACE, 0.0)])
def test_densities_of_scattered_directions_are_those_of_the_reference(probe, random, particle, g):
    before = np.array([0.48, -0.6, 0.64])
    after, density = scattered(probe, particle, g, random, before, 1000)
    name = reference_scattering.Particle({DROPLET: "droplet", MOLECULE: "molecule", SURFACE: "surface"}[particle])
    expected = [reference_scattering.scatter_density(optics(g), name, before, direction) for direction in after]
    # A cosine's rounding of 1e-7 changes the density of g = 0.85 at its peak by 1e-5.
    np.testing.assert_allclose(density, expected, rtol=5e-5, atol=1e-6)


def test_a_surface_reflects_nothing_downwards(probe, random):
    after, _ = scattered(probe, SURFACE, 0.0, random, np.array([0.6, 0.0, -0.8]), 10_000)
    assert np.all(after[:, 2] >= 0)


AXES = {
    "up": [0, 0, 1],
    "down": [0, 0, -1],
    "nearly down": [1e-4, 0, -1],
    "x": [1, 0, 0],
    "minus y": [0, -1, 0],
    "oblique": [0.48, -0.6, 0.64],
    "oblique down": [0.48, 0.6, -0.64],
}


def around(probe, axis, cosine, u):
    axes = np.tile(np.float32(axis), (len(cosine), 1))
    count = len(cosine)
    result = np.zeros((count, 3), np.float32)
    found = probe("probe_direction_around", count, axes, np.float32(cosine), np.float32(u), results=[result])
    return found.astype(float)


@pytest.fixture
def grid_of_angles():
    cosine, u = np.meshgrid([-1, -0.9999, -0.5, 0, 0.3, 0.99, 1], np.linspace(0.01, 0.99, 15))
    return cosine.ravel(), u.ravel()


@pytest.mark.parametrize("axis", AXES.values(), ids=AXES)
def test_directions_around_an_axis_have_unit_length(probe, axis, grid_of_angles):
    axis = np.array(axis) / np.linalg.norm(axis)
    np.testing.assert_allclose(np.linalg.norm(around(probe, axis, *grid_of_angles), axis=1), 1, atol=3e-7)


@pytest.mark.parametrize("axis", AXES.values(), ids=AXES)
def test_directions_around_an_axis_keep_the_cosine(probe, axis, grid_of_angles):
    axis = np.array(axis) / np.linalg.norm(axis)
    np.testing.assert_allclose(around(probe, axis, *grid_of_angles) @ axis, grid_of_angles[0], atol=5e-7)


@pytest.mark.parametrize("axis", AXES.values(), ids=AXES)
def test_directions_around_an_axis_are_those_of_the_reference(probe, axis, grid_of_angles):
    axis = np.array(axis) / np.linalg.norm(axis)
    expected = [reference_scattering.direction_around(axis, c, u) for c, u in zip(*grid_of_angles, strict=True)]
    # The sine of a small angle loses half of its digits.
    np.testing.assert_allclose(around(probe, axis, *grid_of_angles), expected, atol=2e-6)
