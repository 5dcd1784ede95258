"""A field as a file has it, water or extinction between voxel edges, made a `CloudVolume` of uniform voxels."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from cloudtomo_cl.clouds.volume import CloudVolume, uniform_layers, weighted_mean
from cloudtomo_cl.errors import DataError, InvalidSettingError
from cloudtomo_cl.files.extinction import (
    LARGEST,
    PLAUSIBLE_EXTINCTION,
    check_extinction,
    check_radius,
    require_plausible,
)
from cloudtomo_cl.files.missing import require_present
from cloudtomo_cl.files.units import parse_unit
from cloudtomo_cl.memory import require
from cloudtomo_cl.scene.droplets import DropletTable, extinction_from_water
from cloudtomo_cl.scene.grid import Grid

# What a three-dimensional field may be: its units tell. Our unit of each.
OUR_UNITS = {"extinction": "km-1", "liquid water content": "g m-3", "mixing ratio": "g kg-1"}
# What the largest value of a cloud may be where nobody stated the unit, and what it can never be.
PLAUSIBLE_WATER, MOST_WATER, MOST_EXTINCTION = (0.005, 20.0), 50.0, 1e5
RADII_OF_CLOUDS = (0.1, 1000.0)
# Below zero by no more than this share of the largest value is rounding.
_ROUNDING = 1e-6

# Uniform layers that stretched ones become: a cloud of 10 km in layers of a metre.
_MOST_LAYERS, _BYTES_PER_VOXEL = 10_000, 48
# Spacings may differ by this share and count as uniform.
UNIFORM = 1e-3
# Martin, Johnson and Spice 1994: (r_v / r_e)^3, the cube of volume mean over effective radius, in maritime clouds.
_VOLUME_RADIUS_SHARE = 0.80
_WATER_DENSITY = 1e6  # g m^-3


@dataclass(frozen=True)
class ReadingOptions:
    """What a file may leave open.

    Attributes
    ----------
    variable : name of the field, where the file has several or none of the known names
    units : of the field, for files that cannot tell or do not: km-1, m-1, g m-3, kg m-3, g kg-1, kg kg-1
    spacing : voxel edges in km, for files without coordinates
    order : of the axes of a plain array, for instance "zyx"
    time : index of the time step, for files with several
    select : index along a dimension that is neither space nor time, by its name, as {"member": 3}
    missing : "refuse" missing values (NaN, masked, fill values), or take them as "clear", for the files of programs
        that write them outside of the cloud; never where air or droplets' sizes are missing in a cloud
    effective_radius : micrometres, where the file has none
    droplet_number : cm^-3, from which the effective radius follows where the file has none
    droplet_table : file of a Mie table (`cloudtomo mie`) that water becomes extinction by; by default the
        limit of large droplets
    wavelength : nm, which one, where the Mie table has several
    layer : thickness of the uniform layers that stretched ones become, km; by default the thinnest
    """

    variable: str | None = None
    units: str | None = None
    spacing: tuple[float, float, float] | None = None
    order: str = "xyz"
    time: int | None = None
    select: Mapping[str, int] | None = None
    missing: Literal["refuse", "clear"] = "refuse"
    effective_radius: float | None = None
    droplet_number: float | None = None
    droplet_table: Path | None = None
    wavelength: float | None = None
    layer: float | None = None


@dataclass(frozen=True, eq=False)
class Quantity:
    """A variable as it was read.

    Attributes
    ----------
    name : of the variable, or where in a file it stands
    kind : extinction, liquid water content, mixing ratio, effective radius or air density
    values : in our unit, over x, y, z
    unit : as it was stated, or guessed
    stated : whether a file or a user said it
    wavelength : nm, of an extinction, as `CloudVolume.wavelength`
    """

    name: str
    kind: str
    values: np.ndarray
    unit: str
    stated: bool
    wavelength: float | None = None

    def text(self, became: str = "") -> str:
        """For people."""
        missing = int(np.isnan(self.values).sum())
        what = f"; {missing} of {self.values.size} missing{became}" if missing else "; none missing"
        return f"{self.name}, {self.unit} ({'stated' if self.stated else 'guessed'}){what}"


def field_kind(path: Any, units: str) -> tuple[str, float]:
    """What a field is by its units, and the factor to km^-1, g m^-3 or g kg^-1."""
    unit = parse_unit(units)
    for kind, ours in OUR_UNITS.items():
        wanted = parse_unit(ours)
        if unit is not None and wanted is not None and unit.dimension == wanted.dimension:
            return kind, unit.factor / wanted.factor
    allowed = "km-1, m-1, g m-3, kg m-3, g kg-1 or kg kg-1"
    raise DataError(f"{path}: the field has units '{units}', allowed are {allowed}: say them with --units")


def cloud_volume(
    path: Any,
    field: Quantity,
    edges: list[np.ndarray],
    radius: Quantity | None,
    options: ReadingOptions,
    readings: tuple[tuple[str, str], ...] = (),
) -> CloudVolume:
    """A field of extinction or of liquid water content between voxel edges (km), x and y uniform.

    Raises
    ------
    DataError : missing values that nobody called clear; values that are negative, not finite, zero everywhere, or
        unlike any cloud's where nobody stated the unit; a radius that is missing in the cloud; options without effect
    """
    if options.wavelength is not None and options.droplet_table is None:
        raise DataError(f"{path}: --wavelength has no effect: it chooses from a --droplet-table; leave it out")
    values, became = _known(path, field, options)
    if not values.any():
        raise DataError(f"{path}: {field.kind} is zero in every voxel: there is no cloud in this file")
    _require_plausible_field(path, field, float(values.max()))
    sizes, said_of_radius = _known_radius(path, values, field.kind, radius, options)
    if field.kind == "extinction":
        if options.droplet_table is not None:
            raise DataError(f"{path}: --droplet-table has no effect: the file holds extinction; leave it out")
        extinction, wavelength = values, field.wavelength
    else:
        if sizes is None:
            raise DataError(
                f"{path}: holds water content but no effective radius, which extinction depends on: "
                f"add --effective-radius (um) or --droplet-number (cm^-3)"
            )
        try:
            table = _droplet_table(options)
            extinction = extinction_from_water(values, sizes, table)
            wavelength = 0.0 if table is None else table.wavelength_nm
        except DataError as error:
            raise DataError(f"{path}: {error}") from None
    grid, extinction, sizes = _on_uniform_voxels(path, edges, extinction, sizes, options)
    rows = [(field.kind, field.text(became)), *readings]
    if said_of_radius:
        rows.append(("radius of droplets", said_of_radius))
    return CloudVolume(grid, extinction, sizes, wavelength, tuple(rows))


def _known(path: Any, field: Quantity, options: ReadingOptions) -> tuple[np.ndarray, str]:
    """The field's values with what is missing refused or called clear, and what became of it in words."""
    values = np.asarray(field.values, dtype=np.float64)
    missing, became = np.isnan(values), ""
    if missing.any() and options.missing == "clear":
        became, values = ", taken as clear", np.where(missing, 0.0, values)
    require_present(path, field.kind, values, "if they are clear air, add --missing clear")
    wrong = ~(np.isfinite(values) & (values >= 0) & (values < LARGEST))
    if wrong.any():
        # Models leave rounding errors below zero behind.
        if np.isfinite(values).all() and values.max() < LARGEST and values.min() > -_ROUNDING * values.max():
            became += f"; {int(wrong.sum())} below 0 by rounding, taken as 0"
            values = np.maximum(values, 0.0)
        else:
            check_extinction(path, field.kind, values)
    return values, became


