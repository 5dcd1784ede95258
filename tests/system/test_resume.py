"""A reconstruction that is stopped and goes on ends like one that was never stopped."""

import shutil
import signal
import subprocess
import sys
import time
from dataclasses import replace

import numpy as np
import pytest

import cloudtomo_cl as ct
from cloudtomo_cl.commands.cli import main
from cloudtomo_cl.errors import DataError, DeviceError, TransportError
from cloudtomo_cl.transport.jacobian_average import JacobianAverage
from cloudtomo_cl.transport.table_gradient import TableGradient

STAGES = (
    ct.Stage(grid=(3, 3, 3), pixels=0.5, samples=8, iterations=3),
    ct.Stage(grid=(6, 6, 6), samples=8, iterations=4),
)
# Resumes do not depend on how far a step is minimised.
SOLVER = ct.GaussNewton(inner_iterations=4)


@pytest.fixture(scope="module")
def problem(device):
    grid = ct.Grid(shape=(6, 6, 6), spacing=(0.1, 0.1, 0.1))
    extinction = np.zeros(grid.shape, np.float32)
    extinction[2:4, 2:4, 2:5] = 8.0
    scene = ct.Scene(grid=grid, sun=ct.Sun(zenith=30.0))
    views = tuple(
        ct.OrthographicView(zenith=zenith, azimuth=azimuth, width=0.9, pixels=(10, 10))
        for zenith, azimuth in [(0, 0), (45, 60), (45, 240)]
    )
    operator = ct.RadianceOperator(scene, views, device)
    rendering = operator.render(extinction, 64, seed=1)
    return scene, ct.Measurements.rendered(operator, rendering), extinction


def recover(problem, device, **options):
    scene, measurements, truth = problem
    return ct.reconstruct(
        scene,
        measurements,
        **{
            "stages": STAGES,
            "solver": SOLVER,
            "mask": np.ones(truth.shape, bool),
            "device": device,
            "truth": truth,
            "seed": 2,
            "uncertainty": 0,
            **options,
        },
    )


def timeless(history):
    return [replace(record, seconds=0.0) for record in history]


@pytest.mark.parametrize(
    "solver",
    [
        replace(SOLVER, image_samples=2),
        ct.Adam(),
        ct.SGD(
            gradient="replay",
            step_size=1.0,
            parametrisation="extinction",
            image_average_window=1,
            iterate_average_window=1,
        ),
    ],
    ids=["gauss-newton", "adam by the adjoint", "sgd by replay"],
)
def test_every_checkpoint_leads_to_the_same_bits(problem, device, solver, monkeypatch):
    monkeypatch.setattr("cloudtomo_cl.inversion.checkpoint._LEAST_WORK", 0.0)
    taken = []
    options = {"solver": solver, "uncertainty": 2}
    whole = recover(problem, device, **options, checkpoint=taken.append, checkpoint_interval=0.0)
    assert len(taken) == 7
    for checkpoint in taken:
        resumed = recover(problem, device, **options, resume=checkpoint)
        np.testing.assert_array_equal(resumed.extinction, whole.extinction)
        np.testing.assert_array_equal(resumed.standard_error, whole.standard_error)
        assert timeless(resumed.history) == timeless(whole.history)
        assert len(resumed.stage_ends) == 2


def test_motions_of_views_are_the_same_after_a_resume(problem, device, monkeypatch):
    """Within a stage, whose derivatives are made again by the views as they then stood, and at a stage's end."""
    monkeypatch.setattr("cloudtomo_cl.inversion.checkpoint._LEAST_WORK", 0.0)
    scene, measurements, truth = problem
    uncertain = (scene, replace(measurements, pointing_errors=(2.0,) * 3, position_errors=(0.05,) * 3), truth)
    taken = []
    whole = recover(uncertain, device, checkpoint=taken.append, checkpoint_interval=0.0)
    assert whole.views != measurements.views
    for checkpoint in (taken[2], taken[4]):
        resumed = recover(uncertain, device, resume=checkpoint)
        np.testing.assert_array_equal(resumed.extinction, whole.extinction)
        assert resumed.views == whole.views


def test_a_run_that_was_stopped_goes_on_from_its_file(problem, device, tmp_path):
    path = tmp_path / "checkpoint.npz"
    whole = recover(problem, device)
    asked = iter([False, False, True])
    stopped = recover(problem, device, checkpoint=path, stop=lambda: next(asked))
    assert len(stopped.history) == 3
    resumed = recover(problem, device, checkpoint=path, resume=path)
    np.testing.assert_array_equal(resumed.extinction, whole.extinction)


