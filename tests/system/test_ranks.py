"""Ranks change no bit: threads with a device each, and processes under MPI, where it is installed."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from ranks_scene import GRID, RING, SCENE, everything, extinction, of_recovery, recovery

import cloudtomo_cl as ct
from cloudtomo_cl.commands import cli
from cloudtomo_cl.inversion.bound_priors import stage_prior
from cloudtomo_cl.inversion.voxels import Voxels
from cloudtomo_cl.opencl.several import on_devices

NAMES = (
    "rendering", "replay gradient", "adaptive rendering", "fewer pixels than ranks", "fluxes", "table gradient 0",
    "table gradient 1", "table", "products", "transposed products", "curvature", "Gauss-Newton",
    "Gauss-Newton with patches", "Adam", "Adam by replay",
)  # fmt: skip
# Beginning of what ranks run; the rest has `device`.
BEGIN = f"""
import json, sys
sys.path.insert(0, {str(Path(__file__).parent)!r})
from mpi4py import MPI
import cloudtomo_cl as ct
from ranks_scene import *
device = ct.choose_device(communicator=MPI.COMM_WORLD)
"""
LONGEST = 120  # s


def mpiexec():
    """How to start ranks, without their number; None where there is no MPI."""
    beside = Path(sys.executable).with_name("mpiexec")
    found = str(beside) if beside.exists() else shutil.which("mpiexec")
    try:
        import mpi4py  # noqa: F401
    except ImportError:
        return None
    if found is None:
        return None
    said = subprocess.run([found, "--version"], capture_output=True, text=True)
    open_mpi = "Open MPI" in said.stdout or "prte" in said.stdout.lower()
    return [found, "--allow-run-as-root", "--oversubscribe"] if open_mpi else [found]


LAUNCHER = mpiexec()
with_mpi = pytest.mark.skipif(LAUNCHER is None, reason="mpi4py or mpiexec is not installed (the extra mpi, and an MPI)")


def under_mpi(size, code):
    """What ranks print that run this code."""
    command = [*LAUNCHER, "-n", str(size), sys.executable, "-c", BEGIN + code]
    done = subprocess.run(command, capture_output=True, text=True, timeout=LONGEST)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def alone(device):
    return everything(device)


@pytest.fixture(
    scope="module",
    params=["2 threads", pytest.param("3 ranks", marks=with_mpi)],
)
def shared(request):
    size, kind = int(request.param[0]), request.param[2:]
    if kind == "threads":
        return on_devices([0] * size, everything)
    return json.loads(under_mpi(size, "found = everything(device)\nif device.ranks.is_first: print(json.dumps(found))"))


@pytest.mark.parametrize("name", NAMES)
def test_ranks_change_no_bit(alone, shared, name):
    assert shared[name] == alone[name]


def test_all_that_is_shared_is_compared(alone):
    assert tuple(alone) == NAMES


def stopped(checkpoint):
    """A recovery that the last rank asks to stop after the second iteration; it is asked at ends of stages, too."""

    def work(device):
        asked = iter([False, False, device.ranks.rank == device.ranks.size - 1])
        return recovery(device, checkpoint=checkpoint, stop=lambda: next(asked, False))

    return work


@pytest.mark.parametrize("before, after", [(1, 3), (3, 2)])
def test_a_resume_may_have_another_number_of_ranks(alone, tmp_path, before, after):
    file = tmp_path / "checkpoint.npz"
    assert len(on_devices([0] * before, stopped(file)).history) == 2
    result = on_devices([0] * after, lambda device: recovery(device, resume=file))
    assert of_recovery(result) == alone["Gauss-Newton"]


@pytest.mark.parametrize("solver", [ct.Adam(), ct.Adam(gradient="replay")], ids=["table", "replay"])
def test_a_resumed_descent_may_too(alone, tmp_path, solver):
    def begin(device):
        asked = iter([False, False, False, True])
        return recovery(device, solver, checkpoint=tmp_path / "one.npz", stop=lambda: next(asked))

    assert len(on_devices([0, 0, 0], begin).history) == 3
    result = on_devices([0, 0], lambda device: recovery(device, solver, resume=tmp_path / "one.npz"))
    assert of_recovery(result) == alone["Adam" if solver.gradient == "adjoint" else "Adam by replay"]


def test_one_rank_writes_the_checkpoint_and_tells_of_iterations():
    told = []

    def work(device):
        def callback(record):
            told.append(("iteration", device.ranks.rank))

        return recovery(
            device, callback=callback, checkpoint=lambda one: told.append(("checkpoint", device.ranks.rank))
        )

    on_devices([0, 0], work)
    assert {rank for _, rank in told} == {0} and ("checkpoint", 0) in told


def test_rows_of_a_jacobian_are_fewer_on_each_rank(device):
    def entries(own):
        operator = ct.RadianceOperator(SCENE, RING, own, mask=np.ones(GRID.shape, bool))
        from cloudtomo_cl.transport.jacobian_average import JacobianAverage

        return own.ranks.all(JacobianAverage(operator).structure.near.count)

    (whole,), parts = on_devices([0], entries), on_devices([0] * 3, entries)
    assert sum(parts) == whole and max(parts) < 0.5 * whole


def test_a_rank_has_a_part_of_the_patch_prior():
    def tiles(own):
        voxels = Voxels(GRID, np.ones(GRID.shape, bool))
        prior = stage_prior(ct.PatchPrior(), voxels, own).frozen(extinction().reshape(-1).astype(float))
        return own.ranks.all(len(prior.inner._quadratic._stencil))

    (whole,), parts = on_devices([0], tiles), on_devices([0] * 3, tiles)
    assert sum(parts) == whole and max(parts) < 0.5 * whole


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """A folder with a scene file and what it needs."""
    tmp_path = tmp_path_factory.mktemp("files")
    ct.write_extinction(tmp_path / "cloud.nc", GRID, extinction())
    scene = tmp_path / "scene.toml"
    scene.write_text(
        '[cloud]\nfile = "cloud.nc"\n[sun]\nzenith = 30.0\n[[view]]\ntype = "ring"\ncount = 2\nheight = 2.2\n'
        f"target = {list(GRID.centre)}\nradius = 1.2\nfield_of_view = 24.0\npixels = [9, 7]\n"
    )
    return tmp_path


def images(path):
    return ct.read_measurements(path).images


def command(files, *words):
    return [str(word) if word != "scene" else str(files / "scene.toml") for word in words]


def test_devices_of_one_process_share_a_command(files, tmp_path, capsys):
    render = ("render", "scene", "--samples", 16, "--seed", 1, "--output")
    assert cli.main(command(files, *render, tmp_path / "one.nc")) == 0
    one = capsys.readouterr().out
    assert cli.main(command(files, *render, tmp_path / "two.nc", "--device", "0,0")) == 0
    assert capsys.readouterr().out.splitlines()[:2] == one.splitlines()[:2]
    np.testing.assert_array_equal(images(tmp_path / "two.nc"), images(tmp_path / "one.nc"))


@with_mpi
def test_a_command_under_mpi_talks_and_writes_once(files, tmp_path):
    render = command(files, "render", "scene", "--samples", 16, "--seed", 1, "--output")
    assert cli.main([*render, str(tmp_path / "one.nc"), "--quiet"]) == 0
    launch = [*LAUNCHER, "-n", "2", sys.executable, "-m", "cloudtomo_cl", *render, str(tmp_path / "two.nc")]
    done = subprocess.run(launch, capture_output=True, text=True, timeout=LONGEST)
    assert done.returncode == 0 and done.stdout.count("view 0") == 1, done.stderr
    np.testing.assert_array_equal(images(tmp_path / "two.nc"), images(tmp_path / "one.nc"))
    again = subprocess.run(launch, capture_output=True, text=True, timeout=LONGEST)
    assert again.returncode == 2 and again.stderr.count("two.nc: exists already") == 1


def ranks_of(process):
    """The processes of Python that a launcher has started."""
    import psutil

    return [
        one for one in psutil.Process(process.pid).children(recursive=True)
        if one.name().startswith("python") and "cloudtomo_cl" in one.cmdline()
    ]  # fmt: skip


@pytest.fixture(scope="module")
def run(files):
    """What `cloudtomo reconstruct` is given but for the folder, and the extinction that it finds when nothing dies."""
    given = command(files, "render", "scene", "--samples", 16, "--output", files / "images.nc", "--quiet")
    assert cli.main(given) == 0
    (files / "run.toml").write_text(
        '[measurements]\nfile = "images.nc"\n[run]\nuncertainty = 0\ncheckpoint_interval = 0.01\n'
        '[solver]\ninner_iterations = 8\n[prior]\ntype = "smoothness"\n[[stage]]\n'
        f"grid = {list(GRID.shape)}\nsamples = 32\niterations = 15\nwindow = 100\n"
    )
    words = ["reconstruct", str(files / "run.toml"), "--seed", "2", "--no-report", "--quiet", "--output"]
    assert cli.main([*words, str(files / "whole")]) == 0
    return words, ct.read_extinction(files / "whole" / "reconstruction.nc")[1]


@with_mpi
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM])
def test_a_rank_that_dies_ends_all_and_the_run_goes_on(run, tmp_path, number):
    """With another number of ranks, to the same bits."""
    words, expected = run
    folder = tmp_path / "run"
    launch = [*LAUNCHER, "-n", "2", sys.executable, "-m", "cloudtomo_cl", *words, str(folder)]
    process = subprocess.Popen(launch, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    deadline = time.monotonic() + LONGEST
    while not (folder / "checkpoint.npz").exists() and time.monotonic() < deadline:
        time.sleep(0.02)
    ranks = ranks_of(process)
    assert len(ranks) == 2
    os.kill(ranks[1].pid, number)
    assert process.wait(LONGEST) != 0
    assert not [one for one in ranks if one.is_running() and one.status() != "zombie"]
    assert cli.main([*words, str(folder), "--resume"]) == 0
    np.testing.assert_array_equal(ct.read_extinction(folder / "reconstruction.nc")[1], expected)
