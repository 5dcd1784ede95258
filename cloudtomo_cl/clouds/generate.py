"""Made-up clouds: cumuli with adiabatic cores, mixed away at their turbulent edges, and decks of stratocumulus.

Everything is a function of physical coordinates, so the same seed gives the same cloud on
any grid of a domain, only seen more or less finely. Not a simulation: the shapes follow what
large-eddy simulations of trade-wind cumuli show (flat bases, leaning towers of thermals, ragged
edges and holes, extinction that grows with height and falls towards the edges).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from cloudtomo_cl.arguments import NUMBER, WHOLE, a, require_kinds
from cloudtomo_cl.errors import DataError
from cloudtomo_cl.memory import require, require_countable, shape_text, voxels_of
from cloudtomo_cl.scene.grid import Grid
from cloudtomo_cl.scene.seeds import checked_seed

# Heights of base and top, and the margin at the sides, as shares of the domain.
_BASE, _TOP, _MARGIN = 0.26, 0.82, 0.06
_THERMALS = 7
# Far more than any domain shows; each is drawn on all of its voxels.
_MOST_CLOUDS = 10_000
# Arrays that live at the same time while one is made, rounded up.
_BYTES_PER_VOXEL = 64
# Turbulence: the largest eddies relative to the cloud's depth, and how much smaller the smallest are.
_OUTER_SCALE, _SCALE_RANGE, _MODES = 0.7, 10.0, 300
# How far turbulence moves the cloud's edge, in units of the thermals' shape function.
_RAGGEDNESS = 0.33
# How far dry air is mixed in from the edge, in the same units.
_MIXING_DEPTH = 0.3
# Adiabatic liquid water grows linearly with height above the base, and extinction with the
# square of the droplets' radius at a constant number: (z - base)^(2/3).
_ADIABATIC_EXPONENT = 2 / 3
# A deck's top and mean thickness as shares of the domain's height, and its waves along the longer side.
_DECK_TOP, _DECK_THICKNESS, _DECK_WAVES = 0.85, 0.4, 32


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
    DataError : seed, clouds, peak, base or top out of range, or of another kind (InvalidArgumentError); a grid too
        coarse to hold any cloud
    """
    require_kinds(
        "cumulus",
        clouds=(clouds, WHOLE),
        peak=(peak, NUMBER),
        base=(base, NUMBER.or_none()),
        top=(top, NUMBER.or_none()),
    )
    _require_memory(grid, "cumulus")
    if not 1 <= clouds <= _MOST_CLOUDS:
        raise DataError(f"clouds is {clouds}: there must be at least 1, and at most {_MOST_CLOUDS}")
    if not 0 < peak < np.inf:
        raise DataError(f"peak is {peak}: it must be finite and above 0 km^-1")
    lower, upper = grid.origin[2], grid.origin[2] + grid.extent[2]
    base = lower + _BASE * grid.extent[2] if base is None else base
    top = lower + _TOP * grid.extent[2] if top is None else top
    if not lower <= base < top <= upper:
        raise DataError(
            f"base is {base:g} km and top {top:g} km: they must lie in this order inside of the domain, "
            f"{lower:g} to {upper:g} km"
        )
    generator = np.random.default_rng(checked_seed(seed))
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


