"""Text files of clouds in the dialects that people have; mistakes have a line and a column."""

import numpy as np
import pytest

from cloudtomo_cl.clouds.readers import ReadingOptions, read_cloud
from cloudtomo_cl.errors import DataError

HEADER = "# cloud\n3 3 3\n0.05 0.05 0.02 0.06 0.10\n"
PYSHDOM = HEADER + "1 1 1 0.3 10.0\n1 1 2 0.6 10.0\n"
AT3D = "# cloud\n3,3,3\n0.05,0.05\n0.02,0.06,0.10\nx,y,z,lwc,reff\n1,1,1,0.3,10\n1,1,2,0.6,10\n"
DEPTH = (45 + 90) * 0.04


def read(folder, text, encoding="utf-8", **options):
    path = folder / "cloud.txt"
    path.write_bytes(text if isinstance(text, bytes) else text.encode(encoding))
    return read_cloud(path, ReadingOptions(**options))


DIALECTS = {
    "pyshdom": PYSHDOM,
    "AT3D": AT3D,
    "AT3D, header lines explained": AT3D.replace("3,3,3", "3,3,3   # nx,ny,nz").replace("0.05\n", "0.05 # [km]\n"),
    "i, j, k": AT3D.replace("x,y,z,lwc", "i,j,k,lwc"),
    "other columns between": "3,3,3\n.05,.05\n.02,.06,.10\nveff,x,reff,y,z,lwc\n.1,1,10,1,1,.3\n.1,1,10,1,2,.6\n",
    "columns with their units": AT3D.replace("lwc,reff", "lwc [g m-3],reff (um)"),
    "names of columns in pyshdom's": PYSHDOM.replace("1 1 1 0.3", "x y z lwc reff\n1 1 1 0.3"),
    "semicolons": AT3D.replace(",", ";"),
    "semicolons and decimal commas": AT3D.replace(",", ";").replace(".", ","),
    "tabs": AT3D.replace(",", "\t"),
    "quotes": AT3D.replace("x,y,z", '"x","y","z"'),
    "spaces about commas": AT3D.replace(",", " , "),
    "empty columns at the ends": AT3D.replace("\n", ",,\n"),
    "Fortran": PYSHDOM.replace("0.3", "3.0D-1").replace("10.0", "1.0d+01"),
    "Windows": PYSHDOM.replace("\n", "\r\n"),
    "comments between": PYSHDOM.replace("1 1 2", "# upper voxel\n\n1 1 2").replace("0.3 10.0", "0.3 10.0 # lower"),
    "levels on their own line": PYSHDOM.replace("0.05 0.05 0.02", "0.05 0.05\n0.02"),
    "levels on two lines": PYSHDOM.replace("0.06 0.10", "0.06\n0.10"),
    "SHDOM": "2 parameter LWC file\n3 3 3\n.05 .05\n.02 .06 .10\n280 279 278\n2 2 2 0.3 10.0\n2 2 3 0.6 10.0\n",
    "whole numbers with points": PYSHDOM.replace("1 1 1", "1.0 1.0 1.0"),
}


@pytest.mark.parametrize("dialect", DIALECTS)
def test_the_dialects_tell_the_same_cloud(tmp_path, dialect):
    cloud = read(tmp_path, DIALECTS[dialect])
    assert cloud.optical_depth[1, 1] == pytest.approx(DEPTH, rel=1e-6)
    assert (cloud.extinction > 0).sum() == 2 and cloud.extinction[1, 1, 2] == pytest.approx(90)
    assert cloud.grid.spacing == pytest.approx((0.05, 0.05, 0.04))


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "utf-32", "latin-1"])
def test_the_encodings_tell_the_same_cloud(tmp_path, encoding):
    cloud = read(tmp_path, PYSHDOM.replace("# cloud", "# Größe der Wolke"), encoding)
    assert cloud.optical_depth[1, 1] == pytest.approx(DEPTH, rel=1e-6)


