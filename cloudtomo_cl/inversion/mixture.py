"""A mixture of Gaussians of small patches of clouds: what clouds look like in the small."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np


@dataclass(frozen=True, eq=False)
class Mixture:
    """Gaussians of patches' values, which are in units of the cloud's mean extinction (`mean_extinction`).

    The first component is that of patches without cloud.

    Attributes
    ----------
    size : voxels of a patch along x, y, z
    weights : of the components, shape (components,)
    means : shape (components, values), values in the order of a patch's array, z fastest
    covariances : shape (components, values, values)
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
        """Variances along the principal axes, the least first, shape (components, values), and the axes as columns."""
        variances, axes = np.linalg.eigh(self.covariances)
        return np.maximum(variances, 0.0), axes

    def precisions(self, noise: float) -> np.ndarray:
        """Inverse covariances of patches with noise of this standard deviation, (components, values, values)."""
        variances, axes = self._axes
        return (axes / (variances + noise**2)[:, None, :]) @ axes.transpose(0, 2, 1)

    def constants(self, noise: float) -> np.ndarray:
        """What a component's minus log density has beside its quadratic form, but for 2 pi, shape (components,)."""
        return 0.5 * np.log(self._axes[0] + noise**2).sum(axis=1) - np.log(self.weights)

    def whitening(self, noise: float) -> tuple[np.ndarray, np.ndarray]:
        """What patches with noise of this standard deviation are independent along, with variance 1.

        Returns
        -------
        axes as rows, the narrowest first, shape (components, values, values), and the means along them, (components,
        values)
        """
        variances, axes = self._axes
        rows = (axes / np.sqrt(variances + noise**2)[:, None, :]).transpose(0, 2, 1)
        return rows, np.einsum("kij,kj->ki", rows, self.means)