def _require_plausible_field(path: Any, field: Quantity, largest: float) -> None:
    if field.kind == "extinction":
        if not field.stated:
            require_plausible(path, field.name, largest, "km-1", PLAUSIBLE_EXTINCTION)
        elif largest > MOST_EXTINCTION:
            raise DataError(
                f"{path}: {field.name} is {largest:g} km^-1 at most, and no cloud has over {MOST_EXTINCTION:g}: "
                f"it is something else, its units '{field.unit}' are wrong, or it marks missing values unsaid"
            )
    elif not field.stated:
        require_plausible(path, field.name, largest, "g m-3", PLAUSIBLE_WATER)
    elif largest > MOST_WATER:
        raise DataError(
            f"{path}: {field.name} is {largest:g} g m-3 at most, and no cloud holds more than {MOST_WATER:g}: it is "
            f"something else (air?), or its units '{field.unit}' are wrong: choose another --variable, or --units"
        )


def _on_uniform_voxels(
    path: Any, edges: list[np.ndarray], extinction: np.ndarray, radius: np.ndarray | None, options: ReadingOptions
) -> tuple[Grid, np.ndarray, np.ndarray | None]:
    """Grid, extinction and radius in layers of one thickness."""
    heights, layers = _above_ground(path, edges[2], extinction)
    extinction = extinction[..., layers]
    fields = [extinction] if radius is None else [extinction, extinction * np.nan_to_num(radius[..., layers])]
    steps = np.diff(heights)
    if np.ptp(steps) > UNIFORM * steps.mean() or options.layer is not None:
        _require_layers(path, extinction.shape, heights, options.layer)
        heights, fields = uniform_layers(heights, fields, options.layer)
    spacing, origin = zip(*(_edges_to_axis(values) for values in (edges[0], edges[1], heights)))
    extinction = fields[0]
    try:
        grid = Grid(extinction.shape, spacing, origin)
    except InvalidSettingError as error:
        raise DataError(f"{path}: impossible grid: {error.details[0]['msg']}") from None
    sizes = None if radius is None else weighted_mean(fields[1], extinction).astype(np.float32)
    return grid, extinction.astype(np.float32), sizes


