"""What the kernels know of a scene: its optics, air and phase functions, on the device."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from cloudtomo_cl.errors import DataError
from cloudtomo_cl.files.missing import require_present
from cloudtomo_cl.opencl.device import Device
from cloudtomo_cl.opencl.layout import scene_struct
from cloudtomo_cl.scene.arrays import filled
from cloudtomo_cl.scene.masks import checked_mask
from cloudtomo_cl.scene.phase import TabulatedPhaseFunction
from cloudtomo_cl.scene.scene import Scene, Surface

# Blocks along an axis, at most, of those that walks skip where they are clear: their table stays in a
# processor's second-level cache.
_MOST_BLOCKS = 64
# Copies of a periodic domain that are looked at beside it, in blocks; the most a walk skips.
_PERIODIC_MARGIN = 32
_LARGEST_SKIP = 255
# Optical depth across a voxel's shortest edge; the densest clouds have some 10.
_LARGEST_VOXEL_DEPTH = 1e5


@dataclass(frozen=True)
class FilledMedium:
    """An extinction on the device, and what walks through it take along.

    Attributes
    ----------
    struct, inside_struct : the kernels' Scene; the same over a black surface
    extinction : km^-1, array on the device
    skips_zeros : whether walks skip voxels because their extinction is 0: gradients would miss them
    """

    struct: Any
    inside_struct: Any
    extinction: Any
    skips_zeros: bool
    _medium: Medium
    _buffers: dict[str, Any]

    @property
    def arguments(self) -> dict[str, Any]:
        """What every kernel that walks paths takes of the medium, by name (parameters.MEDIUM)."""
        return {"scene": self.struct, "extinction": self.extinction, **self._buffers}


class Medium:
    """The device's buffers of a scene; only the extinction is missing.

    Parameters
    ----------
    scene : grid, optics, sun, air, surface, boundary
    device : where they are
    effective_radius : of the droplets, micrometres, shape of the grid, for a phase table of
        several radii; by default the scene's one. Where it is 0, NaN or masked there are no droplets, and an
        extinction is refused
    side_flights : whether paths send flights towards the sun
    truncation : the largest local estimate, sr^-1
    mask : bool, or 0 and 1, shape of the grid; where it is False every extinction is to be 0, and walks skip

    Raises
    ------
    DataError : effective_radius is missing, of another shape, or outside of the phase table; the mask is none of
        the grid (`checked_mask`)
    """

    def __init__(
        self,
        scene: Scene,
        device: Device,
        effective_radius: np.ndarray | None = None,
        side_flights: bool = False,
        truncation: float = np.inf,
        mask: np.ndarray | None = None,
    ) -> None:
        self.scene = scene
        self.device = device
        self.mask = None if mask is None else checked_mask(mask, scene.grid)
        # Molecules are everywhere: nothing can be skipped.
        self._has_air = scene.air is not None and bool(np.any(scene.air.profile(scene.grid)))
        self._structs, self._inside_structs = (
            {
                skips: device.constant(scene_struct(one, side_flights, truncation, skips, empty_shift(scene)))
                for skips in (False, True)
            }
            for one in (scene, replace(scene, surface=Surface(0.0)))
        )
        self._profiles = device.constant(profiles(scene))
        rows, self._radius = table_rows(scene, effective_radius)
        self._table_row = device.constant(rows)
        self._nothing_empty = device.constant(np.zeros(1, np.uint8))
        self._empty_by_mask = None if self.mask is None or self._has_air else self._clear(self.mask)
        self.features = tuple(
            feature
            for feature, wanted in (
                ("CLOUDTOMO_ATMOSPHERE", scene.air is not None and scene.air.is_outside),
                ("CLOUDTOMO_PHASE_TABLE", isinstance(scene.cloud.phase_function, TabulatedPhaseFunction)),
            )
            if wanted
        )

    @property
    def struct(self) -> Any:
        """The kernels' Scene."""
        return self._structs[False]

    def _clear(self, occupied: np.ndarray) -> Any:
        blocks = occupied_blocks(occupied, empty_shift(self.scene))
        return self.device.constant(empty_distances(blocks, self.scene.boundary.horizontal == "periodic"))

    def filled(self, extinction: Any, skips_empty: bool) -> FilledMedium:
        """Puts an extinction on the device.

        Parameters
        ----------
        extinction : km^-1, shape of the grid; NumPy, an array on the device, which is not looked into, or
            what this has returned before
        skips_empty : whether walks may skip the voxels of a NumPy extinction that are 0, where there is no mask

        Raises
        ------
        DataError : another shape, a value that is missing, negative, not finite or beyond any cloud's, or above 0
            outside of the mask or where the droplets' size is missing; a field of another medium, or one that skips
            zeros where gradients are wanted
        """
        if isinstance(extinction, FilledMedium):
            if extinction._medium is not self:
                raise DataError("this field is of another scene, estimator or mask: give the extinction itself")
            if extinction.skips_zeros and not skips_empty:
                raise DataError("gradients need clear voxels, which this field skips: give the extinction itself")
            return extinction
        if not self.device.is_array(extinction):
            extinction = filled(extinction)
        if tuple(extinction.shape) != self.scene.grid.shape:
            raise DataError(f"extinction has shape {tuple(extinction.shape)}, the grid {self.scene.grid.shape}")
        clear, skips_zeros = self._empty_by_mask, False
        if self.device.is_array(extinction):
            beta = extinction
        else:
            if extinction.dtype.kind == "c":
                raise DataError("extinction is complex: it must be real numbers, km^-1")
            values = np.ascontiguousarray(extinction, np.float32)
            check_extinction(values)
            if self._radius is not None:
                remedy = "a cloudy voxel must know its droplets' size: set its extinction to 0, or give it one"
                require_present("rendering", "effective_radius", self._radius, remedy, values > 0)
            check_depth(values, min(self.scene.grid.spacing))
            if self.mask is not None and values[~self.mask].any():
                raise DataError("extinction is above 0 outside of the mask: set it to 0 there, or widen the mask")
            beta = self.device.array(values)
            if clear is None and skips_empty and not self._has_air:
                clear, skips_zeros = self._clear(values > 0), True
        return FilledMedium(
            self._structs[clear is not None],
            self._inside_structs[clear is not None],
            beta,
            skips_zeros,
            self,
            {
                "table_row": self._table_row,
                "empty": self._nothing_empty if clear is None else clear,
                "profiles": self._profiles,
            },
        )