def test_a_run_that_has_ended_goes_on_with_more_iterations(problem, device):
    taken = []
    shorter = (STAGES[0], replace(STAGES[1], iterations=2))
    assert len(recover(problem, device, stages=shorter, checkpoint=taken.append).history) == 5
    longer = recover(problem, device, resume=taken[-1])
    assert len(longer.history) == 7
    np.testing.assert_array_equal(longer.extinction, recover(problem, device).extinction)


def test_seconds_go_on_over_a_resume(problem, device):
    taken = []
    recover(problem, device, checkpoint=taken.append, stop=lambda: True)
    late = replace(taken[-1], seconds=1000.0)
    result = recover(problem, device, resume=late, time_limit=999.0)
    assert len(result.history) == 1  # the time was over: nothing was done
    assert recover(problem, device, resume=late).history[-1].seconds > 1000.0


def test_a_checkpoint_of_another_run_is_refused(problem, device):
    taken = []
    recover(problem, device, checkpoint=taken.append, stop=lambda: True)
    with pytest.raises(DataError, match=r"prior.strength is 0.5, the checkpoint's is"):
        recover(problem, device, resume=taken[-1], prior=ct.PatchPrior(strength=0.5))
    scene, measurements, truth = problem
    other = ct.Measurements(measurements.views, tuple(2 * i for i in measurements.images), measurements.standard_errors)
    with pytest.raises(DataError, match=r"images\[0\] holds other numbers"):
        recover((scene, other, truth), device, resume=taken[-1])


SCENE = """
[cloud]
file = "cloud.nc"
[sun]
zenith = 30.0
[[view]]
type = "orthographic"
zenith = 0.0
width = 0.8
pixels = [8, 8]
[[view]]
type = "orthographic"
zenith = 50.0
width = 0.8
pixels = [8, 8]
"""
RUN = """
[measurements]
file = "images.nc"
[run]
checkpoint_interval = 0.0
uncertainty = 2
[solver]
inner_iterations = 4
[[stage]]
grid = [3, 3, 3]
samples = {samples}
iterations = {iterations}
window = 1000
"""


@pytest.fixture(scope="module")
def images(problem, tmp_path_factory):
    folder = tmp_path_factory.mktemp("resume")
    ct.write_extinction(folder / "cloud.nc", problem[0].grid, problem[2])
    (folder / "scene.toml").write_text(SCENE)
    arguments = ["--samples", "16", "--quiet", "--output", str(folder / "images.nc")]
    assert main(["render", str(folder / "scene.toml"), *arguments]) == 0
    return (folder / "images.nc").read_bytes()


@pytest.fixture
def folder(images, tmp_path, monkeypatch):
    (tmp_path / "images.nc").write_bytes(images)
    (tmp_path / "run.toml").write_text(RUN.format(samples=8, iterations=4))
    monkeypatch.chdir(tmp_path)
    return tmp_path


COMMAND = ["reconstruct", "run.toml", "--seed", "2", "--output", "run"]
NO_REPORT = "--no-report"


@pytest.mark.parametrize(("name", "status"), [("SIGINT", 130), ("SIGTERM", 143)])
def test_a_signal_keeps_all_and_the_same_command_goes_on(folder, name, status):
    (folder / "run.toml").write_text(RUN.format(samples=64, iterations=100_000))
    program = [sys.executable, "-m", "cloudtomo_cl", *COMMAND]
    process = subprocess.Popen(program, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True)
    history = folder / "run" / "history.csv"
    deadline = time.monotonic() + 60
    while not (history.exists() and len(history.read_text().splitlines()) > 3):
        assert time.monotonic() < deadline and process.poll() is None
        time.sleep(0.05)
    process.send_signal(getattr(signal, name))
    _, message = process.communicate(timeout=60)
    assert process.returncode == status, message
    assert "Traceback" not in message and "interrupted in stage 1 of 1, iteration" in message
    assert message.splitlines()[-1].split() == "cloudtomo reconstruct run.toml --output run --resume --seed 2".split()
    files = sorted(path.name for path in (folder / "run").iterdir())
    expected = ["checkpoint.npz", "figures", "files.json", "history.csv", "reconstruction.nc", "settings.json"]
    assert files == expected
    iterations = len(history.read_text().splitlines()) - 1
    assert ct.read_extinction(folder / "run" / "reconstruction.nc")[1].max() > 0
    from cloudtomo_cl.inversion.checkpoint import read_checkpoint

    assert read_checkpoint(folder / "run" / "checkpoint.npz").iterations == iterations


