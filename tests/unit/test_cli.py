"""The command line: files, messages, exit status."""

import argparse
import inspect
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from cloudtomo_cl.commands import cli, devices, fluxes, reconstruction, rendering
from cloudtomo_cl.commands.cli import main
from cloudtomo_cl.files.extinction import read_extinction, write_extinction
from cloudtomo_cl.files.measurements import write_rays
from cloudtomo_cl.inversion.solvers.gauss_newton import GaussNewton
from cloudtomo_cl.scene.grid import Grid
from cloudtomo_cl.scene.sensors import RayView
from cloudtomo_cl.settings.tables import PatchPriorTable, read_reconstruct_settings, read_render_settings
from cloudtomo_cl.settings.tables import views as expanded

SCENE = """
[cloud]
file = "cloud.nc"
phase_function = { type = "henyey-greenstein", g = 0.5 }
[surface]
albedo = 0.1
[sun]
zenith = 30.0
[[view]]
type = "perspective"
position = [2.0, 0.2, 1.5]
target = [0.3, 0.3, 0.3]
field_of_view = 40.0
pixels = [6, 4]
[[view]]
type = "orthographic"
zenith = 0.0
width = 0.8
pixels = [5, 5]
"""
RUN = """
[measurements]
file = "images.nc"
[truth]
file = "cloud.nc"
[run]
uncertainty = 2
[solver]
inner_iterations = 5
[[stage]]
grid = [6, 6, 6]
samples = 8
iterations = 3
"""
GENERATE = "cloud --generate cumulus --shape 8 8 8 --spacing 0.1 0.1 0.1 --seed 1 --output".split()


def write_inputs(folder):
    """A cloud of 6 x 6 x 6 voxels, a scene file and a run file."""
    extinction = np.zeros((6, 6, 6), np.float32)
    extinction[2:4, 2:4, 2:5] = 8.0
    write_extinction(folder / "cloud.nc", Grid((6, 6, 6), (0.1, 0.1, 0.1)), extinction)
    (folder / "scene.toml").write_text(SCENE)
    (folder / "run.toml").write_text(RUN)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """The working folder, with the inputs."""
    write_inputs(tmp_path)
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture(scope="module")
def rendered(tmp_path_factory):
    """Images of the cloud, rendered once, as bytes."""
    folder = tmp_path_factory.mktemp("rendered")
    write_inputs(folder)
    output = folder / "images.nc"
    assert main(["render", str(folder / "scene.toml"), "--samples", "16", "--quiet", "--output", str(output)]) == 0
    return output.read_bytes()


def fails(capsys, *arguments):
    """The message of a command that must fail with exit status 2 and no traceback."""
    assert main([str(argument) for argument in arguments]) == 2
    message = capsys.readouterr().err
    assert "Traceback" not in message
    return message


@pytest.mark.parametrize("module", ["pyopencl", "xarray", "matplotlib", "numpy", "pydantic", "rich"])
def test_help_waits_for_no_slow_import(module):
    code = f"import sys, cloudtomo_cl.commands.cli as c; c.parser().format_help(); sys.exit({module!r} in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], timeout=60).returncode == 0


@pytest.mark.parametrize("command", sorted(cli.COMMANDS))
def test_help_of_every_command_has_an_example(command, capsys):
    with pytest.raises(SystemExit) as exit_:
        main([command, "--help"])
    assert exit_.value.code == 0 and f"cloudtomo {command}" in capsys.readouterr().out.split("example", 1)[1]


@pytest.mark.parametrize("command", sorted(cli.COMMANDS))
def test_every_command_has_one_shape(command):
    """HELP is a line, and `run` takes just the options that `add_arguments` makes."""
    module, parser = cli.COMMANDS[command], argparse.ArgumentParser()
    module.add_arguments(parser)
    assert "\n" not in module.HELP and module.DESCRIPTION and module.EXAMPLES
    options = {action.dest for action in parser._actions} - {"help"}
    requests = {"render": rendering.Request, "flux": fluxes.Request, "reconstruct": reconstruction.Request}
    inspect.signature(requests.get(command, module.run)).bind(**dict.fromkeys(options))


def test_version(capsys):
    with pytest.raises(SystemExit):
        main(["--version"])
    assert re.match(r"cloudtomo \d+\.\d+", capsys.readouterr().out)


def test_devices_lists_at_least_one(capsys):
    assert main(["devices"]) == 0
    header, *lines = capsys.readouterr().out.strip().splitlines()
    assert "compute units" in header and lines and lines[0].split()[0] == "0"


