"""Clouds in netCDF files of models and of AT3D: fields found by units, standard names and names, units understood.

Names propose, units and attributes decide: a `density` in kg m-3 of air is no water, a `Re` without unit or shape no
radius. What was read as what stands in the cloud's `readings`.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from cloudtomo_cl.clouds.quantities import OUR_UNITS, UNIFORM, Quantity, ReadingOptions, cloud_volume, field_kind
from cloudtomo_cl.clouds.volume import CloudVolume
from cloudtomo_cl.errors import DataError
from cloudtomo_cl.files.axes import Axis, find_axes, kind_of_dimension, read_axis
from cloudtomo_cl.files.extinction import extinction_wavelength
from cloudtomo_cl.files.missing import require_present
from cloudtomo_cl.files.netcdf import Source, load_dataset, name_of, require_numbers
from cloudtomo_cl.files.units import LENGTH, MASS_DENSITY, parse_unit
from cloudtomo_cl.files.wavelengths import wavelengths_of

if TYPE_CHECKING:
    import xarray as xr

# Names that fields go by, in lower case, the likelier first.
_NAMES = {
    "extinction": ("extinction", "ext", "beta", "sigma_ext", "extinction_coefficient", "beta_ext", "kext"),
    "liquid water content": ("density", "lwc", "liquid_water_content", "cloud_water_content", "clwc"),
    "mixing ratio": (
        "ql", "qc", "qcloud", "qn", "qcl", "l", "clw", "cloud_water_mixing_ratio", "q_liquid", "clwmr",
    ),
}  # fmt: skip
WATER_NAMES = _NAMES["liquid water content"]
RADIUS_NAMES = ("effective_radius", "reff", "re", "r_eff", "rel", "re_cloud", "reffc", "effective_radius_cloud")
_AIR_NAMES = ("rho", "air_density", "rhobf", "rho0", "dn0", "rhof", "density", "dens", "rhobh", "rhoa", "rho_air")
# CF standard names, as regular expressions.
_STANDARD_NAMES = {
    "extinction": r"volume_extinction_coefficient.*cloud.*",
    "liquid water content": r"mass_concentration_of_(cloud_)?liquid_water.*_in_air",
    "mixing ratio": r"(cloud_liquid_water_mixing_ratio|mass_fraction_of_cloud_liquid_water_in_air)",
    "effective radius": r"effective_radius_of_cloud_(liquid_water|droplet|condensed_water).*",
    "air density": r"(dry_|moist_)?air_density",
}
# Words in a standard_name or long_name that say that a variable is something else than its name proposes.
_NOT_CLOUD_WATER = r"vapou?r|\brain|\bsnow|graupel|\bhail|\bice water|\bcloud ice|\bpath\b|humidity"
_OTHER_THINGS = {
    "extinction": r"backscatter|aerosol|thermal|coriolis|rossby|\bgas|\brain|lidar ratio|efficienc",
    "liquid water content": rf"\bair\b|\bfluid\b|potential density|{_NOT_CLOUD_WATER}",
    "mixing ratio": _NOT_CLOUD_WATER,
    "effective radius": r"reynolds|\brain|\bice\b|\bsnow|graupel|\bhail|earth|mean volume",
    "air density": r"water|vapou?r|\brain|\bice\b|\bsnow|number|anomaly|potential",
}
# Between two levels air's density changes by less than this share, or it cannot be interpolated (or is none).
_MOST_CHANGE = 0.08
_PLAUSIBLE_AIR = (0.01, 2.0)  # kg m^-3, from the ground to 35 km


def read_netcdf_cloud(source: Source, options: ReadingOptions) -> CloudVolume:
    """Extinction, water content or mixing ratio over x, y, z.

    Raises
    ------
    DataError : no such field, other units, coordinates that are not uniform but for the vertical one
    """
    path, dataset = Path(name_of(source)), load_dataset(source)
    if options.order != "xyz":
        raise DataError(f"{path}: --order {options.order} has no effect: the file names its dimensions; leave it out")
    name, kind, unit, stated, notes = _field(path, dataset, options)
    used: set[str] = set()
    field = _selected(path, dataset[name], dataset, options, used)
    dimensions = find_axes(path, dataset, field)
    spacing = options.spacing or (None, None, None)
    axes = {
        letter: read_axis(path, dataset, dimensions[letter], letter, length) for letter, length in zip("xyz", spacing)
    }
    factor = 1.0 if unit is None else field_kind(path, unit)[1]
    said = unit or OUR_UNITS[kind]
    values = _over(path, dataset, field, axes) * factor
    rows: list[tuple[str, str]] = [*notes]
    if kind == "mixing ratio":
        air = _air(path, dataset, name, axes, options, used)
        in_cloud = np.nan_to_num(values) > 0
        remedy = "a mixing ratio in the cloud needs it: correct the file, or store the water content in g m-3"
        require_present(path, "air density", air.values, remedy, in_cloud)
        _require_air(path, air, in_cloud)
        rows.append(("air density", air.text(", none of them in the cloud")))
        values, kind = values * np.where(in_cloud, air.values, 1.0), "liquid water content"
    radius = _radius(path, dataset, axes, options, used)
    _refuse_unused(path, options, used)
    for letter in "xy":
        steps, apart = np.diff(axes[letter].edges), np.diff(axes[letter].points)
        if max(np.ptp(steps), np.ptp(apart) if len(apart) else 0.0) > 2 * UNIFORM * steps.mean():
            raise DataError(f"{path}: {axes[letter].source} is not uniform: only vertical levels may be stretched")
    rows += [(letter, axes[letter].text()) for letter in "xyz"]
    quantity = Quantity(name, kind, values, said, stated, _wavelength(path, field) if kind == "extinction" else None)
    return cloud_volume(path, quantity, [axes[letter].edges for letter in "xyz"], radius, options, tuple(rows))


def _wavelength(path: Any, field: xr.DataArray) -> float | None:
    """At which the extinction is, as `CloudVolume.wavelength`; others' files may call something else so."""
    try:
        found = wavelengths_of(path, field.to_dataset(name="extinction"))
    except DataError:
        return None
    return found[0] if len(found) == 1 else extinction_wavelength(field)


