"""Carving keeps the cloud and removes much of the rest, on rendered images.

Rationale: a mask that cuts off cloud cannot be mended by the descent, a loose one only costs
time. Expected: at least 99 % of the optical mass kept in every case; over dark ground at most a
third of the voxels.
"""

import os
from pathlib import Path

import numpy as np
import pytest

from cloudtomo_cl.clouds.generate import cumulus
from cloudtomo_cl.files.extinction import read_extinction
from cloudtomo_cl.inversion.carving import carve
from cloudtomo_cl.scene.grid import Grid, coarsened
from cloudtomo_cl.scene.measurements import Measurements
from cloudtomo_cl.scene.scene import Scene, Sun, Surface
from cloudtomo_cl.scene.sensors import OrthographicView, PerspectiveView
from cloudtomo_cl.transport.radiance import RadianceOperator

DATA = Path(os.environ.get("CLOUDTOMO_DATA", Path(__file__).resolve().parents[3] / "shared" / "data"))


def nine_cameras(position, target, ring, field_of_view, pixels):
    """A camera at the nadir of its position and eight on a ring around it."""
    options = {"target": target, "field_of_view": field_of_view, "pixels": (pixels, pixels)}
    views = [PerspectiveView(position=position, up=(0.0, 1.0, 0.0), **options)]
    for azimuth in np.radians(45.0 * np.arange(8)):
        east, north = position[0] + ring * np.cos(azimuth), position[1] + ring * np.sin(azimuth)
        views.append(PerspectiveView(position=(east, north, position[2]), **options))
    return tuple(views)


def rendered(grid, extinction, views, samples, sun=0.0, albedo=0.01):
    """Images with and without the cloud."""
    scene = Scene(grid=grid, sun=Sun(zenith=sun, azimuth=30.0), surface=Surface(albedo=albedo))
    operator = RadianceOperator(scene, views)

    def measured(values, samples):
        return Measurements.rendered(operator, operator.render(values, samples))

    return measured(extinction, samples), measured(np.zeros_like(extinction), 2 * samples)


def scene_file(name):
    path = DATA / name
    if not path.is_file():
        pytest.skip(f"{name} is not in {DATA}: set CLOUDTOMO_DATA to the folder that holds it")
    return read_extinction(path)


CAMERAS = {
    "scene_c.nc": ((0.38, 0.38, 1.647), (0.38, 0.38, 1.013), 0.50, 85.4),
    "scene_f.nc": ((0.86, 0.86, 2.16), (0.86, 0.86, 0.27), 1.02, 69.7),
}


@pytest.mark.parametrize(
    ("name", "pixels", "samples"), [("scene_c.nc", 38, 256), ("scene_c.nc", 16, 512), ("scene_f.nc", 43, 256)]
)
def test_large_eddy_clouds_are_kept_and_clear_air_is_removed(name, pixels, samples):
    grid, extinction = scene_file(name)
    mask = carve(grid, *rendered(grid, extinction, nine_cameras(*CAMERAS[name], pixels), samples))
    kept = extinction[mask].sum() / extinction.sum()
    print(f"{name}, {pixels} pixels: {mask.mean():.3f} of the voxels and {kept:.4f} of the mass are kept")
    assert kept >= 0.99
    assert mask.mean() < 0.35
    coarse = coarsened(mask, (8, 8, 8))
    assert coarse.mean() < 0.6


@pytest.mark.parametrize(
    ("sun", "albedo", "largest"), [(0.0, 0.01, 0.35), (50.0, 0.01, 0.35), (0.0, 0.4, 0.85), (50.0, 0.4, 0.85)]
)
def test_a_generated_cloud_is_kept_under_any_sun_over_any_ground(sun, albedo, largest):
    grid = Grid(shape=(32, 32, 32), spacing=(0.76 / 32, 0.76 / 32, 1.52 / 32))
    extinction = cumulus(grid, seed=1)
    views = nine_cameras(*CAMERAS["scene_c.nc"], 24)
    mask = carve(grid, *rendered(grid, extinction, views, 256, sun, albedo))
    kept = extinction[mask].sum() / extinction.sum()
    print(f"sun {sun}, albedo {albedo}: {mask.mean():.3f} of the voxels and {kept:.4f} of the mass are kept")
    assert kept >= 0.99
    assert mask.mean() < largest


def test_a_camera_towards_the_sun_does_not_carve_clouds_away_that_others_see():
    """Clouds are some fifty times as bright in its image as in all others."""
    grid = Grid((12, 12, 12), (0.08, 0.08, 0.08), origin=(0.0, 0.0, 0.4))
    cloud = cumulus(grid, seed=3, peak=40.0)
    sky = [OrthographicView(zenith=45.0, azimuth=azimuth, width=1.6, pixels=(32, 32)) for azimuth in (0, 90, 180, 270)]
    sun = Sun(zenith=30.0, azimuth=30.0).direction
    below = np.array(grid.centre) - 0.8 * np.array(sun) / sun[2]
    up = PerspectiveView(position=tuple(below), target=grid.centre, field_of_view=70.0, pixels=(32, 32))
    images, clear = rendered(grid, cloud, (*sky, up), samples=512, sun=30.0, albedo=0.0)
    assert images.images[-1].max() > 20 * max(image.max() for image in images.images[:-1])
    mask = carve(grid, images, clear)
    assert cloud[mask].sum() > 0.99 * cloud.sum()
    assert mask.mean() < 0.4
