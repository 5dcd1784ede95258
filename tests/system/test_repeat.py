"""A run can be repeated from its own output file alone."""

import json

import numpy as np
import pytest
import xarray as xr

from cloudtomo_cl.commands.cli import main
from cloudtomo_cl.files.extinction import write_extinction
from cloudtomo_cl.scene.grid import Grid

SCENE = """
[cloud]
file = "cloud.nc"
phase_function = { type = "henyey-greenstein", g = 0.5 }
[sun]
zenith = 30.0
[noise]
full_well = 20000
read_noise = 10.0
bits = 10
calibration_error = 0.02
[[view]]
type = "ring"
target = [0.3, 0.3, 0.3]
height = 2.0
radius = 1.0
count = 3
field_of_view = 30.0
pixels = [8, 8]
"""
RUN = """
[measurements]
file = "images.nc"
[run]
uncertainty = 2
[solver]
damping = 0.2
inner_iterations = 5
[[stage]]
grid = [6, 6, 6]
samples = 8
iterations = 3
"""


@pytest.fixture(scope="module")
def outputs(tmp_path_factory):
    """images.nc and reconstruction.nc, moved away from everything they were made from."""
    made, alone = (tmp_path_factory.mktemp(name) for name in ("made", "alone"))
    extinction = np.zeros((6, 6, 6), np.float32)
    extinction[2:4, 2:4, 2:5] = 8.0
    write_extinction(made / "cloud.nc", Grid((6, 6, 6), (0.1, 0.1, 0.1)), extinction)
    (made / "scene.toml").write_text(SCENE)
    (made / "run.toml").write_text(RUN)
    images = str(made / "images.nc")
    render = ["render", str(made / "scene.toml"), "--samples", "16", "--seed", "3", "--quiet", "--output", images]
    assert main(render) == 0
    run = str(made / "run")
    assert main(["reconstruct", str(made / "run.toml"), "--seed", "4", "--quiet", "--no-report", "--output", run]) == 0
    for file in (made / "images.nc", made / "run" / "reconstruction.nc"):
        (alone / file.name).write_bytes(file.read_bytes())
    return alone


def test_images_are_rendered_again_bit_by_bit(outputs, tmp_path):
    again = tmp_path / "again.nc"
    assert main(["render", str(outputs / "images.nc"), "--quiet", "--output", str(again)]) == 0
    with xr.open_dataset(outputs / "images.nc") as first, xr.open_dataset(again) as second:
        assert np.array_equal(first.radiance, second.radiance, equal_nan=True)
        assert first.attrs["settings"].split("cloud_file")[0] == second.attrs["settings"].split("cloud_file")[0]


def test_images_of_earlier_versions_are_rendered_again_with_their_random_numbers(outputs, tmp_path):
    """They kept the stream as `iteration`; both are others than those of the stream 0."""
    radiances = []
    for index, kept in enumerate(({}, {"stream": 5}, {"iteration": 5})):
        with xr.load_dataset(outputs / "images.nc") as images:
            images.attrs["settings"] = json.dumps({**json.loads(images.attrs["settings"]), **kept})
        file, again = tmp_path / f"{index}.nc", tmp_path / f"{index}-again.nc"
        images.to_netcdf(file)
        assert main(["render", str(file), "--quiet", "--output", str(again)]) == 0
        with xr.open_dataset(again) as rendered:
            radiances.append(rendered.radiance.values)
            assert json.loads(rendered.attrs["settings"]).get("stream", 0) == (5 if kept else 0)
    assert np.array_equal(radiances[1], radiances[2]) and not np.array_equal(radiances[0], radiances[1])


def test_a_scenes_noise_is_in_its_images(outputs):
    """Radiances are whole digital numbers, of 1.25 times the brightest pixel in 1024 steps."""
    with xr.open_dataset(outputs / "images.nc") as images:
        np.testing.assert_array_equal(images.calibration_error, [0.02] * 4)
        levels = np.unique(images.radiance.values)
    steps = np.diff(levels) / np.diff(levels).min()
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-6)


def test_a_reconstruction_is_done_again_bit_by_bit(outputs, tmp_path):
    again = tmp_path / "run"
    words = ["--quiet", "--no-report", "--output", str(again)]
    assert main(["reconstruct", str(outputs / "reconstruction.nc"), *words]) == 0
    first, second = (xr.open_dataset(folder / "reconstruction.nc") for folder in (outputs, again))
    with first, second:
        assert np.array_equal(first.extinction, second.extinction) and float(first.extinction.max()) > 0


def test_a_reconstruction_says_how_sure_it_is(outputs):
    with xr.open_dataset(outputs / "reconstruction.nc") as data:
        error = data.extinction_standard_error
        assert error.units == "km-1" and error.dims == ("z", "y", "x")
        assert float(error.max()) > 0 and float(error.where(data.mask == 0, 0.0).max()) == 0


def test_a_scene_can_be_changed_on_the_way(outputs, tmp_path):
    again = tmp_path / "again.nc"
    words = ["--quiet", "--output", str(again), "--set", "sun.zenith=60", "--samples", "4"]
    assert main(["render", str(outputs / "images.nc"), *words]) == 0
    with xr.open_dataset(again) as dataset:
        assert '"zenith": 60' in dataset.attrs["settings"] and '"samples": 4' in dataset.attrs["settings"]


@pytest.mark.parametrize("name", ["images.nc", "reconstruction.nc"])
def test_every_number_has_a_unit(outputs, name):
    with xr.open_dataset(outputs / name) as dataset:
        # Bounds have the unit of what they bound (CF 7.1).
        numbers = {name for name in dataset.variables if dataset[name].dtype.kind in "fiu" and "bounds" not in name}
        assert len(numbers) > 10 and not [name for name in numbers if "units" not in dataset[name].attrs]
        assert {"source", "settings", "device", "versions", "paths", "Conventions"} <= set(dataset.attrs)


def test_what_keeps_no_settings_is_said(outputs, tmp_path, capsys):
    assert main(["reconstruct", str(outputs / "images.nc"), "--output", str(tmp_path / "run")]) == 2
    assert "keeps no settings of a reconstruction" in capsys.readouterr().err
