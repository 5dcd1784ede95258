"""One run at a time in a folder."""

import json
import os
import platform
import subprocess
import sys

import pytest

from cloudtomo_cl.commands import folder_lock
from cloudtomo_cl.commands.folder_lock import held
from cloudtomo_cl.errors import DataError

HOLD = """
import sys
from pathlib import Path
from cloudtomo_cl.commands.folder_lock import held
with held(Path(sys.argv[1])):
    print("holds", flush=True)
    sys.stdin.read()
"""


@pytest.fixture
def other(tmp_path):
    """Another process, which holds the folder."""
    words = [sys.executable, "-c", HOLD, str(tmp_path / "run")]
    process = subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    assert process.stdout.readline() == "holds\n"
    yield process
    process.kill()
    process.wait()


def test_a_second_run_is_refused_by_the_name_of_the_first(tmp_path, other):
    owner = rf"process {other.pid} on {platform.node()}, since 20"
    with pytest.raises(DataError, match=owner), held(tmp_path / "run"):
        pytest.fail("two runs in one folder")


def test_the_folder_is_free_when_its_run_has_ended(tmp_path, other):
    other.communicate("", timeout=30)
    with held(tmp_path / "run"):
        assert (tmp_path / "run" / ".lock").exists()
    assert not (tmp_path / "run").exists()


def test_a_run_that_was_killed_holds_nothing(tmp_path, other):
    other.kill()
    other.wait()
    assert (tmp_path / "run" / ".lock").exists()
    with held(tmp_path / "run"):
        pass


def test_a_folder_stays_that_something_was_written_into(tmp_path):
    with held(tmp_path / "many" / "run"):
        (tmp_path / "many" / "run" / "file").touch()
    assert os.listdir(tmp_path / "many" / "run") == ["file"]


def test_a_lock_is_not_taken_from_a_run_that_is_about_to_begin(tmp_path, monkeypatch):
    """The first one removes its name between the second one's opening and locking: that lock would hold nothing."""
    original, first = folder_lock._lock, held(tmp_path)
    first.__enter__()
    ended = []

    def late(descriptor, path):
        if not ended:
            ended.append(first.__exit__(None, None, None))
        original(descriptor, path)

    monkeypatch.setattr(folder_lock, "_lock", late)
    with held(tmp_path):
        monkeypatch.undo()
        with pytest.raises(DataError, match="another run"), held(tmp_path):
            pytest.fail("two runs in one folder")


@pytest.mark.parametrize(
    ("owner", "free"),
    [
        ({"host": platform.node(), "process": os.getppid()}, False),
        ({"host": platform.node(), "process": 2**22 + 1}, True),
        ({"host": "another", "process": 2**22 + 1}, False),
        ({}, True),
    ],
    ids=["alive", "dead", "of another machine", "unknown"],
)
def test_where_there_are_no_locks_the_owner_decides(tmp_path, monkeypatch, owner, free):
    fcntl = pytest.importorskip("fcntl")

    def no_locks(*_):
        raise OSError(95, "Operation not supported")

    monkeypatch.setattr(fcntl, "flock", no_locks)
    (tmp_path / ".lock").write_text(json.dumps(owner) if owner else "")
    if free:
        with held(tmp_path):
            pass
    else:
        with pytest.raises(DataError, match="another run is at work"), held(tmp_path):
            pytest.fail("two runs in one folder")
