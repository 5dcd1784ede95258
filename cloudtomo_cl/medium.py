"""What the kernels know of a scene: its optics, air and phase functions, on the device."""

from __future__ import annotations

from typing import Any

import numpy as np

from cloudtomo_cl.device import Device
from cloudtomo_cl.errors import DataError
from cloudtomo_cl.layout import scene_struct
from cloudtomo_cl.phase import TabulatedPhaseFunction
from cloudtomo_cl.scene import Scene


class Medium:
    """The device's buffers of a scene; only the extinction is missing.

    Parameters
    ----------
    scene : grid, optics, sun, air, surface, boundary
    device : where they are
    effective_radius : of the droplets, micrometres, shape of the grid, for a phase table of
        several radii; by default the scene's one. Where it is 0 or NaN there are no droplets
    side_flights : whether paths send flights towards the sun
    truncation : the largest local estimate, sr^-1

    Raises
    ------
    DataError : effective_radius is missing, of another shape, or outside of the phase table
    """

    def __init__(
        self,
        scene: Scene,
        device: Device,
        effective_radius: np.ndarray | None = None,
        side_flights: bool = False,
        truncation: float = np.inf,
    ) -> None:
        import pyopencl.array

        self.scene = scene
        self.device = device
        self._array = pyopencl.array
        self.struct = device.constant(scene_struct(scene, side_flights, truncation))
        self._profiles = device.constant(profiles(scene))
        self._table_row = device.constant(table_rows(scene, effective_radius))
        self.features = tuple(
            feature
            for feature, wanted in (
                ("CLOUDTOMO_ATMOSPHERE", scene.air is not None and scene.air.is_outside),
                ("CLOUDTOMO_PHASE_TABLE", isinstance(scene.cloud.phase_function, TabulatedPhaseFunction)),
            )
            if wanted
        )

    def extinction(self, extinction: Any) -> Any:
        """An extinction (km^-1, shape of the grid; NumPy or on the device) as an array on the device.

        Raises
        ------
        DataError : another shape, a value that is negative or not finite
        """
        if tuple(extinction.shape) != self.scene.grid.shape:
            raise DataError(f"extinction has shape {tuple(extinction.shape)}, the grid {self.scene.grid.shape}")
        if isinstance(extinction, self._array.Array):
            return extinction
        values = np.ascontiguousarray(extinction, np.float32)
        check_extinction(values)
        return self._array.to_device(self.device.queue, values)

    def arguments(self, extinction: Any) -> tuple[Any, ...]:
        """What every kernel that walks paths takes of the medium."""
        return extinction.data, self._table_row, self._profiles


def check_extinction(values: np.ndarray) -> None:
    """Raises DataError if an extinction is negative or not finite anywhere."""
    wrong = ~(np.isfinite(values) & (values >= 0))
    if wrong.any():
        voxel = tuple(int(i) for i in np.unravel_index(np.argmax(wrong), values.shape))
        raise DataError(f"extinction at voxel {voxel} is {values[voxel]}: it must be finite and at least 0 km^-1")


def profiles(scene: Scene) -> np.ndarray:
    """The 1-D tables of a scene one after the other, float32 (see kernels/medium.h)."""
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


def table_rows(scene: Scene, effective_radius: np.ndarray | None) -> np.ndarray:
    """Every voxel's place in the phase table: a row, or between two. One entry if there is one row."""
    phase = scene.cloud.phase_function
    if not isinstance(phase, TabulatedPhaseFunction) or len(phase.values) == 1:
        return np.zeros(1, np.float32)
    radius = effective_radius if effective_radius is not None else scene.cloud.effective_radius
    if radius is None:
        raise DataError(
            f"the phase function has {len(phase.values)} effective radii: give cloud.effective_radius, or the "
            "effective_radius of every voxel (micrometres)"
        )
    radius = np.asarray(radius, dtype=float)
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
    return np.ascontiguousarray(np.broadcast_to(rows, scene.grid.shape), np.float32)
