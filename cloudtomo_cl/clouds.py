"""Made-up cumuli: adiabatic cores, mixed away at their turbulent edges.

Everything is a function of physical coordinates, so the same seed gives the same cloud on
any grid of a domain, only seen more or less finely. Not a simulation: the shapes follow what
large-eddy simulations of trade-wind cumuli show (flat bases, leaning towers of thermals, ragged
edges and holes, extinction that grows with height and falls towards the edges).
"""

from __future__ import annotations

import numpy as np

from cloudtomo_cl.errors import DataError
from cloudtomo_cl.grid import Grid

# Heights of base and top, and the margin at the sides, as shares of the domain.
_BASE, _TOP, _MARGIN = 0.26, 0.82, 0.06
_THERMALS = 7
# Turbulence: the largest eddies relative to the cloud's depth, and how much smaller the smallest are.
_OUTER_SCALE, _SCALE_RANGE, _MODES = 0.7, 10.0, 300
# How far turbulence moves the cloud's edge, in units of the thermals' shape function.
_RAGGEDNESS = 0.33
# How far dry air is mixed in from the edge, in the same units.
_MIXING_DEPTH = 0.3
# Adiabatic liquid water grows linearly with height above the base, and extinction with the
# square of the droplets' radius at a constant number: (z - base)^(2/3).
_ADIABATIC_EXPONENT = 2 / 3