def test_interrupt_has_its_exit_status(monkeypatch, capsys):
    def interrupt():
        raise KeyboardInterrupt

    monkeypatch.setattr(devices, "run", interrupt)
    assert main(["devices"]) == 130 and "interrupted" in capsys.readouterr().err


def test_cloud_is_generated(folder):
    assert main([*GENERATE, "new.nc"]) == 0
    with xr.open_dataset("new.nc") as dataset:
        assert dataset.extinction.shape == (8, 8, 8) and float(dataset.extinction.max()) > 0


def test_cloud_summary(folder, capsys):
    assert main(["cloud", "cloud.nc"]) == 0
    text = re.sub(r" +", " ", capsys.readouterr().out)
    # 4 of 36 columns hold 3 voxels of 8 km^-1, 0.1 km thick.
    for line in ("voxels 6 x 6 x 6", "largest extinction 8 km^-1", "largest 2.4, mean 0.2667", "cover 11.1%"):
        assert line in text
    assert "optical mass 0.096 km^2" in text


def test_cloud_quiet_says_nothing(folder, capsys):
    assert main([*GENERATE, "new.nc", "--quiet"]) == 0
    assert capsys.readouterr().out == ""


def test_generating_does_not_replace_a_file(folder, capsys):
    before = Path("cloud.nc").read_bytes()
    assert "--overwrite" in fails(capsys, *GENERATE, "cloud.nc") and Path("cloud.nc").read_bytes() == before


def test_generating_replaces_a_file_on_demand(folder):
    before = Path("cloud.nc").read_bytes()
    assert main([*GENERATE, "cloud.nc", "--overwrite"]) == 0 and Path("cloud.nc").read_bytes() != before


def test_render_writes_radiances_with_units(folder, rendered):
    Path("images.nc").write_bytes(rendered)
    with xr.open_dataset("images.nc") as dataset:
        for name in ("radiance", "radiance_standard_error"):
            assert dataset[name].dims == ("view", "row", "column") and dataset[name].attrs["units"] == "W m-2 sr-1"


def test_render_writes_what_made_it(folder, rendered):
    Path("images.nc").write_bytes(rendered)
    settings = xr.open_dataset("images.nc").attrs["settings"]
    for word in ('"zenith": 30.0', '"samples": 16', '"seed": 0', '"g": 0.5', '"shape"'):
        assert word in settings


def test_render_prints_radiances_and_photons(folder, capsys):
    assert main("render scene.toml --samples 8 --output images.nc".split()) == 0
    text = capsys.readouterr().out
    assert len(re.findall(r"view \d: mean radiance [\d.]+ ± [\d.e-]+ W m\^-2 sr\^-1", text)) == 2
    assert "392 paths" in text  # 8 for each of 24 + 25 pixels


def test_render_repeats_with_its_seed(folder):
    for name in ("one", "two"):
        assert main(["render", "scene.toml", "--samples", "4", "--seed", "5", "--quiet", "--output", f"{name}.nc"]) == 0
    assert np.array_equal(xr.open_dataset("one.nc").radiance, xr.open_dataset("two.nc").radiance, equal_nan=True)


def test_render_reaches_a_target_error(folder, capsys):
    assert main("render scene.toml --target-error 20% --output images.nc".split()) == 0
    noise = [float(share) for share in re.findall(r"pixel noise ([\d.]+)%", capsys.readouterr().out)]
    assert len(noise) == 2 and max(noise) <= 20


@pytest.mark.parametrize("share", ["0", "-1%", "one", "nan", "7", "100%"])
def test_render_refuses_targets_that_are_no_share(folder, capsys, share):
    with pytest.raises(SystemExit) as stop:
        main(["render", "scene.toml", f"--target-error={share}", "--output", "images.nc"])
    assert stop.value.code == 2 and "is no share between 0 and 1" in capsys.readouterr().err


def test_flux_prints_and_writes_fluxes_with_units(folder, capsys):
    periodic = ["--set", 'boundary.horizontal="periodic"']
    assert main(["flux", "scene.toml", "--photons", "2e4", "--seed", "1", "--output", "fluxes.nc", *periodic]) == 0
    text = capsys.readouterr().out
    for name in ("reflected", "transmitted", "direct", "diffuse", "absorbed"):
        assert re.search(rf"{name} +[\d.]+ ± [\d.e-]+ W m\^-2", text)
    with xr.open_dataset("fluxes.nc") as dataset:
        for name in ("reflected", "direct", "diffuse", "absorbed"):
            for variable in (dataset[name], dataset[f"{name}_standard_error"]):
                assert variable.dims == ("y", "x") and variable.attrs["units"] == "W m-2"
        assert dataset.attrs["photons"] >= 2e4 and dataset.attrs["seed"] == 1