# ---- which variable


def _words(variable: xr.DataArray) -> str:
    texts = (variable.attrs.get(name, "") for name in ("standard_name", "long_name", "description"))
    return " ".join(str(text) for text in texts).lower().replace("_", " ")


def _candidates(dataset: xr.Dataset, kind: str, names: tuple[str, ...]) -> list[str]:
    """Variables that may be of a kind: first those whose standard name says so, then those of its names."""
    by_standard = [
        str(name)
        for name, variable in dataset.variables.items()
        if re.fullmatch(_STANDARD_NAMES[kind], str(variable.attrs.get("standard_name", "")).lower())
    ]
    by_lower = {str(name).lower(): str(name) for name in dataset.variables}
    by_name = [by_lower[name] for name in names if name in by_lower]
    return list(dict.fromkeys(by_standard + by_name))


def _says_otherwise(variable: xr.DataArray, kind: str) -> str:
    """The word by which a variable says that it is something else; nothing if it does not."""
    words = _words(variable)
    if re.fullmatch(_STANDARD_NAMES[kind], str(variable.attrs.get("standard_name", "")).lower()):
        return ""
    if kind == "liquid water content" and re.search(r"\bwater\b|\blwc\b", words) and "vapo" not in words:
        words = re.sub(r"\b(in|of|per kg|per kilogram|per volume|per unit volume) (of )?(dry |moist )?air\b", "", words)
    # DALES calls its cloud water so.
    words = words.replace("liquid water specific humidity", "liquid water")
    found = re.search(_OTHER_THINGS[kind], words)
    return found.group().strip() if found else ""


def _stated_units(variable: xr.DataArray) -> str | None:
    return str(variable.attrs.get("units", "")).strip() or None