WRONG = {
    "places in km": (PYSHDOM.replace("1 1 1", "0.05 0.05 0.06"), "line 4, column 1: 0.05 is no.*not its place in km"),
    "places in km beyond": (PYSHDOM.replace("1 1 2", "1 1 1.5"), "line 5, column 5: 1.5 is no whole number"),
    "a voxel twice": (PYSHDOM + "1 1 1 0.2 10.0\n", "line 6: the voxel 1 1 1 stands on line 4, too"),
    "outside": (PYSHDOM.replace("1 1 2", "1 1 3"), "line 5, column 5: the voxel 3 along z lies outside of 3 voxels"),
    "counted from 1": (PYSHDOM.replace("1 1 2", "1 -1 2"), "line 5, column 3: the voxel -1 along y"),
    "NaN water": (PYSHDOM.replace("0.6", "nan"), "liquid water content is missing in 1 of 27 voxels"),
    "no water": (PYSHDOM.replace("0.6", "--"), "liquid water content is missing in 1 of 27 voxels"),
    "NaN radius": (PYSHDOM.replace("0.6 10.0", "0.6 NaN"), r"effective radius is missing in .* first at \(1, 1, 2\)"),
    "NaN index": (PYSHDOM.replace("1 1 2", "nan 1 2"), "line 5, column 1: nan is no whole number"),
    "negative": (PYSHDOM.replace("0.6", "-999.0"), "attribute _FillValue|at least 0"),
    "words": (PYSHDOM.replace("0.6", "much"), "line 5, column 7: 'much' is no number"),
    "too few numbers": (PYSHDOM.replace(" 0.6 10.0", " 0.6"), "line 5 has 4 numbers"),
    "an empty column": (AT3D.replace("0.6,10", ",10"), "line 7, column 7: '' is no number"),
    "no radius": (AT3D.replace("lwc,reff", "lwc,veff"), "line 5: has the columns x, y, z, lwc, veff"),
    "another unit": (AT3D.replace("lwc,", "lwc [kg m-3],"), r"line 5, column 7: 'lwc \[kg m-3\]' must be in g m-3"),
    "no voxels": (HEADER, "has no voxels"),
    "levels fall": (PYSHDOM.replace("0.02 0.06", "0.06 0.02"), "z must be finite and increase"),
    "levels repeat": (PYSHDOM.replace("0.02 0.06", "0.06 0.06"), "z must be finite and increase"),
    "fractions of voxels": (PYSHDOM.replace("3 3 3", "3 3.5 3"), "line 2 must be nx ny nz"),
    "no spacing": (PYSHDOM.replace("0.05 0.05", "0 0.05"), "dx dy, both above 0 km"),
    "voxels beyond memory": (PYSHDOM.replace("3 3 3", "99999999 99999999 3"), "voxels"),
    "levels in metres": (PYSHDOM.replace("0.02 0.06 0.10", "20 60 100"), "must be in km, not in metres"),
    "UTF-16 without its mark": (PYSHDOM.encode("utf-16-le"), "zero bytes"),
    "a picture": (b"\x89PNG\r\n\x1a\n" + bytes(range(256)), "none of the known kinds"),
    "nothing": ("", "ends too early"),
}  # fmt: skip


@pytest.mark.parametrize("case", WRONG)
def test_what_is_wrong_has_its_line_and_column(tmp_path, case):
    text, message = WRONG[case]
    with pytest.raises(DataError, match=message):
        read(tmp_path, text)


def test_missing_water_may_be_called_clear(tmp_path):
    cloud = read(tmp_path, PYSHDOM.replace("0.6", "nan"), missing="clear")
    assert cloud.optical_depth[1, 1] == pytest.approx(45 * 0.04, rel=1e-6)
    assert "1 of 27 missing, taken as clear" in dict(cloud.readings)["liquid water content"]


@pytest.mark.parametrize(
    "options",
    [{"spacing": (1.0, 1.0, 1.0)}, {"units": "kg m-3"}, {"variable": "lwc"}, {"time": 0}, {"order": "zyx"},
     {"select": {"member": 0}}],
)  # fmt: skip
def test_options_without_effect_on_text_are_answered(tmp_path, options):
    with pytest.raises(DataError, match="has no effect"):
        read(tmp_path, PYSHDOM, **options)


@pytest.mark.parametrize("bad", ["nan", "-1", "inf", "x"])
def test_tables_of_optical_depths_hold_numbers_only(tmp_path, bad):
    np.savetxt(tmp_path / "scene.dz.2x2", np.full((2, 2), 0.1))
    (tmp_path / "scene.tau.2x2").write_text(f"1.0 2.0\n3.0 {bad}\n")
    with pytest.raises(DataError, match=r"line 2, number 2|no table of numbers"):
        read_cloud(tmp_path / "scene.tau.2x2")


def test_a_pipe_is_not_waited_for(tmp_path):
    import os

    os.mkfifo(tmp_path / "cloud.txt")
    with pytest.raises(DataError, match="a pipe or a device"):
        read_cloud(tmp_path / "cloud.txt")