def read_bits(folder):
    extinction = ct.read_extinction(folder / "reconstruction.nc")[1]
    header, *lines = [line.split(",") for line in (folder / "history.csv").read_text().splitlines()]
    place = header.index("seconds")
    return extinction, [line[:place] + line[place + 1 :] for line in lines]


def test_a_run_that_fails_goes_on_with_the_same_bits(folder, finished, monkeypatch, capsys):
    original, calls = JacobianAverage.add, []

    def fail(self, *arguments):
        calls.append(1)
        if len(calls) == 3:
            raise DeviceError("the device fell off the bus")
        return original(self, *arguments)

    monkeypatch.setattr(JacobianAverage, "add", fail)
    assert main(COMMAND) == 2
    message = capsys.readouterr().err
    assert "fell off the bus" in message and "--resume" in message and "checkpoint.npz" in message
    assert main([*COMMAND, "--resume", "--quiet", NO_REPORT]) == 0
    for found, expected in zip(read_bits(folder / "run"), read_bits(finished)):
        np.testing.assert_array_equal(found, expected)


def test_a_resume_without_a_checkpoint_starts(folder, capsys):
    assert main([*COMMAND, "--resume", NO_REPORT]) == 0
    assert "run has no checkpoint: starting from the beginning" in capsys.readouterr().out


def test_a_finished_run_may_be_resumed(folder, finished):
    shutil.copytree(finished, folder / "run")
    before = read_bits(folder / "run")
    (folder / "run" / "history.csv").write_text("lines of a crash")
    assert main([*COMMAND, "--quiet", "--resume", NO_REPORT]) == 0
    for found, expected in zip(read_bits(folder / "run"), before):
        np.testing.assert_array_equal(found, expected)


@pytest.fixture(scope="module")
def finished(images, tmp_path_factory):
    """A run folder, whole."""
    folder = tmp_path_factory.mktemp("finished")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        (folder / "images.nc").write_bytes(images)
        (folder / "run.toml").write_text(RUN.format(samples=8, iterations=4))
        assert main([*COMMAND, "--quiet", NO_REPORT]) == 0
    return folder / "run"


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"--seed": "3"}, "seed is 3, the checkpoint's is 2"),
        ({"toml": ("samples = 8", "samples = 16")}, r"stage[0].samples is 16, the checkpoint's is 8"),
        ({"more": ["--overwrite"]}, "give one of them"),
        ({"more": ["--set", "solver.iterations=9"]}, "solver.iterations is for automatic stages"),
        ({"damage": True}, "checkpoint.npz: is no checkpoint, or damaged"),
    ],
)
def test_a_resume_that_cannot_be_touches_nothing(folder, finished, capsys, change, message):
    shutil.copytree(finished, folder / "run")
    checkpoint = folder / "run" / "checkpoint.npz"
    if "damage" in change:
        checkpoint.write_bytes(checkpoint.read_bytes()[:-1000])
    if "toml" in change:
        (folder / "run.toml").write_text((folder / "run.toml").read_text().replace(*change["toml"]))
    before = {path: path.read_bytes() for path in (folder / "run").rglob("*") if path.is_file()}
    command = [change.get("--seed", word) if word == "2" else word for word in COMMAND]
    assert main([*command, "--resume", *change.get("more", [])]) == 2
    assert message in capsys.readouterr().err
    assert {path: path.read_bytes() for path in (folder / "run").rglob("*") if path.is_file()} == before


def test_a_gradient_that_is_no_number_names_its_voxel(problem, device, monkeypatch):
    original = TableGradient.gradient

    def spoilt(self, *arguments):
        values, tangent = original(self, *arguments)
        host = values.get()
        host[1, 2, 0] = np.nan
        values.set(host)
        return values, tangent

    monkeypatch.setattr(TableGradient, "gradient", spoilt)
    with pytest.raises(TransportError, match=r"gradient is not finite at voxel \(1, 2, 0\).*stream 1"):
        recover(problem, device, solver=ct.Adam())


def test_a_derivative_that_is_no_number_is_not_passed_over(problem, device, monkeypatch):
    """A minimiser that meets NaN may return where it began."""
    original = JacobianAverage._add_rows

    def spoilt(self, *arguments):
        original(self, *arguments)
        values = self._near.get()
        values[0] = np.nan
        self._near.set(values)

    monkeypatch.setattr(JacobianAverage, "_add_rows", spoilt)
    with pytest.raises(TransportError, match=r"gradient is not finite at voxel .*stream 1"):
        recover(problem, device)
