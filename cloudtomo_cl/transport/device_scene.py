"""What the kernels know of a scene: its optics, air and phase functions, on the device."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from cloudtomo_cl.errors import DataError
from cloudtomo_cl.files.missing import require_present
from cloudtomo_cl.opencl.device import Device
from cloudtomo_cl.opencl.layout import scene_struct
from cloudtomo_cl.scene.arrays import as_numbers, real_numbers
from cloudtomo_cl.scene.masks import checked_mask
from cloudtomo_cl.scene.phase import TabulatedPhaseFunction
from cloudtomo_cl.scene.scene import Scene, Surface
from cloudtomo_cl.transport.empty_blocks import empty_distances, empty_shift, occupied_blocks
from cloudtomo_cl.transport.medium import Medium, check_depth, check_extinction


class DeviceScene:
    """The device's buffers of a scene; only the extinction is missing, with which it is a `Medium`.

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

    Attributes
    ----------
    scene, device, mask : as given, the mask as bool
    features : macros of kernels that walk through the scene

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
        self._empty_by_mask = None if self.mask is None or self._has_air else self._empty(self.mask)
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

    def _empty(self, occupied: np.ndarray) -> Any:
        """How far walks may skip where voxels are not occupied, on the device."""
        blocks = occupied_blocks(occupied, empty_shift(self.scene))
        return self.device.constant(empty_distances(blocks, self.scene.boundary.horizontal == "periodic"))

    def medium(self, extinction: Any, skips_empty: bool) -> Medium:
        """Puts an extinction on the device.

        Parameters
        ----------
        extinction : km^-1, shape of the grid; NumPy, an array on the device, which is not looked into, or
            what this has returned before
        skips_empty : whether walks may skip the voxels of a NumPy extinction that are 0, where there is no mask

        Raises
        ------
        DataError : another shape, a value that is missing, negative, not finite or beyond any cloud's, or above 0
            outside of the mask or where the droplets' size is missing; a medium of another scene, or one that skips
            zeros where gradients are wanted
        """
        if isinstance(extinction, Medium):
            if extinction._made_by is not self:
                raise DataError("this medium is of another scene, estimator or mask: give the extinction itself")
            if extinction.skips_zeros and not skips_empty:
                raise DataError("gradients need clear voxels, which this medium skips: give the extinction itself")
            return extinction
        if not self.device.is_array(extinction):
            extinction = real_numbers(extinction, "extinction")
        if tuple(extinction.shape) != self.scene.grid.shape:
            raise DataError(f"extinction has shape {tuple(extinction.shape)}, the grid {self.scene.grid.shape}")
        empty, skips_zeros = self._empty_by_mask, False
        if not self.device.is_array(extinction):
            values = self._checked(extinction)
            extinction = self.device.array(values)
            if empty is None and skips_empty and not self._has_air:
                empty, skips_zeros = self._empty(values > 0), True
        skips = empty is not None
        buffers = {
            "table_row": self._table_row, "empty": empty if skips else self._nothing_empty, "profiles": self._profiles,
        }  # fmt: skip
        return Medium(self._structs[skips], self._inside_structs[skips], extinction, skips_zeros, self, buffers)

    def _checked(self, extinction: np.ndarray) -> np.ndarray:
        """An extinction as kernels take it; see `medium`."""
        values = np.ascontiguousarray(extinction, np.float32)
        check_extinction(values)
        if self._radius is not None:
            remedy = "a cloudy voxel must know its droplets' size: set its extinction to 0, or give it one"
            require_present("rendering", "effective_radius", self._radius, remedy, values > 0)
        check_depth(values, min(self.scene.grid.spacing))
        if self.mask is not None and values[~self.mask].any():
            raise DataError("extinction is above 0 outside of the mask: set it to 0 there, or widen the mask")
        return values


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
    radius = as_numbers(radius, "effective_radius")
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
