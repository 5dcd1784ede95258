"""Images as a linear function of the extinction, near one: what solvers minimise with."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from cloudtomo_cl.transport.jacobian import Jacobian


@dataclass(frozen=True, eq=False)
class LinearModel:
    """Images near an extinction: image(x) is about `image` + `jacobian` (x - `x0`).

    Attributes
    ----------
    x0 : extinction of the mask's voxels, km^-1, shape (voxels,)
    image : radiances there, W m^-2 sr^-1, shape (pixels,)
    variance : of their noise, shape (pixels,)
    jacobian : a `scipy.sparse.linalg.LinearOperator`, shape (pixels, voxels), W m^-2 sr^-1 km
    rendering : what image and jacobian were made of
    """

    x0: np.ndarray
    image: np.ndarray
    variance: np.ndarray
    jacobian: Jacobian
    rendering: Any

    def __call__(self, x: np.ndarray) -> np.ndarray:
        """The modelled images at an extinction, shape (pixels,)."""
        return self.image + self.jacobian @ (np.asarray(x, float) - self.x0)

    def __repr__(self) -> str:
        pixels, voxels = self.jacobian.shape
        return f"LinearModel({pixels} pixels, {voxels} voxels)"
