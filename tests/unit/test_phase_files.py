"""Files of phase functions: what is written comes back the same, and unfit files are named as such."""

import numpy as np
import pytest
import xarray as xr

from cloudtomo_cl.errors import DataError
from cloudtomo_cl.files.phase import read_droplet_table, read_phase_function, write_phase_function
from cloudtomo_cl.scene.droplets import DropletTable
from cloudtomo_cl.scene.phase import TabulatedPhaseFunction

ANGLE = np.array([0.0, 1.0, 5.0, 40.0, 90.0, 150.0, 180.0])
SHAPES = np.array([(90.0, 60.0, 20.0, 1.0, 0.1, 0.2, 0.4), (9.0, 8.0, 5.0, 1.0, 0.1, 0.1, 0.0)])
TABLE = TabulatedPhaseFunction.normalised(ANGLE, SHAPES, (5.0, 10.0), (1.0, 0.99))
ONE = TabulatedPhaseFunction.normalised(ANGLE, SHAPES[0])


def dataset(**changes):
    """A file with both radii; `changes` replace variables, None removes one."""
    variables = {
        "angle": ("angle", ANGLE, {"units": "degree"}),
        "effective_radius": ("effective_radius", [5.0, 10.0], {"units": "um"}),
        "phase_function": (("effective_radius", "angle"), np.array(TABLE.values), {"units": "sr-1"}),
        "single_scattering_albedo": ("effective_radius", [1.0, 0.99]),
        **changes,
    }
    return xr.Dataset({name: variable for name, variable in variables.items() if variable is not None})


def read(folder, **changes):
    dataset(**changes).to_netcdf(folder / "table.nc")
    return read_phase_function(folder / "table.nc")


@pytest.mark.parametrize("table", [TABLE, ONE])
def test_what_is_written_comes_back_bit_by_bit(tmp_path, table):
    write_phase_function(tmp_path / "table.nc", table)
    assert read_phase_function(tmp_path / "table.nc") == table


def test_a_table_of_droplets_comes_back_bit_by_bit(tmp_path):
    table = DropletTable(TABLE, (2.2, 2.1), 672.0, 0.1, 1.331, 2e-8)
    write_phase_function(tmp_path / "table.nc", table, {"source": "a test"})
    assert read_droplet_table(tmp_path / "table.nc") == table


def test_mass_extinction_is_in_the_file(tmp_path):
    write_phase_function(tmp_path / "table.nc", DropletTable(TABLE, (2.0, 2.0), 672.0, 0.1, 1.331, 2e-8))
    with xr.open_dataset(tmp_path / "table.nc") as written:
        np.testing.assert_allclose(written.mass_extinction, [0.3, 0.15])  # 3 / (2 rho r_e), by hand
        assert written.mass_extinction.units == "m2 g-1"


def test_foreign_file_is_read(tmp_path):
    assert read(tmp_path) == TABLE


@pytest.mark.parametrize(
    "changes",
    [
        {"angle": ("angle", np.radians(ANGLE), {"units": "radian"})},
        {"angle": ("angle", np.radians(ANGLE).astype(np.float32), {"units": "radian"})},
        {"effective_radius": ("effective_radius", [5e-6, 1e-5], {"units": "m"})},
        {"phase_function": (("angle", "effective_radius"), np.array(TABLE.values).T, {"units": "sr^-1"})},
        {
            "phase_function": (
                ("effective_radius", "angle"),
                4 * np.pi * np.array(TABLE.values),
                {"units": "1", "normalization": "4 pi"},
            )
        },
        {"phase_function": (("effective_radius", "angle"), 3 * np.array(TABLE.values), {"normalisation": 3.0})},
        {
            "angle": ("angle", ANGLE[::-1]),
            "phase_function": (("effective_radius", "angle"), np.array(TABLE.values)[:, ::-1]),
        },
    ],
    ids=["radians", "single precision", "metres", "transposed", "4 pi", "any normalisation", "falling angles"],
)
def test_other_units_and_orders_are_the_same_table(tmp_path, changes):
    table = read(tmp_path, **changes)
    cosine = np.linspace(-1, 1, 101)
    assert table.effective_radius == pytest.approx(TABLE.effective_radius, rel=1e-12)
    for row in (0, 1):
        np.testing.assert_allclose(table.density(cosine, row), TABLE.density(cosine, row), rtol=1e-5)


