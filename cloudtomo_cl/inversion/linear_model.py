"""Images as a linear function of the extinction, near one: what solvers minimise with."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.sparse.linalg import LinearOperator

# Entries of a Jacobian that are squared at a time.
_BLOCK = 1 << 24


class Jacobian(LinearOperator):
    """Derivatives of pixels' radiances with respect to voxels' extinctions, W m^-2 sr^-1 km.

    Products, `jacobian @ x` and `jacobian.T @ y`, are in single precision; they change nothing.

    Parameters
    ----------
    values : float32, shape (pixels, voxels); it is not copied
    """

    def __init__(self, values: np.ndarray) -> None:
        super().__init__(np.dtype(np.float32), values.shape)
        self._values = values

    def _matvec(self, x: np.ndarray) -> np.ndarray:
        return self._values @ np.asarray(x, np.float32).reshape(-1)

    def _rmatvec(self, y: np.ndarray) -> np.ndarray:
        return np.asarray(y, np.float32).reshape(-1) @ self._values

    def _matmat(self, x: np.ndarray) -> np.ndarray:
        return self._values @ np.asarray(x, np.float32)

    def _rmatmat(self, y: np.ndarray) -> np.ndarray:
        return self._values.T @ np.asarray(y, np.float32)

    def curvature(self, weights: np.ndarray) -> np.ndarray:
        """The diagonal of J^T W J: sum_d w_d J_dv^2.

        Parameters
        ----------
        weights : w, shape (pixels,)

        Returns
        -------
        shape (voxels,), float64
        """
        values = self._values
        curvature = np.zeros(values.shape[1])
        block = max(1, _BLOCK // len(curvature))
        for first in range(0, len(values), block):
            here = slice(first, first + block)
            curvature += weights[here].astype(np.float32) @ values[here] ** 2
        return curvature


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
