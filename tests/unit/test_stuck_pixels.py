"""Saturated pixels and bright stuck columns are told of before a recovery, and nothing that is rendered."""

from dataclasses import replace

import numpy as np
import pytest

import cloudtomo_cl as ct
from cloudtomo_cl.clouds.generate import PRESETS
from cloudtomo_cl.inversion.stuck_pixels import stuck_text

GRID = ct.Grid((12, 12, 12), (0.05, 0.05, 0.05))
VIEWS = tuple(
    ct.OrthographicView(zenith=zenith, azimuth=azimuth, width=0.8, pixels=(32, 32))
    for zenith, azimuth in [(0, 0), (45, 0), (45, 120), (45, 240)]
)
SCENE = ct.Scene(GRID, ct.Sun(30.0))


def rendered(scene, cloud, device, samples, views=VIEWS):
    operator = ct.RadianceOperator(scene, views, device)
    return ct.Measurements.rendered(operator, operator.render(cloud, samples))


@pytest.fixture(scope="module", params=[64, 256])
def images(request, device):
    return rendered(SCENE, ct.cumulus(GRID, seed=1, peak=60.0), device, request.param)


def spoilt(measured, change):
    arrays = [image.copy() for image in measured.images]
    for array in arrays[2:3]:
        change(array)
    return stuck_text(SCENE, replace(measured, images=tuple(arrays)))


def clip(image):
    np.minimum(image, np.percentile(image, 97), out=image)


def stick_column(image):
    image[:, 15] = 1.0


def stick_row(image):
    image[14] = 1.0


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (clip, "pixels of view 2 have exactly"),
        (stick_column, "column 15 of view 2 has one radiance"),
        (stick_row, "row 14 of view 2 has one"),
    ],
)
def test_what_no_scene_looks_like_is_named(images, change, said):
    text = spoilt(images, change)
    assert said in text and text.endswith("Set the radiance of such pixels to NaN") and "view 0" not in text


NOISES = {"no noise": None, "8 bits": ct.Noise(full_well=2e4, bits=8), "10 bits": ct.Noise(full_well=1e6, bits=10)}
SCENES = {
    "black": {},
    "bright ground": {"surface": ct.Surface(0.7)},
    "ground brighter than clouds": {"surface": ct.Surface(1.0), "cloud": ct.Cloud(0.5)},
    "periodic": {"boundary": ct.Boundary("periodic")},
    "air": {"air": ct.Air(wavelength=672.0)},
}


@pytest.mark.parametrize("samples", [2, 8, 64])
@pytest.mark.parametrize("scene", SCENES.values(), ids=SCENES)
@pytest.mark.parametrize("kind", ["cumulus", "field", "stratocumulus"])
def test_nothing_is_said_of_what_is_rendered(device, kind, scene, samples):
    grid = PRESETS[kind].grid.with_shape((12, 12, 12))
    of = ct.Scene(grid, ct.Sun(30.0), **scene)
    views = [replace(view, width=1.5 * max(grid.extent)) for view in VIEWS]
    for factor in (1.0, 0.05):
        measured = rendered(of, factor * PRESETS[kind].generate(grid, 1), device, samples, views)
        unknown = replace(measured, standard_errors=tuple(0 * error for error in measured.standard_errors))
        for noise in NOISES.values():
            for one in (measured, unknown):
                assert stuck_text(of, one if noise is None else noise.added_to(one)) == ""


def test_lists_of_rays_are_left_alone():
    rays = ct.RayView(np.tile([0.3, 0.3, 2.0], (300, 1)), np.tile([0.0, 0.0, -1.0], (300, 1)))
    radiance = np.minimum(np.linspace(0.1, 1.0, 300), 0.8)[None]
    assert stuck_text(SCENE, ct.Measurements((rays,), (radiance,), (0 * radiance,))) == ""


def test_a_recovery_warns(images, device):
    clipped = replace(images, images=tuple(np.minimum(one, np.percentile(one, 97)) for one in images.images))
    stages = [ct.Stage(grid=(4, 4, 4), iterations=1, samples=4)]
    with pytest.warns(ct.RecoveryWarning, match="pixels seem to be saturated or stuck: "):
        ct.reconstruct(SCENE, clipped, stages, mask=np.ones(GRID.shape, bool), device=device, uncertainty=0)
