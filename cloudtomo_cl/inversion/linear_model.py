"""Images as a linear function of the extinction, near a given one."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from cloudtomo_cl.scene.arrays import as_numbers
from cloudtomo_cl.transport.jacobian import Jacobian


@dataclass(frozen=True, eq=False)
class LinearModel:
    """Images near an extinction `x0`: image(x) is about `image` + `jacobian` (x - `x0`).

    Attributes
    ----------
    x0 : extinction of the mask's voxels, km^-1, shape (voxels,)
    image : radiances at x0, W m^-2 sr^-1, shape (pixels,)
    variance : variance of their noise, (W m^-2 sr^-1)^2, shape (pixels,)
    jacobian : derivatives, a `scipy.sparse.linalg.LinearOperator`, shape (pixels, voxels), W m^-2 sr^-1 km
    rendering : rendering that image and jacobian were made of
    """

    x0: np.ndarray
    image: np.ndarray
    variance: np.ndarray
    jacobian: Jacobian
    rendering: Any

    def __call__(self, x: np.ndarray) -> np.ndarray:
        """The modelled images at an extinction, shape (pixels,)."""
        return self.image + self.jacobian @ (as_numbers(x, "x") - self.x0)

    def __repr__(self) -> str:
        pixels, voxels = self.jacobian.shape
        return f"LinearModel({pixels} pixels, {voxels} voxels)"
