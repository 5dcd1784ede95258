"""Mixtures of Gaussians fitted to patches of clouds."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from cloudtomo_cl.blas import with_one_blas_thread
from cloudtomo_cl.errors import DataError
from cloudtomo_cl.inversion.mixture import Mixture
from cloudtomo_cl.inversion.relative_prior import mean_extinction

# Patches without cloud: their share of all patches near a cloud, and the standard deviation of their values. A patch
# has cloud if a voxel of it exceeds _LEAST_CLOUD. Values are in units of the cloud's mean extinction.
_CLEAR_SHARE, _CLEAR_DEVIATION, _LEAST_CLOUD = 0.5, 0.02, 0.01
# Variance added in every direction: for rounding, and where too few patches differ.
_LEAST_VARIANCE = 1e-4
# Rounds of k-means.
_MEANS_ROUNDS = 8
# Responsibilities (probabilities of a component given a patch) below this are left out of sums.
_LEAST_SHARE = 1e-4


def cloudy_patches(
    clouds: Sequence[np.ndarray], size: tuple[int, int, int], count: int, random: np.random.Generator
) -> np.ndarray:
    """Patches with cloud, the same number from each cloud where it has so many, in units of its mean extinction.

    Each is turned and mirrored about the vertical at random, since no horizontal direction is special.

    Parameters
    ----------
    clouds : extinctions in any unit, on voxels of one shape; clear air is added around them
    size : size of a patch, voxels along x, y, z; the first two are equal
    count : largest number of patches

    Returns
    -------
    values of the patches, float32, shape (patches, values)

    Raises
    ------
    DataError : a patch is not as wide as long, or there is no cloud
    """
    if size[0] != size[1]:
        raise DataError(f"patches of {size} voxels cannot be turned: the first two numbers must be equal")
    found = []
    for cloud in clouds:
        scale = mean_extinction(np.asarray(cloud, float))
        if not scale > 0:
            raise DataError("a cloud to learn from has no extinction: leave it out")
        padded = np.pad((cloud / scale).astype(np.float32), [(n - 1, n - 1) for n in size])
        patches = np.lib.stride_tricks.sliding_window_view(padded, size)
        places = np.argwhere(patches.max(axis=(3, 4, 5)) > _LEAST_CLOUD)
        chosen = places[random.choice(len(places), min(count // len(clouds), len(places)), replace=False)]
        found.append(_turned(patches[tuple(chosen.T)], random).reshape(len(chosen), -1))
    return np.concatenate(found)


def _turned(patches: np.ndarray, random: np.random.Generator) -> np.ndarray:
    result = patches.copy()
    for axes in ((2, 1, 3), None, None):
        chosen = random.random(len(patches)) < 0.5
        axis = 1 if axes is None else 2
        result[chosen] = result[chosen].transpose(0, *axes) if axes else np.flip(result[chosen], axis)
    return result


@with_one_blas_thread
def fitted_mixture(
    patches: np.ndarray,
    size: tuple[int, int, int],
    components: int,
    rounds: int,
    random: np.random.Generator,
    progress: Callable[[int, int], None] | None = None,
) -> Mixture:
    """The mixture of largest likelihood, with a first component added for patches without cloud.

    It is found by expectation maximisation (Dempster, Laird and Rubin 1977), started by k-means.

    Parameters
    ----------
    patches : values of patches with cloud, float32, shape (patches, values)
    size : size of a patch, voxels along x, y, z
    components : number of components for patches with cloud
    rounds : number of rounds of expectation maximisation
    random : generator for the start of k-means
    progress : function that is called after every round, with the number of rounds done and of all rounds

    Raises
    ------
    DataError : fewer patches per component than a patch has values: covariances would not have full rank
    """
    values = math.prod(size)
    if len(patches) < components * values:
        fewer = f", or take at most {len(patches) // values} components" if len(patches) >= values else ""
        raise DataError(
            f"{len(patches)} patches with cloud are too few for {components} components, each of which needs "
            f"{values} or more: give more or larger clouds, or allow more patches{fewer}"
        )
    shares = np.zeros((len(patches), components), np.float32)
    shares[np.arange(len(patches)), _clusters(patches, components, random)] = 1.0
    for done in range(1, rounds + 1):
        weights, means, covariances = _most_likely(patches, shares)
        shares = _shares(patches, weights, means, covariances)
        if progress is not None:
            progress(done, rounds)
    weights, means, covariances = _most_likely(patches, shares)
    return Mixture(
        size,
        np.concatenate([[_CLEAR_SHARE], (1 - _CLEAR_SHARE) * weights]),
        np.concatenate([np.zeros((1, values)), means]),
        np.concatenate([_CLEAR_DEVIATION**2 * np.eye(values)[None], covariances]),
    )


def _clusters(patches: np.ndarray, components: int, random: np.random.Generator) -> np.ndarray:
    """The number of each patch's cluster, by k-means from patches drawn at random."""
    centres = patches[random.choice(len(patches), components, replace=False)]
    for _ in range(_MEANS_ROUNDS):
        nearest = ((centres**2).sum(axis=1) - 2 * patches @ centres.T).argmin(axis=1)
        for cluster in range(components):
            if (nearest == cluster).any():
                centres[cluster] = patches[nearest == cluster].mean(axis=0)
    return nearest


def _most_likely(patches: np.ndarray, shares: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Weights, means and covariances of components, from their shares of each patch, shape (patches, components)."""
    counts = shares.sum(axis=0, dtype=np.float64) + 1e-9
    means = (shares.T @ patches).astype(float) / counts[:, None]
    covariances = np.empty((len(counts), patches.shape[1], patches.shape[1]))
    for component, count in enumerate(counts):
        counted = shares[:, component] > _LEAST_SHARE
        away = (patches[counted] - means[component].astype(np.float32)) * np.sqrt(shares[counted, component])[:, None]
        covariances[component] = away.T @ away / count
    covariances += _LEAST_VARIANCE * np.eye(patches.shape[1])
    return counts / counts.sum(), means, covariances


def _shares(patches: np.ndarray, weights: np.ndarray, means: np.ndarray, covariances: np.ndarray) -> np.ndarray:
    """The probability of each component given each patch, shape (patches, components)."""
    logarithms = np.empty((len(patches), len(weights)), np.float32)
    for component, mean in enumerate(means):
        root = np.linalg.cholesky(covariances[component])
        white = (patches - mean.astype(np.float32)) @ np.linalg.inv(root).T.astype(np.float32)
        constant = np.log(weights[component]) - np.log(np.diag(root)).sum()
        logarithms[:, component] = constant - 0.5 * np.einsum("ij,ij->i", white, white)
    logarithms -= logarithms.max(axis=1, keepdims=True)
    np.exp(logarithms, out=logarithms)
    return logarithms / logarithms.sum(axis=1, keepdims=True)
