"""What VTK's readers, and so ParaView, make of our files: a corner voxel is where it is."""

import numpy as np
import pytest

from cloudtomo_cl.commands.cli import main
from cloudtomo_cl.errors import DataError
from cloudtomo_cl.files.extinction import read_extinction, write_extinction
from cloudtomo_cl.files.vti import write_vti
from cloudtomo_cl.scene.grid import Grid

GRID = Grid((3, 4, 5), (0.1, 0.2, 0.3), (1.0, 2.0, 3.0))
BOUNDS = (1.0, 1.3, 2.0, 2.8, 3.0, 4.5)


@pytest.fixture
def vtk():
    """Readers of VTK; the whole of it takes a second to import."""
    reason = "needs VTK's own readers: pip install vtk (140 MB, the extra viewers)"
    pytest.importorskip("vtkmodules.vtkIOXML", reason=reason)
    from vtkmodules import vtkIONetCDF, vtkIOXML

    return {"nc": vtkIONetCDF.vtkNetCDFCFReader, "vti": vtkIOXML.vtkXMLImageDataReader}


@pytest.fixture
def extinction():
    """Other numbers in every voxel."""
    return np.arange(1.0, 61.0, dtype=np.float32).reshape(GRID.shape)


def at(data, name, point):
    """The value of the cell that a point lies in, or of the point itself."""
    if data.GetPointData().GetArray(name):
        return data.GetPointData().GetArray(name).GetValue(data.FindPoint(point))
    from vtkmodules.vtkCommonCore import reference

    cell = data.FindCell(point, None, 0, 1e-9, reference(0), [0.0] * 3, [0.0] * 8)
    return data.GetCellData().GetArray(name).GetValue(cell)


@pytest.mark.parametrize("kind", ["nc", "vti"])
def test_a_viewer_gets_the_cloud_upright(tmp_path, vtk, extinction, kind):
    path = tmp_path / f"cloud.{kind}"
    if kind == "nc":
        write_extinction(path, GRID, extinction)
    else:
        write_vti(path, GRID, {"extinction": (extinction, "km-1")})
    reader = vtk[kind]()
    reader.SetFileName(str(path))
    reader.Update()
    data = reader.GetOutput()
    # Of netCDF it makes points at the centres, of .vti the voxels themselves.
    inset = np.outer(GRID.spacing, [0.5, -0.5]).ravel() if kind == "nc" else np.zeros(6)
    assert data.GetBounds() == pytest.approx(BOUNDS + inset)
    assert at(data, "extinction", (1.25, 2.1, 3.15)) == extinction[2, 0, 0]
    assert at(data, "extinction", (1.05, 2.7, 4.35)) == extinction[0, 3, 4]


def test_a_viewer_would_bend_axes_that_are_named(tmp_path, vtk, extinction):
    """Why x and y have no attribute axis, which the CF checker would like: they are taken for angles."""
    import netCDF4

    write_extinction(tmp_path / "cloud.nc", GRID, extinction)
    with netCDF4.Dataset(tmp_path / "cloud.nc", "a") as file:
        file["x"].axis, file["y"].axis = "X", "Y"
    reader = vtk["nc"]()
    reader.SetFileName(str(tmp_path / "cloud.nc"))
    reader.Update()
    inset = np.outer(GRID.spacing, [0.5, -0.5]).ravel()
    assert reader.GetOutput().GetBounds() != pytest.approx(BOUNDS + inset)


def test_a_viewer_is_told_the_unit(tmp_path, vtk, extinction):
    write_vti(tmp_path / "cloud.vti", GRID, {"extinction": (extinction, "km-1")})
    reader = vtk["vti"]()
    reader.SetFileName(str(tmp_path / "cloud.vti"))
    reader.Update()
    array = reader.GetOutput().GetCellData().GetScalars()
    assert array.GetName() == "extinction" and array.GetInformation().Get(array.UNITS_LABEL()) == "km-1"


def test_vti_holds_the_numbers_with_x_fastest(tmp_path, extinction):
    """By hand, after VTK's page on its XML formats."""
    import zlib

    write_vti(tmp_path / "cloud.vti", GRID, {"extinction": (extinction, "km-1"), "mask": (extinction > 9, "1")})
    head, data = (tmp_path / "cloud.vti").read_bytes().split(b'<AppendedData encoding="raw">\n_')
    assert b'WholeExtent="0 3 0 4 0 5" Origin="1.0 2.0 3.0" Spacing="0.1 0.2 0.3"' in head
    for kind, expected in (("<f4", extinction), ("i1", extinction > 9)):
        blocks, size, rest, packed = np.frombuffer(data[:32], "<u8")
        assert (blocks, rest) == (1, 0)
        values = np.frombuffer(zlib.decompress(data[32 : 32 + int(packed)]), kind)
        assert size == values.nbytes and np.array_equal(values, expected.ravel(order="F"))
        data = data[32 + int(packed) :]
    assert data == b"\n</AppendedData>\n</VTKFile>\n"


def test_netcdf_is_written_as_viewers_take_for_granted(tmp_path, extinction):
    import netCDF4

    write_extinction(tmp_path / "cloud.nc", GRID, extinction)
    with netCDF4.Dataset(tmp_path / "cloud.nc") as file:
        assert file["extinction"].dimensions == ("z", "y", "x")
    assert np.array_equal(read_extinction(tmp_path / "cloud.nc")[1], extinction)


def test_a_quantity_of_another_shape_is_refused(tmp_path, extinction):
    with pytest.raises(DataError, match="c.vti: mask has shape .2, 4, 5., the grid .3, 4, 5."):
        write_vti(tmp_path / "c.vti", GRID, {"extinction": (extinction, "km-1"), "mask": (extinction[1:], "1")})
    assert not list(tmp_path.iterdir())


def test_the_command_exports_a_cloud(tmp_path, monkeypatch, extinction, capsys):
    monkeypatch.chdir(tmp_path)
    write_extinction("cloud.nc", GRID, extinction, effective_radius=extinction)
    assert main("cloud cloud.nc --vti cloud.vti".split()) == 0
    assert "cloud.vti is written" in capsys.readouterr().out
    assert (tmp_path / "cloud.vti").read_bytes().count(b"<DataArray") == 2
    assert main("cloud cloud.nc --vti cloud.nc2".split()) == 2
    assert "must end in .vti" in capsys.readouterr().err
