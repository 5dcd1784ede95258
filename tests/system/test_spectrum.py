"""From a scene file with several wavelengths to a recovery at one of them, by the command line."""

import json

import numpy as np
import pytest
import xarray as xr

import cloudtomo_cl as ct
from cloudtomo_cl.commands.cli import main
from cloudtomo_cl.files.stored_settings import read_settings

GRID = ct.Grid((6, 6, 6), (0.1, 0.1, 0.1))
SCENE = """
[cloud]
file = "cloud.nc"
phase_function = { type = "table", file = "mie.nc" }
effective_radius = 6.0
[sun]
zenith = 30.0
[spectrum]
wavelengths = [672.0, 2130.0]
irradiance = [1.5, 0.5]
[[view]]
type = "orthographic"
zenith = 0.0
width = 0.7
pixels = [6, 6]
[[view]]
type = "orthographic"
zenith = 40.0
width = 0.7
pixels = [6, 6]
"""
RUN = """
[measurements]
file = "images.nc"
[truth]
file = "images.nc"
[run]
uncertainty = 2
[solver]
inner_iterations = 5
[[stage]]
grid = [6, 6, 6]
samples = 8
iterations = 2
"""
ONE = "--set spectrum.reference=672 --set spectrum.wavelengths={} --set spectrum.irradiance={}"


def command(text):
    return main([*text.split(), "--quiet"])


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("wavelengths")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        (folder / "scene.toml").write_text(SCENE)
        (folder / "run.toml").write_text(RUN)
        ct.write_extinction("cloud.nc", GRID, ct.cumulus(GRID, seed=1))
        forward = ct.TabulatedPhaseFunction.normalised([0, 60, 180], [[5, 1, 1]] * 2, [5.0, 10.0], [1.0, 1.0])
        back = ct.TabulatedPhaseFunction.normalised([0, 60, 180], [[2, 1, 1]] * 2, [5.0, 10.0], [0.9, 0.8])
        tables = [
            ct.DropletTable(forward, (2.2, 2.1), 672.0, 0.1, 1.33, 0.0),
            ct.DropletTable(back, (2.6, 2.3), 2130.0, 0.1, 1.29, 3e-4),
        ]
        ct.write_phase_function("mie.nc", tables)
        assert command("render scene.toml --samples 16 --seed 4 --output images.nc --png previews") == 0
    return folder


@pytest.fixture(autouse=True)
def inside(folder, monkeypatch):
    monkeypatch.chdir(folder)


@pytest.mark.parametrize(("wavelength", "irradiance"), [(672.0, 1.5), (2130.0, 0.5)])
def test_each_wavelength_has_the_bits_that_it_has_alone(wavelength, irradiance, tmp_path):
    output = tmp_path / "one.nc"
    alone = ONE.format(f"[{wavelength}]", f"[{irradiance}]")
    assert command(f"render scene.toml --samples 16 --seed 4 --output {output} {alone}") == 0
    one, of_both = ct.read_measurements(output), ct.read_measurements("images.nc", wavelength)
    for name in ("images", "standard_errors"):
        assert all(map(np.array_equal, getattr(one, name), getattr(of_both, name)))
    assert one.views == of_both.views and one.wavelength == of_both.wavelength == wavelength
    assert np.array_equal(ct.read_extinction(output)[1], ct.read_extinction("images.nc", wavelength)[1])
    assert read_settings(output)["scene"] == read_settings("images.nc", wavelength=wavelength)["scene"]


def test_a_scene_in_python_has_the_same_bits():
    table = ct.read_droplet_table("mie.nc", 2130.0)
    extinction = ct.extinction_at(ct.read_extinction("cloud.nc")[1], 6.0, table, ct.read_droplet_table("mie.nc", 672.0))
    cloud = ct.Cloud(phase_function=table.phase_function, effective_radius=6.0)
    scene = ct.Scene(GRID, ct.Sun(30.0, irradiance=0.5), cloud, wavelength=2130.0)
    written = ct.read_measurements("images.nc", 2130.0)
    operator = ct.RadianceOperator(scene, written.views)
    images = ct.Measurements.rendered(operator, operator.render(extinction.astype(np.float32), samples=16, seed=4))
    assert images.wavelength == 2130.0 and all(map(np.array_equal, images.images, written.images))


