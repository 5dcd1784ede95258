"""Checkpoints: they come back, and unfit ones are named."""

import json
import os
import pickle
from pathlib import Path

import numpy as np
import pytest

from cloudtomo_cl.errors import DataError
from cloudtomo_cl.files.whole import written_whole
from cloudtomo_cl.inversion.checkpoint import Checkpoint, Checkpoints, read_checkpoint


def some_checkpoint(iterations=7, **changes):
    state = {"descent.mean": np.arange(6, dtype=np.float32).reshape(1, 2, 3) / 7, "mask": np.ones((1, 2, 3), bool)}
    fields = {
        "identity": {"seed": 3, "solver": {"step_size": 0.1}, "stage": [{"grid": [4, 4, 4]}], "mask": "sha256:ab"},
        "device": "a device",
        "stage": 1,
        "iterations": iterations,
        "seconds": 1 / 3,
        "stage_ends": [0.1],
        "history": [{"stage": 0, "cost": 1 / 7, "epsilon": None}, *({"stage": 1} for _ in range(iterations))],
        "state": state,
    }
    return Checkpoint(**{**fields, **changes})


def test_a_checkpoint_comes_back_with_its_bits(tmp_path):
    some_checkpoint().write(tmp_path / "checkpoint.npz")
    found, expected = vars(read_checkpoint(tmp_path / "checkpoint.npz")), vars(some_checkpoint())
    states = found.pop("state"), expected.pop("state")
    assert found == expected
    for name, array in states[1].items():
        np.testing.assert_array_equal(states[0][name], array)
        assert states[0][name].dtype == array.dtype


def test_writing_leaves_one_file(tmp_path):
    for iterations in (1, 2):
        some_checkpoint(iterations=iterations).write(tmp_path / "checkpoint.npz")
    assert [path.name for path in tmp_path.iterdir()] == ["checkpoint.npz"]
    assert read_checkpoint(tmp_path / "checkpoint.npz").iterations == 2


def test_a_failed_write_keeps_the_last_good_one(tmp_path, monkeypatch):
    path = tmp_path / "checkpoint.npz"
    some_checkpoint(iterations=1).write(path)

    def fail(file, *_, **options):
        file.write(b"half")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(np.lib.format, "write_array", fail)
    with pytest.raises(DataError, match="checkpoint.npz: could not be written .No space left on device"):
        some_checkpoint(iterations=2).write(path)
    assert read_checkpoint(path).iterations == 1 and list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("share", [0.0, 0.1, 0.5, 0.99])
def test_a_checkpoint_that_was_cut_short_is_named(tmp_path, share):
    path = tmp_path / "checkpoint.npz"
    some_checkpoint().write(path)
    content = path.read_bytes()
    path.write_bytes(content[: int(share * len(content))])
    with pytest.raises(DataError, match="checkpoint.npz: is no checkpoint, or damaged or cut short"):
        read_checkpoint(path)


def test_no_flipped_bit_passes_for_other_numbers(tmp_path, random):
    """Every part of the file has a check sum: a damaged checkpoint is refused, or reads the same."""
    path = tmp_path / "checkpoint.npz"
    some_checkpoint().write(path)
    content = path.read_bytes()
    refused = 0
    for position in random.choice(len(content), 200, replace=False):
        damaged = bytearray(content)
        damaged[position] ^= 1 << int(random.integers(8))
        path.write_bytes(damaged)
        try:
            found = read_checkpoint(path)
        except DataError:
            refused += 1
            continue
        same = {name: array for name, array in found.state.items() if name in some_checkpoint().state}
        for name, array in same.items():
            np.testing.assert_array_equal(array, some_checkpoint().state[name])
        assert found.history == some_checkpoint().history
    assert refused > 50


class Malicious:
    """Unpickled, it makes a file."""

    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return os.mkdir, (str(self.path),)


@pytest.mark.parametrize("kind", ["array of objects", "bare pickle"])
def test_no_pickle_is_read(tmp_path, kind):
    path, trap = tmp_path / "checkpoint.npz", tmp_path / "trap"
    if kind == "bare pickle":
        path.write_bytes(pickle.dumps(Malicious(trap)))
    else:
        with open(path, "wb") as file:
            np.savez(file, header=np.array([Malicious(trap)], dtype=object))
    with pytest.raises(DataError, match="is no checkpoint"):
        read_checkpoint(path)
    assert not trap.exists()


def test_no_source_reads_pickles():
    """numpy.load reads none unless it is told to."""
    folder = Path(__file__).parents[2] / "cloudtomo_cl"
    text = "".join(path.read_text() for path in folder.rglob("*.py"))
    assert "allow_pickle=True" not in text and "import pickle" not in text