def _require_layers(path: Any, shape: tuple[int, ...], heights: np.ndarray, layer: float | None) -> None:
    """Checks that uniform layers, as thin as the thinnest or as asked for, can be made."""
    count = (heights[-1] - heights[0]) / (np.diff(heights).min() if layer is None else layer)
    if not count < _MOST_LAYERS:
        raise DataError(
            f"{path}: would have {count:.3g} uniform layers, at most {_MOST_LAYERS} are made: choose thicker ones with "
            f"--layer DZ (km)"
        )
    voxels = shape[0] * shape[1] * round(count)
    require(_BYTES_PER_VOXEL * voxels, f"{path}: {count:.0f} uniform layers", "choose thicker ones with --layer DZ")


def _droplet_table(options: ReadingOptions) -> DropletTable | None:
    if options.droplet_table is None:
        return None
    from cloudtomo_cl.files.phase import read_droplet_table

    return read_droplet_table(options.droplet_table, options.wavelength)


def _known_radius(
    path: Any, field: np.ndarray, kind: str, radius: Quantity | None, options: ReadingOptions
) -> tuple[np.ndarray | None, str]:
    """The effective radius in cloudy voxels, micrometres, from the file or from what the user says; and in words."""
    cloudy = field > 0
    if options.effective_radius is not None and options.droplet_number is not None:
        raise DataError(f"{path}: --effective-radius and --droplet-number both give the droplets' size: choose one")
    instead = "" if radius is None else f", instead of the file's {radius.name}"
    if options.effective_radius is not None:
        sizes = np.full(field.shape, options.effective_radius)
        return np.where(cloudy, sizes, np.nan), f"{options.effective_radius:g} um, by --effective-radius{instead}"
    if options.droplet_number is not None:
        if kind != "liquid water content":
            raise DataError(f"{path}: --droplet-number has no effect: the file holds {kind}; use --effective-radius")
        # LWC = 4/3 pi rho k r_e^3 N: micrometres from g m^-3 and cm^-3.
        volume = field / (4 / 3 * np.pi * _WATER_DENSITY * _VOLUME_RADIUS_SHARE * options.droplet_number * 1e6)
        sizes = np.cbrt(volume) * 1e6
        return np.where(cloudy, sizes, np.nan), f"by --droplet-number{instead}"
    if radius is None:
        return None, ""
    sizes = np.where(cloudy, np.broadcast_to(radius.values, field.shape), np.nan)
    check_radius(path, sizes, cloudy, radius.stated)
    lower, upper = RADII_OF_CLOUDS
    for value in (sizes[cloudy].min(), sizes[cloudy].max()):
        if not lower <= value <= upper:
            raise DataError(
                f"{path}: {radius.name} is {value:g} um in the cloud, and no droplets are: they are {lower:g} to "
                f"{upper:g} um: correct its units '{radius.unit}', or say --effective-radius"
            )
    return sizes, radius.text(", none of them in the cloud")


def _above_ground(path: Any, edges: np.ndarray, extinction: np.ndarray) -> tuple[np.ndarray, slice]:
    """Edges of the layers, and which; a first level at z = 0 has half of its layer below the ground."""
    if edges[0] >= 0:
        return edges, slice(None)
    above = int(np.searchsorted(edges, 0.0))
    if not extinction[..., :above].any():
        return edges[above:], slice(above, None)
    if edges[1] > 0:
        return np.concatenate([[0.0], edges[1:]]), slice(None)
    raise DataError(f"{path}: there is cloud at z = {edges[0]:g} km, below the ground z = 0")


def _edges_to_axis(edges: np.ndarray) -> tuple[float, float]:
    """Spacing and lower end, without the rounding of single precision."""
    return round(float(edges[-1] - edges[0]) / (len(edges) - 1), 9), round(float(edges[0]), 9)


def box_edges(shape: tuple[int, ...], spacing: tuple[float, ...]) -> list[np.ndarray]:
    """Edges of uniform voxels from 0 on."""
    return [step * np.arange(count + 1) for count, step in zip(shape, spacing)]
