"""Bins of directions, and what droplets scatter from one into another."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from cloudtomo_cl.scene.phase import PhaseFunction

# Rings of directions around the vertical, degrees from it, and their azimuths: cells of about
# 0.17 sr, smaller near the vertical.
EDGES = (0.0, 8.0, 16.0, 28.0, 42.0, 60.0, 80.0, 100.0, 125.0, 150.0, 180.0)
AZIMUTHS = (1, 4, 6, 8, 10, 12, 12, 10, 8, 4)
_FIRST = tuple(int(first) for first in np.concatenate([[0], np.cumsum(AZIMUTHS)[:-1]]))
BINS = sum(AZIMUTHS)
# What kernels are built with.
FEATURES = (
    f"DIRECTION_RINGS {len(AZIMUTHS)}",
    f"DIRECTION_BINS {BINS}",
    "RING_COSINES " + ", ".join(f"{np.cos(np.radians(edge)):.8f}f" for edge in EDGES),
    "RING_AZIMUTHS " + ", ".join(map(str, AZIMUTHS)),
    "RING_FIRSTS " + ", ".join(map(str, _FIRST)),
)
# Points along each side of a bin over which functions are averaged.
_POINTS = 8
# Legendre moments that are used; they fade out over the later half, for bins see no finer.
_MOMENTS, _FADED = 100, 50.0
# Points between the directions 0 and 180 degrees apart at which functions of the angle are known.
_ANGLES = 4001
# Variances of a bin's radiance, in those of `scattering_matrix`'s fields: of what does not depend on direction, about
# which nothing is to be assumed, and of what is no smooth field at all.
_ISOTROPIC, _ROUGH = 1e4, 1e-3


def solid_angles() -> np.ndarray:
    """Of the bins, sr, shape (bins,)."""
    rings = -2 * np.pi * np.diff(np.cos(np.radians(EDGES)))
    return np.repeat(rings / AZIMUTHS, AZIMUTHS)


@lru_cache
def scattering_matrix(phase_function: PhaseFunction) -> np.ndarray:
    """From the radiance in each bin of directions to the light that droplets scatter into each.

    Were the radiance the same all over a bin, too much of it would scatter into the bin beside it: of the difference
    between scattered light and radiance, on which derivatives are made, some 20 % too much under an asymmetry of 0.85.
    So what bins hold is taken for means of a smooth field: a Gaussian process that is the same in all directions, with
    the covariance of light that has been scattered once, whatever its directions before. Both, p * p and what droplets
    make of it, p * p * p, have moments that are powers of the phase function's.

    Source: kriging with a mean that is not known, of averages (Journel and Huijbregts 1978, "Mining Geostatistics").

    Returns
    -------
    shape (bins, bins), sr per sr: the source function in bin i is its sum over j times the radiance in j; rows sum to 1
    """
    moments = _moments(phase_function)
    orders = np.arange(len(moments))
    covariance = moments**2 * np.exp(-((orders / _FADED) ** 2))
    directions, solid_angles = _points()
    radiance = _means(covariance, directions)
    scattered = _means(covariance * moments, directions)
    scale = np.mean(np.diag(radiance))
    rough = _ROUGH * scale * solid_angles.mean() / solid_angles
    both = _ISOTROPIC * scale
    matrix = np.linalg.solve(radiance + both + np.diag(rough), scattered + both).T
    return matrix / matrix.sum(axis=1, keepdims=True)


def _points() -> tuple[list[np.ndarray], np.ndarray]:
    """Unit vectors all over each bin, arrays (points, 3), and the bins' solid angles, sr."""
    random = np.random.default_rng(0)
    directions, solid_angles = [], []
    for ring, count in enumerate(AZIMUTHS):
        upper, lower = np.cos(np.radians(EDGES[ring : ring + 2]))
        for azimuth in range(count):
            u = (np.indices((_POINTS, _POINTS)).reshape(2, -1).T + random.random((_POINTS**2, 2))) / _POINTS
            cosine, phi = lower + (upper - lower) * u[:, 0], 2 * np.pi * (azimuth + u[:, 1]) / count
            sine = np.sqrt(1 - cosine**2)
            directions.append(np.column_stack([sine * np.cos(phi), sine * np.sin(phi), cosine]))
            solid_angles.append((upper - lower) * 2 * np.pi / count)
    return directions, np.array(solid_angles)


def _means(moments: np.ndarray, directions: list[np.ndarray]) -> np.ndarray:
    """Means over every two bins of a function of the angle between directions, given its Legendre moments."""
    orders = np.arange(len(moments))
    cosines = np.cos(np.linspace(np.pi, 0, _ANGLES))
    values = np.polynomial.legendre.legval(cosines, (2 * orders + 1) / (4 * np.pi) * moments)
    means = np.empty((BINS, BINS))
    for i, first in enumerate(directions):
        for j, second in enumerate(directions[: i + 1]):
            means[i, j] = means[j, i] = np.interp(first @ second.T, cosines, values).mean()
    return means


def _moments(phase_function: PhaseFunction) -> np.ndarray:
    """Legendre moments of a phase function, the first one 1."""
    angles = np.linspace(0, np.pi, 10 * _ANGLES)
    cosines = np.cos(angles)
    weighted = phase_function.density(cosines) * np.sin(angles)
    moments = np.empty(_MOMENTS + 1)
    order, following = np.ones_like(cosines), cosines
    for n in range(len(moments)):
        moments[n] = np.trapezoid(weighted * order, angles)
        order, following = following, ((2 * n + 3) * cosines * following - (n + 1) * order) / (n + 2)
    return moments / moments[0]