def _field(
    path: Any, dataset: xr.Dataset, options: ReadingOptions
) -> tuple[str, str, str | None, bool, tuple[tuple[str, str], ...]]:
    """Name, kind and unit of the cloud's field, whether the unit was stated, and what a person should know of it."""
    if options.variable is not None:
        return _chosen_field(path, dataset, options)
    passed: list[str] = []
    for kind, names in _NAMES.items():
        for name in _candidates(dataset, kind, names):
            variable = dataset[name]
            if variable.ndim < 3:
                continue
            other = _says_otherwise(variable, kind)
            if other:
                passed.append(f"{name} is not read as {kind}, for it says '{other}'")
                continue
            units = options.units or _stated_units(variable)
            if units is None:
                if kind == "mixing ratio":
                    raise DataError(
                        f"{path}: {name} has no units: say them with --units, for instance --units 'g kg-1'"
                    )
                return name, kind, None, False, ()
            actual = _kind_by_units(path, units, name, options)
            if actual is None or (kind == "extinction") != (actual == "extinction"):
                passed.append(f"{name} has units '{units}', which are not of {kind}")
                continue
            if actual == "liquid water content" and _is_air(variable, units):
                passed.append(f"{name} is as dense as air, and not read as water")
                continue
            return name, actual, units, True, _about_others(dataset, name, units, options)
    found = ", ".join(str(name) for name in dataset.data_vars) or "none"
    reasons = "".join(f"; {reason}" for reason in passed)
    raise DataError(
        f"{path}: no variable extinction, lwc, density, ql or qc over x, y, z{reasons}; choose one with --variable "
        f"from: {found}"
    )


def _chosen_field(
    path: Any, dataset: xr.Dataset, options: ReadingOptions
) -> tuple[str, str, str | None, bool, tuple[tuple[str, str], ...]]:
    name = options.variable
    if name not in dataset.variables:
        found = ", ".join(str(other) for other in dataset.data_vars) or "none"
        raise DataError(f"{path}: has no variable {name}: choose one with --variable from: {found}")
    assert name is not None
    units = options.units or _stated_units(dataset[name])
    if units is not None:
        return name, field_kind(f"{path}: {name}", units)[0], units, True, _about_others(dataset, name, units, options)
    kinds = [kind for kind, names in _NAMES.items() if name.lower() in names and kind != "mixing ratio"]
    if not kinds:
        raise DataError(f"{path}: {name} has no units: say them with --units, for instance --units 'g kg-1'")
    return name, kinds[0], None, False, ()


def _kind_by_units(path: Any, units: str, name: str, options: ReadingOptions) -> str | None:
    try:
        return field_kind(f"{path}: {name}", units)[0]
    except DataError:
        if options.units is not None:
            raise
        return None


def _is_air(variable: xr.DataArray, units: str) -> bool:
    """Whether a density is everywhere one of air, which no cloud's water is."""
    unit = parse_unit(units)
    values = variable.values
    if unit is None or unit.dimension != MASS_DENSITY or not np.isfinite(values).any():
        return False
    values = values[np.isfinite(values)] * unit.factor
    return bool(values.min() > 0.2 and values.max() < _PLAUSIBLE_AIR[1])


def _about_others(dataset: xr.Dataset, name: str, units: str, options: ReadingOptions) -> tuple[tuple[str, str], ...]:
    own = _stated_units(dataset[name])
    if options.units is not None and own is not None and own != options.units:
        return (("units", f"{units}, by --units, instead of the file's {own}"),)
    return ()


# ---- over x, y, z


def _selected(
    path: Any, variable: xr.DataArray, dataset: xr.Dataset, options: ReadingOptions, used: set[str]
) -> xr.DataArray:
    """One time of a variable, and one entry along each dimension that is not of space."""
    for dimension in map(str, variable.dims):
        kind, count = kind_of_dimension(dataset, dimension), variable.sizes[dimension]
        if kind in ("x", "y", "z"):
            continue
        asked = None if options.select is None else options.select.get(dimension)
        index = 0
        if asked is not None:
            used.add(dimension)
            index, option = asked, f"--select {dimension}={asked}"
        elif kind == "t" and options.time is not None:
            # A profile that is the same at all times has one.
            alone = count == 1 and "time" in used
            used.add("time")
            index, option = (0, "") if alone else (options.time, f"--time {options.time}")
        elif count > 1:
            what = "--time INDEX" if kind == "t" else f"--select {dimension}=INDEX"
            steps = "steps of" if kind == "t" else "entries along"
            raise DataError(f"{path}: {variable.name} has {count} {steps} {dimension}: choose one with {what}")
        if not -count <= index < count:
            raise DataError(f"{path}: {option}: {variable.name} has {count} entries along {dimension}")
        variable = variable.isel({dimension: index})
    return variable


