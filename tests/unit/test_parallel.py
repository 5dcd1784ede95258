"""What ranks tell each other, by threads of this process; system/test_ranks.py has them compute, also under MPI."""

import os
import signal
import subprocess
import sys
import threading

import numpy as np
import pytest

from cloudtomo_cl.commands import ranks as of_commands
from cloudtomo_cl.errors import DataError, DeviceError, Interrupted, MissingPackageError, TransportError
from cloudtomo_cl.opencl.devices import choose_device
from cloudtomo_cl.opencl.fixed_point import summed
from cloudtomo_cl.opencl.several import on_devices
from cloudtomo_cl.parallel.launched import launched_rank, launched_ranks
from cloudtomo_cl.parallel.ranks import ALONE
from cloudtomo_cl.parallel.threads import shared_by_threads

SIZES = [1, 2, 3, 5]


def on_all(size, work):
    """What every rank returns."""
    return shared_by_threads(size, lambda ranks: ranks.all(work(ranks)))


@pytest.mark.parametrize("size", SIZES)
def test_everything_is_dealt_out_once(size):
    blocks = np.repeat(np.arange(11), 3)
    found = on_all(size, lambda ranks: ranks.dealt(blocks).own)
    assert sorted(np.concatenate(found)) == list(range(33))


@pytest.mark.parametrize("size", SIZES)
def test_blocks_are_dealt_out_whole_and_evenly(size):
    blocks = np.random.default_rng(1).permutation(np.repeat(np.arange(40), 4))
    found = on_all(size, lambda ranks: np.unique(blocks[ranks.dealt(blocks).own]))
    assert sum(map(len, found)) == 40 and max(map(len, found)) - min(map(len, found)) <= 1


