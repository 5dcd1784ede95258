"""What a file's attributes call missing is missing, and packed values are what they stand for."""

import netCDF4
import numpy as np
import pytest
import xarray as xr

from cloudtomo_cl.errors import DataError
from cloudtomo_cl.files.missing import decode_all
from cloudtomo_cl.files.netcdf import load_dataset
from cloudtomo_cl.scene.arrays import unmasked

VALUES = np.array([1.0, 2.0, 3.0, 4.0])


def stored(path, kind, values, **attributes):
    """A file with one variable as it is given, and what of it is read."""
    with netCDF4.Dataset(path, "w") as file:
        file.createDimension("n", len(values))
        variable = file.createVariable("v", kind, ("n",), fill_value=attributes.pop("_FillValue", False))
        variable.set_auto_maskandscale(False)
        variable[:] = values
        variable.setncatts(attributes)
    return load_dataset(path)["v"].values


FILLS = {
    "_FillValue": ("f4", -999.0, {"_FillValue": np.float32(-999.0)}),
    "_FillValue of integers": ("i2", -99, {"_FillValue": np.int16(-99)}),
    "missing_value": ("f4", -999.0, {"missing_value": np.float32(-999.0)}),
    "missing_value in double": ("f4", np.float32(-999.9), {"missing_value": -999.9}),
    "two missing_values": ("f8", -2.0, {"missing_value": np.array([-1.0, -2.0])}),
    "missing_value as text": ("f8", -999.0, {"missing_value": "-999."}),
    "FillValue": ("f8", 1e20, {"FillValue": 1e20}),
    "nodata": ("i4", -1, {"nodata": -1}),
    "valid_range": ("f4", 1e9, {"valid_range": np.array([0.0, 10.0], "f4")}),
    "valid_min": ("f4", -5.0, {"valid_min": np.float32(0.0)}),
    "valid_max": ("i2", 99, {"valid_max": np.int16(50)}),
    "NaN": ("f8", np.nan, {}),
    "never written, single": ("f4", 9.969209968386869e36, {}),
    "never written, double": ("f8", 9.969209968386869e36, {}),
    "never written, short": ("i2", -32767, {}),
    "never written, int": ("i4", -2147483647, {}),
    "unsigned": ("i1", -1, {"_Unsigned": "true", "_FillValue": np.int8(-1)}),
}


@pytest.mark.parametrize("case", FILLS)
def test_a_missing_value_is_nan_and_no_other_is(tmp_path, case):
    kind, fill, attributes = FILLS[case]
    values = VALUES.copy().astype(kind)
    values[1] = fill
    read = stored(tmp_path / "file.nc", kind, values, **attributes)
    np.testing.assert_array_equal(read, [1.0, np.nan, 3.0, 4.0])


@pytest.mark.parametrize(
    ("kind", "values", "attributes", "expected"),
    [
        # An integer scale on floats must not cut them to whole numbers.
        ("f4", [20.5, 0.25], {"scale_factor": 1}, [20.5, 0.25]),
        ("i2", [41, 1], {"scale_factor": 0.5, "add_offset": 10.0}, [30.5, 10.5]),
        ("i2", [41, -1], {"scale_factor": 0.5, "missing_value": np.int16(-1)}, [20.5, np.nan]),
        ("i2", [41, 400], {"scale_factor": 0.5, "valid_max": np.int16(100)}, [20.5, np.nan]),
        ("i1", [-1, 1], {"_Unsigned": "true", "scale_factor": 0.1}, [25.5, 0.1]),
        ("f4", [1e-7, 3.0], {"scale_factor": np.float32(0.1)}, [1e-8, 0.3]),
    ],
)
def test_packed_values_are_unpacked_in_double_precision(tmp_path, kind, values, attributes, expected):
    read = stored(tmp_path / "file.nc", kind, values, **attributes)
    np.testing.assert_allclose(read, expected, rtol=1e-6)


@pytest.mark.parametrize(
    "attributes", [{"scale_factor": "a"}, {"scale_factor": 0.0}, {"scale_factor": np.nan}, {"valid_range": 5.0}]
)
def test_attributes_that_make_no_sense_are_named(tmp_path, attributes):
    with pytest.raises(DataError, match="v has"):
        stored(tmp_path / "file.nc", "f8", VALUES, **attributes)


def test_decoding_twice_changes_nothing(tmp_path):
    stored(tmp_path / "file.nc", "i2", [1, 2, -9], scale_factor=0.5, add_offset=1.0, missing_value=np.int16(-9))
    once = load_dataset(tmp_path / "file.nc")
    xr.testing.assert_identical(decode_all("twice", once), once)


def test_what_xarray_has_decoded_is_read_the_same(tmp_path):
    """A valid range counts packed values, also after xarray has unpacked them."""
    stored(tmp_path / "file.nc", "i2", [1, 200, -9], scale_factor=0.5, valid_max=np.int16(100), _FillValue=np.int16(-9))
    with xr.open_dataset(tmp_path / "file.nc") as opened:
        read = load_dataset(opened.load())["v"].values
    np.testing.assert_array_equal(read, [0.5, np.nan, np.nan])


def test_a_masked_array_is_nan_where_it_is_masked():
    masked = np.ma.masked_array([1, 2, 3], [False, True, False])
    np.testing.assert_array_equal(unmasked(masked), [1.0, np.nan, 3.0])


def test_a_small_file_that_claims_much_is_refused_at_once(tmp_path):
    path = tmp_path / "bomb.nc"
    with netCDF4.Dataset(path, "w") as file:
        file.createDimension("x", 200_000_000)
        file.createVariable("x", "f8", ("x",), chunksizes=(1000,))
    assert path.stat().st_size < 100_000
    with pytest.raises(DataError, match=r"x claims 1.6 GB in a file of .* bytes: most of it was never written"):
        load_dataset(path)
