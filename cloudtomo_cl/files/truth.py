"""A known cloud, to compare a recovered one with."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from cloudtomo_cl.errors import SettingsError
from cloudtomo_cl.files.extinction import read_extinction, read_extinction_wavelength
from cloudtomo_cl.files.wavelengths import is_same, read_wavelengths
from cloudtomo_cl.scene.grid import Grid


def read_truth(path: Path, grid: Grid, wavelength: float | None = None) -> np.ndarray:
    """A known cloud on the grid of a reconstruction.

    Parameters
    ----------
    path : of its file
    grid : of the reconstruction
    wavelength : nm, of the images, if it is known: an extinction at another one is no truth

    Raises
    ------
    SettingsError : it lies on another grid, or is at another wavelength
    """
    several = wavelength is not None and len(read_wavelengths(path)) > 1
    grid_of_truth, truth = read_extinction(path, wavelength if several else None)
    known = None if several else read_extinction_wavelength(path)
    if wavelength is not None and known is not None and not is_same(known, wavelength):
        at = f"at {known:g} nm" if known else "in the limit of large droplets"
        raise SettingsError(
            f"truth.file: {path} has its extinction {at}, the images are of {wavelength:g} nm: take the images' file, "
            "which has that of each of its wavelengths"
        )
    same = grid_of_truth.shape == grid.shape and all(
        np.allclose(getattr(grid_of_truth, name), getattr(grid, name), rtol=1e-5, atol=1e-6)
        for name in ("spacing", "origin")
    )
    if not same:
        raise SettingsError(f"truth.file: {path} lies on {grid_of_truth}, the reconstruction on {grid}: use one grid")
    return truth