class Turbulence:
    """A random field of unit variance whose spectrum falls as k^(-5/3), made of Fourier modes.

    Parameters
    ----------
    generator : of the modes
    outer_scale : the longest wavelength, km; the shortest is _SCALE_RANGE times shorter
    """

    def __init__(self, generator: np.random.Generator, outer_scale: float) -> None:
        octave = generator.uniform(0.0, np.log(_SCALE_RANGE), _MODES)
        directions = generator.normal(size=(_MODES, 3))
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        self.wavevectors = 2 * np.pi / outer_scale * np.exp(octave)[:, None] * directions
        # Modes are uniform in log k: the variance of one is E(k) k, that is k^(-2/3).
        variance = np.exp(-2 / 3 * octave)
        phases = np.exp(2j * np.pi * generator.uniform(size=_MODES))
        self.amplitudes = np.sqrt(2 * variance / variance.sum()) * phases

    def __call__(self, x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
        """Values at the points of a lattice with these coordinates, shape (len(x), len(y), len(z))."""
        # A plane wave is a product of waves along the axes: one matrix product sums all modes.
        along = [np.exp(1j * np.outer(axis, k)) for axis, k in zip((x, y, z), self.wavevectors.T)]
        values = np.empty((len(x), len(y), len(z)))
        for index in range(len(x)):
            values[index] = ((along[0][index] * self.amplitudes * along[1]) @ along[2].T).real
        return values


def cumulus(
    grid: Grid,
    seed: int = 0,
    clouds: int = 1,
    peak: float = 100.0,
    base: float | None = None,
    top: float | None = None,
) -> np.ndarray:
    """Extinction of a field of cumuli.

    The tallest cloud reaches about to `top`, further ones less high. The sides and the top of
    the domain stay free of cloud, and outside of clouds extinction is exactly zero.

    Parameters
    ----------
    grid : of the domain, which the clouds are scaled to; km
    seed : of the clouds; the same seed is the same cloud on any grid of the same domain
    clouds : how many
    peak : the largest extinction, km^-1
    base, top : height of the flat cloud base, and of the tallest top, km; by default 26 % and
        82 % of the domain's height

    Returns
    -------
    km^-1, float32, shape of the grid

    Raises
    ------
    DataError : clouds, peak, base or top out of range; a grid too coarse to hold any cloud
    """
    if clouds < 1:
        raise DataError(f"clouds is {clouds}: there must be at least 1")
    if not (np.isfinite(peak) and peak > 0):
        raise DataError(f"peak is {peak}: it must be finite and above 0 km^-1")
    lower, upper = grid.origin[2], grid.origin[2] + grid.extent[2]
    base = lower + _BASE * grid.extent[2] if base is None else base
    top = lower + _TOP * grid.extent[2] if top is None else top
    if not lower <= base < top <= upper:
        raise DataError(
            f"base is {base:g} km and top {top:g} km: they must lie in this order inside of the domain, "
            f"{lower:g} to {upper:g} km"
        )
    generator = np.random.default_rng(seed)
    coordinates = [grid.centres(axis) for axis in range(3)]
    thermals = _thermals(generator, grid, clouds, base, top)
    edges = Turbulence(generator, _OUTER_SCALE * (top - base))
    mixing = Turbulence(generator, _OUTER_SCALE * (top - base))
    shape = _shape(thermals, coordinates) + _RAGGEDNESS * edges(*coordinates) + _margins(grid, coordinates)
    # From the edge inwards the cloud is less and less mixed with dry air.
    mixed = (1 - np.exp(-np.clip(shape, 0.0, None) / _MIXING_DEPTH)) * np.exp(0.15 * mixing(*coordinates))
    adiabatic = np.clip((coordinates[2] - base) / (top - base), 0.0, None) ** _ADIABATIC_EXPONENT
    extinction = mixed * adiabatic
    if not extinction.max() > 0:
        raise DataError(f"no voxel of the grid {grid.shape} lies in a cloud: use more voxels or another seed")
    return (extinction * (peak / extinction.max())).astype(np.float32)


def _thermals(generator: np.random.Generator, grid: Grid, clouds: int, base: float, top: float) -> np.ndarray:
    """Centres (x, y, z) and radii (horizontal, vertical) of all thermals, km: shape (thermals, 5)."""
    width = np.array(grid.extent[:2])
    radius = 0.28 * width.min() / np.sqrt(clouds)
    rows: list[np.ndarray] = []
    feet: list[np.ndarray] = []
    for cloud in range(clouds):
        # Of several random feet the one farthest from the other clouds.
        candidates = generator.uniform(0.3, 0.7, (12, 2)) if clouds == 1 else generator.uniform(0.2, 0.8, (12, 2))
        if feet:
            apart = np.linalg.norm((candidates[:, None] - np.array(feet)[None]) * width, axis=-1).min(axis=1)
            foot = candidates[np.argmax(apart)]
        else:
            foot = candidates[0] if clouds > 1 else 0.5 + 0.4 * (candidates[0] - 0.5)
        feet.append(foot)
        depth = (top - base) * (1.0 if cloud == 0 else generator.uniform(0.3, 0.85))
        heading = generator.uniform(0.0, 2 * np.pi)
        lean = 0.9 * radius * np.array([np.cos(heading), np.sin(heading)])
        for height in np.linspace(0.0, 1.0, _THERMALS):
            wide = radius * (0.95 - 0.5 * height) * generator.uniform(0.75, 1.15)
            tall = 0.24 * depth * generator.uniform(0.8, 1.2)
            centre = np.asarray(grid.origin[:2]) + foot * width + (height - 0.5) * lean
            centre = centre + 0.35 * radius * generator.normal(size=2)
            rows.append(np.array([*centre, base + height * (depth - tall), wide, tall]))
    return np.array(rows)


def _shape(thermals: np.ndarray, coordinates: list[np.ndarray]) -> np.ndarray:
    """Positive inside of thermals, up to 1 in their middle; falls without bound outside."""
    x, y, z = np.meshgrid(*coordinates, indexing="ij", sparse=True)
    shape = np.full((len(coordinates[0]), len(coordinates[1]), len(coordinates[2])), -np.inf)
    for centre_x, centre_y, centre_z, wide, tall in thermals:
        distance = np.sqrt(((x - centre_x) ** 2 + (y - centre_y) ** 2) / wide**2 + (z - centre_z) ** 2 / tall**2)
        np.maximum(shape, 0.75 - distance, out=shape)
    return shape


def _margins(grid: Grid, coordinates: list[np.ndarray]) -> np.ndarray:
    """Zero inside of the domain, so far below zero in the margins at sides and top that no cloud is left."""
    depths = []
    for axis, values in enumerate(coordinates):
        margin = _MARGIN * grid.extent[axis]
        above, below = values - grid.origin[axis], grid.origin[axis] + grid.extent[axis] - values
        distance = below if axis == 2 else np.minimum(above, below)
        depths.append(np.clip(distance / margin - 1.0, 0.0, 1.0))
    x, y, z = np.meshgrid(*depths, indexing="ij", sparse=True)
    inside = np.minimum(np.minimum(x, y), z)
    # Turbulence stays far below 10 standard deviations.
    return np.where(inside > 0, 2.0 * (inside - 1.0), -10.0)
