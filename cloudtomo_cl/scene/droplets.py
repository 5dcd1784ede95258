"""Optics of droplets by their size: tables from Mie theory, and extinction from liquid water.

Radii are in micrometres, wavelengths in nm, liquid water in g m^-3, extinction in km^-1.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from cloudtomo_cl.arguments import NUMBER, NUMBERS, a, require_kinds
from cloudtomo_cl.errors import DataError
from cloudtomo_cl.scene.arrays import as_numbers
from cloudtomo_cl.scene.phase import TabulatedPhaseFunction

# Density of liquid water, g m^-3.
WATER_DENSITY = 1e6
_METRES_PER_KILOMETRE = 1e3
_MICROMETRES_PER_METRE = 1e6
# Large droplets take twice the light that falls on them (van de Hulst 1957, sec. 8.22).
GEOMETRIC_EXTINCTION_EFFICIENCY = 2.0


@dataclass(frozen=True)
class DropletTable:
    """Optics of droplets of several effective radii at one wavelength.

    Attributes
    ----------
    phase_function : phase functions of k effective radii, with their single-scattering albedos
    extinction_efficiency : extinction over geometric cross-section, both summed over the size distribution, k values
    wavelength_nm : wavelength in air, nm
    effective_variance : effective variance of the size distribution, without unit
    refractive_index_real, refractive_index_imag : refractive index of water; a positive imaginary part absorbs

    Raises
    ------
    DataError : as many extinction_efficiency as effective radii are needed; a field is of another kind
        (InvalidArgumentError)
    """

    phase_function: TabulatedPhaseFunction
    extinction_efficiency: tuple[float, ...]
    wavelength_nm: float
    effective_variance: float
    refractive_index_real: float
    refractive_index_imag: float

    def __post_init__(self) -> None:
        names = ("wavelength_nm", "effective_variance", "refractive_index_real", "refractive_index_imag")
        require_kinds(
            "DropletTable",
            phase_function=(self.phase_function, a(TabulatedPhaseFunction)),
            extinction_efficiency=(self.extinction_efficiency, NUMBERS),
            **{name: (getattr(self, name), NUMBER) for name in names},
        )
        if len(self.extinction_efficiency) != len(self.phase_function.effective_radius):
            raise DataError(
                f"extinction_efficiency has {len(self.extinction_efficiency)} entries: it must have "
                f"{len(self.phase_function.effective_radius)}, one for each effective_radius"
            )

    def __repr__(self) -> str:
        about = f"{self.wavelength_nm:g} nm, effective variance {self.effective_variance:g}"
        return f"DropletTable({about}, {self.phase_function!r})"

    @property
    def mass_extinction(self) -> np.ndarray:
        """Extinction of a gram of water in droplets of each effective radius, m^2 g^-1, shape (k,)."""
        return _mass_extinction(self.extinction_efficiency, np.array(self.phase_function.effective_radius))


def _mass_extinction(efficiency: np.ndarray | tuple[float, ...] | float, radius: np.ndarray) -> np.ndarray:
    """3 Q / (4 rho r_e), m^2 g^-1: cross-section over mass, by the definition of the effective radius."""
    return 0.75 * np.asarray(efficiency) / (WATER_DENSITY * radius / _MICROMETRES_PER_METRE)


def extinction_from_water(
    liquid_water_content: np.ndarray | float,
    effective_radius: np.ndarray | float,
    table: DropletTable | None = None,
) -> np.ndarray:
    """The extinction of liquid water in droplets.

    Parameters
    ----------
    liquid_water_content : mass of liquid water per volume of air, g m^-3, any shape
    effective_radius : effective radius of the droplets, micrometres, same shape or one number; without water its value
        does not matter
    table : table of the extinction efficiency, which is interpolated linearly in the radius. Without a table
        it is 2, the limit of large droplets: 3 LWC / (2 rho r_e) (Stephens 1978, Eq. 7), which is
        6 to 10 % too little for droplets of 5 to 10 micrometres in visible light

    Returns
    -------
    extinction : extinction, km^-1, same shape, float64

    Raises
    ------
    DataError : shapes that differ; water that is negative or not finite; a radius that is not positive, or outside of
        the table, where there is water
    """
    water, radius = _together(liquid_water_content=liquid_water_content, effective_radius=effective_radius)
    if not (np.isfinite(water) & (water >= 0)).all():
        raise DataError("liquid_water_content must be finite and at least 0 g m^-3 everywhere")
    wet = water > 0
    if not (np.isfinite(radius[wet]) & (radius[wet] > 0)).all():
        raise DataError("effective_radius must be finite and greater than 0 micrometres where there is water")
    efficiency = _efficiency(radius[wet], table)
    extinction = np.zeros(water.shape)
    extinction[wet] = water[wet] * _mass_extinction(efficiency, radius[wet]) * _METRES_PER_KILOMETRE
    return extinction


def _together(**given: Any) -> list[np.ndarray]:
    """Arrays of one shape, double precision. DataError if their shapes do not belong together."""
    arrays = {name: as_numbers(values, name) for name, values in given.items()}
    try:
        return list(np.broadcast_arrays(*arrays.values()))
    except ValueError:
        shapes = " and ".join(f"{name} {array.shape}" for name, array in arrays.items())
        raise DataError(
            f"shapes do not belong together: {shapes}: give both the same, or the last as a number"
        ) from None


def extinction_at(
    extinction: np.ndarray,
    effective_radius: np.ndarray | float,
    table: DropletTable,
    reference: DropletTable | None = None,
) -> np.ndarray:
    """The extinction of the same droplets at another wavelength: in proportion to the extinction efficiency.

    Parameters
    ----------
    extinction : given extinction, km^-1, any shape
    effective_radius : effective radius of the droplets, micrometres, same shape or one number; without cloud its value
        does not matter
    table : table for the wanted wavelength
    reference : table for the wavelength of `extinction`; by default `extinction` is that of the limit of large
        droplets, which `extinction_from_water` gives without a table

    Returns
    -------
    extinction : extinction at the wanted wavelength, km^-1, same shape, float64

    Raises
    ------
    DataError : shapes that differ; a radius that is not positive, or outside of a table, where there is cloud
    """
    values, radius = _together(extinction=extinction, effective_radius=effective_radius)
    cloudy = values > 0
    if not (np.isfinite(radius[cloudy]) & (radius[cloudy] > 0)).all():
        raise DataError("effective_radius must be finite and greater than 0 micrometres where there is cloud")
    changed = values.copy()
    changed[cloudy] *= _efficiency(radius[cloudy], table) / _efficiency(radius[cloudy], reference)
    return changed


def _efficiency(radius: np.ndarray, table: DropletTable | None) -> np.ndarray | float:
    """Extinction efficiencies of droplets, linear in the radius; without a table the limit of large ones."""
    require_kinds("table of droplets", table=(table, a(DropletTable, hint="read_droplet_table reads one").or_none()))
    if table is None or not radius.size:
        return GEOMETRIC_EXTINCTION_EFFICIENCY
    nodes = table.phase_function.effective_radius
    if radius.min() < nodes[0] or radius.max() > nodes[-1]:
        raise DataError(
            f"effective_radius is {radius.min():g} to {radius.max():g} micrometres, the table has "
            f"{nodes[0]:g} to {nodes[-1]:g}: make a table of more radii, or limit the radius"
        )
    return np.interp(radius, nodes, table.extinction_efficiency)