def _refuse_unused(path: Any, options: ReadingOptions, used: set[str]) -> None:
    """Options that found nothing to do are answered, not ignored."""
    if options.time is not None and "time" not in used:
        raise DataError(f"{path}: --time {options.time} has no effect: nothing that is read has a time; leave it out")
    for dimension in options.select or {}:
        if dimension not in used:
            raise DataError(f"{path}: --select {dimension} has no effect: nothing that is read has this dimension")


def _over(path: Any, dataset: xr.Dataset, variable: xr.DataArray, axes: dict[str, Axis]) -> np.ndarray:
    """A variable over x, y, z along rising axes (length 1 where it has no such dimension)."""
    require_numbers(path, variable)
    for dimension in map(str, variable.dims):
        letter = kind_of_dimension(dataset, dimension)
        if dimension == axes[letter].dimension:
            continue
        if letter != "z":
            raise DataError(
                f"{path}: {variable.name} lies on {dimension}, the cloud's field on {axes[letter].dimension}: "
                f"interpolate it to the same points"
            )
        variable = _at_levels(path, dataset, variable, dimension, axes["z"])
    order = [axes[letter].dimension for letter in "xyz"]
    missing = [dimension for dimension in order if dimension not in variable.dims]
    values = variable.expand_dims(missing).transpose(*order).values.astype(np.float64)
    turned = tuple(
        slice(None, None, -1 if axes[letter].falls and axes[letter].dimension not in missing else 1) for letter in "xyz"
    )
    return values[turned]


def _at_levels(path: Any, dataset: xr.Dataset, variable: xr.DataArray, dimension: str, axis: Axis) -> xr.DataArray:
    """A variable on other levels (half levels, say) interpolated to the field's, linear in height.

    Beyond the outermost of its own levels it goes on in a line for no more than the distance of two of them.
    """
    import xarray as xr

    own = read_axis(path, dataset, dimension, "z")
    points, targets = own.points, axis.points
    if len(points) < 2 or axis.how.startswith(", by --spacing"):
        raise DataError(
            f"{path}: {variable.name} lies on {dimension}, the cloud's field on {axis.dimension}: give both heights in "
            f"m or km, or interpolate it to the same levels"
        )
    values = np.moveaxis(variable.values.astype(np.float64), variable.dims.index(dimension), -1)
    values = values[..., ::-1] if own.falls else values
    lower = np.clip(np.searchsorted(points, targets) - 1, 0, len(points) - 2)
    share = (targets - points[lower]) / (points[lower + 1] - points[lower])
    if share.min() < -1.01 or share.max() > 2.01:
        raise DataError(
            f"{path}: {variable.name} is known from {points[0]:g} to {points[-1]:g} km only, the cloud's levels lie at "
            f"{targets[0]:g} to {targets[-1]:g} km: extend it"
        )
    # A level that coincides with one of its own does not look at the next, which may be missing.
    below, above = values[..., lower], values[..., lower + 1]
    below = np.where(share == 1, above, below)
    above = np.where(share == 0, below, above)
    levels = below + share * (above - below)
    levels = levels[..., ::-1] if axis.falls else levels
    rest = [name for name in variable.dims if name != dimension]
    return xr.DataArray(levels, dims=(*rest, axis.dimension), name=variable.name)


# ---- what else is needed


