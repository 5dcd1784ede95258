"""A mixture of Gaussians for small patches of clouds: what clouds look like on a small scale."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np


@dataclass(frozen=True, eq=False)
class Mixture:
    """A mixture of Gaussians for the values of patches, in units of the cloud's mean extinction (`mean_extinction`).

    The first component stands for patches without cloud.

    Attributes
    ----------
    size : size of a patch, voxels along x, y, z
    weights : probabilities of the components, shape (components,)
    means : means of the components, shape (components, values), values in the order of a patch's array, z fastest
    covariances : covariances of the components, shape (components, values, values)
    """

    size: tuple[int, int, int]
    weights: np.ndarray
    means: np.ndarray
    covariances: np.ndarray

    def __len__(self) -> int:
        return len(self.weights)

    def __repr__(self) -> str:
        return f"Mixture({len(self)} components of {' x '.join(map(str, self.size))} voxels)"

    @cached_property
    def _axes(self) -> tuple[np.ndarray, np.ndarray]:
        """Variances along the principal axes, least first, shape (components, values), and the axes as columns."""
        variances, axes = np.linalg.eigh(self.covariances)
        return np.maximum(variances, 0.0), axes

    def precisions(self, noise: float) -> np.ndarray:
        """Inverse covariances of patches with noise of this standard deviation, (components, values, values)."""
        variances, axes = self._axes
        return (axes / (variances + noise**2)[:, None, :]) @ axes.transpose(0, 2, 1)

    def constants(self, noise: float) -> np.ndarray:
        """Constant of each component's minus log density, without the factor 2 pi, shape (components,)."""
        return 0.5 * np.log(self._axes[0] + noise**2).sum(axis=1) - np.log(self.weights)

    def whitening(self, noise: float) -> tuple[np.ndarray, np.ndarray]:
        """Axes along which patches with noise of this standard deviation are independent and have variance 1.

        Returns
        -------
        axes as rows, the narrowest first, shape (components, values, values), and the means along them, shape
        (components, values)
        """
        variances, axes = self._axes
        rows = (axes / np.sqrt(variances + noise**2)[:, None, :]).transpose(0, 2, 1)
        return rows, np.einsum("kij,kj->ki", rows, self.means)
