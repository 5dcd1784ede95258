"""The scene: cloud optics, air, surface, boundary and sun.

The classes are the settings' tables: the same words and the same checks in a TOML file and
in Python. Lengths are in km, extinction in km^-1, angles in degrees.
"""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from pydantic import ConfigDict, Field, model_validator
from pydantic.dataclasses import dataclass

from cloudtomo_cl.arguments import a, require_kinds
from cloudtomo_cl.messages import answering
from cloudtomo_cl.scene.grid import Grid, resample
from cloudtomo_cl.scene.phase import HenyeyGreenstein, PhaseFunction

Fraction = Annotated[float, Field(ge=0, le=1)]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
# The limit is far beyond any air: with more, paths would scatter in one voxel without end.
_AirExtinction = Annotated[float, Field(ge=0, le=1e4)]
Angle = Annotated[float, Field(allow_inf_nan=False)]


def direction(zenith: float, azimuth: float) -> np.ndarray:
    """The unit vector from the scene towards (zenith, azimuth), in degrees.

    Azimuth runs from +x (east) towards +y (north).
    """
    theta, phi = np.radians([zenith, azimuth])
    return np.array([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)])


@answering
@dataclass(frozen=True, config=ConfigDict(extra="forbid"))
class Sun:
    """A collimated sun.

    Attributes
    ----------
    zenith, azimuth : direction towards the sun, degrees
    irradiance : irradiance on a plane normal to the beam, W m^-2
    """

    zenith: Annotated[float, Field(ge=0, lt=90)]
    azimuth: Angle = 0.0
    # Radiances are squared on the way to their standard errors: that must not overflow.
    irradiance: Annotated[float, Field(ge=1e-12, le=1e12)] = 1.0

    @property
    def direction(self) -> np.ndarray:
        """Unit vector towards the sun."""
        return direction(self.zenith, self.azimuth)


@answering
@dataclass(frozen=True, config=ConfigDict(extra="forbid"))
class Cloud:
    """Optics of the droplets, the same in every voxel.

    Attributes
    ----------
    single_scattering_albedo : single-scattering albedo of the droplets, 0 to 1
    phase_function : phase function of the droplets
    effective_radius : effective radius, micrometres, that selects from a phase table where no radius is
        given voxel by voxel
    """

    single_scattering_albedo: Fraction = 1.0
    phase_function: PhaseFunction = HenyeyGreenstein(g=0.85)
    effective_radius: Positive | None = None


# Scale height of the molecules' extinction, and faces of the layers of a standard atmosphere.
_SCALE_HEIGHT = 8.0  # km
_STANDARD_LEVELS = tuple(float(level) for level in (*range(0, 20), *range(20, 51, 5)))  # km