def test_the_file_renders_all_of_them_again(tmp_path):
    assert command(f"render images.nc --output {tmp_path / 'again.nc'}") == 0
    with xr.open_dataset("images.nc") as one, xr.open_dataset(tmp_path / "again.nc") as other:
        assert one.equals(other) and one.attrs["settings"] == other.attrs["settings"]


def test_previews_are_of_each(folder):
    names = sorted(path.name for path in (folder / "previews").iterdir())
    assert names == [f"{light}nm_view_{view}.png" for light in ("2130", "672") for view in range(2)]


def test_a_blind_file_keeps_no_cloud(tmp_path):
    output = tmp_path / "blind.nc"
    assert command(f"render scene.toml --samples 16 --blind --output {output}") == 0
    with xr.open_dataset(output) as dataset:
        assert "extinction" not in dataset and list(json.loads(dataset.attrs["settings"])) == ["scenes"]


def test_a_cameras_noise_is_independent(tmp_path):
    both, scene = tmp_path / "both.nc", tmp_path / "scene.toml"
    # Of one wavelength twice, but for a nanometre: paths have the same random numbers.
    scene.write_text(
        SCENE.replace('file = "', f'file = "{tmp_path}/').replace("672.0, 2130.0", "1000.0, 1001.0")
        + "[surface]\nalbedo = 0.5\n[noise]\nfull_well = 10000\n"
    )
    ct.write_extinction(tmp_path / "cloud.nc", *ct.read_extinction("cloud.nc"))
    table = ct.read_droplet_table("mie.nc", 672.0)
    function, efficiency = table.phase_function, table.extinction_efficiency
    pair = [ct.DropletTable(function, efficiency, one, 0.1, 1.33, 0.0) for one in (1000.0, 1001.0)]
    ct.write_phase_function(tmp_path / "mie.nc", pair)
    same = "--set spectrum.irradiance=[1.0,1.0]"
    assert command(f"render {scene} --samples 16 --output {both} {same}") == 0
    one, other = (ct.read_measurements(both, wavelength).images[0] for wavelength in (1000.0, 1001.0))
    assert (one != other).mean() > 0.8  # numbers of electrons may agree by chance


def test_a_recovery_says_which_wavelengths_there_are(capsys):
    assert command("reconstruct run.toml --output none") == 2
    said = capsys.readouterr().err
    assert "images.nc: holds 672, 2130 nm: choose one: [measurements] wavelength in a run file" in said


def test_a_recovery_takes_one(capsys):
    assert command("reconstruct run.toml --output run --set measurements.wavelength=2130") == 0
    recovered = ct.read_measurements("run/reconstruction.nc")
    assert recovered.wavelength == 2130.0
    assert all(map(np.array_equal, recovered.images, ct.read_measurements("images.nc", 2130.0).images))
    assert ct.read_measurements("run/modelled.nc").wavelength == 2130.0
    assert json.loads(open("run/settings.json").read())["scene"]["sun"]["irradiance"] == 0.5
    page = open("run/report.html", encoding="utf-8").read()
    assert "2130 nm" in page and "error, eps" in page
    assert main(["reconstruct", "run/reconstruction.nc", "--output", "again", "--quiet", "--no-report"]) == 0
    assert np.array_equal(
        ct.read_extinction("again/reconstruction.nc")[1], ct.read_extinction("run/reconstruction.nc")[1]
    )
    assert "truth" not in capsys.readouterr().err


def test_a_table_of_several_is_read_at_the_wavelength_of_the_run(tmp_path):
    table = 'cloud.phase_function={ type = "table", file = "mie.nc" }'
    chosen = ["--set", "measurements.wavelength=672", "--set", table, "--set", "cloud.effective_radius=6.0"]
    assert main(["reconstruct", "run.toml", "--output", str(tmp_path / "run"), "--no-report", "--quiet", *chosen]) == 0
    scene = json.loads((tmp_path / "run" / "settings.json").read_text())["scene"]
    expected = ct.read_phase_function("mie.nc", 672.0)
    assert scene["cloud"]["phase_function"]["values"] == [list(row) for row in expected.values]


def test_one_wavelength_of_several_gives_fluxes():
    text = "flux scene.toml --photons 1000 --output flux.nc --set boundary.horizontal=periodic"
    assert command(f"{text} {ONE.format('[2130.0]', '[0.5]')}") == 0
    with xr.open_dataset("flux.nc") as dataset:
        assert dataset.wavelength == 2130.0 and dataset.extinction.dims == ("z", "y", "x")