def test_another_format_is_named(tmp_path, monkeypatch):
    monkeypatch.setattr("cloudtomo_cl.inversion.checkpoint.FORMAT", 99)
    some_checkpoint().write(tmp_path / "checkpoint.npz")
    monkeypatch.undo()
    with pytest.raises(DataError, match="has format 99"):
        read_checkpoint(tmp_path / "checkpoint.npz")


def rewritten(path, header=None, arrays=None, drop=()):
    """A checkpoint file with some of it changed."""
    with np.load(path) as file:
        parts = {name: file[name] for name in file.files if name not in drop}
    parts |= arrays or {}
    if header:
        text = json.loads(bytes(parts["header"])) | header
        parts["header"] = np.frombuffer(json.dumps(text).encode(), np.uint8)
    with open(path, "wb") as file:
        np.savez(file, **parts)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"drop": ["descent.mean"]}, "descent.mean is missing or not what was written"),
        ({"drop": ["mask"]}, "mask is missing"),
        ({"arrays": {"descent.mean": np.zeros(3)}}, "descent.mean is missing or not what was written"),
        ({"arrays": {"other": np.zeros(3)}}, "other is missing or not what was written"),
        ({"header": {"iterations": 2**40}}, "its history has 7 iterations of stage 1, it says 1099511627776"),
        ({"header": {"stage": -1}}, "stage: Input should be greater than or equal to 0"),
        ({"header": {"stage": "x"}}, "stage: Input should be a valid integer"),
        ({"header": {"seconds": None}}, "seconds: Input should be a valid number"),
        ({"header": {"history": "x"}}, "history: Input should be a valid"),
        ({"header": {"more": 1}}, "more: Extra inputs are not permitted"),
    ],
)
def test_parts_that_do_not_belong_together_are_refused(tmp_path, change, message):
    path = tmp_path / "checkpoint.npz"
    some_checkpoint().write(path)
    rewritten(path, **change)
    with pytest.raises(DataError, match=message):
        read_checkpoint(path)


def test_an_absent_checkpoint_is_named(tmp_path):
    with pytest.raises(DataError, match="absent.npz: no such file"):
        read_checkpoint(tmp_path / "absent.npz")


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"seed": 4}, "seed is 4, the checkpoint's is 3"),
        ({"solver": {"step_size": 0.2}}, r"solver.step_size is 0.2, the checkpoint's is 0.1"),
        ({"stage": [{"grid": [4, 4, 5]}]}, r"stage\[0\].grid\[2\] is 5, the checkpoint's is 4"),
        ({"stage": []}, r"stage is \[\], the checkpoint's is \[.*4, 4, 4"),
        ({"mask": "sha256:cd"}, "mask holds other numbers than the checkpoint's"),
        ({"mask": None}, "mask is not given, the checkpoint's is given"),
    ],
)
def test_a_checkpoint_of_another_run_names_the_key(change, text):
    identity = some_checkpoint().identity
    some_checkpoint().check(identity)
    with pytest.raises(DataError, match=text):
        some_checkpoint().check({**identity, **change})


def test_checkpoints_are_taken_first_then_when_it_is_time_and_at_ends(monkeypatch):
    clock = [0.0]
    monkeypatch.setattr("cloudtomo_cl.inversion.checkpoint.time.monotonic", lambda: clock[0])
    taken = []
    checkpoints = Checkpoints(taken.append, 60.0)
    for iteration in range(1, 10):
        clock[0] += 25.0
        checkpoints.take(iteration == 1, 0, iteration, lambda: iteration)  # noqa: B023
    checkpoints.take(True, 0, 9, lambda: "end")
    checkpoints.take(True, 0, 9, lambda: "the same end")
    assert taken == [1, 4, 7, "end"]


def test_slow_checkpoints_are_rare(monkeypatch):
    clock = [0.0]
    monkeypatch.setattr("cloudtomo_cl.inversion.checkpoint.time.monotonic", lambda: clock[0])

    def slow(checkpoint):
        taken.append(checkpoint)
        clock[0] += 30.0

    taken = []
    checkpoints = Checkpoints(slow, 60.0)
    for iteration in range(100):
        clock[0] += 10.0
        checkpoints.take(False, 0, iteration, lambda: iteration)  # noqa: B023
    # 30 s every 630 s or more, not every 90 s.
    assert len(taken) == 2


def test_a_file_is_replaced_only_when_it_is_whole(tmp_path):
    path = tmp_path / "file"
    path.write_text("old")
    with pytest.raises(KeyboardInterrupt), written_whole(path) as partial:
        partial.write_text("ne")
        raise KeyboardInterrupt
    assert path.read_text() == "old" and list(tmp_path.iterdir()) == [path]
