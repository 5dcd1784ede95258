"""A known cloud, to compare a recovered one with."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from cloudtomo_cl.errors import SettingsError
from cloudtomo_cl.files.extinction import read_extinction
from cloudtomo_cl.scene.grid import Grid


def read_truth(path: Path, grid: Grid) -> np.ndarray:
    """A known cloud on the grid of a reconstruction. SettingsError if it lies on another grid."""
    grid_of_truth, truth = read_extinction(path)
    same = grid_of_truth.shape == grid.shape and all(
        np.allclose(getattr(grid_of_truth, name), getattr(grid, name), rtol=1e-5, atol=1e-6)
        for name in ("spacing", "origin")
    )
    if not same:
        raise SettingsError(f"truth.file: {path} lies on {grid_of_truth}, the reconstruction on {grid}: use one grid")
    return truth