@answering
@dataclass(frozen=True, config=ConfigDict(extra="forbid"))
class Air:
    """Molecules of the air, which scatter after Rayleigh.

    Without levels they are inside the grid only, as in the paper. With levels they lie in
    horizontal layers without end: below, beside (if sides are open) and above the grid.

    Attributes
    ----------
    extinction : extinction of the molecules, km^-1, constant, or one value for each layer from the lowest up; without
        levels these are layers of equal height that fill the grid's, as many as there are values
    single_scattering_albedo : single-scattering albedo of the molecules, 0 to 1
    levels : heights of the layers' faces above the ground, km, from the lowest up, one more than layers; by
        default the layers fill the height of the grid
    wavelength : wavelength, nm; in place of extinction, it gives that of a standard atmosphere
        (`rayleigh_optical_depth`, falling with a scale height of 8 km)
    """

    extinction: _AirExtinction | Annotated[tuple[_AirExtinction, ...], Field(min_length=1)] | None = None
    single_scattering_albedo: Fraction = 1.0
    levels: Annotated[tuple[NotNegative, ...], Field(min_length=2)] | None = None
    wavelength: Annotated[float, Field(ge=250, le=4000)] | None = None

    @model_validator(mode="after")
    def _check(self) -> Air:
        if (self.extinction is None) == (self.wavelength is None):
            raise ValueError("give either extinction or wavelength")
        if self.levels is not None:
            if not np.all(np.diff(self.levels) > 0):
                raise ValueError("levels must increase from the lowest up, in km")
            layers = np.size(self.extinction) if isinstance(self.extinction, tuple) else len(self.levels) - 1
            if layers != len(self.levels) - 1:
                raise ValueError(
                    f"{len(self.levels)} levels bound {len(self.levels) - 1} layers, extinction has {layers}"
                )
        return self

    @property
    def is_outside(self) -> bool:
        """Whether there is air outside of the grid too."""
        return self.levels is not None or self.wavelength is not None

    def layers(self, grid: Grid) -> tuple[np.ndarray, np.ndarray]:
        """All layers of air, among them those of the grid.

        Returns
        -------
        levels : heights of the layers' faces above the ground, km, increasing, shape (layers + 1,);
            with air outside of the grid the first is 0
        extinction : extinction of each layer, km^-1, shape (layers,)

        A profile is averaged onto the grid's layers so that its optical depth is kept.
        """
        require_kinds("Air", grid=(grid, a(Grid)))
        grid_levels = grid.origin[2] + grid.spacing[2] * np.arange(grid.shape[2] + 1)
        if not self.is_outside:
            values = np.atleast_1d(np.asarray(self.extinction, dtype=float))
            return grid_levels, resample(values, grid.shape[2:])
        levels = np.asarray(_STANDARD_LEVELS if self.levels is None else self.levels)
        if self.wavelength is not None:
            above = rayleigh_optical_depth(self.wavelength) * np.exp(-levels / _SCALE_HEIGHT)
            above[-1] = 0.0
            values = -np.diff(above) / np.diff(levels)
        else:
            values = np.broadcast_to(np.asarray(self.extinction, dtype=float), len(levels) - 1)
        depth = np.concatenate([[0.0], np.cumsum(values * np.diff(levels))])
        others = np.concatenate([[0.0], levels])
        # A level that differs from the grid's by rounding alone would make a layer without thickness.
        apart = 1e-6 * grid.spacing[2]
        others = np.unique(others[(others < grid_levels[0] - apart) | (others > grid_levels[-1] + apart)])
        merged = np.sort(np.concatenate([others, grid_levels]))
        return merged, np.diff(np.interp(merged, levels, depth)) / np.diff(merged)

    def profile(self, grid: Grid) -> np.ndarray:
        """Extinction in the layers of a grid, km^-1, shape (nz,)."""
        levels, extinction = self.layers(grid)
        below = int(np.argmin(np.abs(levels - grid.origin[2])))
        return extinction[below : below + grid.shape[2]]


def rayleigh_optical_depth(wavelength: float) -> float:
    """Optical depth of a standard atmosphere's molecules above sea level.

    wavelength : wavelength, nm, 250 to 4000

    Source: Bodhaine, Wood, Dutton and Slusser 1999, "On Rayleigh optical depth calculations",
    Eq. 30 (1013.25 hPa, 45 degrees of latitude, 360 ppm of CO2).
    """
    square = (wavelength / 1000) ** 2  # um^2
    numerator = 1.0455996 - 341.29061 / square - 0.90230850 * square
    return 0.0021520 * numerator / (1 + 0.0027059889 / square - 85.968563 * square)


@answering
@dataclass(frozen=True, config=ConfigDict(extra="forbid"))
class Surface:
    """A Lambertian surface at z = 0, also outside of an open domain.

    Attributes
    ----------
    albedo : share of the light that is reflected, 0 (black) to 1
    """

    albedo: Fraction = 0.0


@answering
@dataclass(frozen=True, config=ConfigDict(extra="forbid"))
class Boundary:
    """The surroundings of the domain.

    Attributes
    ----------
    horizontal : what lies beside the domain: vacuum ("open"), or copies of the domain ("periodic")
    """

    horizontal: Literal["open", "periodic"] = "open"


@answering
@dataclass(frozen=True, config=ConfigDict(extra="forbid"))
class Scene:
    """Everything but the extinction and the sensors, at one wavelength.

    Attributes
    ----------
    grid : grid of the domain
    sun : the sun
    cloud : optics of the droplets
    air : molecules of the air; None: there is no air
    surface : ground at z = 0
    boundary : what lies beside the domain
    wavelength : wavelength in air, nm, for which these optics hold, if it is known; images get it as a coordinate,
        and nothing is computed from it
    """

    grid: Grid
    sun: Sun
    cloud: Cloud = Cloud()
    air: Air | None = None
    surface: Surface = Surface()
    boundary: Boundary = Boundary()
    wavelength: Positive | None = None

    def air_layers(self) -> tuple[np.ndarray, np.ndarray]:
        """`Air.layers` on the scene's grid; without air their extinction is 0."""
        return (self.air or Air(extinction=0.0)).layers(self.grid)

    @property
    def top(self) -> float:
        """The height above which nothing scatters, km."""
        return float(self.air_layers()[0][-1])

    def air_layers_below(self) -> int:
        """The number of layers of air below the grid."""
        levels, _ = self.air_layers()
        return int(np.argmin(np.abs(levels - self.grid.origin[2])))
