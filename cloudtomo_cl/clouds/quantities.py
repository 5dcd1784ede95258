"""A field as a file has it, water or extinction between voxel edges, made a `CloudVolume` of uniform voxels."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pydantic import ValidationError

from cloudtomo_cl.clouds.volume import CloudVolume, uniform_layers, weighted_mean
from cloudtomo_cl.errors import DataError
from cloudtomo_cl.scene.droplets import DropletTable, extinction_from_water
from cloudtomo_cl.scene.grid import Grid

# What a three-dimensional field may be: its units tell, and its unit here is the first factor's.
_EXTINCTIONS = {"km-1": 1.0, "1/km": 1.0, "m-1": 1e3, "1/m": 1e3}
_WATER_CONTENTS = {"gm-3": 1.0, "g/m3": 1.0, "kgm-3": 1e3, "kg/m3": 1e3}
_MIXING_RATIOS = {"gkg-1": 1.0, "g/kg": 1.0, "kgkg-1": 1e3, "kg/kg": 1e3}

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
    effective_radius : micrometres, where the file has none
    droplet_number : cm^-3, from which the effective radius follows where the file has none
    droplet_table : file of a Mie table (`cloudtomo mie`) that water becomes extinction by; by default the
        limit of large droplets
    layer : thickness of the uniform layers that stretched ones become, km; by default the thinnest
    """

    variable: str | None = None
    units: str | None = None
    spacing: tuple[float, float, float] | None = None
    order: str = "xyz"
    time: int | None = None
    effective_radius: float | None = None
    droplet_number: float | None = None
    droplet_table: Path | None = None
    layer: float | None = None


def field_kind(path: Path, units: str) -> tuple[str, float]:
    """What a field is by its units, and the factor to km^-1, g m^-3 or g kg^-1."""
    short = units.replace(" ", "").replace("^", "").replace("**", "").replace("/m**3", "/m3")
    for kind, table in (
        ("extinction", _EXTINCTIONS),
        ("liquid water content", _WATER_CONTENTS),
        ("mixing ratio", _MIXING_RATIOS),
    ):
        if short in table:
            return kind, table[short]
    allowed = "km-1, m-1, g m-3, kg m-3, g kg-1 or kg kg-1"
    raise DataError(f"{path}: the field has units '{units}', allowed are {allowed}: say them with --units")


def cloud_volume(
    path: Path,
    field: np.ndarray,
    kind: str,
    edges: list[np.ndarray],
    radius: np.ndarray | None,
    options: ReadingOptions,
) -> CloudVolume:
    """A field of extinction (km^-1) or of water content (g m^-3) between voxel edges (km), x and y uniform."""
    field = np.nan_to_num(np.asarray(field, dtype=np.float64), posinf=np.inf, neginf=-np.inf)
    wrong = ~(np.isfinite(field) & (field >= 0))
    if wrong.any():
        # Models leave rounding errors below zero behind.
        if np.isfinite(field).all() and field.min() > -1e-6 * field.max():
            field = np.maximum(field, 0.0)
        else:
            voxel = tuple(int(i) for i in np.argwhere(wrong)[0])
            raise DataError(f"{path}: {kind} at voxel {voxel} is {field[voxel]}: it must be finite and at least 0")
    if not field.any():
        raise DataError(f"{path}: {kind} is zero in every voxel: there is no cloud in this file")
    radius = _known_radius(path, field, kind, radius, options)
    if kind == "extinction":
        extinction = field
    else:
        if radius is None:
            raise DataError(
                f"{path}: holds water content but no effective radius, which extinction depends on: "
                f"add --effective-radius (um) or --droplet-number (cm^-3)"
            )
        try:
            extinction = extinction_from_water(field, radius, _droplet_table(options))
        except DataError as error:
            raise DataError(f"{path}: {error}") from None
    heights, layers = _above_ground(path, edges[2], extinction)
    extinction = extinction[..., layers]
    fields = [extinction] if radius is None else [extinction, extinction * np.nan_to_num(radius[..., layers])]
    steps = np.diff(heights)
    if np.ptp(steps) > UNIFORM * steps.mean() or options.layer is not None:
        heights, fields = uniform_layers(heights, fields, options.layer)
    spacing, origin = zip(*(_edges_to_axis(values) for values in (edges[0], edges[1], heights)))
    extinction = fields[0]
    try:
        grid = Grid(extinction.shape, spacing, origin)
    except ValidationError as error:
        raise DataError(f"{path}: impossible grid: {error.errors()[0]['msg']}") from None
    return CloudVolume(
        grid,
        extinction.astype(np.float32),
        None if radius is None else weighted_mean(fields[1], extinction).astype(np.float32),
    )


def _droplet_table(options: ReadingOptions) -> DropletTable | None:
    if options.droplet_table is None:
        return None
    from cloudtomo_cl.files.phase import read_droplet_table

    return read_droplet_table(options.droplet_table)


def _known_radius(
    path: Path, field: np.ndarray, kind: str, radius: np.ndarray | None, options: ReadingOptions
) -> np.ndarray | None:
    """The effective radius in cloudy voxels, micrometres, from the file or from what the user says."""
    if options.effective_radius is not None:
        radius = np.full(field.shape, options.effective_radius)
    elif options.droplet_number is not None and kind == "liquid water content":
        # LWC = 4/3 pi rho k r_e^3 N: micrometres from g m^-3 and cm^-3.
        volume = field / (4 / 3 * np.pi * _WATER_DENSITY * _VOLUME_RADIUS_SHARE * options.droplet_number * 1e6)
        radius = np.cbrt(volume) * 1e6
    if radius is None:
        return None
    radius = np.where(field > 0, np.broadcast_to(radius, field.shape), np.nan)
    wrong = (field > 0) & ~(np.isfinite(radius) & (radius > 0))
    if wrong.any():
        voxel = tuple(int(i) for i in np.argwhere(wrong)[0])
        raise DataError(
            f"{path}: effective radius at the cloudy voxel {voxel} is {radius[voxel]}: it must be above 0 um"
        )
    return radius


def _above_ground(path: Path, edges: np.ndarray, extinction: np.ndarray) -> tuple[np.ndarray, slice]:
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


def edges_between(path: Path, name: str, points: np.ndarray, single: float | None = None) -> np.ndarray:
    """Edges half-way between points; the outermost voxels are as wide as their neighbours' distance."""
    points = np.asarray(points, dtype=np.float64)
    if not np.isfinite(points).all() or (np.diff(points) <= 0).any():
        raise DataError(f"{path}: {name} must be finite and increase from point to point")
    if len(points) == 1:
        if single is None:
            raise DataError(f"{path}: {name} has one point only, which tells no spacing: add --spacing")
        return np.array([points[0] - single / 2, points[0] + single / 2])
    middle = (points[1:] + points[:-1]) / 2
    return np.concatenate([[2 * points[0] - middle[0]], middle, [2 * points[-1] - middle[-1]]])


def box_edges(shape: tuple[int, ...], spacing: tuple[float, ...]) -> list[np.ndarray]:
    """Edges of uniform voxels from 0 on."""
    return [step * np.arange(count + 1) for count, step in zip(shape, spacing)]
