"""`cloudtomo prior learn`, and the script that makes the package's own file."""

import json
import re
import sys
from pathlib import Path

import netCDF4
import numpy as np
import pytest
import xarray as xr
from threadpoolctl import threadpool_limits

import cloudtomo_cl as ct
from cloudtomo_cl.commands import prior
from cloudtomo_cl.commands.cli import main
from cloudtomo_cl.inversion.bound_priors import stage_prior
from cloudtomo_cl.inversion.learning import Learning, by_shape
from cloudtomo_cl.inversion.mixture import Mixture
from cloudtomo_cl.inversion.mixture_file import SHIPPED, MixtureFile, read_mixtures
from cloudtomo_cl.inversion.noise_units import NoiseUnits

SCRIPT = Path(__file__).parents[2] / "scripts/learn_prior.py"
UNITS = NoiseUnits(1.0, 0.0)
SMALL = "--patches 1500 --components 3 --rounds 2".split()


def cloud(folder, name, height=0.02, seed=1, factor=1.0):
    """A file of a cumulus on voxels 0.02 km wide."""
    grid = ct.Grid((12, 12, 12), (0.02, 0.02, height))
    ct.write_extinction(folder / name, grid, factor * ct.cumulus(grid, seed))
    return folder / name


def learn(folder, *arguments, output="prior.nc"):
    """The exit status; the file is `output`."""
    return main(["prior", "learn", *map(str, arguments), *SMALL, "--output", str(folder / output)])


def numbers(path):
    """All of a file's arrays, as bytes."""
    with xr.open_dataset(path) as dataset:
        return {name: dataset[name].values.tobytes() for name in dataset.variables}


def test_the_same_seed_gives_the_same_numbers_whatever_threads(tmp_path):
    clouds = [cloud(tmp_path, "flat.nc"), cloud(tmp_path, "tall.nc", 0.04)]
    for threads in (1, 2):
        with threadpool_limits(limits=threads, user_api="blas"):
            assert learn(tmp_path, *clouds, "--seed", 3, output=f"{threads}.nc") == 0
    assert numbers(tmp_path / "1.nc") == numbers(tmp_path / "2.nc")


def test_another_seed_gives_other_numbers(tmp_path):
    for seed in (1, 2):
        assert learn(tmp_path, cloud(tmp_path, "cloud.nc"), "--seed", seed, output=f"{seed}.nc") == 0
    assert numbers(tmp_path / "1.nc")["mean"] != numbers(tmp_path / "2.nc")["mean"]


def test_a_cloud_five_times_as_bright_gives_the_same_mixture(tmp_path):
    found = []
    for factor in (1.0, 5.0):
        assert learn(tmp_path, cloud(tmp_path, "cloud.nc", factor=factor), "--overwrite") == 0
        found.append(read_mixtures(tmp_path / "prior.nc").mixtures[0])
    np.testing.assert_allclose(found[1].means, found[0].means, rtol=1e-4, atol=1e-5)
    np.testing.assert_allclose(found[1].covariances, found[0].covariances, rtol=1e-4, atol=1e-5)


def test_clouds_are_learnt_from_together_if_their_voxels_have_one_shape(tmp_path, capsys):
    clouds = [cloud(tmp_path, f"{height}.nc", height) for height in (0.04, 0.02, 0.021)]
    assert learn(tmp_path, *clouds) == 0
    found = read_mixtures(tmp_path / "prior.nc")
    assert found.aspects == pytest.approx((1.05**0.5, 2.0), rel=1e-6)
    assert [len(mixture) for mixture in found.mixtures] == [1 + 3, 1 + 3]
    first, second, *_ = capsys.readouterr().out.splitlines()
    assert "1.02 times as high as wide: 2 clouds, " in first and "2 times as high as wide: 1 cloud, " in second


def test_shapes_are_one_up_to_a_tenth_above_the_flattest():
    """Not from one to the next, or shapes would be one by a chain of others."""
    assert by_shape([4.0, 1.0, 1.19, 1.09]) == [[1, 3], [2], [0]]


