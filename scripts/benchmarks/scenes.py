"""The clouds that everything is timed on."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import cloudtomo_cl as ct


@dataclass(frozen=True)
class Case:
    """A scene, one view of it, and its extinction in km^-1."""

    name: str
    scene: ct.Scene
    view: ct.PerspectiveView
    extinction: np.ndarray


def data_folder() -> Path:
    """Where scene C lies: CLOUDTOMO_DATA, or ../shared/data beside the checkout."""
    beside = Path(__file__).resolve().parents[3] / "shared" / "data"
    return Path(os.environ.get("CLOUDTOMO_DATA", beside))


def scene_c(pixels: int = 76) -> Case:
    """Scene C of the paper from its nadir camera: 38^3 voxels of 20 x 20 x 40 m.

    Raises
    ------
    FileNotFoundError : the cloud is not there
    """
    import xarray

    with xarray.open_dataset(data_folder() / "scene_c.nc") as file:
        extinction = file["extinction"].transpose("x", "y", "z").values.astype(np.float32)
    grid = ct.Grid(shape=extinction.shape, spacing=(0.02, 0.02, 0.04))
    scene = ct.Scene(grid=grid, sun=ct.Sun(zenith=0.0), surface=ct.Surface(albedo=0.01))
    view = ct.PerspectiveView(
        position=(0.38, 0.38, 1.647), target=(0.38, 0.38, 1.013), up=(0, 1, 0), field_of_view=85.4,
        pixels=(pixels, pixels),
    )  # fmt: skip
    return Case("scene C", scene, view, extinction)


def generated(size: int, pixels: int = 64, voxels: int | None = None) -> Case:
    """A cloud of 1.6 km made up on `voxels`^3 voxels (by default size^3), each cut into equal parts to size^3."""
    voxels = voxels or size
    coarse = ct.Grid(shape=(voxels,) * 3, spacing=(1.6 / voxels,) * 3)
    extinction = ct.cumulus(coarse, seed=1).astype(np.float32)
    for axis in range(3):
        extinction = np.repeat(extinction, size // voxels, axis)
    scene = ct.Scene(grid=coarse.with_shape((size,) * 3), sun=ct.Sun(zenith=30.0, azimuth=40.0))
    view = ct.PerspectiveView(
        position=(0.8, 0.8, 5.0), target=(0.8, 0.8, 0.8), up=(0, 1, 0), field_of_view=22.0, pixels=(pixels, pixels)
    )
    return Case(f"cloud of {size}^3", scene, view, extinction)
