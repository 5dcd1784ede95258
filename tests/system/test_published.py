"""Radiances against published ones.

Rationale: the reference shares this project's reading of the equations; others' codes do not.
Expected: the mean within 4 standard errors (a significance of 6e-5 each) plus 0.3 %, the spread
among the published codes.
"""

import numpy as np
import pytest

from cloudtomo_cl.grid import Grid
from cloudtomo_cl.phase import HenyeyGreenstein
from cloudtomo_cl.scene import Boundary, Cloud, Scene, Sun
from cloudtomo_cl.sensors import OrthographicView
from cloudtomo_cl.transport import RadianceOperator

STEP_CLOUD = np.repeat([2.0, 18.0], 16).reshape(32, 1, 1) / 0.25  # km^-1
# Normalised radiance pi L / (mu0 F0): I3RC case 1 (Cahalan et al. 2005), consensus of the domain's mean.
# Experiment, sun zenith, single-scattering albedo, view zenith and azimuth. The sun stands at azimuth 180.
I3RC = [
    ("exp1", 0, 1.0, 0, 0, 0.25640),
    ("exp1", 0, 1.0, 60, 180, 0.40425),
    ("exp2", 60, 1.0, 0, 0, 0.40607),
    ("exp2", 60, 1.0, 60, 180, 0.56674),
    ("exp4", 60, 0.99, 0, 0, 0.32256),
    ("exp4", 60, 0.99, 60, 0, 0.88616),
]


def assert_mean(scene, extinction, view, device, samples, expected):
    rendering = RadianceOperator(scene, [view], device).render(extinction, samples, seed=5)
    factor = np.pi / (np.cos(np.radians(scene.sun.zenith)) * scene.sun.irradiance)
    mean, error = rendering.mean.mean(), np.sqrt(np.sum(rendering.standard_error**2)) / rendering.mean.size
    assert factor * error < 0.02 * expected
    assert abs(factor * mean - expected) < 4 * factor * error + 0.003 * expected


@pytest.mark.parametrize("experiment, sun, albedo, zenith, azimuth, expected", I3RC)
def test_i3rc_step_cloud(device, experiment, sun, albedo, zenith, azimuth, expected):
    scene = Scene(
        grid=Grid(shape=(32, 1, 1), spacing=(0.5 / 32, 0.5, 0.25)),
        sun=Sun(zenith=sun, azimuth=180.0),
        cloud=Cloud(single_scattering_albedo=albedo),
        boundary=Boundary(horizontal="periodic"),
    )
    # Seen under the zenith angle, the domain's length is shorter by its cosine.
    width = 0.5 * np.cos(np.radians(zenith))
    view = OrthographicView(zenith=zenith, azimuth=azimuth, width=width, pixels=(1, 1), up=(0, 1, 0))
    assert_mean(scene, STEP_CLOUD, view, device, 60_000, expected)


@pytest.mark.parametrize("albedo, expected", [(0.9, 0.38507), (0.99, 0.75669)])
def test_semi_infinite_isotropic_medium(device, albedo, expected):
    """Nadir reflectance factor under an overhead sun: Chandrasekhar 1960, albedo / 4 H(1)^2."""
    scene = Scene(
        grid=Grid(shape=(1, 1, 1), spacing=(1.0, 1.0, 1.0)),
        sun=Sun(zenith=0.0),
        cloud=Cloud(single_scattering_albedo=albedo, phase_function=HenyeyGreenstein(g=0.0)),
        boundary=Boundary(horizontal="periodic"),
    )
    view = OrthographicView(zenith=0.0, width=1.0, pixels=(1, 1))
    assert_mean(scene, np.full((1, 1, 1), 200.0), view, device, 40_000, expected)