def test_file_without_radii_is_one_row(tmp_path):
    table = read(
        tmp_path,
        effective_radius=None,
        single_scattering_albedo=None,
        phase_function=("angle", np.array(ONE.values[0])),
    )
    assert table == ONE


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"angle": None}, r"no variable angle\(angle\); the file has effective_radius, phase_function"),
        ({"phase_function": None}, r"no variable phase_function\(effective_radius, angle\)"),
        ({"phase_function": ("angle", np.array(ONE.values[0]))}, r"phase_function has dimensions \(angle\)"),
        ({"angle": ("angle", ANGLE, {"units": "gon"})}, "angle has units 'gon', allowed are degree"),
        (
            {"effective_radius": ("effective_radius", [5.0, 10.0], {"units": "km"})},
            "effective_radius is 5e.09 to 1e.10 um, and droplets' are .* correct its units 'km'",
        ),
        ({"angle": ("angle", ANGLE[[0, 2, 1, 3, 4, 5, 6]])}, "angle must increase: entry 2 is 1, the one before it 5"),
        ({"angle": ("angle", ANGLE / 2)}, "angle runs from 0 to 90 degrees"),
        (
            {"phase_function": (("effective_radius", "angle"), 4 * np.pi * np.array(TABLE.values))},
            r"values\[0\] integrates to 12.5664.*4 pi.*attribute normalisation",
        ),
        (
            {"phase_function": (("effective_radius", "angle"), np.array(TABLE.values), {"normalisation": "one"})},
            "the attribute normalisation of phase_function is 'one'",
        ),
        (
            {"phase_function": (("effective_radius", "angle"), -np.array(TABLE.values))},
            r"values\[0\]\[0\] must be greater than or equal to 0, is -",
        ),
        ({"single_scattering_albedo": ("effective_radius", [1.0, 1.5])}, r"single_scattering_albedo\[1\] must be less"),
        ({"angle": ("angle", list("abcdefg"))}, "angle has type .*, it must hold numbers"),
    ],
)
def test_unfit_file_is_named(tmp_path, changes, message):
    with pytest.raises(DataError, match=message) as error:
        read(tmp_path, **changes)
    assert str(tmp_path / "table.nc") in str(error.value)


def test_truncated_file_is_named(tmp_path):
    write_phase_function(tmp_path / "table.nc", TABLE)
    whole = (tmp_path / "table.nc").read_bytes()
    (tmp_path / "table.nc").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(DataError, match="table.nc: not a netCDF file, or damaged or cut short"):
        read_phase_function(tmp_path / "table.nc")


def test_phase_functions_alone_are_no_table_of_droplets(tmp_path):
    write_phase_function(tmp_path / "table.nc", TABLE)
    with pytest.raises(DataError, match="no variable extinction_efficiency"):
        read_droplet_table(tmp_path / "table.nc")


def test_a_failed_write_leaves_the_file_as_it_was(tmp_path, monkeypatch):
    write_phase_function(tmp_path / "table.nc", ONE)
    before = (tmp_path / "table.nc").read_bytes()

    def fail(*_, **__):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(xr.Dataset, "to_netcdf", fail)
    with pytest.raises(DataError, match="No space left"):
        write_phase_function(tmp_path / "table.nc", TABLE)
    assert (tmp_path / "table.nc").read_bytes() == before
    assert [path.name for path in tmp_path.iterdir()] == ["table.nc"]
