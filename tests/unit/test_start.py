"""What a recovery begins with: as deep as the images say, and no cloud that vanishes."""

from dataclasses import replace

import numpy as np
import pytest

import cloudtomo_cl as ct
from cloudtomo_cl.errors import DataError
from cloudtomo_cl.inversion.start import uniform_start
from cloudtomo_cl.scene.grid import mean_chord

GRID = ct.Grid((12, 12, 12), (0.05, 0.05, 0.05))
CHORD = mean_chord(GRID.extent)
VIEWS = tuple(
    ct.OrthographicView(zenith=zenith, azimuth=azimuth, width=1.0, pixels=(20, 20))
    for zenith, azimuth in [(0, 0), (45, 0), (45, 90), (45, 180), (45, 270)]
)


def scene(asymmetry=0.85, ground=0.0):
    cloud = ct.Cloud(1.0, ct.HenyeyGreenstein(g=asymmetry))
    return ct.Scene(grid=GRID, sun=ct.Sun(zenith=20.0), cloud=cloud, surface=ct.Surface(ground))


def images(of, extinction, device):
    operator = ct.RadianceOperator(of, VIEWS, device)
    return ct.Measurements.rendered(operator, operator.render(extinction, samples=256, seed=1))


@pytest.mark.parametrize("depth, asymmetry, ground", [(0.05, 0.85, 0.0), (0.05, 0.0, 0.0), (0.25, 0.85, 0.6)])
def test_a_thin_cloud_is_begun_as_thin_as_it_is(depth, asymmetry, ground, device):
    """Images of a cloud that is everywhere alike, by the start itself: to a factor of two."""
    extinction = np.full(GRID.shape, depth / CHORD)
    everywhere = np.ones(GRID.shape, bool)
    of = scene(asymmetry, ground)
    problem = ct.Problem.of(of, images(of, extinction, device), mask=everywhere, device=device)
    assert 0.49 < uniform_start(problem, everywhere, GRID, seed=2) / extinction[0, 0, 0] < 2.01


def test_a_deep_cloud_is_begun_with_a_depth_of_one(device):
    everywhere = np.ones(GRID.shape, bool)
    problem = ct.Problem.of(scene(), images(scene(), np.full(GRID.shape, 30.0), device), mask=everywhere, device=device)
    assert uniform_start(problem, everywhere, GRID, seed=2) == pytest.approx(1 / CHORD)


@pytest.mark.parametrize("start", [None, 1 / CHORD])
def test_a_cloud_that_is_much_thinner_than_the_start_does_not_vanish(start, device):
    """Where the start is too deep the linear model of images says that there is no cloud."""
    truth = ct.cumulus(GRID, seed=1, peak=1.0)
    measured = images(scene(asymmetry=0.0), truth, device)
    solver = ct.GaussNewton(start=start, iterations=4)
    found = ct.reconstruct(scene(0.0), measured, truth=truth, seed=2, device=device, solver=solver, uncertainty=0)
    assert abs(found.history[-1].delta) < 0.3


def test_images_that_are_too_dark_everywhere_do_not_say_that_there_is_no_cloud(device):
    """A dark level of a tenth of the cloud's radiance was taken away twice."""
    truth = ct.cumulus(GRID, seed=1, peak=40)
    right = images(scene(), truth, device)
    level = 0.1 * np.percentile(right.images[0], 99)
    measured = replace(right, images=tuple(image - level for image in right.images))
    solver = ct.GaussNewton(iterations=3)
    found = ct.reconstruct(scene(), measured, truth=truth, seed=2, device=device, solver=solver, uncertainty=0)
    assert -0.5 < found.history[-1].delta < 0


def test_a_start_of_next_to_nothing_is_refused(device):
    measured = images(scene(), ct.cumulus(GRID, seed=1), device)
    with pytest.raises(DataError, match="solver.start is 0.001 km\\^-1, an optical depth of 0.0004 across the domain"):
        ct.reconstruct(scene(), measured, solver=ct.GaussNewton(start=1e-3), device=device)


def test_a_start_deeper_than_any_cloud_is_refused(device):
    """Its first iteration, which the time limit does not end, would take for ever."""
    measured = images(scene(), ct.cumulus(GRID, seed=1), device)
    with pytest.raises(DataError, match="solver.start is 5000 km\\^-1, .* it must be 0.0025 to 2.5e\\+03 km\\^-1"):
        ct.reconstruct(scene(), measured, solver=ct.GaussNewton(start=5000.0), device=device, time_limit=1.0)


def test_images_without_light_are_refused(device):
    measured = ct.Measurements(VIEWS, [np.zeros((20, 20))] * len(VIEWS), [np.full((20, 20), 1e-4)] * len(VIEWS))
    with pytest.raises(DataError, match="no light"):
        ct.reconstruct(scene(), measured, mask=np.ones(GRID.shape, bool), device=device)