def test_render_quiet_says_nothing(folder, capsys):
    assert main("render scene.toml --samples 4 --quiet --output images.nc --png png".split()) == 0
    assert capsys.readouterr().out == ""


def test_render_makes_a_preview_of_every_view(folder):
    assert main("render scene.toml --samples 4 --quiet --output images.nc --png png".split()) == 0
    assert sorted(path.name for path in Path("png").iterdir()) == ["view_0.png", "view_1.png"]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("absent.toml", "absent.toml: no such file"),
        ("scene.toml --device no-such-device", "no OpenCL device 'no-such-device'"),
        ("below.toml", "below.toml: view[0] is wrong: position lies below the ground"),
        ("damaged.toml", "damaged.nc"),
    ],
)
def test_render_that_fails_leaves_no_file(folder, capsys, arguments, message):
    Path("below.toml").write_text(SCENE.replace("1.5]", "-1.5]"))
    Path("damaged.toml").write_text(SCENE.replace("cloud.nc", "damaged.nc"))
    Path("damaged.nc").write_bytes(Path("cloud.nc").read_bytes()[:500])
    before = sorted(folder.iterdir())
    assert message in fails(capsys, "render", *arguments.split(), "--output", "images.nc")
    assert sorted(folder.iterdir()) == before


@pytest.mark.parametrize(
    ("output", "message"),
    [
        (".", "is a folder: choose the name of a file"),
        ("absent/images.nc", "does not exist: make it first"),
        ("cloud.nc", "choose another --output"),
        ("/dev/null", "is no plain file"),
    ],
)
def test_render_refuses_the_output_before_the_work(folder, capsys, monkeypatch, output, message):
    monkeypatch.setattr(rendering, "choose_device", lambda *given: pytest.fail("the work began"))
    assert message in fails(capsys, "render", "scene.toml", "--output", output)


@pytest.mark.parametrize("number", ["0", "3", "-2", "1.5", "many"])
def test_render_refuses_samples_that_are_not_even(folder, capsys, number):
    with pytest.raises(SystemExit) as stop:
        main(["render", "scene.toml", f"--samples={number}", "--output", "images.nc"])
    assert stop.value.code == 2 and "is no even number of paths per pixel" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("command", "message"),
    [
        ("render scene.toml --output images.vti", "images.vti: the name must end in .nc"),
        ("flux scene.toml --output fluxes.txt", "fluxes.txt: the name must end in .nc"),
        ("cloud cloud.nc --output other.npy", "other.npy: the name must end in .nc"),
        ("cloud cloud.nc --png cloud.jpg", "cloud.jpg: the name must end in .png or .pdf or .svg"),
        ("mie --wavelength 672 --effective-radius 10 --output mie.csv", "mie.csv: the name must end in .nc"),
    ],
)
def test_names_of_other_formats_are_refused(folder, capsys, command, message):
    assert message in fails(capsys, *command.split())


@pytest.mark.parametrize(
    "options",
    [
        "--set run.time_limits=5",
        "--set truth.file='absent.nc'",
        "--set grid.shape=[5,6,6] --set grid.spacing=[0.1,0.1,0.1]",
        "--set stage[0].grid=[2000,2000,2000]",
        "--device no-such-device",
        "--resume --overwrite",
    ],
)
def test_reconstruct_refuses_before_the_first_path(folder, rendered, monkeypatch, capsys, options):
    Path("images.nc").write_bytes(rendered)
    monkeypatch.setattr(reconstruction, "execute", lambda job: pytest.fail("the work began"))
    fails(capsys, "reconstruct", "run.toml", "--output", "run", *options.split())


@pytest.mark.parametrize("arguments", [[], ["cloud.nc", "--generate", "cumulus"], ["--generate", "cumulus"]])
def test_cloud_says_which_arguments_it_needs(folder, capsys, arguments):
    assert "--generate" in fails(capsys, "cloud", *arguments)


def test_seed_must_be_of_32_bits(capsys):
    with pytest.raises(SystemExit) as exit_:
        main(["render", "scene.toml", "--seed", str(2**32), "--output", "images.nc"])
    assert exit_.value.code == 2