def empty_shift(scene: Scene) -> int:
    """Walks skip blocks of 2^empty_shift voxels along each axis; a periodic domain's ends with a whole one."""
    shape, shift = scene.grid.shape, 0
    periodic = scene.boundary.horizontal == "periodic"
    while max(shape) > _MOST_BLOCKS << shift and not (periodic and (shape[0] | shape[1]) & 1 << shift):
        shift += 1
    return shift


def occupied_blocks(occupied: np.ndarray, shift: int) -> np.ndarray:
    """Which blocks of 2^shift voxels along each axis hold an occupied one; those at the ends may be smaller."""
    for axis in range(occupied.ndim):
        occupied = np.logical_or.reduceat(occupied, np.arange(0, occupied.shape[axis], 1 << shift), axis)
    return occupied


def empty_distances(occupied: np.ndarray, periodic: bool) -> np.ndarray:
    """How far from every block the nearest occupied one is, in blocks along the axis where it is most.

    Parameters
    ----------
    occupied : bool, shape (blocks along x, y, z)
    periodic : whether the domain is repeated horizontally

    Returns uint8, same shape: 0 where occupied, 1 beside it, at most 255.
    """
    # Beyond the margin nothing is known of a periodic domain's copies, and a walk wraps once at most.
    largest = min(_PERIODIC_MARGIN, *occupied.shape[:2]) if periodic else _LARGEST_SKIP
    if not occupied.any():
        return np.full(occupied.shape, largest, np.uint8)
    distances, reached = np.zeros(occupied.shape, np.uint8), occupied
    # SciPy has this (ndimage), but to import it takes half as long as all the rest of a small render.
    for _ in range(largest):
        if reached.all():
            break
        distances += ~reached
        for axis in range(3):
            reached = _spread(reached, axis, periodic and axis < 2)
    return distances