def _air(
    path: Any, dataset: xr.Dataset, field: str, axes: dict[str, Axis], options: ReadingOptions, used: set[str]
) -> Quantity:
    """The density of air, kg m^-3."""
    passed = []
    for name in _candidates(dataset, "air density", _AIR_NAMES):
        variable, units = dataset[name], _stated_units(dataset[name])
        unit = parse_unit(units)
        other = _says_otherwise(variable, "air density")
        if name == field or other or variable.dtype.kind not in "fiu":
            passed.append(f"{name} says '{other}'" if other else name)
            continue
        if units is not None and (unit is None or unit.dimension != MASS_DENSITY):
            passed.append(f"{name} has units '{units}', it must have kg m-3")
            continue
        values = _over(path, dataset, _selected(path, variable, dataset, options, used), axes)
        if axes["z"].dimension not in variable.dims:
            _require_smooth(path, name, dataset, variable)
        shape = tuple(len(axes[letter].points) for letter in "xyz")
        factor = 1.0 if unit is None else unit.factor
        return Quantity(
            name, "air density", np.broadcast_to(values * factor, shape), units or "kg m-3", units is not None
        )
    reasons = "".join(f"; {reason}" for reason in passed)
    raise DataError(
        f"{path}: {field} is a mixing ratio, which needs the density of air: add a variable rho (kg m-3) "
        f"on its levels, or store the water content in g m-3{reasons}"
    )


def _require_smooth(path: Any, name: str, dataset: xr.Dataset, variable: xr.DataArray) -> None:
    """Refuses a density of air that changes too much from level to level to be interpolated to others."""
    for dimension in map(str, variable.dims):
        if kind_of_dimension(dataset, dimension) == "z" and variable.sizes[dimension] > 1:
            values = np.moveaxis(variable.values.astype(np.float64), variable.dims.index(dimension), -1)
            change = np.abs(np.diff(values, axis=-1)) / np.maximum(np.abs(values[..., 1:]), np.abs(values[..., :-1]))
            if np.nanmax(change, initial=0.0) > _MOST_CHANGE:
                raise DataError(
                    f"{path}: {name} lies on {dimension}, not on the field's levels, and changes by "
                    f"{np.nanmax(change):.0%} from one to the next, too much to interpolate: give it on those levels"
                )


def _require_air(path: Any, air: Quantity, among: np.ndarray) -> None:
    lower, upper = _PLAUSIBLE_AIR
    values = air.values[among]
    if values.size and not (lower <= values.min() and values.max() <= upper):
        raise DataError(
            f"{path}: {air.name} is {values.min():g} to {values.max():g} kg m-3 in the cloud, and air is {lower:g} to "
            f"{upper:g}: correct it, or its units '{air.unit}'"
        )


def _radius(
    path: Any, dataset: xr.Dataset, axes: dict[str, Axis], options: ReadingOptions, used: set[str]
) -> Quantity | None:
    """The droplets' effective radius, micrometres; None if no variable is one."""
    if options.effective_radius is not None or options.droplet_number is not None:
        # What the user says comes first; that the file has one too is told in the summary.
        name = next(iter(_candidates(dataset, "effective radius", RADIUS_NAMES)), None)
        return None if name is None else Quantity(name, "effective radius", np.array(np.nan), "", False)
    for name in _candidates(dataset, "effective radius", RADIUS_NAMES):
        variable, units = dataset[name], _stated_units(dataset[name])
        unit = parse_unit(units)
        if _says_otherwise(variable, "effective radius") or variable.dtype.kind not in "fiu":
            continue
        if units is None and name.lower() in ("re", "rel") and variable.ndim < 3 and "radius" not in _words(variable):
            continue  # Re, and no more: as likely a Reynolds number
        if units is not None and (unit is None or unit.dimension != LENGTH):
            if unit is not None and "radius" not in f"{name} {_words(variable)}".lower():
                continue
            raise DataError(f"{path}: {name} has units '{units}', it must have um or m")
        values = _over(path, dataset, _selected(path, variable, dataset, options, used), axes)
        shape = tuple(len(axes[letter].points) for letter in "xyz")
        factor = 1.0 if unit is None else unit.factor / 1e-6
        values = np.broadcast_to(values * factor, shape)
        return Quantity(name, "effective radius", values, units or "um", units is not None)
    return None
