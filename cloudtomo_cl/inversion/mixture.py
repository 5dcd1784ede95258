"""A mixture of Gaussians of small patches of clouds: what clouds look like in the small."""

from __future__ import annotations

import math
import os
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from cloudtomo_cl.errors import DataError

_SHIPPED = Path(__file__).with_name("patches.npz")


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


@dataclass(frozen=True, eq=False)
class MixtureFile:
    """Mixtures for voxels of several shapes.

    Attributes
    ----------
    aspects : heights of the voxels over their widths
    mixtures : one for each
    """

    aspects: tuple[float, ...]
    mixtures: tuple[Mixture, ...]

    def of_spacing(self, spacing: tuple[float, ...]) -> Mixture:
        """That for voxels whose shape is the most like."""
        aspect = spacing[2] / math.sqrt(spacing[0] * spacing[1])
        return self.mixtures[int(np.argmin(np.abs(np.log(np.divide(self.aspects, aspect)))))]

    def write(self, path: str | os.PathLike[str]) -> None:
        """As .npz; of a covariance the lower triangle, in single precision."""
        rows, columns = np.tril_indices(self.mixtures[0].means.shape[1])
        np.savez_compressed(
            path,
            size=np.array(self.mixtures[0].size),
            aspects=np.array(self.aspects),
            weights=np.array([mixture.weights for mixture in self.mixtures], np.float32),
            means=np.array([mixture.means for mixture in self.mixtures], np.float32),
            covariances=np.array([mixture.covariances[:, rows, columns] for mixture in self.mixtures], np.float32),
        )


def read_mixtures(path: str | os.PathLike[str] = _SHIPPED) -> MixtureFile:
    """Mixtures that `MixtureFile.write` wrote; by default the one that comes with the package.

    Raises
    ------
    DataError : there is no such file, or it holds no mixtures
    """
    if not Path(path).is_file():
        raise DataError(f"{path}: no such file: `python scripts/learn_prior.py` makes one of clouds")
    try:
        with np.load(path, allow_pickle=False) as file:
            arrays = {name: file[name] for name in ("size", "aspects", "weights", "means", "covariances")}
        return _of_arrays(**arrays)
    except Exception as error:  # what a damaged file may raise has no end
        raise DataError(f"{path}: holds no mixtures of patches, or is damaged ({error}): make it again") from None


def _of_arrays(
    size: np.ndarray, aspects: np.ndarray, weights: np.ndarray, means: np.ndarray, covariances: np.ndarray
) -> MixtureFile:
    voxels = tuple(int(n) for n in size)
    values = math.prod(voxels)
    rows, columns = np.tril_indices(values)
    if len(voxels) != 3 or means.shape != (*weights.shape, values) or len(aspects) != len(weights):
        raise ValueError("its arrays do not belong together")
    if not all(np.isfinite(array).all() for array in (aspects, weights, means, covariances)):
        raise ValueError("a number is not finite")
    mixtures = []
    for weight, mean, triangle in zip(weights, means, covariances):
        covariance = np.zeros((len(weight), values, values))
        covariance[:, rows, columns] = covariance[:, columns, rows] = triangle
        shape = voxels[0], voxels[1], voxels[2]
        mixtures.append(Mixture(shape, weight.astype(float), mean.astype(float), covariance))
    return MixtureFile(tuple(float(aspect) for aspect in aspects), tuple(mixtures))
