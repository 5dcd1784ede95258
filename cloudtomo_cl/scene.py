"""What light meets: cloud optics, air, surface, boundary and sun.

The classes are the settings' tables: the same words and the same checks in a TOML file and
in Python. Lengths are in km, extinction in km^-1, angles in degrees.
"""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from pydantic import ConfigDict, Field
from pydantic.dataclasses import dataclass

from cloudtomo_cl.grid import Grid, resample
from cloudtomo_cl.phase import HenyeyGreenstein, PhaseFunction

Fraction = Annotated[float, Field(ge=0, le=1)]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
Angle = Annotated[float, Field(allow_inf_nan=False)]


def direction(zenith: float, azimuth: float) -> np.ndarray:
    """The unit vector from the scene towards (zenith, azimuth), in degrees.

    Azimuth runs from +x (east) towards +y (north).
    """
    theta, phi = np.radians([zenith, azimuth])
    return np.array([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)])


@dataclass(frozen=True, config=ConfigDict(extra="forbid"))
class Sun:
    """A collimated sun.

    Attributes
    ----------
    zenith, azimuth : where the sun stands, degrees
    irradiance : on a plane normal to the beam, W m^-2
    """

    zenith: Annotated[float, Field(ge=0, lt=90)]
    azimuth: Angle = 0.0
    irradiance: Positive = 1.0

    @property
    def direction(self) -> np.ndarray:
        """Unit vector towards the sun."""
        return direction(self.zenith, self.azimuth)


@dataclass(frozen=True, config=ConfigDict(extra="forbid"))
class Cloud:
    """Optics of the droplets, the same in every voxel.

    Attributes
    ----------
    single_scattering_albedo : 0 to 1
    phase_function : of the droplets
    """

    single_scattering_albedo: Fraction = 1.0
    phase_function: PhaseFunction = HenyeyGreenstein(g=0.85)


@dataclass(frozen=True, config=ConfigDict(extra="forbid"))
class Air:
    """Molecules inside the domain; they scatter after Rayleigh.

    Attributes
    ----------
    extinction : km^-1, constant, or one value for each layer of voxels from the lowest up
    single_scattering_albedo : 0 to 1
    """

    extinction: NotNegative | Annotated[tuple[NotNegative, ...], Field(min_length=1)]
    single_scattering_albedo: Fraction = 1.0

    def profile(self, grid: Grid) -> np.ndarray:
        """Extinction in the layers of a grid, km^-1, shape (nz,).

        A profile given on other layers of the same height is averaged onto these.
        """
        return resample(np.atleast_1d(np.asarray(self.extinction, dtype=float)), grid.shape[2:])


@dataclass(frozen=True, config=ConfigDict(extra="forbid"))
class Surface:
    """A Lambertian surface at z = 0, also outside of an open domain."""

    albedo: Fraction = 0.0


@dataclass(frozen=True, config=ConfigDict(extra="forbid"))
class Boundary:
    """What lies beside the domain: vacuum ("open"), or its copies ("periodic")."""

    horizontal: Literal["open", "periodic"] = "open"


@dataclass(frozen=True, config=ConfigDict(extra="forbid"))
class Scene:
    """Everything but the extinction and the sensors."""

    grid: Grid
    sun: Sun
    cloud: Cloud = Cloud()
    air: Air | None = None
    surface: Surface = Surface()
    boundary: Boundary = Boundary()
