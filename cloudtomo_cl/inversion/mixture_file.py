"""NetCDF files with mixtures for patches, one for each of several shapes of voxels."""

from __future__ import annotations

import hashlib
import math
import os
import threading
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from cloudtomo_cl.errors import DataError
from cloudtomo_cl.files.netcdf import load_dataset, number_variable, save_variables
from cloudtomo_cl.inversion.mixture import Mixture

SHIPPED = Path(__file__).with_name("patches.nc")
LEARN = "`cloudtomo prior learn CLOUD... --output prior.nc`"
_OF_MIXTURE = ("aspect_ratio", "component")
_PATCH = ("patch_x", "patch_y", "patch_z")
_DIMENSIONS = {
    "aspect_ratio": ("aspect_ratio",),
    "weight": _OF_MIXTURE,
    "mean": (*_OF_MIXTURE, *_PATCH),
    "covariance": (*_OF_MIXTURE, "pair"),
}
_MEANINGS = {
    "aspect_ratio": "height of the voxels over their width",
    "weight": "share of the patches that are of a component",
    "mean": "extinction of a component's patches over the mean extinction of their cloud",
    "covariance": "covariance of the values of a component's patches",
}
# Voxels are like those of a mixture if their ratios of height to width differ by no more than this factor.
_ALIKE = 1.5
# With several devices every thread reads the file, and the netCDF library is not safe in threads.
_one_at_a_time = threading.Lock()


@dataclass(frozen=True, eq=False)
class MixtureFile:
    """Mixtures for voxels of several shapes.

    Attributes
    ----------
    aspects : height over width of the voxels of each mixture
    mixtures : mixtures, with the same size of patches and number of components
    """

    aspects: tuple[float, ...]
    mixtures: tuple[Mixture, ...]

    def of_spacing(self, spacing: tuple[float, ...]) -> Mixture:
        """The mixture for voxels whose shape is the most similar."""
        return self.mixtures[int(np.argmin(self._factors(spacing)))]

    def unlike(self, spacing: tuple[float, ...]) -> str:
        """A text that says how voxels differ from those of all mixtures; empty if some are alike."""
        factors = self._factors(spacing)
        if factors.min() <= _ALIKE:
            return ""
        return (
            f"the prior was learnt from no clouds on voxels like these, {aspect_ratio(spacing):.3g} times as high as "
            f"wide: it takes those of {self.aspects[int(np.argmin(factors))]:.3g}, which may be worse than smoothness "
            f'([prior] type = "smoothness"); {LEARN} learns from clouds of yours'
        )

    def _factors(self, spacing: tuple[float, ...]) -> np.ndarray:
        """The factor by which each mixture's aspect ratio differs from the voxels', at least 1."""
        factors: np.ndarray = np.exp(np.abs(np.log(np.divide(self.aspects, aspect_ratio(spacing)))))
        return factors

    @property
    def digest(self) -> str:
        """A digest of all numbers: the same for all files that hold the same mixtures."""
        found = hashlib.sha256(np.array(self.aspects, np.float64).tobytes())
        for mixture in self.mixtures:
            for array in (mixture.size, mixture.weights, mixture.means, mixture.covariances):
                found.update(np.ascontiguousarray(array, np.float64).data)
        return found.hexdigest()

    def write(self, path: str | os.PathLike[str], attributes: Mapping[str, Any] | None = None) -> None:
        """Writes a netCDF file, whole or not at all; numbers in single precision.

        Its variables are weight (aspect_ratio, component), mean (aspect_ratio, component, patch_x, patch_y, patch_z),
        and covariance (aspect_ratio, component, pair): the lower triangles, row by row.

        Parameters
        ----------
        path : path of the file
        attributes : further attributes, text or numbers; mappings are stored as JSON

        Raises
        ------
        DataError : the file cannot be written
        """
        first = self.mixtures[0]
        rows, columns = np.tril_indices(first.means.shape[1])
        arrays = {
            "aspect_ratio": np.array(self.aspects, np.float64),
            "weight": np.array([mixture.weights for mixture in self.mixtures], np.float32),
            "mean": np.array([mixture.means.reshape(-1, *first.size) for mixture in self.mixtures], np.float32),
            "covariance": np.array([mixture.covariances[:, rows, columns] for mixture in self.mixtures], np.float32),
        }
        variables: dict[str, Any] = {
            name: (_DIMENSIONS[name], array, {"long_name": _MEANINGS[name], "units": "1"})
            for name, array in arrays.items()
        }
        variables["covariance"][2]["comment"] = (
            "the lower triangle of a symmetric matrix, row by row; rows and columns are the values of mean, patch_z "
            "fastest"
        )
        coordinates = {name: variables.pop(name) for name in ("aspect_ratio",)}
        save_variables(path, "mixtures of Gaussians of patches of clouds", variables, coordinates, attributes)


def aspect_ratio(spacing: tuple[float, ...]) -> float:
    """A voxel's height over its width, the geometric mean of those along x and y."""
    return spacing[2] / math.sqrt(spacing[0] * spacing[1])


def read_mixtures(path: str | os.PathLike[str] = SHIPPED) -> MixtureFile:
    """Reads mixtures that `MixtureFile.write` wrote; by default the ones that come with the package.

    It also reads the older .npz files of scripts/learn_prior.py.

    Raises
    ------
    DataError : there is no such file, or it holds no mixtures
    """
    if not Path(path).is_file():
        raise DataError(f"{path}: no such file: {LEARN} makes one of clouds")
    try:
        with _one_at_a_time:
            return _of_arrays(*(_archived(path) if zipfile.is_zipfile(path) else _stored(path)))
    except MemoryError:
        raise
    except Exception as error:  # a damaged file may raise anything
        why = str(error).removeprefix(f"{path}: ")
        raise DataError(
            f"{path}: holds no mixtures of patches, or is damaged ({why}): make it again with {LEARN}"
        ) from None


def _stored(path: Any) -> tuple[np.ndarray, ...]:
    """aspect_ratio, weight, mean and covariance of a netCDF file."""
    dataset = load_dataset(path)
    return tuple(number_variable(path, dataset, name, dims).values for name, dims in _DIMENSIONS.items())


def _archived(path: Any) -> tuple[np.ndarray, ...]:
    """aspect_ratio, weight, mean and covariance of an older .npz file."""
    with np.load(path, allow_pickle=False) as file:
        means = file["means"].reshape(*file["weights"].shape, *map(int, file["size"]))
        return file["aspects"], file["weights"], means, file["covariances"]


def _of_arrays(aspects: np.ndarray, weights: np.ndarray, means: np.ndarray, covariances: np.ndarray) -> MixtureFile:
    size = means.shape[2], means.shape[3], means.shape[4]
    values = math.prod(size)
    rows, columns = np.tril_indices(values)
    if covariances.shape != (*weights.shape, len(rows)) or not weights.size or not values:
        raise ValueError("its arrays do not belong together")
    if not all(np.isfinite(array).all() for array in (aspects, weights, means, covariances)):
        raise ValueError("a number is not finite")
    if not (aspects > 0).all() or not (weights > 0).all():
        raise ValueError("an aspect ratio or a weight is not above 0")
    mixtures = []
    for weight, mean, triangle in zip(weights, means, covariances):
        covariance = np.zeros((len(weight), values, values))
        covariance[:, rows, columns] = covariance[:, columns, rows] = triangle
        mixtures.append(Mixture(size, weight.astype(float), mean.reshape(-1, values).astype(float), covariance))
    return MixtureFile(tuple(float(aspect) for aspect in aspects), tuple(mixtures))
