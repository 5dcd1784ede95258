"""netCDF files of phase functions: those of `cloudtomo mie`, and tables from elsewhere.

xarray and the netCDF library are imported where they are used: importing this package is fast.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from cloudtomo_cl.arguments import NUMBER, PATH, a, many, require_kinds
from cloudtomo_cl.errors import DataError, InvalidSettingError
from cloudtomo_cl.files.netcdf import (
    factor_of,
    file_attributes,
    load_dataset,
    name_for_netcdf,
    netcdf_errors,
    number_variable,
)
from cloudtomo_cl.files.wavelengths import WAVELENGTH, at_wavelength, is_same, stacked, wavelengths_of
from cloudtomo_cl.files.whole import written_whole
from cloudtomo_cl.scene.droplets import DropletTable
from cloudtomo_cl.scene.phase import TabulatedPhaseFunction

if TYPE_CHECKING:
    import xarray as xr

# Of droplets, micrometres: what lies beyond is in another unit than it says.
_RADII = (1e-3, 1e4)
# Attributes of phase_function that say what its integral over the sphere is, and how they may say it.
_NORMALISATION_NAMES = ("normalisation", "normalization")
_NORMALISATIONS = {"1": 1.0, "4 pi": 4 * np.pi, "4pi": 4 * np.pi, "4*pi": 4 * np.pi}
# The first and the last angle may miss 0 and 180 degrees by this much: single precision, in radians.
_ANGLE_ROUNDING = 1e-4
# The refractive index, an attribute of tables of one wavelength and a variable of those of several.
_INDEX = {
    "refractive_index_real": "real part of the droplets' refractive index",
    "refractive_index_imag": "imaginary part of the droplets' refractive index, which absorbs",
}
_NUMBERS_OF_A_TABLE = ("wavelength_nm", "effective_variance", "refractive_index_real", "refractive_index_imag")


def read_phase_function(path: str | os.PathLike[str], wavelength: float | None = None) -> TabulatedPhaseFunction:
    """Reads a phase function from a netCDF file.

    Variables: `angle` (degree, or radian), rising from 0 to 180 degrees or falling;
    `phase_function` (effective_radius, angle) or (angle), a density over the sphere in sr-1, or
    with an attribute `normalisation`, the integral over the sphere (a number, or "4 pi");
    `effective_radius` (um, or m); optional `single_scattering_albedo` (effective_radius).

    Parameters
    ----------
    path : of the file
    wavelength : nm, which of the wavelengths that the file has; one that does not say its own is taken as it is

    Raises
    ------
    DataError : no such file, not netCDF, cut short; several wavelengths of which none is chosen, or another; missing
        variables, other dimensions or units;
        a table that TabulatedPhaseFunction does not take, for instance of another normalisation
    """
    return _phase_function(path, _at(path, wavelength))


def read_droplet_table(path: str | os.PathLike[str], wavelength: float | None = None) -> DropletTable:
    """Reads what `cloudtomo mie` writes: phase functions and what else Mie's theory tells.

    Parameters
    ----------
    path, wavelength : as in `read_phase_function`

    Raises
    ------
    DataError : as `read_phase_function`; no `extinction_efficiency`, or attributes are missing
    """
    dataset = _at(path, wavelength)
    function = _phase_function(path, dataset)
    efficiency = _numbers(path, dataset, "extinction_efficiency", ("effective_radius",), "1")
    numbers = {}
    for name in _NUMBERS_OF_A_TABLE:
        try:
            numbers[name] = float(dataset.attrs[name] if name in dataset.attrs else dataset[name])
        except (KeyError, TypeError, ValueError):
            raise DataError(
                f"{path}: no number in the attribute {name}: make the table again with cloudtomo mie"
            ) from None
    return DropletTable(function, tuple(efficiency.tolist()), **numbers)


def _at(path: Any, wavelength: float | None) -> xr.Dataset:
    """What a file of one or several wavelengths has of one; with one, its number is an attribute."""
    require_kinds(str(path), wavelength=(wavelength, NUMBER.or_none()))
    dataset = load_dataset(path)
    if WAVELENGTH in dataset.variables:
        dataset = at_wavelength(path, dataset, wavelength)
        return dataset.assign_attrs(wavelength_nm=wavelengths_of(path, dataset)[0])
    alone = dataset.attrs.get("wavelength_nm")
    if wavelength is not None and isinstance(alone, (int, float, np.number)) and not is_same(float(alone), wavelength):
        raise DataError(f"{path}: has no {wavelength:g} nm: it holds {alone:g} nm")
    return dataset


def write_phase_function(
    path: str | os.PathLike[str],
    table: TabulatedPhaseFunction | DropletTable | Sequence[DropletTable],
    attributes: Mapping[str, Any] | None = None,
) -> None:
    """Writes phase functions as `read_phase_function` reads them, in double precision.

    Parameters
    ----------
    path : of the file; it is replaced whole or not at all
    table : phase functions alone, or with all that Mie's theory tells of the droplets; or several of these, of
        different wavelengths and the same angles, radii and variance, as `droplet_tables` makes them
    attributes : of the file, text or numbers; mappings are stored as JSON

    Raises
    ------
    DataError : the file cannot be written; tables that do not go into one
    """
    one = a(TabulatedPhaseFunction, DropletTable)
    require_kinds("write_phase_function", path=(path, PATH), table=(table, one.or_(many(DropletTable))))
    if isinstance(table, (TabulatedPhaseFunction, DropletTable)):
        dataset = _dataset(table, attributes)
    else:
        dataset = _several(path, table, attributes)
    encoding = {name: {"_FillValue": None} for name in dataset.variables}
    with written_whole(path) as partial, name_for_netcdf(partial) as name, netcdf_errors():
        dataset.to_netcdf(name, engine="netcdf4", format="NETCDF4", encoding=encoding)


def _several(path: Any, tables: Sequence[DropletTable], attributes: Mapping[str, Any] | None) -> xr.Dataset:
    """Tables by their wavelength; one alone is as ever."""
    if not len(tables):
        raise DataError(f"{path}: there is no table to write")
    if len(tables) == 1:
        return _dataset(tables[0], attributes)
    common = [(t.phase_function.angle, t.phase_function.effective_radius, t.effective_variance) for t in tables]
    if any(other != common[0] for other in common):
        raise DataError(f"{path}: tables of one file have the same angles, radii and variance: use droplet_tables")
    datasets = [_dataset(table, attributes) for table in tables]
    changing = ("phase_function", "single_scattering_albedo", "extinction_efficiency", "mass_extinction")
    dataset = stacked(str(path), datasets, [table.wavelength_nm for table in tables], changing)
    for name, text in _INDEX.items():
        values = np.array([getattr(table, name) for table in tables])
        dataset[name] = (WAVELENGTH, values, {"long_name": text, "units": "1"})
    for name in ("wavelength_nm", *_INDEX):
        del dataset.attrs[name]
    return dataset


def _dataset(table: TabulatedPhaseFunction | DropletTable, attributes: Mapping[str, Any] | None) -> xr.Dataset:
    """Of one wavelength."""
    import xarray as xr

    function = table.phase_function if isinstance(table, DropletTable) else table
    per_radius = ("effective_radius",) if function.effective_radius else ()
    values = np.array(function.values)

    def described(name: str, units: str) -> dict[str, str]:
        return {"long_name": name, "units": units}

    def by_radius(numbers: Any) -> np.ndarray:
        return np.array(numbers) if per_radius else np.array(numbers[0])

    coordinates: dict[str, Any] = {
        "angle": ("angle", np.array(function.angle), described("scattering angle", "degree"))
    }
    if per_radius:
        radius = described("effective radius of the droplets", "um")
        coordinates["effective_radius"] = (per_radius, np.array(function.effective_radius), radius)
    variables: dict[str, Any] = {
        "phase_function": (
            (*per_radius, "angle"),
            values if per_radius else values[0],
            {
                **described("phase function, linear in the cosine of the angle between the angles", "sr-1"),
                "normalisation": 1.0,
            },
        )
    }
    if function.single_scattering_albedo is not None:
        albedo = by_radius(function.single_scattering_albedo)
        variables["single_scattering_albedo"] = (per_radius, albedo, described("single-scattering albedo", "1"))
    about = file_attributes("phase functions of cloud droplets", attributes)
    if isinstance(table, DropletTable):
        efficiency = described("extinction over geometric cross-section", "1")
        variables["extinction_efficiency"] = (per_radius, by_radius(table.extinction_efficiency), efficiency)
        mass = described("extinction of a gram of liquid water", "m2 g-1")
        variables["mass_extinction"] = (per_radius, by_radius(table.mass_extinction), mass)
        about.update({name: getattr(table, name) for name in _NUMBERS_OF_A_TABLE})
    return xr.Dataset(variables, coordinates, about)


def _phase_function(path: Any, dataset: xr.Dataset) -> TabulatedPhaseFunction:
    per_radius = ("effective_radius",) if "effective_radius" in dataset.dims else ()
    angle = _numbers(path, dataset, "angle", ("angle",), "degree")
    values = _numbers(path, dataset, "phase_function", (*per_radius, "angle"), "sr-1")
    values = np.atleast_2d(values) / _declared_integral(path, dataset["phase_function"])
    radius = _numbers(path, dataset, "effective_radius", per_radius, "um") if per_radius else np.array([])
    if len(radius) and not (_RADII[0] <= radius.min() and radius.max() <= _RADII[1]):
        raise DataError(
            f"{path}: effective_radius is {radius.min():g} to {radius.max():g} um, and droplets' are {_RADII[0]:g} to "
            f"{_RADII[1]:g}: correct its units '{dataset['effective_radius'].attrs.get('units', '')}'"
        )
    albedo = None
    if "single_scattering_albedo" in dataset.variables:
        albedo = np.atleast_1d(_numbers(path, dataset, "single_scattering_albedo", per_radius, "1"))
    if len(angle) and angle[0] > angle[-1]:
        angle, values = angle[::-1], values[:, ::-1]
    angle = angle.copy()
    for end in (0.0, 180.0):
        angle[np.abs(angle - end) <= _ANGLE_ROUNDING] = end
    try:
        return TabulatedPhaseFunction(
            angle=tuple(angle.tolist()),
            values=tuple(map(tuple, values.tolist())),
            effective_radius=tuple(radius.tolist()),
            single_scattering_albedo=None if albedo is None else tuple(albedo.tolist()),
        )
    except InvalidSettingError as error:
        first = error.details[0]
        where = "".join(f"[{part}]" if isinstance(part, int) else str(part) for part in first["loc"])
        what = first["msg"].removeprefix("Value error, ").replace("Input should be", "must be")
        what = f"{where} {what}, is {first['input']!r}" if where else what
        if "integrates to" in what:
            what += "; or the file may say its integral in the attribute normalisation of phase_function"
        raise DataError(f"{path}: not a phase function: {what}") from None


def _declared_integral(path: Any, variable: xr.DataArray) -> float:
    """The integral over the sphere that a file says it has."""
    for name in _NORMALISATION_NAMES:
        if name in variable.attrs:
            text = str(variable.attrs[name]).strip()
            try:
                integral = _NORMALISATIONS[text] if text in _NORMALISATIONS else float(text)
            except ValueError:
                integral = np.nan
            if not (np.isfinite(integral) and integral > 0):
                raise DataError(
                    f"{path}: the attribute {name} of phase_function is '{text}': it must be the integral over the "
                    "sphere, a number or '4 pi'"
                )
            return integral
    return 1.0


def _numbers(path: Any, dataset: xr.Dataset, name: str, dims: tuple[str, ...], ours: str) -> np.ndarray:
    """A variable in our unit (that without units is taken to be in it), in double precision."""
    variable = number_variable(path, dataset, name, dims)
    units = variable.attrs.get("units")
    if ours == "sr-1" and units == "1":  # as most tables call a density over the sphere
        units = None
    values = variable.values.astype(np.float64) * factor_of(path, name, units, ours)[0]
    if np.isnan(values).any():
        raise DataError(f"{path}: {name} has missing values: a phase function must be known at every angle and radius")
    return values