@pytest.mark.parametrize("size", SIZES)
def test_gathering_undoes_taking(size, random):
    values = random.normal(size=(17, 2))

    def there_and_back(ranks):
        shares = ranks.dealt(np.arange(17) // 2)
        return shares.gathered(shares.taken(values))

    for found in on_all(size, there_and_back):
        np.testing.assert_array_equal(found, values)


@pytest.mark.parametrize("size", SIZES)
def test_parts_make_the_whole(size):
    assert [n for part in on_all(size, lambda ranks: ranks.part(7)) for n in part] == list(range(7))


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("largest", [9, 2**61])
def test_sums_are_exact(size, largest, random):
    """Python's integers know better; the larger ones' sums leave 64 bits on the way, and come back."""
    values = random.integers(-largest, largest, (size, 50)) // size

    def add(ranks):
        return ranks.sum(values[ranks.rank])

    expected = [sum(map(int, column)) for column in values.T]
    for found in on_all(size, add):
        assert found.tolist() == expected


def test_halves_that_leave_64_bits_on_the_way_come_back():
    values = np.array([[2**62], [2**62], [-(2**62) - 5]])
    assert [found.tolist() for found in on_all(3, lambda ranks: ranks.sum(values[ranks.rank]))] == [[2**62 - 5]] * 3


def test_a_sum_that_does_not_fit_is_found():
    many = np.array([2**62 - 1])
    with pytest.raises(TransportError, match="the gradient has left the range of its 64-bit sums"):
        shared_by_threads(3, lambda ranks: summed(many, ranks, "the gradient", "voxel"))


def test_an_overflow_on_one_rank_is_told_by_all():
    told = []

    def work(ranks):
        own = np.array([np.iinfo(np.int64).min if ranks.rank == 1 else 0])
        try:
            summed(own, ranks, "a flux", "column")
        except TransportError as error:
            told.append(str(error))

    shared_by_threads(3, work)
    assert len(told) == 3 and all("a flux has left the range" in text for text in told)


def test_parts_change_hands():
    def work(ranks):
        return np.concatenate(ranks.exchange([np.full(n + 1, 10 * ranks.rank + n) for n in range(3)])).tolist()

    assert on_all(3, work) == [[0, 10, 20], [1, 1, 11, 11, 21, 21], [2, 2, 2, 12, 12, 12, 22, 22, 22]]


@pytest.mark.parametrize("failure", [DataError("no such voxel"), Interrupted("interrupted", 143)])
def test_an_error_on_one_rank_is_raised_on_all(failure):
    raised = []

    def fail(ranks):
        if ranks.rank == 1:
            raise failure

    def work(ranks):
        with pytest.raises(type(failure)) as caught:
            ranks.together(lambda: fail(ranks))
        raised.append((ranks.rank, str(caught.value), getattr(caught.value, "status", None)))

    shared_by_threads(3, work)
    status = getattr(failure, "status", None)
    expected = [(n, f"rank 1 of 3: {failure}" if n != 1 else str(failure), status) for n in range(3)]
    assert sorted(raised) == expected


def test_a_library_error_has_the_name_of_its_rank():
    def work(ranks):
        ranks.together(lambda: 1 / (1 - ranks.rank))

    with pytest.raises(DeviceError, match="rank 1 of 2: ZeroDivisionError"):
        shared_by_threads(2, work)


def test_a_rank_that_fails_alone_lets_nobody_wait_for_ever():
    def work(ranks):
        if ranks.rank == 1:
            raise DataError("alone")
        ranks.all(1)

    with pytest.raises(DataError, match="alone"):
        shared_by_threads(3, work)
    assert not [thread for thread in threading.enumerate() if thread.name.startswith("rank ")]


INTERRUPTED = """
import signal, threading, time
from cloudtomo_cl.parallel.threads import shared_by_threads

signal.signal(signal.SIGINT, signal.default_int_handler)  # also where whoever started the tests ignores it

def work(ranks):
    for exchange in range(1000):
        time.sleep(0.05)
        ranks.all(1)
        if ranks.rank == 0 and exchange == 5:  # all ranks have begun, and whoever began them waits
            print("begun", flush=True)

try:
    shared_by_threads(2, work)
except KeyboardInterrupt:
    print("at work:", sum(thread.name.startswith("rank ") for thread in threading.enumerate()))
"""


@pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
def test_control_c_ends_ranks_before_it_is_raised():
    with subprocess.Popen([sys.executable, "-c", INTERRUPTED], stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout.readline() == "begun\n"
            process.send_signal(signal.SIGINT)
            assert process.communicate(timeout=20)[0] == "at work: 0\n"
        finally:
            process.kill()


def test_other_bits_on_one_rank_are_told():
    def work(ranks):
        ranks.require_same(np.array([1.0 + (ranks.rank == 2) * 1e-16 * 3]), "the extinction")

    with pytest.raises(TransportError, match="the extinction has other bits on rank 2 than on rank 0"):
        shared_by_threads(3, work)


def test_the_devices_of_a_process_are_named(device):
    assert on_devices([0, device.name], lambda own: own.ranks.all(own.name)) == [device.name] * 2
    with pytest.raises(DeviceError, match="no OpenCL device 'no such'"):
        on_devices([0, "no such"], lambda own: None)
    with pytest.raises(DeviceError, match="no device is named"):
        on_devices([], lambda own: None)


def test_several_devices_are_not_taken_for_one(device):
    with pytest.raises(DeviceError, match="device '0,0' is several, and here one is wanted"):
        choose_device("0,0")


def launcher(monkeypatch, **variables):
    for name in ("OMPI_COMM_WORLD_SIZE", "PMI_SIZE", "SLURM_STEP_NUM_TASKS", "PMI_RANK", "SLURM_PROCID"):
        monkeypatch.delenv(name, raising=False)
    for name, value in variables.items():
        monkeypatch.setenv(name, value)


def test_without_a_launcher_there_is_one_rank(monkeypatch):
    launcher(monkeypatch, SLURM_PROCID="0", SLURM_STEP_NUM_TASKS="1")
    monkeypatch.setitem(sys.modules, "mpi4py", None)
    assert launched_ranks() is ALONE and launched_rank() == 0


def test_processes_that_know_nothing_of_each_other_are_refused(monkeypatch):
    launcher(monkeypatch, PMI_SIZE="4", PMI_RANK="3")
    monkeypatch.setitem(sys.modules, "mpi4py", None)
    monkeypatch.delitem(sys.modules, "cloudtomo_cl.parallel.mpi", raising=False)
    with pytest.raises(MissingPackageError, match=r"4 processes .* pip install 'cloudtomo-cl\[mpi\]"):
        launched_ranks()
    assert launched_rank() == 3


def test_mpi_is_not_imported_where_nobody_asks():
    assert of_commands.current() is ALONE
    code = "import sys, cloudtomo_cl as ct; ct.choose_device(); sys.exit('mpi4py' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code]).returncode == 0
