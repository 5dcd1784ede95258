"""Photons from the sun: against the reference one by one, and against exact results."""

import numpy as np
import pytest
from scenes import GRID, OUTSIDE_AIR, PERIODIC, SCENES, TABLE, extinction_of, optics

from cloudtomo_cl.errors import DataError
from cloudtomo_cl.opencl.layout import sun_view_struct
from cloudtomo_cl.reference import paths as reference
from cloudtomo_cl.reference import random as reference_random
from cloudtomo_cl.scene.scene import Air, Cloud, Scene, Sun, Surface
from cloudtomo_cl.transport.flux import FluxOperator

FLUXES = ("reflected", "direct", "diffuse", "absorbed")


def is_bounded(scene):
    """Whether all the light that matters comes through the top of a domain."""
    outside = scene.air is not None and scene.air.is_outside
    return scene.boundary.horizontal == "periodic" or (scene.surface.albedo == 0 and not outside)


BOUNDED = {name: scene for name, scene in SCENES.items() if is_bounded(scene)}


def reference_fluxes(scene, extinction, photons_per_pixel, seed, effective_radius=None):
    """Fluxes of the columns, for an irradiance of 1; [flux][x][y]."""
    view, area = sun_view_struct(scene)
    width, height = int(view["width"]), int(view["height"])
    origin = view["origin"].astype(float)
    fluxes = dict.fromkeys(FLUXES, 0.0) | {name: np.zeros(scene.grid.shape[:2]) for name in FLUXES}
    for pixel in range(width * height):
        for sample in range(photons_per_pixel):
            u = reference_random.uniforms(seed, 0, reference.SUN_VIEW, pixel, sample, 0)
            across, along = (pixel % width + u[0]) / width, (pixel // width + u[1]) / height
            start = origin[:3] + across * origin[3:6] + along * origin[6:9] + scene.grid.origin
            left = reference.photon(scene, extinction, seed, start, pixel, sample, effective_radius)
            for name, column, weight in left:
                fluxes[name][column] += weight
    column_area = scene.grid.spacing[0] * scene.grid.spacing[1]
    scale = scene.sun.direction[2] * area / (width * height * photons_per_pixel) / column_area
    return {name: values * scale for name, values in fluxes.items()}


def compare_with_reference(scene, device, effective_radius=None):
    # Rounding sends a photon in a hundred another way (see test_paths): of 32 photons a pixel of
    # the sun, so much of the whole light may be elsewhere.
    extinction = extinction_of(scene)
    operator = FluxOperator(scene, device, effective_radius=effective_radius)
    found = operator.compute(extinction, 1, seed=5)
    expected = reference_fluxes(scene, extinction, found.photons // operator._pixels, 5, effective_radius)
    for name in FLUXES:
        difference = np.abs(getattr(found, name).value - expected[name]).mean()
        assert difference <= 0.03 * found.incident, name


@pytest.mark.parametrize("scene", BOUNDED.values(), ids=BOUNDED)
def test_photons_end_where_the_reference_has_them(device, scene):
    compare_with_reference(scene, device)


def test_photons_among_droplets_of_a_radius_in_every_voxel(device, random):
    radius = random.uniform(5.0, 20.0, GRID.shape).astype(np.float32).astype(float)
    compare_with_reference(SCENES["phase table"], device, radius)


@pytest.mark.parametrize("scene", BOUNDED.values(), ids=BOUNDED)
def test_what_comes_in_goes_out(device, scene):
    # Not by construction: columns are tallied apart from the account, and incoming light is geometry.
    found = FluxOperator(scene, device).compute(extinction_of(scene), 200_000, seed=3)
    mean = {name: found.domain_mean(name).value for name in (*FLUXES, "transmitted")}
    upward = scene.surface.albedo * mean["transmitted"]
    outgoing = mean["reflected"] + mean["transmitted"] - upward + mean["absorbed"]
    if scene.boundary.horizontal == "open":
        # What enters and leaves by the sides is known to the account alone, as a share of what was launched.
        _, area = sun_view_struct(scene)
        launched = found.incident * area / (scene.grid.extent[0] * scene.grid.extent[1])
        outgoing += launched * (found.audit.sides + found.audit.missed)
    else:
        launched = found.incident
    # Roulettes give and take a little: their account is exact, and must come out as 0 within its error.
    assert outgoing + launched * found.audit.killed == pytest.approx(launched, rel=1e-6)


@pytest.mark.parametrize("zenith", [0, 50])
def test_direct_light_follows_beer_column_by_column(device, zenith):
    """Exact in a layer of equal columns; by 4 standard errors (significance 6e-5 for each of 12 columns)."""
    scene = Scene(GRID, Sun(zenith=zenith, azimuth=30), optics(0.85), Air(1.5), boundary=PERIODIC)
    found = FluxOperator(scene, device).compute(np.full(GRID.shape, 2.0), 300_000, seed=1)
    depth = 3.5 * GRID.extent[2] / np.cos(np.radians(zenith))
    expected = found.incident * np.exp(-depth)
    assert np.all(np.abs(found.direct.value - expected) < 4 * found.direct.standard_error)
    assert np.all(found.direct.standard_error < 0.03 * expected)


def test_direct_light_through_all_layers_of_air(device):
    scene = Scene(GRID, Sun(zenith=30), optics(0.85), OUTSIDE_AIR, boundary=PERIODIC)
    found = FluxOperator(scene, device).compute(np.zeros(GRID.shape), 100_000, seed=1).domain_mean("direct")
    depth = np.sum(np.diff(OUTSIDE_AIR.levels) * OUTSIDE_AIR.extinction) / np.cos(np.radians(30))
    expected = np.cos(np.radians(30)) * np.exp(-depth)
    assert abs(found.value - expected) < 4 * found.standard_error < 0.02 * expected


def test_standard_errors_are_those_of_repeated_runs(device):
    """The spread of 40 seeds over the mean standard error: within 4 sigma of chi-square, 0.55 to 1.45."""
    scene = SCENES["periodic"]
    operator = FluxOperator(scene, device)
    runs = [operator.compute(extinction_of(scene), 20_000, seed=seed).domain_mean("reflected") for seed in range(40)]
    spread = np.std([run.value for run in runs], ddof=1)
    assert 0.55 < spread / np.mean([run.standard_error for run in runs]) < 1.45


def test_an_endless_plane_of_photons_is_refused(device):
    for scene in (
        Scene(GRID, Sun(zenith=0), surface=Surface(0.1)),
        Scene(GRID, Sun(zenith=0), air=OUTSIDE_AIR),
    ):
        with pytest.raises(DataError, match="periodic"):
            FluxOperator(scene, device)


def test_droplets_of_every_radius_absorb_as_their_row_says(device):
    """Overhead sun on one thin voxel: what is absorbed is the optical depth times 1 - albedo, to first order."""
    scene = Scene(GRID, Sun(zenith=0), Cloud(phase_function=TABLE), boundary=PERIODIC)
    radius = np.empty(GRID.shape)
    radius[0], radius[1], radius[2] = 5.0, 10.0, 15.0
    found = FluxOperator(scene, device, effective_radius=radius).compute(np.full(GRID.shape, 0.02), 4_000_000, seed=2)
    # Albedo 1, 0.95, and halfway between 0.95 and 0.9. What is scattered twice adds a few per cent.
    expected = found.incident * (1 - np.exp(-0.02 * GRID.extent[2])) * np.array([0.0, 0.05, 0.075])
    absorbed, error = found.absorbed.value.mean(axis=1), np.sqrt((found.absorbed.standard_error**2).mean(axis=1) / 4)
    assert np.all(np.abs(absorbed - expected) <= 4 * error + 0.05 * expected)


def test_what_is_transmitted_is_direct_and_diffuse_in_every_column(device):
    scene = next(iter(BOUNDED.values()))
    found = FluxOperator(scene, device).compute(extinction_of(scene), 20_000, seed=1)
    np.testing.assert_allclose(found.transmitted.value, found.direct.value + found.diffuse.value)