@pytest.mark.parametrize(
    "command", ["reconstruct run.toml --output=", "render scene.toml --output i.nc --png=", "init example --output="]
)
def test_a_folder_without_a_name_is_not_the_one_of_the_moment(folder, rendered, capsys, command):
    """As of `--output "$OUT"` in a shell where OUT is not set."""
    Path("images.nc").write_bytes(rendered)
    before = sorted(Path().iterdir())
    with pytest.raises(SystemExit) as exit_:
        main(command.split())
    assert exit_.value.code == 2 and "is empty" in capsys.readouterr().err and sorted(Path().iterdir()) == before


def test_reconstruct_writes_a_run_folder(folder, rendered, whole_figures, capsys):
    Path("images.nc").write_bytes(rendered)
    assert main("reconstruct run.toml --seed 2 --output run".split()) == 0
    files = ("reconstruction.nc", "history.csv", "settings.json", "modelled.nc", "report.html")
    for name in (*files, "figures/slices.png", "figures/history.pdf", "figures/comparison.png"):
        assert Path("run", name).stat().st_size > 0
    assert Path("run/figures/history.pdf").read_bytes().startswith(b"%PDF")
    assert re.search(r"^eps [\d.]+  delta [-+][\d.]+%  run$", capsys.readouterr().out.splitlines()[-1])


def test_reconstruct_that_fails_leaves_no_folder(folder, rendered, capsys):
    Path("images.nc").write_bytes(rendered)
    Path("run.toml").write_text(RUN + "[grid]\nshape = [5, 6, 6]\nspacing = [0.1, 0.1, 0.1]\n")
    assert "truth.file" in fails(capsys, "reconstruct", "run.toml", "--output", "run")
    assert not Path("run").exists()


def test_reconstruct_does_not_touch_an_older_run(folder, rendered, capsys):
    Path("images.nc").write_bytes(rendered)
    Path("run").mkdir()
    Path("run/settings.json").write_text("{}")
    assert "--overwrite" in fails(capsys, "reconstruct", "run.toml", "--output", "run")


def test_report_of_a_moved_run_does_without_the_truth(folder, rendered, capsys):
    Path("images.nc").write_bytes(rendered)
    assert main("reconstruct run.toml --quiet --no-report --output run".split()) == 0
    Path("images.nc").unlink()
    Path("cloud.nc").unlink()
    assert main(["report", "run"]) == 0 and "cloud.nc is not there any more" in capsys.readouterr().err
    # The result keeps the images.
    assert Path("run/figures/comparison.png").is_file() and not Path("run/figures/scatter.png").exists()


def test_what_a_notebook_draws_with_is_not_asked_for(folder):
    environment = os.environ | {"MPLBACKEND": "module://not_installed_here"}
    words = [sys.executable, "-m", "cloudtomo_cl", "cloud", "cloud.nc", "--png", "cloud.png"]
    assert subprocess.run(words, env=environment, capture_output=True, timeout=60).returncode == 0


def test_reconstruct_refuses_a_start_that_light_never_leaves_before_the_first_path(
    folder, rendered, monkeypatch, capsys
):
    Path("images.nc").write_bytes(rendered)
    monkeypatch.setattr(reconstruction, "carved_mask", lambda *_: pytest.fail("a path was walked"))
    message = fails(capsys, *"reconstruct run.toml --output run --set solver.start=1e6".split())
    assert "solver.start is 1e+06 km^-1" in message and not Path("run").exists()


def test_report_of_no_run_fails(folder, capsys):
    assert "no run was finished" in fails(capsys, "report", ".")


def test_cloud_reads_changes_plots_and_writes(folder, capsys):
    words = "cloud cloud.nc --crop z=.2: --pad x=2 --rotate 90 --coarsen 2 2 2 --tile 1 2 --output new.nc --png new.png"
    assert main(words.split()) == 0
    with xr.open_dataset("new.nc") as dataset:
        assert dataset.extinction.shape == (2, 10, 3)
        assert '"rotate": 90' in dataset.attrs["settings"] and dataset.attrs["source"].startswith("cloudtomo-cl")
    assert Path("new.png").stat().st_size > 10_000 and "voxels                  3 x 10 x 2" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("cloud.nc --crop 0.2:0.4", "--crop '0.2:0.4' is not understood"),
        ("cloud.nc --crop x=0:0.1", "no cloud is left"),
        ("cloud.nc --shape 2 2 2", "--shape belongs to --generate"),
        ("cloud.nc --effective-radius -1", "must be above 0"),
        ("--generate cirrus --output new.nc", "stratocumulus"),
        ("scene.toml", "is no cloud that can be read"),
    ],
)
def test_cloud_that_cannot_be_writes_nothing(folder, capsys, arguments, message):
    before = sorted(folder.iterdir())
    assert message in fails(capsys, "cloud", *arguments.split())
    assert sorted(folder.iterdir()) == before


