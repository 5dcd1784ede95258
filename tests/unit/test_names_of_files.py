"""Files are written and read by whatever name they have: the netCDF library takes some names for something else."""

import os

import numpy as np
import pytest

import cloudtomo_cl as ct
from cloudtomo_cl.commands.run_folder import RunFolder
from cloudtomo_cl.files.netcdf import name_for_netcdf

GRID = ct.Grid((4, 4, 4), (0.1, 0.1, 0.1))
CLOUD = np.zeros(GRID.shape, np.float32)
CLOUD[1:3, 1:3, 1:3] = 5.0
NAMES = [
    "a\\b.nc",
    "\\a.nc",
    "back\\slash/a.nc",
    " leading.nc",
    "trailing ",
    "C:/a.nc",
    "file:/a.nc",
    "http:/a.nc",
    "https:a.nc",
    "a#mode=zarr",
    "a?b%20.nc",
]
TABLE = ct.TabulatedPhaseFunction((0.0, 90.0, 180.0), (((1 / (4 * np.pi),) * 3),), (10.0,), (1.0,))


@pytest.mark.skipif(os.name == "nt", reason="such names are none there")
@pytest.mark.parametrize("name", NAMES)
def test_a_file_of_any_name_is_written_and_read(tmp_path, monkeypatch, name):
    monkeypatch.chdir(tmp_path)
    os.makedirs(os.path.dirname(name) or ".", exist_ok=True)
    ct.write_extinction(name, GRID, CLOUD)
    assert np.array_equal(ct.read_extinction(name)[1], CLOUD)
    ct.write_phase_function(name, TABLE)  # in its place
    assert ct.read_phase_function(name) == TABLE
    left = [os.path.join(folder, file) for folder, _, files in os.walk(".") for file in files]
    assert left == [os.path.join(".", name)]


@pytest.mark.skipif(os.name == "nt", reason="such names are none there")
def test_a_run_folder_may_have_any_name(tmp_path):
    folder = RunFolder(tmp_path / "C:\\runs\\one")
    folder.path.mkdir()
    folder.write_reconstruction(GRID, CLOUD, CLOUD > 0, {})
    _, extinction, mask = folder.read_reconstruction()
    assert np.array_equal(extinction, CLOUD) and np.array_equal(mask, CLOUD > 0)


def test_other_names_are_absolute_and_need_no_link(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with name_for_netcdf("cloud.nc") as name:
        assert name == str(tmp_path / "cloud.nc")