def stratocumulus(
    grid: Grid,
    seed: int = 0,
    optical_depth: float = 12.0,
    variability: float = 0.4,
    thickness: float | None = None,
    top: float | None = None,
) -> np.ndarray:
    """Extinction of a stratocumulus deck, periodic in x and y.

    The optical depth of columns is log-normal, with a spectrum that falls as k^(-5/3) (Cahalan et al. 1994,
    J. Atmos. Sci. 51, 2434). Below a flat top, the inversion, every column is adiabatic: extinction grows with the
    height above its base h as h^(2/3), so that the optical depth goes with the 5/3 power of the thickness
    (Brenguier et al. 2000, J. Atmos. Sci. 57, 803). The same seed gives the same columns on any grid of a domain.

    Parameters
    ----------
    grid : of the domain; km
    seed : of the columns
    optical_depth : mean over the columns
    variability : standard deviation of the optical depth's logarithm
    thickness : of a column of the mean optical depth, km; by default 40 % of the domain's height
    top : of the deck, km; by default 85 % of the domain's height

    Returns
    -------
    km^-1, float32, shape of the grid

    Raises
    ------
    DataError : the seed or a parameter out of range; a top outside of the domain
    """
    lower, height = grid.origin[2], grid.extent[2]
    top = lower + _DECK_TOP * height if top is None else top
    thickness = _DECK_THICKNESS * height if thickness is None else thickness
    if not (optical_depth > 0 and variability >= 0 and thickness > 0):
        raise DataError(
            f"optical_depth {optical_depth}, variability {variability}, thickness {thickness}: the first and the last "
            "must be above 0, the variability at least 0"
        )
    if not lower < top <= lower + height:
        raise DataError(f"top is {top:g} km: it must lie inside of the domain, {lower:g} to {lower + height:g} km")
    gaussian = _periodic_field(np.random.default_rng(checked_seed(seed)), grid)
    depth = optical_depth * np.exp(variability * gaussian - variability**2 / 2)
    # What does not fit between the domain's floor and the top is cut from the column's top thickness.
    thick = np.minimum(thickness * (depth / optical_depth) ** (1 / (1 + _ADIABATIC_EXPONENT)), top - lower)
    edges = grid.origin[2] + np.arange(grid.shape[2] + 1) * grid.spacing[2]
    # The integral of the profile over every layer: columns keep their optical depth on any layers.
    # Rounded, lest the layer above a top that lies on an edge holds the last digit's worth of cloud.
    above_base = np.clip(np.round((edges - (top - thick)[..., None]) / thick[..., None], 12), 0.0, 1.0)
    integral = depth[..., None] * above_base ** (1 + _ADIABATIC_EXPONENT)
    return (np.diff(integral, axis=-1) / grid.spacing[2]).astype(np.float32)


def _periodic_field(generator: np.random.Generator, grid: Grid) -> np.ndarray:
    """A periodic Gaussian field of unit variance over x, y whose spectrum falls as k^(-5/3), shape (nx, ny)."""
    waves = np.arange(-_DECK_WAVES, _DECK_WAVES + 1)
    amplitudes = generator.normal(size=(len(waves), len(waves), 2)) @ [1, 1j]
    # Waves of a domain that is not square have the same wavelengths along both axes.
    along = np.array(grid.extent[:2]) / max(grid.extent[:2])
    wavenumber = np.hypot(waves[:, None] / along[0], waves[None, :] / along[1])
    # In the plane a ring holds about k modes: the variance of one is E(k) / k.
    spread = np.where(wavenumber > 0, np.maximum(wavenumber, 1e-9) ** (-8 / 3), 0.0)
    phase_x, phase_y = (np.exp(2j * np.pi * np.outer((np.arange(n) + 0.5) / n, waves)) for n in grid.shape[:2])
    field = (phase_x @ (amplitudes * np.sqrt(spread)) @ phase_y.T).real
    return field / np.sqrt(spread.sum())


@dataclass(frozen=True)
class Preset:
    """A kind of cloud by name: what it is, on which voxels if nothing else is said, and its function of a grid."""

    description: str
    grid: Grid
    generate: Callable[[Grid, int], np.ndarray]


PRESETS = {
    "cumulus": Preset("one trade-wind cumulus", Grid((32, 32, 32), (0.025, 0.025, 0.025)), cumulus),
    "field": Preset(
        "eight cumuli", Grid((80, 80, 40), (0.04, 0.04, 0.04)), lambda grid, seed: cumulus(grid, seed, clouds=8)
    ),
    "tower": Preset(
        "a tall, thick cumulus congestus",
        Grid((40, 40, 80), (0.05, 0.05, 0.05)),
        lambda grid, seed: cumulus(grid, seed, peak=150.0),
    ),
    "stratocumulus": Preset(
        "a deck of stratocumulus, periodic in x and y",
        Grid((64, 64, 32), (0.05, 0.05, 0.02), (0.0, 0.0, 0.4)),
        stratocumulus,
    ),
}


def _require_memory(grid: Grid, what: str) -> None:
    """DataError if there is not memory enough for an extinction on this grid, or more voxels than kernels count."""
    require_kinds(what, grid=(grid, a(Grid)))
    voxels, shape = voxels_of(grid.shape), shape_text(grid.shape)
    require_countable(voxels, 0, f"{what}: {shape} voxels")
    require(_BYTES_PER_VOXEL * voxels, f"{what}: an extinction of {shape} voxels", "use fewer")
