"""A cloud on its voxels, and what people do to clouds before they use them: crop, pad, rotate, coarsen, tile."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from cloudtomo_cl.arguments import NUMBER, WHOLE, Kind, a, is_sequence_of, require_kinds, several
from cloudtomo_cl.errors import DataError
from cloudtomo_cl.files.extinction import check_extinction, check_radius
from cloudtomo_cl.files.missing import require_present
from cloudtomo_cl.memory import require, shape_text, voxels_of
from cloudtomo_cl.scene.arrays import real_numbers
from cloudtomo_cl.scene.cards import card
from cloudtomo_cl.scene.grid import Grid, resample

# Columns thinner than this in the vertical are counted as clear.
COVER_OPTICAL_DEPTH = 0.1
# A voxel belongs to a crop if its centre lies inside, whatever the last digit says.
_ROUNDING = 1e-6
# Extinction, radius and what checks them, in double precision, before and after.
_BYTES_PER_VOXEL = 48
_RANGES = several(3, several(2, NUMBER.or_none()))
_READINGS = Kind("a tuple of pairs of texts", lambda pairs: is_sequence_of(several(2, a(str)), pairs))


@dataclass(frozen=True, eq=False)
class CloudVolume:
    """The extinction of a cloud and, where known, the size of its droplets.

    Attributes
    ----------
    grid : of the domain
    extinction : km^-1, shape of the grid
    effective_radius : of the droplets, micrometres, shape of the grid, NaN where there is no cloud;
        None if nothing is known of it
    wavelength : nm, at which the extinction is; 0 in the limit of large droplets, where the extinction efficiency is
        2 at every wavelength; None if it is not known
    readings : what was read as what, for people: quantity, and variable, unit (stated or guessed), missing values
        and what became of them; nothing of clouds that no file held
    """

    grid: Grid
    extinction: np.ndarray
    effective_radius: np.ndarray | None = None
    wavelength: float | None = None
    readings: tuple[tuple[str, str], ...] = field(default=(), compare=False, repr=False)

    def __post_init__(self) -> None:
        require_kinds(
            "CloudVolume",
            grid=(self.grid, a(Grid)),
            wavelength=(self.wavelength, NUMBER.or_none()),
            readings=(self.readings, _READINGS),
        )
        for name in ("extinction", "effective_radius"):
            if name == "effective_radius" and self.effective_radius is None:
                continue
            values = real_numbers(getattr(self, name), name)
            object.__setattr__(self, name, values)
            if values.shape != self.grid.shape:
                raise DataError(f"{name} has shape {values.shape}, the grid {self.grid.shape}")
        require_present("the cloud", "extinction", self.extinction, "it must be known; in clear air it is 0")
        check_extinction("the cloud", "extinction", self.extinction)
        if self.effective_radius is not None:
            check_radius("the cloud", self.effective_radius, self.extinction > 0)

    def __repr__(self) -> str:
        radius = "" if self.effective_radius is None else ", effective radius known"
        depth = f"vertical optical depth up to {self.optical_depth.max():.3g}"
        return f"CloudVolume({self.grid.text}, extinction up to {self.extinction.max():.4g} km^-1, {depth}{radius})"

    def _repr_html_(self) -> str:
        return card("CloudVolume", self.summary(), [("optical depth from above", self.optical_depth.T[::-1])])

    @property
    def optical_depth(self) -> np.ndarray:
        """Of every vertical column, shape (nx, ny)."""
        return self.extinction.sum(axis=2, dtype=float) * self.grid.spacing[2]

    def cropped(self, ranges: Sequence[tuple[float | None, float | None]]) -> CloudVolume:
        """The voxels whose centres lie in a range of x, of y and of z.

        Parameters
        ----------
        ranges : (lower, upper) in km for x, y, z; None leaves an end open

        Raises
        ------
        DataError : no voxel is left; ranges are no such pairs (InvalidArgumentError)
        """
        require_kinds("CloudVolume.cropped", ranges=(ranges, _RANGES))
        slices, origin = [], []
        for axis, (lower, upper) in enumerate(ranges):
            centres, edge = self.grid.centres(axis), _ROUNDING * self.grid.spacing[axis]
            inside = np.ones(len(centres), bool)
            if lower is not None:
                inside &= centres > lower - edge
            if upper is not None:
                inside &= centres < upper + edge
            if not inside.any():
                raise DataError(
                    f"crop: no voxel has its centre between {'xyz'[axis]} = {lower} and {upper} km; "
                    f"the centres lie between {centres[0]:g} and {centres[-1]:g} km"
                )
            first, last = np.flatnonzero(inside)[[0, -1]]
            slices.append(slice(first, last + 1))
            origin.append(_tidy(self.grid.origin[axis] + first * self.grid.spacing[axis]))
        return self._changed(lambda values: values[tuple(slices)], self.grid.spacing, origin)

    def padded(self, voxels: Sequence[tuple[int, int]]) -> CloudVolume:
        """With clear voxels around it: how many below and above along x, y, z.

        Raises
        ------
        DataError : the padding would reach below the ground, or is negative; voxels are no such pairs
            (InvalidArgumentError)
        """
        require_kinds("CloudVolume.padded", voxels=(voxels, several(3, several(2, WHOLE))))
        if any(count < 0 for pair in voxels for count in pair):
            raise DataError("pad: numbers of voxels must not be negative; to take voxels away, crop")
        self._require_memory("pad", [count + below + above for count, (below, above) in zip(self.grid.shape, voxels)])
        origin = [
            _tidy(start - below * edge) for start, (below, _), edge in zip(self.grid.origin, voxels, self.grid.spacing)
        ]
        if origin[2] < 0:
            raise DataError(
                f"pad: {voxels[2][0]} voxels below would reach {-origin[2]:g} km below the ground, z = 0; there is "
                f"room for {int(self.grid.origin[2] / self.grid.spacing[2] + _ROUNDING)}"
            )
        return self._changed(
            lambda values: np.pad(values, voxels), self.grid.spacing, origin, lambda radius: _pad_nan(radius, voxels)
        )

    def rotated(self, degrees: int) -> CloudVolume:
        """Turned about the vertical by a multiple of 90 degrees, from +x (east) towards +y (north).

        The domain's lower corner stays where it is.

        Raises
        ------
        DataError : degrees is no multiple of 90, or no number (InvalidArgumentError)
        """
        require_kinds("CloudVolume.rotated", degrees=(degrees, NUMBER))
        if degrees % 90:
            raise DataError(f"rotate: {degrees} degrees is no multiple of 90")
        turns = degrees // 90 % 4
        spacing = self.grid.spacing
        if turns % 2:
            spacing = (spacing[1], spacing[0], spacing[2])
        # x is the first index and y the second: rot90 from axis 0 to axis 1 turns x towards y.
        return self._changed(lambda values: np.rot90(values, turns, (0, 1)), spacing, self.grid.origin)

    def coarsened(self, factors: Sequence[int]) -> CloudVolume:
        """Means over blocks of voxels: optical depth and liquid water are conserved.

        The effective radius is weighted with extinction, so that the product of both, which is the
        liquid water content but for a constant, is conserved too.

        Raises
        ------
        DataError : an axis does not divide by its factor; factors are no three whole numbers (InvalidArgumentError)
        """
        require_kinds("CloudVolume.coarsened", factors=(factors, several(3, WHOLE)))
        for axis, (count, factor) in enumerate(zip(self.grid.shape, factors)):
            if factor < 1 or count % factor:
                more = -count % max(factor, 1)
                hint = f"; pad {'xyz'[axis]}=0:{more} first, or crop" if factor >= 1 else ""
                raise DataError(f"coarsen: {count} voxels along {'xyz'[axis]} do not divide by {factor}{hint}")
        shape = tuple(count // factor for count, factor in zip(self.grid.shape, factors))
        extinction = resample(self.extinction, shape)
        radius = None
        if self.effective_radius is not None:
            weighted = resample(self.extinction * np.nan_to_num(self.effective_radius), shape)
            radius = weighted_mean(weighted, extinction)
        spacing = tuple(_tidy(edge * factor) for edge, factor in zip(self.grid.spacing, factors))
        grid = Grid(shape, spacing, self.grid.origin)  # type: ignore[arg-type]
        return replace(self, grid=grid, extinction=extinction, effective_radius=radius)

    def tiled(self, along_x: int, along_y: int) -> CloudVolume:
        """Copies side by side.

        Raises
        ------
        DataError : a number below 1, or no whole one (InvalidArgumentError)
        """
        require_kinds("CloudVolume.tiled", along_x=(along_x, WHOLE), along_y=(along_y, WHOLE))
        if along_x < 1 or along_y < 1:
            raise DataError(f"tile: {along_x} x {along_y} copies: there must be at least 1 along each axis")
        self._require_memory("tile", (along_x * self.grid.shape[0], along_y * self.grid.shape[1], self.grid.shape[2]))
        copies = (along_x, along_y, 1)
        return self._changed(lambda values: np.tile(values, copies), self.grid.spacing, self.grid.origin)

    def _require_memory(self, what: str, shape: Sequence[int]) -> None:
        """DataError if there is not memory enough for a cloud of so many voxels."""
        needed = _BYTES_PER_VOXEL * voxels_of(tuple(shape))
        require(needed, f"{what}: a cloud of {shape_text(tuple(shape))} voxels", "use fewer")

    def _changed(self, change, spacing, origin, change_radius=None) -> CloudVolume:  # type: ignore[no-untyped-def]
        """Both arrays changed alike, on the grid that results."""
        extinction = np.ascontiguousarray(change(self.extinction))
        radius = self.effective_radius
        if radius is not None:
            radius = np.ascontiguousarray((change_radius or change)(radius))
        grid = replace(self.grid, shape=extinction.shape, spacing=tuple(spacing), origin=tuple(origin))
        return replace(self, grid=grid, extinction=extinction, effective_radius=radius)

    def summary(self) -> dict[str, str]:
        """What a person wants to know of a cloud: names and texts with units."""
        grid, extinction, depth = self.grid, np.asarray(self.extinction, dtype=float), self.optical_depth
        cloudy, covered = extinction > 0, depth > COVER_OPTICAL_DEPTH
        rows = {
            **dict(self.readings),
            "voxels": " x ".join(map(str, grid.shape)),
            "spacing": f"{' x '.join(f'{edge:g}' for edge in grid.spacing)} km",
            "domain": ", ".join(
                f"{axis} {start:g} to {start + edge:g} km" for axis, start, edge in zip("xyz", grid.origin, grid.extent)
            ),
            "largest extinction": f"{extinction.max():.4g} km^-1",
            "mean extinction": f"{extinction.mean():.4g} km^-1",
            "vertical optical depth": f"largest {depth.max():.4g}, mean {depth.mean():.4g}",
            "cover": f"{covered.mean():.1%} of columns deeper than {COVER_OPTICAL_DEPTH}",
            "optical mass": f"{extinction.sum() * grid.voxel_volume:.4g} km^2",
        }
        if self.wavelength is not None:
            rows["extinction holds"] = f"at {self.wavelength:g} nm" if self.wavelength else "for large droplets (Q = 2)"
        if cloudy.any():
            layers = np.flatnonzero(cloudy.any(axis=(0, 1)))
            base = grid.origin[2] + layers[0] * grid.spacing[2]
            top = grid.origin[2] + (layers[-1] + 1) * grid.spacing[2]
            rows["mean extinction"] += f" ({extinction[cloudy].mean():.4g} km^-1 in cloudy voxels)"
            rows["cloud base and top"] = f"{base:g} and {top:g} km"
        if self.effective_radius is not None and cloudy.any():
            radius = self.effective_radius[cloudy]
            mean = float((radius * extinction[cloudy]).sum() / extinction[cloudy].sum())
            rows["effective radius"] = f"{radius.min():.3g} to {radius.max():.3g} um, mean {mean:.3g} um"
        return rows


def weighted_mean(weighted: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """weighted / weight, NaN where there is no weight."""
    return np.divide(weighted, weight, out=np.full(weight.shape, np.nan), where=weight > 0)


def _pad_nan(radius: np.ndarray, voxels: Sequence[tuple[int, int]]) -> np.ndarray:
    return np.pad(radius, voxels, constant_values=np.nan)


def _tidy(value: float) -> float:
    """Without the rounding error of a sum or product of decimal numbers."""
    return round(value, 12)


def uniform_layers(
    edges: np.ndarray, values: Sequence[np.ndarray], thickness: float | None = None
) -> tuple[np.ndarray, list[np.ndarray]]:
    """Densities in stretched layers, brought to layers of one thickness; every column keeps its integral.

    Parameters
    ----------
    edges : of the layers, increasing, shape (nz + 1,)
    values : densities per length, each (..., nz)
    thickness : of the new layers, about; by default that of the thinnest old one. The new layers
        fill the same height exactly.

    Returns
    -------
    edges : of the new layers
    values : in the new layers
    """
    thickness = float(np.diff(edges).min()) if thickness is None else thickness
    count = max(1, int(np.ceil((edges[-1] - edges[0]) / thickness - _ROUNDING)))
    new = np.linspace(edges[0], edges[-1], count + 1)
    lower = np.maximum(new[:-1, None], edges[None, :-1])
    upper = np.minimum(new[1:, None], edges[None, 1:])
    shares = np.maximum(upper - lower, 0.0) / np.diff(new)[:, None]
    return new, [np.tensordot(array, shares, axes=(-1, 1)) for array in values]
