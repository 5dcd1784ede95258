"""Signals, closed terminals and pipes: a run ends as it should, and nothing hangs."""

import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
import xarray as xr

import cloudtomo_cl as ct
from cloudtomo_cl.commands.cli import main

pytestmark = pytest.mark.skipif(os.name != "posix", reason="signals and terminals of POSIX")
PROGRAM = [sys.executable, "-m", "cloudtomo_cl"]
GENERATE = "cloud --generate cumulus --shape 8 8 8 --spacing 0.1 0.1 0.1 --seed 1 --output cloud.nc".split()
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
inner_iterations = 5
[[stage]]
grid = [3, 3, 3]
samples = 8
iterations = 3
"""
# In the netCDF write, as xarray has just taken its lock, the program gets signals. (A handler that raises there leaves
# the lock taken for ever, and the way out waits for it.)
IN_THE_WRITE = """
import os, signal, sys, time
import xarray.backends.netCDF4_ as backend
from cloudtomo_cl.commands.cli import main
original = backend.NetCDF4DataStore.prepare_variable
def struck(self, *arguments, **options):
    self.lock.acquire()
    for _ in range({times}):
        os.kill(os.getpid(), signal.{name})
        time.sleep(0.05)
    self.lock.release()
    backend.NetCDF4DataStore.prepare_variable = original
    return original(self, *arguments, **options)
backend.NetCDF4DataStore.prepare_variable = struck
sys.exit(main(sys.argv[1:]))
"""


@pytest.fixture(scope="module")
def inputs(tmp_path_factory):
    folder = tmp_path_factory.mktemp("signals")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        (folder / "scene.toml").write_text(SCENE)
        (folder / "run.toml").write_text(RUN)
        assert main([*GENERATE, "--quiet"]) == 0
        assert main("render scene.toml --samples 16 --quiet --output images.nc".split()) == 0
    return folder


@pytest.fixture
def folder(inputs, tmp_path, monkeypatch):
    for path in inputs.iterdir():
        (tmp_path / path.name).write_bytes(path.read_bytes())
    monkeypatch.chdir(tmp_path)
    return tmp_path


def partials(folder):
    return list(folder.rglob("*.partial"))


def names(folder):
    return {path.name for path in folder.iterdir()}


@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM", "SIGHUP"])
def test_a_signal_in_the_netcdf_write_ends_after_it(folder, name):
    code = IN_THE_WRITE.format(times=1, name=name)
    words = [*GENERATE[:-1], "new.nc", "--png", "new.png"]
    done = subprocess.run([sys.executable, "-c", code, *words], timeout=60, capture_output=True, text=True)
    assert done.returncode == 128 + getattr(signal, name), done.stderr
    # The file that was being written is whole, the next one was not begun.
    assert ct.read_extinction("new.nc")[1].max() > 0 and not (folder / "new.png").exists()
    assert "Traceback" not in done.stderr and not partials(folder)


def test_a_second_signal_in_the_netcdf_write_ends_at_once(folder):
    code = IN_THE_WRITE.format(times=2, name="SIGINT")
    words = [*GENERATE, "--overwrite"]
    before = (folder / "cloud.nc").read_bytes()
    done = subprocess.run([sys.executable, "-c", code, *words], timeout=60, capture_output=True, text=True)
    assert done.returncode == 130 and (folder / "cloud.nc").read_bytes() == before and not partials(folder)


def test_a_second_signal_ends_a_program_that_hangs(folder):
    code = """
import sys, threading
from cloudtomo_cl.commands import devices
from cloudtomo_cl.commands.cli import main
def hang():
    print("hangs", flush=True)
    lock = threading.Lock()
    lock.acquire()
    with lock:
        pass
devices.run = hang
sys.exit(main(["devices"]))
"""
    process = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert process.stdout.readline() == "hangs\n"
    process.terminate()
    assert process.stderr.readline() == "\n"
    assert process.stderr.readline() == "cloudtomo devices: stopping (once more stops at once)\n"
    assert process.poll() is None
    process.terminate()
    assert process.wait(10) == 143


def test_ctrl_c_in_the_imports_is_no_traceback():
    code = """
import os, signal, sys
from cloudtomo_cl.__main__ import main
class Struck:
    def find_spec(self, name, *_):
        if name == "cloudtomo_cl.commands.cli":
            os.kill(os.getpid(), signal.SIGINT)
sys.meta_path.insert(0, Struck())
sys.exit(main())
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert (done.returncode, done.stderr) == (-signal.SIGINT, "")


def test_nothing_is_imported_before_ctrl_c_is_taken_from_python():
    """For Python's answer is a traceback."""
    code = """
import signal, sys
sys.path.insert(0, sys.argv[1])
before = set(sys.modules)
from cloudtomo_cl.__main__ import main
print(sorted(set(sys.modules) - before))
"""
    root = os.path.dirname(os.path.dirname(ct.__file__))
    done = subprocess.run([sys.executable, "-I", "-S", "-c", code, root], capture_output=True, text=True, timeout=60)
    assert done.stdout == "['__future__', 'cloudtomo_cl', 'cloudtomo_cl.__main__']\n", done.stderr


def test_a_signal_that_comes_too_late_still_has_its_status():
    """So that a shell's loop over many commands ends too."""
    code = """
import os, signal, sys, time
from cloudtomo_cl.commands import devices
from cloudtomo_cl.commands.cli import main
devices.run = lambda: (os.kill(os.getpid(), signal.SIGINT), time.sleep(0.05))[1]
sys.exit(main(["devices"]))
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert done.returncode == 130 and "all was done when it was interrupted" in done.stderr


def test_a_library_that_waits_for_its_child_is_not_interrupted():
    """As PoCL waits for its linker: a call that a signal interrupts is a kernel that does not build."""
    code = """