def test_every_type_of_view_is_rendered_and_reconstructed(folder):
    write_rays(folder / "rays.nc", RayView([(x, 0.3, 0.0) for x in (0.2, 0.3, 0.4)], [(0, 0, 1)] * 3))
    views = """
[[view]]
type = "rays"
file = "rays.nc"
[[view]]
type = "push-broom"
start = [0.3, 0.0, 5.0]
end = [0.3, 0.6, 5.0]
field_of_view = 7.0
pixels = [9, 9]
[[view]]
type = "radiometer"
zenith = 0.0
pixels = [6, 6]
[[view]]
type = "ring"
target = [0.3, 0.3, 0.3]
height = 2.0
radius = 1.0
count = 2
field_of_view = 30.0
pixels = [9, 9]
"""
    (folder / "scene.toml").write_text(SCENE + views)
    assert main("render scene.toml --samples 16 --output images.nc --png previews --quiet".split()) == 0
    assert len(list((folder / "previews").iterdir())) == 8
    assert main("reconstruct run.toml --output run --quiet".split()) == 0
    with xr.open_dataset("images.nc") as images:
        assert images.view_type.values.tolist()[2:] == ["rays", "push-broom", "radiometer"] + ["perspective"] * 3
    assert (folder / "run" / "figures" / "images.png").is_file()


def test_a_file_of_rays_that_is_unfit_is_named(folder, capsys):
    (folder / "rays.nc").write_text("not netCDF")
    (folder / "scene.toml").write_text(SCENE + '[[view]]\ntype = "rays"\nfile = "rays.nc"\n')
    assert main("render scene.toml --samples 16 --output images.nc".split()) == 2
    assert "rays.nc: not a netCDF file" in capsys.readouterr().err
    assert not (folder / "images.nc").exists()


def test_set_takes_the_place_of_a_key(folder):
    words = "render scene.toml --samples 4 --quiet --output images.nc --set sun.zenith=12 --set view[1].pixels=[3,2]"
    assert main(words.split()) == 0
    with xr.open_dataset("images.nc") as dataset:
        assert '"zenith": 12.0' in dataset.attrs["settings"] and dataset.image_width.values.tolist() == [6, 3]


@pytest.mark.parametrize(
    ("override", "message"),
    [("sun.zenit=12", "sun.zenit is no known key: did you mean zenith?"), ("sun.zenith=95", "sun.zenith")],
)
def test_set_is_checked_like_the_file(folder, capsys, override, message):
    assert message in fails(capsys, "render", "scene.toml", "--output", "images.nc", "--set", override)


def uncommented(path):
    """The file with all that is optional in it made real."""
    text = Path(path).read_text()
    return re.sub(r"^# (?=\[+\w+\]+$|\[+\w+\]+ |\w+ = )", "", text, flags=re.MULTILINE)


@pytest.mark.parametrize("everything", [False, True])
def test_init_writes_files_that_render_and_reconstruct(folder, capsys, everything):
    assert main("init render --cloud cloud.nc --output new.toml".split()) == 0
    assert "cloudtomo render new.toml" in capsys.readouterr().out
    if everything:
        Path("new.toml").write_text(uncommented("new.toml"))
    assert main("render new.toml --samples 4 --quiet --output new.nc --set view[0].pixels=[8,8]".split()) == 0
    assert main("init reconstruct --measurements new.nc --truth cloud.nc --output again.toml".split()) == 0
    if everything:
        Path("again.toml").write_text(uncommented("again.toml"))
        assert len(read_reconstruct_settings("again.toml").stage) == 1
    settings = read_reconstruct_settings("again.toml")
    assert settings.prior == PatchPriorTable() and settings.solver == GaussNewton()


def test_the_views_of_init_see_the_whole_cloud(folder):
    assert main("init --cloud cloud.nc --quiet --overwrite".split()) == 0
    grid, extinction = read_extinction("cloud.nc")
    corners = np.argwhere(extinction > 0)
    points = np.concatenate([grid.origin + (corners + shift) * grid.spacing for shift in np.ndindex(2, 2, 2)])
    views = expanded(read_render_settings("scene.toml").view)
    assert len(views) == 9
    for view in views:
        u, v, depth = view.project(grid, points)
        assert (depth > 0).all() and min(u.min(), v.min()) > 0 and max(u.max(), v.max()) < 1


def test_init_does_not_replace_a_file(folder, capsys):
    assert "--overwrite" in fails(capsys, "init", "render") and Path("scene.toml").read_text() == SCENE
