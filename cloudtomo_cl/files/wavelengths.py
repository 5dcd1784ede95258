"""The coordinate `wavelength` of files: what is of one wavelength stacked into one file, and taken out of it again.

xarray is imported where it is used: importing this package is fast.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from cloudtomo_cl.arguments import NUMBER, require_kinds
from cloudtomo_cl.errors import DataError
from cloudtomo_cl.files.netcdf import Source, factor_of, load_dataset, name_of, number_variable

if TYPE_CHECKING:
    import xarray as xr

WAVELENGTH = "wavelength"
UNITS = "nm"
# Wavelengths that differ by less than this share are one: 672 nm are 0.672 um, whatever a conversion's rounding.
_SAME = 1e-5
# Of wavelengths without units, the least that is taken as nm: less is likely one in micrometres.
_SHORTEST = 100.0
_ATTRIBUTES = {"units": UNITS, "long_name": "wavelength in air", "standard_name": "radiation_wavelength"}
_HOW = (
    "choose one: [measurements] wavelength in a run file, [spectrum] wavelengths in a scene file, --wavelength of "
    "cloudtomo cloud, or wavelength=... in Python"
)


def is_same(one: float, other: float) -> bool:
    """Whether two wavelengths are one, but for rounding."""
    return abs(one - other) <= _SAME * abs(other)


def wavelength_coordinate(wavelength: float | Sequence[float]) -> tuple[tuple[str, ...], np.ndarray, dict[str, str]]:
    """The coordinate of one wavelength (without a dimension) or of several, nm."""
    values = np.asarray(wavelength, dtype=np.float64)
    return (WAVELENGTH,) * values.ndim, values, dict(_ATTRIBUTES)


def stacked(
    name: str, datasets: Sequence[xr.Dataset], wavelengths: Sequence[float | None], changing: Sequence[str]
) -> xr.Dataset:
    """Datasets that differ by their wavelength as one.

    Parameters
    ----------
    name : what errors call it
    datasets : each of one wavelength
    wavelengths : of them, nm
    changing : the variables that depend on it; the first dataset's others are kept

    Raises
    ------
    DataError : a wavelength is not known, or they do not increase
    """
    known = [wavelength for wavelength in wavelengths if wavelength is not None]
    if len(known) < len(wavelengths):
        raise DataError(f"{name}: several images go into one file by their wavelengths: give each its own (nm)")
    if not (np.diff(known) > 0).all():
        raise DataError(f"{name}: the wavelengths are {_listed(known)}: they must increase")
    variables = {
        key: (
            (WAVELENGTH, *datasets[0][key].dims),
            np.stack([dataset[key].values for dataset in datasets]),
            datasets[0][key].attrs,
        )
        for key in changing
        if key in datasets[0]
    }
    coordinate = {WAVELENGTH: wavelength_coordinate(known)}
    return datasets[0].drop_vars(WAVELENGTH, errors="ignore").assign(variables).assign_coords(coordinate)


def wavelengths_of(path: Any, dataset: xr.Dataset) -> tuple[float, ...]:
    """The wavelengths of a dataset, nm; none where it says none.

    Raises
    ------
    DataError : they are no numbers, in a unit of something else, or not above 0
    """
    if WAVELENGTH not in dataset.variables:
        return ()
    variable = dataset[WAVELENGTH]
    variable = number_variable(path, dataset, WAVELENGTH, (WAVELENGTH,) if variable.ndim else ())
    factor, stated = factor_of(path, WAVELENGTH, variable.attrs.get("units"), UNITS)
    values = np.ravel(variable.values.astype(np.float64) * factor)
    if not stated and (values < _SHORTEST).any():
        raise DataError(f"{path}: wavelength has no units, and is {values.min():g}: set its attribute units, likely um")
    if not (np.isfinite(values) & (values > 0)).all():
        raise DataError(f"{path}: wavelength is {values.tolist()} nm: it must be greater than 0")
    # Without the noise of a unit's conversion.
    return tuple(float(f"{value:.10g}") for value in values)


def read_wavelengths(source: Source) -> tuple[float, ...]:
    """The wavelengths that a file of images, of a cloud or of phase functions holds.

    Returns
    -------
    wavelengths : nm; none where the file does not say any

    Raises
    ------
    DataError : no such file, not netCDF; wavelengths that are none
    """
    dataset = load_dataset(source)
    found = wavelengths_of(name_of(source), dataset)
    return found or ((float(dataset.attrs["wavelength_nm"]),) if "wavelength_nm" in dataset.attrs else ())


def at_wavelength(path: Any, dataset: xr.Dataset, wavelength: float | None = None) -> xr.Dataset:
    """A dataset of one wavelength: what a file holds of it.

    Parameters
    ----------
    path : what errors call it
    dataset : of a file, which may hold several wavelengths, one, or say nothing of it
    wavelength : nm; None is the only one that there is

    Raises
    ------
    DataError : it holds several and none is chosen, or has not the one that is asked for; wavelength is no number
        (InvalidArgumentError)
    """
    require_kinds(str(path), wavelength=(wavelength, NUMBER.or_none()))
    found = wavelengths_of(path, dataset)
    if wavelength is None and len(found) > 1:
        raise DataError(f"{path}: holds {_listed(found)}: {_HOW}")
    if wavelength is None and not found:
        return dataset
    if not found:
        raise DataError(f"{path}: does not say its wavelength, so none can be chosen: leave out {wavelength:g} nm")
    place = 0 if wavelength is None else next((n for n, one in enumerate(found) if is_same(one, wavelength)), None)
    if place is None:
        raise DataError(f"{path}: has no {wavelength:g} nm: it holds {_listed(found)}")
    if WAVELENGTH in dataset.dims:
        dataset = dataset.isel({WAVELENGTH: place})
    return dataset.assign_attrs(_attributes(dataset, place))


def _attributes(dataset: xr.Dataset, place: int) -> dict[str, Any]:
    """The settings with the scene of one wavelength in place of all."""
    try:
        settings = json.loads(dataset.attrs["settings"])
        scene = settings.pop("scenes")[place]
    except (KeyError, IndexError, TypeError, ValueError, AttributeError, RecursionError):
        return {}  # what is no settings is answered where they are read
    return {"settings": json.dumps({"scene": scene, **settings}, indent=1)}


def _listed(wavelengths: Sequence[float]) -> str:
    return ", ".join(f"{wavelength:g}" for wavelength in wavelengths) + " nm"