def run_file(folder, prior):
    """run.toml, of one iteration from the images of cloud.nc in the folder, with this table [prior]."""
    view = '[[view]]\ntype = "orthographic"\nzenith = 20.0\nwidth = 0.4\npixels = [8, 8]\n'
    (folder / "scene.toml").write_text(f'[cloud]\nfile = "cloud.nc"\n[sun]\nzenith = 30.0\n{view}')
    stage = "[[stage]]\ngrid = [6, 6, 6]\nsamples = 8\niterations = 1\n"
    (folder / "run.toml").write_text(f'[measurements]\nfile = "images.nc"\n{stage}{prior}')
    assert main("render scene.toml --samples 64 --output images.nc --quiet".split()) == 0


def test_what_is_printed_goes_into_settings_and_is_taken(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    cloud(tmp_path, "cloud.nc")
    assert main("prior learn cloud.nc --output prior.nc --components 3 --rounds 2".split()) == 0
    words = capsys.readouterr().out
    settings = words[words.index("[prior]") :]
    assert settings.splitlines() == ["[prior]", 'file = "prior.nc"']
    run_file(tmp_path, settings)
    assert main("reconstruct run.toml --output run --no-report --quiet".split()) == 0
    assert json.loads((tmp_path / "run/settings.json").read_text())["settings"]["prior"]["file"].endswith("prior.nc")


def test_a_prior_of_voxels_of_another_shape_is_told(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    cloud(tmp_path, "cloud.nc")
    assert learn(tmp_path, cloud(tmp_path, "tall.nc", 0.04)) == 0
    run_file(tmp_path, '[prior]\nfile = "prior.nc"\n')
    assert main("reconstruct run.toml --output run --no-report".split()) == 0
    said = capsys.readouterr().out
    assert said.count("the prior was learnt") == 1
    assert "learnt from no clouds on voxels like these, 1 times as high as wide: it takes those of 2, " in said


def test_python_warns_of_a_prior_of_voxels_of_another_shape(device):
    grid = ct.Grid((6, 6, 6), (0.1, 0.1, 0.01))
    scene = ct.Scene(grid=grid, sun=ct.Sun(zenith=20.0))
    operator = ct.RadianceOperator(scene, [ct.OrthographicView(zenith=0, azimuth=0, width=0.6, pixels=(6, 6))], device)
    images = ct.Measurements.rendered(operator, operator.render(np.full(grid.shape, 9.0), 16))
    once = [ct.Stage(grid=grid.shape, samples=8, iterations=1)]
    with pytest.warns(ct.RecoveryWarning, match="0.1 times as high as wide: it takes those of 0.5"):
        ct.reconstruct(scene, images, once, device=device, uncertainty=0)


def test_a_damaged_prior_is_found_before_the_first_path(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    cloud(tmp_path, "cloud.nc")
    (tmp_path / "prior.nc").write_bytes(b"no mixture")
    run_file(tmp_path, '[prior]\nfile = "prior.nc"\n')
    assert main("reconstruct run.toml --output run".split()) == 2
    said = capsys.readouterr()
    assert "prior.nc: holds no mixtures" in said.err and "carving" not in said.out
    assert not (tmp_path / "run").exists()


def test_a_file_is_the_prior_that_its_mixtures_are(tmp_path, device, random):
    """The package's own under another name: the same bits."""
    (tmp_path / "prior.nc").write_bytes(SHIPPED.read_bytes())
    voxels = ct.Voxels(ct.Grid((8, 8, 8), (0.02,) * 3), np.ones((8, 8, 8), bool))
    extinction = 30 * random.random(len(voxels))
    found, expected = (
        stage_prior(given, voxels, device).frozen(extinction).hessian_times(np.eye(len(voxels))[:, :3], UNITS)
        for given in (ct.PatchPrior(file=tmp_path / "prior.nc"), ct.PatchPrior())
    )
    assert np.array_equal(found, expected)


def test_a_file_says_what_it_was_learnt_from(tmp_path):
    assert learn(tmp_path, cloud(tmp_path, "cloud.nc"), "--seed", 5) == 0
    with xr.open_dataset(tmp_path / "prior.nc") as dataset:
        assert dataset.attrs["source"].startswith("cloudtomo-cl ")
        told = json.loads(dataset.attrs["settings"])
        assert told == {"clouds": ["cloud.nc"], "components": 3, "patches": 1500, "rounds": 2, "seed": 5}
        assert dataset["mean"].dims[2:] == ("patch_x", "patch_y", "patch_z") and dataset["mean"].units == "1"


def test_values_stand_where_their_voxel_is_in_the_patch(tmp_path):
    """Mean and covariance of a patch whose value is 15 x + 3 y + z."""
    values = np.arange(75.0)
    mixture = Mixture((5, 5, 3), np.ones(1), values[None], (np.minimum.outer(values, values) + np.eye(75))[None])
    MixtureFile((1.0,), (mixture,)).write(tmp_path / "prior.nc")
    with xr.open_dataset(tmp_path / "prior.nc") as dataset:
        assert dataset["mean"].isel(patch_x=2, patch_y=3, patch_z=1).values.tolist() == [[15 * 2 + 3 * 3 + 1]]
    found = read_mixtures(tmp_path / "prior.nc").mixtures[0]
    assert np.array_equal(found.means, mixture.means) and np.array_equal(found.covariances, mixture.covariances)


def test_of_several_wavelengths_the_first_is_learnt_from(tmp_path):
    path = cloud(tmp_path, "cloud.nc")
    with xr.open_dataset(path) as opened:
        one = opened.load()
    values = np.stack([one.extinction.values, 2 * one.extinction.values[..., ::-1]])
    one["extinction"] = (("wavelength", *one.extinction.dims), values, one.extinction.attrs)
    wavelengths = ("wavelength", [672.0, 2130.0], {"units": "nm"})
    one.assign_coords(wavelength=wavelengths).to_netcdf(tmp_path / "two.nc")
    assert learn(tmp_path, path, output="one-prior.nc") == learn(tmp_path, tmp_path / "two.nc") == 0
    assert numbers(tmp_path / "prior.nc") == numbers(tmp_path / "one-prior.nc")


def test_an_archive_of_earlier_days_is_read(tmp_path):
    assert learn(tmp_path, cloud(tmp_path, "cloud.nc")) == 0
    expected = read_mixtures(tmp_path / "prior.nc").mixtures[0]
    rows, columns = np.tril_indices(75)
    np.savez(
        tmp_path / "prior.npz", size=[5, 5, 3], aspects=[1.0], weights=[expected.weights], means=[expected.means],
        covariances=[expected.covariances[:, rows, columns]],
    )  # fmt: skip
    found = read_mixtures(tmp_path / "prior.npz").mixtures[0]
    for name in ("size", "weights", "means", "covariances"):
        assert np.array_equal(getattr(found, name), getattr(expected, name))


def _clear(folder):
    with netCDF4.Dataset(cloud(folder, "given.nc"), "a") as dataset:
        dataset["extinction"][:] = 0


def _water(folder):
    with netCDF4.Dataset(cloud(folder, "given.nc"), "a") as dataset:
        dataset.renameVariable("extinction", "lwc")


MISTAKES = {
    "no file": (lambda folder: None, [], "given.nc: no such file"),
    "no netCDF": (lambda folder: (folder / "given.nc").write_text("x"), [], "given.nc: not a netCDF file"),
    "water": (_water, [], "given.nc: holds no extinction: .* cloudtomo cloud .*given.nc --output"),
    "clear sky": (_clear, [], "given.nc: extinction is zero in every voxel"),
    "too few patches": (lambda folder: cloud(folder, "given.nc"), ["--patches", "200"],
                        "200 patches .* too few for 3 components, .* needs 75 or more: .* at most 2 components"),
    "no patch for a component": (lambda folder: cloud(folder, "given.nc"), ["--patches", "20"],
                                 "voxels 1 times as high as wide: 20 patches .* allow more patches$"),
    "another format": (lambda folder: cloud(folder, "given.nc"), ["--output", "prior.npz"], "must end in .nc"),
    "no folder": (lambda folder: cloud(folder, "given.nc"), ["--output", "none/prior.nc"], "does not exist"),
    "there already": (lambda folder: cloud(folder, "given.nc") and (folder / "prior.nc").touch(), [],
                      "prior.nc: exists already: choose another --output, or add --overwrite"),
    "over the cloud": (lambda folder: cloud(folder, "given.nc"), ["--output", "given.nc", "--overwrite"],
                       "given.nc: this command reads it, and would write over it: choose another --output"),
}  # fmt: skip


@pytest.mark.parametrize(("prepare", "words", "said"), MISTAKES.values(), ids=MISTAKES)
def test_a_mistake_is_told_and_leaves_all_as_it_was(tmp_path, monkeypatch, capsys, prepare, words, said):
    monkeypatch.chdir(tmp_path)
    prepare(tmp_path)
    before = {path: path.read_bytes() for path in tmp_path.iterdir()}
    assert main(["prior", "learn", "given.nc", *SMALL, "--output", "prior.nc", *words]) == 2
    message = capsys.readouterr().err.strip()
    assert "Traceback" not in message
    assert re.search(said, message), message
    assert {path: path.read_bytes() for path in tmp_path.iterdir()} == before


@pytest.mark.parametrize("option", ["--components", "--patches", "--rounds"])
@pytest.mark.parametrize("number", ["0", "-1", "1.5", "many", "1000000000"])
def test_numbers_have_bounds(tmp_path, capsys, option, number):
    with pytest.raises(SystemExit) as left:
        main(["prior", "learn", "cloud.nc", "--output", "prior.nc", option, number])
    assert left.value.code == 2 and f"'{number}' is no whole number from 1 to " in capsys.readouterr().err


def test_help_tells_the_defaults_of_the_library():
    assert Learning() == Learning(prior.COMPONENTS, prior.PATCHES, prior.ROUNDS)


def test_the_script_learns_from_generated_clouds_for_each_shape(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(str(SCRIPT.parent))
    import learn_prior

    words = [*SMALL, "--count", "4", "--aspects", "2", "1", "--output", str(tmp_path / "own.nc")]
    monkeypatch.setattr(sys, "argv", [str(SCRIPT), *words])
    learn_prior.main()
    assert read_mixtures(tmp_path / "own.nc").aspects == (2.0, 1.0)


@pytest.fixture
def with_own_prior(tmp_path, monkeypatch):
    """The working folder, with run/ of a recovery by run.toml, whose prior is prior.nc."""
    monkeypatch.chdir(tmp_path)
    assert learn(tmp_path, cloud(tmp_path, "cloud.nc"), "--seed", 1) == 0
    run_file(tmp_path, '[prior]\nfile = "prior.nc"\n')
    assert main("reconstruct run.toml --output run --no-report --quiet".split()) == 0
    return tmp_path


def test_a_run_does_not_go_on_with_other_mixtures_under_the_same_name(with_own_prior, capsys):
    assert learn(with_own_prior, "cloud.nc", "--seed", 2, "--overwrite") == 0
    assert main("reconstruct run.toml --output run --no-report --resume".split()) == 2
    assert "prior.file holds other numbers than the checkpoint's" in capsys.readouterr().err


def test_a_run_with_a_prior_of_its_own_goes_on_from_another_folder(with_own_prior, monkeypatch):
    (with_own_prior / "elsewhere").mkdir()
    monkeypatch.chdir(with_own_prior / "elsewhere")
    assert main("reconstruct ../run.toml --output ../run --no-report --quiet --resume".split()) == 0


def test_a_run_with_a_prior_of_its_own_is_repeated_by_its_result(with_own_prior, monkeypatch):
    """Also after both moved together, from whatever folder."""
    (with_own_prior / "moved").mkdir()
    for name in ("run", "prior.nc"):
        (with_own_prior / name).rename(with_own_prior / "moved" / name)
    assert main("reconstruct moved/run/reconstruction.nc --output again --no-report --quiet".split()) == 0
    first, second = (numbers(f"{folder}/reconstruction.nc") for folder in ("moved/run", "again"))
    assert first["extinction"] == second["extinction"]
