"""The folder of a reconstruction."""

import json
from dataclasses import dataclass

import numpy as np
import pytest

from cloudtomo_cl.commands.run_folder import RunFolder
from cloudtomo_cl.errors import DataError
from cloudtomo_cl.scene.grid import Grid

GRID = Grid((2, 3, 4), (0.1, 0.2, 0.3))


@dataclass(frozen=True)
class Record:
    """Some fields of an iteration."""

    stage: int
    seconds: float
    epsilon: float | None


@pytest.fixture
def begun(tmp_path):
    """A run after its first iteration."""
    folder = RunFolder(tmp_path / "runs" / "one")
    folder.begin({"seed": 3})
    folder.append(Record(0, 0.1, 0.9))
    yield folder
    folder.close()


def test_nothing_is_written_before_the_first_iteration(tmp_path):
    folder = RunFolder(tmp_path / "run")
    folder.begin({"seed": 3})
    folder.close()
    assert not folder.path.exists()


def test_settings_come_back(begun):
    assert begun.read_settings() == {"seed": 3}


def test_history_is_on_the_disk_after_each_iteration(begun):
    begun.append(Record(1, 1 / 3, 0.5))
    assert begun.history.read()["seconds"].tolist() == [0.1, 1 / 3]


def test_what_is_unknown_is_nan(begun):
    begun.append(Record(1, 0.2, None))
    assert np.isnan(begun.history.read()["epsilon"]).tolist() == [False, True]


def test_reconstruction_comes_back(begun):
    extinction = np.arange(24, dtype=np.float32).reshape(GRID.shape)
    begun.write_reconstruction(GRID, extinction, extinction > 5, {"seed": 3})
    grid, values, mask = begun.read_reconstruction()
    assert grid == GRID and np.array_equal(values, extinction) and np.array_equal(mask, extinction > 5)


def test_a_failed_write_leaves_nothing(begun):
    with pytest.raises((TypeError, ValueError)):
        begun.write_reconstruction(GRID, np.ones(GRID.shape), np.array("no mask"), {})
    assert not list(begun.path.glob("*reconstruction*")) and not list(begun.path.glob(".*"))


def test_a_folder_with_a_run_is_not_taken(begun):
    with pytest.raises(DataError, match="--overwrite"):
        RunFolder(begun.path).check_new()


def test_a_folder_with_a_run_is_taken_on_demand(begun):
    RunFolder(begun.path, overwrite=True).check_new()


def test_a_folder_with_other_files_is_taken(tmp_path):
    (tmp_path / "images.nc").touch()
    RunFolder(tmp_path).check_new()


def test_a_second_run_leaves_nothing_of_the_first(begun):
    begun.write_reconstruction(GRID, np.ones(GRID.shape), np.ones(GRID.shape, bool), {})
    second = RunFolder(begun.path, overwrite=True)
    second.begin({})
    second.append(Record(0, 0.1, None))
    second.close()
    with pytest.raises(DataError, match="no run was finished"):
        second.read_reconstruction()


def foreign_files(folder):
    """Files of somebody else's, some with names that a run needs."""
    names = ("report.html", "modelled.nc", ".draft.partial", "figures/mine.png", "figures/mine.pdf", "figures/maps.png")
    (folder / "figures").mkdir()
    for name in names:
        (folder / name).write_text("not ours")
    return [folder / name for name in names]


def test_files_of_others_are_neither_removed_nor_replaced(tmp_path):
    files = foreign_files(tmp_path)
    with pytest.raises(DataError, match="modelled.nc: no run has written it"):
        RunFolder(tmp_path).check_new()
    folder = RunFolder(tmp_path)
    folder.begin({})
    folder.append(Record(0, 0.1, None))
    folder.close()
    with pytest.raises(DataError, match="report.html: no run has written it"):
        folder.claim(folder.files.report)
    with pytest.raises(DataError, match="no run has written it"):
        RunFolder(tmp_path).check_own()
    assert [file.read_text() for file in files] == ["not ours"] * len(files)


def test_overwriting_removes_what_a_run_has_written_and_nothing_else(tmp_path):
    first = RunFolder(tmp_path)
    first.begin({})
    first.append(Record(0, 0.1, None))
    first.close()
    ours = [first.files.report, first.files.figures / "maps.pdf"]
    first.claim(*ours)
    for file in ours:
        file.write_text("ours")
    mine = [first.files.figures / "mine.png", tmp_path / ".draft.partial", first.files.figures / "scatter.png"]
    for file in mine:
        file.write_text("mine")
    second = RunFolder(tmp_path, overwrite=True)
    second.begin({})
    second.append(Record(0, 0.1, None))
    second.close()
    assert not any(file.exists() for file in ours) and all(file.read_text() == "mine" for file in mine)


def test_a_list_leads_nowhere_else(tmp_path):
    (tmp_path / "run").mkdir()
    (tmp_path / "precious").write_text("mine")
    (tmp_path / "run" / "files.json").write_text(json.dumps(["../precious", str(tmp_path / "precious")]))
    folder = RunFolder(tmp_path / "run", overwrite=True)
    folder.begin({})
    folder.append(Record(0, 0.1, None))
    folder.close()
    assert (tmp_path / "precious").read_text() == "mine"


def test_a_file_is_no_run_folder(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(DataError, match="is a file"):
        RunFolder(tmp_path / "file", overwrite=True).check_new()


def test_damaged_settings_are_named(begun):
    begun.files.settings.write_text(json.dumps({})[:-1])
    with pytest.raises(DataError, match="settings.json"):
        begun.read_settings()


def test_damaged_history_is_named(begun):
    begun.files.history.write_text("stage,seconds\n1,what\n")
    with pytest.raises(DataError, match="history.csv"):
        begun.history.read()
