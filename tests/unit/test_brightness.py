"""Images in a wrong unit are refused, or warned of, with a message that says so."""

import warnings
from dataclasses import replace

import numpy as np
import pytest

import cloudtomo_cl as ct
from cloudtomo_cl.commands.cli import main
from cloudtomo_cl.inversion.brightness import brightness_text

GRID = ct.Grid((8, 8, 8), (0.1, 0.1, 0.1))
VIEWS = tuple(
    ct.OrthographicView(zenith=zenith, azimuth=azimuth, width=1.2, pixels=(12, 12))
    for zenith, azimuth in [(0, 0), (40, 0), (40, 120), (40, 240)]
)
CLOUD = ct.cumulus(GRID, seed=1)


def scene(irradiance=1.0, asymmetry=0.85, zenith=30.0, ground=0.0):
    cloud = ct.Cloud(1.0, ct.HenyeyGreenstein(g=asymmetry))
    return ct.Scene(GRID, ct.Sun(zenith, irradiance=irradiance), cloud, surface=ct.Surface(ground))


def images(of, device, cloud=CLOUD, samples=64):
    operator = ct.RadianceOperator(of, VIEWS, device)
    return ct.Measurements.rendered(operator, operator.render(cloud, samples))


def times(measured, factor):
    scaled = (tuple(factor * array for array in arrays) for arrays in (measured.images, measured.standard_errors))
    return replace(measured, **dict(zip(("images", "standard_errors"), scaled)))


@pytest.mark.parametrize("irradiance", [1.0, 1800.0, 1e-12, 1e12])
@pytest.mark.parametrize("factor, verdict", [
    (1e3, "a cloud that reflects all light has some 0.3 times: check the radiances' unit"),
    (1e-10, "no cloud that can be seen is so dark: check the radiances' unit"),
])  # fmt: skip
def test_what_no_cloud_can_be_is_refused(device, irradiance, factor, verdict):
    of = scene(irradiance)
    with pytest.raises(ct.DataError, match=verdict):
        ct.reconstruct(of, times(images(of, device), factor), device=device)


@pytest.mark.parametrize("factor", [1e-300, 1e-160, 1e-100, 1e-30])
def test_radiances_whose_squares_are_no_numbers_are_refused(device, factor):
    measured = times(images(scene(), device), factor)
    with pytest.raises(ct.DataError, match="check the radiances' unit"):
        ct.Problem.of(scene(), measured, mask=CLOUD > 0, device=device)


def test_images_that_are_much_too_dark_are_warned_of(device):
    measured, stages = times(images(scene(), device), 1e-6), [ct.Stage(grid=(4, 4, 4), iterations=1, samples=4)]
    with pytest.warns(ct.RecoveryWarning, match="no cloud that can be seen is so dark: check the radiances' unit"):
        ct.reconstruct(scene(), measured, stages, mask=CLOUD > 0, device=device, uncertainty=0)


def test_images_that_are_somewhat_too_bright_are_warned_of(device):
    measured, stages = times(images(scene(), device), 100), [ct.Stage(grid=(4, 4, 4), iterations=1, samples=4)]
    with pytest.warns(ct.RecoveryWarning, match="a cloud that reflects all light has some 0.3 times: check the radia"):
        ct.reconstruct(scene(), measured, stages, mask=CLOUD > 0, device=device, uncertainty=0)


@pytest.mark.parametrize(
    "of",
    [scene(), scene(asymmetry=0.0), scene(asymmetry=-0.9), scene(ground=1.0), scene(zenith=85.0), scene(1800.0)],
    ids=["as most", "isotropic", "backwards", "white ground", "low sun", "a real sun"],
)
@pytest.mark.parametrize("factor", [1e-3, 1.0, 30.0])
def test_nothing_is_said_of_clouds_thin_or_deep(device, of, factor):
    assert brightness_text(of, images(of, device, factor * CLOUD)) == ""


def test_a_view_towards_the_sun_may_be_bright(device):
    towards = ct.OrthographicView(zenith=80.0, azimuth=180.0, width=1.2, pixels=(8, 8))
    bright = ct.Measurements((towards,), (np.full((8, 8), 100.0),), (np.zeros((8, 8)),))
    assert brightness_text(scene(zenith=85.0), bright) == ""


def test_broken_pixels_do_not_make_images_too_bright(device):
    measured = images(scene(), device)
    for image in measured.images:
        image[3, 3] = 1e5
    assert brightness_text(scene(), measured) == ""


def test_the_command_line_says_it_once(tmp_path, monkeypatch, capsys, device):
    monkeypatch.chdir(tmp_path)
    ct.write_measurements("dark.nc", times(images(scene(), device), 1e-6))
    (tmp_path / "run.toml").write_text(
        '[measurements]\nfile = "dark.nc"\n[grid]\nshape = [8, 8, 8]\nspacing = [0.1, 0.1, 0.1]\n[sun]\nzenith = 30.0\n'
        "[[stage]]\ngrid = [4, 4, 4]\niterations = 1\nsamples = 4\n"
    )
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert main(["reconstruct", "run.toml", "--output", "run", "--no-report"]) == 0
    told = capsys.readouterr()
    assert (told.out + told.err).count("no cloud that can be seen is so dark") == 1
