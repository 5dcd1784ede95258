"""The scenes of a scene file: one for each wavelength, with the cloud's extinction at it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cloudtomo_cl.errors import SettingsError
from cloudtomo_cl.files.extinction import read_effective_radius, read_extinction, read_extinction_wavelength
from cloudtomo_cl.files.phase import read_droplet_table
from cloudtomo_cl.files.wavelengths import is_same, read_wavelengths
from cloudtomo_cl.scene.droplets import DropletTable, extinction_at
from cloudtomo_cl.scene.scene import Scene
from cloudtomo_cl.settings.tables import (
    FluxSettings,
    RenderSettings,
    Spectrum,
    read_flux_settings,
    read_render_settings,
    read_tables,
)


@dataclass(frozen=True, eq=False)
class SceneFile:
    """What a scene file says, all of it read.

    Attributes
    ----------
    settings : at the first wavelength
    scenes : one, or one for each wavelength
    extinctions : of the cloud in each of them, km^-1, shape of the grid
    effective_radius : of the droplets, micrometres, shape of the grid; None if the cloud's file has none
    """

    settings: RenderSettings
    scenes: tuple[Scene, ...]
    extinctions: tuple[np.ndarray, ...]
    effective_radius: np.ndarray | None


def read_scene_file(path: Path, overrides: Sequence[str] = (), with_views: bool = True) -> SceneFile:
    """Reads a scene file and the cloud that it names.

    Raises
    ------
    SettingsError : a key is wrong; several wavelengths without a table of droplets that has them, or whose radii are
        not known
    DataError : a file is not there, or not what it must be; a table has not the wavelengths
    """
    read = read_render_settings if with_views else read_flux_settings
    first: RenderSettings | FluxSettings = read(path, overrides)
    file, spectrum = first.cloud.file, first.spectrum
    radius = read_effective_radius(file)
    if spectrum is None:
        grid, extinction = read_extinction(file)
        return SceneFile(first, (first.scene(grid),), (extinction,), radius)
    every = [first, *(read(path, overrides, wavelength) for wavelength in spectrum.wavelengths[1:])]
    light = _Droplets(path, first, _table_file(path, overrides), radius)
    extinctions = tuple(light.extinction(spectrum, wavelength) for wavelength in spectrum.wavelengths)
    scenes = tuple(spectrum.at(settings.scene(light.grid), index) for index, settings in enumerate(every))
    return SceneFile(first, scenes, extinctions, radius)


def _table_file(path: Path, overrides: Sequence[str]) -> Path | None:
    """The file of the droplets' phase functions, if a scene file, which has been checked, names one."""
    function = read_tables(path, overrides)["cloud"].get("phase_function")
    return path.parent / function["file"] if isinstance(function, dict) and "file" in function else None


class _Droplets:
    """The cloud of a scene file, whose extinction at any wavelength follows from its droplets."""

    def __init__(self, path: Path, settings: RenderSettings, table: Path | None, radius: np.ndarray | None) -> None:
        self._path, self._table = path, table
        self._file = settings.cloud.file
        self._several = len(read_wavelengths(self._file)) > 1
        self._known = None if self._several else read_extinction_wavelength(self._file)
        self._radius: np.ndarray | float | None = settings.cloud.effective_radius if radius is None else radius
        radii: tuple[float, ...] = getattr(settings.cloud.phase_function, "effective_radius", ())
        if self._radius is None and len(radii) == 1:
            self._radius = radii[0]
        first = settings.spectrum.wavelengths[0] if self._several and settings.spectrum is not None else None
        self.grid = read_extinction(self._file, first)[0]

    def extinction(self, spectrum: Spectrum, wavelength: float) -> np.ndarray:
        """At a wavelength, km^-1, float32, shape of the grid."""
        if self._several:
            return read_extinction(self._file, wavelength)[1]
        extinction = read_extinction(self._file)[1]
        reference = self._known if self._known is not None else spectrum.reference or spectrum.wavelengths[0]
        if is_same(reference, wavelength):
            return extinction
        if self._table is None:
            raise SettingsError(
                f"{self._path}: spectrum: the extinction at {wavelength:g} nm follows from the droplets, and there is "
                "no table of them: make one with cloudtomo mie --wavelength ..., and write phase_function = { type = "
                '"table", file = "mie.nc" }'
            )
        if self._radius is None:
            raise SettingsError(
                f"{self._path}: spectrum: the extinction at {wavelength:g} nm follows from the droplets' size, which "
                f"{self._file} does not have: give cloud.effective_radius (um)"
            )
        before = self._droplets(reference) if reference else None
        changed = extinction_at(extinction, self._radius, self._droplets(wavelength), before)
        return changed.astype(np.float32)

    def _droplets(self, wavelength: float) -> DropletTable:
        assert self._table is not None
        return read_droplet_table(self._table, wavelength)