import ctypes, os, signal, subprocess, sys, threading
from cloudtomo_cl.commands import devices
from cloudtomo_cl.commands.cli import main
def run():
    child = subprocess.Popen(["sleep", "1"])
    threading.Timer(0.3, os.kill, (os.getpid(), signal.SIGTERM)).start()
    print(ctypes.CDLL(None).waitpid(child.pid, None, 0) == child.pid)
devices.run = run
sys.exit(main(["devices"]))
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert (done.stdout, done.returncode) == ("True\n", 143)


def test_a_pipe_that_closes_ends_quietly(folder):
    for words in (["devices"], ["cloud", "cloud.nc"], ["--help"]):
        reader, writer = os.pipe()
        os.close(reader)
        done = subprocess.run([*PROGRAM, *words], stdout=writer, stderr=subprocess.PIPE, timeout=60)
        os.close(writer)
        assert (done.returncode, done.stderr) == (0, b"")


def test_a_run_without_output_is_whole(folder):
    """What it opens first does not take the place of standard output, into which libraries write."""
    code = "import sys; from cloudtomo_cl.commands import modelled; modelled.PATHS = modelled.FEWEST_SAMPLES = 16; "
    code += "from cloudtomo_cl.__main__ import main; main()"
    command = f"exec {sys.executable} -c '{code}' reconstruct run.toml --output run 1>&- 2>&-"
    assert subprocess.run(["sh", "-c", command], timeout=120).returncode == 0
    assert names(folder / "run") >= {"reconstruction.nc", "modelled.nc", "report.html", "history.csv", "files.json"}
    assert (folder / "run" / "history.csv").read_text().startswith("stage,stages")


def test_a_library_that_could_not_write_does_not_decide_over_the_exit_status():
    """As LLVM aborts in the end, when it could not write to a terminal."""
    code = """
import ctypes, os
from cloudtomo_cl.__main__ import main
libc = ctypes.CDLL(None)
abort = ctypes.CFUNCTYPE(None)(libc.abort)
libc.__cxa_atexit(abort, None, None)
import sys
sys.argv = ["cloudtomo", "--version"]
main()
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0 and done.stdout.startswith("cloudtomo "), done.stderr


@pytest.mark.parametrize("closed", ["1>&-", "2>&-"])
def test_a_command_without_output_writes_its_file(folder, closed):
    command = f"exec {sys.executable} -m cloudtomo_cl render scene.toml --samples 8 --output new.nc {closed}"
    assert subprocess.run(["sh", "-c", command], timeout=120, capture_output=True).returncode == 0
    assert len(ct.read_measurements("new.nc").views) == 2


def test_a_disk_that_is_full_for_standard_output_is_told(folder):
    if not os.path.exists("/dev/full"):
        pytest.skip("no /dev/full")
    with open("/dev/full", "w") as full:
        done = subprocess.run([*PROGRAM, "cloud", "cloud.nc", "--output", "new.nc"], stdout=full,
                              stderr=subprocess.PIPE, text=True, timeout=60)  # fmt: skip
    assert done.returncode == 0 and "standard output could not be written (No space left" in done.stderr
    assert np.array_equal(ct.read_extinction("new.nc")[1], ct.read_extinction("cloud.nc")[1])


def test_a_terminal_that_closes_loses_nothing(folder):
    """The run is on a terminal of its own, which hangs up after some iterations."""
    import pty

    text = RUN.replace("iterations = 3", "iterations = 100000\nwindow = 100000").replace("samples = 8", "samples = 64")
    (folder / "run.toml").write_text(text)
    child, terminal = pty.fork()
    if child == 0:
        os.execv(sys.executable, [*PROGRAM, "reconstruct", "run.toml", "--output", "run"])
    history, deadline = folder / "run" / "history.csv", time.monotonic() + 60
    os.set_blocking(terminal, False)
    while not (history.exists() and len(history.read_text().splitlines()) > 2):
        assert time.monotonic() < deadline
        try:
            os.read(terminal, 65536)
        except (BlockingIOError, OSError):
            time.sleep(0.05)
    os.close(terminal)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 129
    assert ct.read_extinction(folder / "run" / "reconstruction.nc")[1].max() > 0
    with xr.open_dataset(folder / "run" / "reconstruction.nc") as dataset:
        assert "interrupted" in dataset.attrs["state"]


def test_of_two_runs_started_at_once_one_is_refused(folder):
    """By the name of the other one, which ends as if alone."""
    text = RUN.replace("iterations = 3", "iterations = 30\nwindow = 1000").replace("samples = 8", "samples = 64")
    (folder / "run.toml").write_text(text)
    words = [*PROGRAM, *"reconstruct run.toml --output run --no-report".split()]
    both = [subprocess.Popen(words, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True) for _ in range(2)]
    messages = [process.communicate(timeout=120)[1] for process in both]
    statuses = [process.returncode for process in both]
    assert sorted(statuses) == [0, 2], messages
    refused = statuses.index(2)
    assert f"another run is at work in this folder (process {both[1 - refused].pid} on " in messages[refused]
    assert len((folder / "run" / "history.csv").read_text().splitlines()) == 31
    assert not (folder / "run" / ".lock").exists()