def _spread(reached: np.ndarray, axis: int, wraps: bool) -> np.ndarray:
    """With the blocks beside them along an axis."""
    before = np.moveaxis(reached, axis, 0)
    after = before.copy(order="K")
    after[1:] |= before[:-1]
    after[:-1] |= before[1:]
    if wraps:
        after[0] |= before[-1]
        after[-1] |= before[0]
    return np.moveaxis(after, 0, axis)


def check_extinction(values: np.ndarray) -> None:
    """Raises DataError if an extinction is negative or not finite anywhere."""
    wrong = ~(np.isfinite(values) & (values >= 0))
    if wrong.any():
        voxel = tuple(int(i) for i in np.unravel_index(np.argmax(wrong), values.shape))
        raise DataError(f"extinction at voxel {voxel} is {values[voxel]}: it must be finite and at least 0 km^-1")


def check_depth(values: np.ndarray, edge: float) -> None:
    """Raises DataError if an optical depth is so large that paths would scatter in one voxel for ever."""
    voxel = tuple(int(i) for i in np.unravel_index(np.argmax(values), values.shape))
    depth = float(values[voxel]) * edge
    if depth > _LARGEST_VOXEL_DEPTH:
        raise DataError(
            f"extinction at voxel {voxel} is {values[voxel]:.4g} km^-1, an optical depth of {depth:.3g} across "
            f"{edge:g} km (at most {_LARGEST_VOXEL_DEPTH:g}): are its unit (km^-1) and the coordinates' (km) right?"
        )


def profiles(scene: Scene) -> np.ndarray:
    """The 1-D tables of a scene one after the other, float32 (see kernels/walk/medium.h)."""
    levels, molecules = scene.air_layers()
    parts = [levels - scene.grid.origin[2], molecules]
    phase = scene.cloud.phase_function
    if isinstance(phase, TabulatedPhaseFunction):
        node = np.sin(np.radians(phase.angle) / 2) ** 2
        density = np.array(phase.values)
        # The sphere's area element is 4 pi ds; densities are linear in s.
        steps = 4 * np.pi * np.diff(node) * (density[:, 1:] + density[:, :-1]) / 2
        cumulative = np.concatenate([np.zeros((len(density), 1)), np.cumsum(steps, axis=1)], axis=1)
        albedo = phase.single_scattering_albedo or (scene.cloud.single_scattering_albedo,) * len(density)
        parts += [node, density, cumulative / cumulative[:, -1:], np.asarray(albedo)]
    return np.concatenate([np.ravel(part) for part in parts]).astype(np.float32)


def table_rows(scene: Scene, effective_radius: np.ndarray | None) -> tuple[np.ndarray, np.ndarray | None]:
    """Every voxel's place in the phase table: a row, or between two. One entry if there is one row.

    Also the radii, NaN where they are missing, if they are so anywhere; otherwise None.
    """
    phase = scene.cloud.phase_function
    if not isinstance(phase, TabulatedPhaseFunction) or len(phase.values) == 1:
        return np.zeros(1, np.float32), None
    radius = effective_radius if effective_radius is not None else scene.cloud.effective_radius
    if radius is None:
        raise DataError(
            f"the phase function has {len(phase.values)} effective radii: give cloud.effective_radius, or the "
            "effective_radius of every voxel (micrometres)"
        )
    radius = np.asarray(filled(radius), dtype=float)
    if radius.ndim and radius.shape != scene.grid.shape:
        raise DataError(f"effective_radius has shape {radius.shape}, the grid {scene.grid.shape}")
    least, most = phase.effective_radius[0], phase.effective_radius[-1]
    clear = np.isnan(radius) | (radius == 0)
    wrong = ~clear & ~((radius >= least) & (radius <= most))
    if wrong.any():
        raise DataError(
            f"effective_radius is {radius[wrong].flat[0]:g} um in some voxel; the phase function has {least:g} to "
            f"{most:g} um: make a table of more radii, or limit the radii"
        )
    rows = np.interp(np.where(clear, least, radius), phase.effective_radius, np.arange(len(phase.values)))
    missing = np.where(clear, np.nan, radius) if clear.any() else None
    return np.ascontiguousarray(np.broadcast_to(rows, scene.grid.shape), np.float32), missing
