"""Bins of directions, and what droplets scatter from one into another."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from cloudtomo_cl.blas import with_one_blas_thread
from cloudtomo_cl.scene.phase import PhaseFunction

# Rings of directions around the vertical, degrees from it, and their azimuths: cells of about
# 0.09 sr, smaller near the vertical.
EDGES = (0.0, 7.0, 17.0, 28.0, 40.0, 52.0, 65.0, 78.0, 90.0, 102.0, 115.0, 128.0, 140.0, 152.0, 163.0, 173.0, 180.0)
AZIMUTHS = (1, 4, 6, 8, 10, 13, 14, 14, 14, 14, 13, 10, 8, 6, 4, 1)
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
# Angles from the vertical within each ring over which functions are averaged.
_NODES = 48
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
@with_one_blas_thread
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
    covariance = moments**2 * np.exp(-((np.arange(len(moments)) / _FADED) ** 2))
    harmonics, degrees = _harmonics()

    def means(of_degree: np.ndarray) -> np.ndarray:
        """Over every two bins, of the function of the angle between directions that has these moments."""
        means_of_two: np.ndarray = (harmonics * of_degree[degrees]) @ harmonics.T
        return means_of_two

    radiance, scattered = means(covariance), means(covariance * moments)
    scale = np.mean(np.diag(radiance))
    rough = _ROUGH * scale * solid_angles().mean() / solid_angles()
    both = _ISOTROPIC * scale
    matrix = np.linalg.solve(radiance + both + np.diag(rough), scattered + both).T
    return matrix / matrix.sum(axis=1, keepdims=True)


def _harmonics() -> tuple[np.ndarray, np.ndarray]:
    """Means of the real spherical harmonics over the bins.

    Source: the recursion of Holmes and Featherstone 2002, "A unified approach to the Clenshaw summation and the
    recursive computation of very high degree and order normalised associated Legendre functions", equation 11.

    Returns
    -------
    means : shape (bins, harmonics)
    degrees : of the harmonics
    """
    nodes, weights = np.polynomial.legendre.leggauss(_NODES)
    lower, upper = np.radians(EDGES[:-1])[:, None], np.radians(EDGES[1:])[:, None]
    angles = (lower + upper) / 2 + (upper - lower) / 2 * nodes  # (rings, nodes)
    weights = weights * np.sin(angles)
    weights /= weights.sum(axis=1, keepdims=True)
    cosine, sine = np.cos(angles), np.sin(angles)
    counts = np.repeat(AZIMUTHS, AZIMUTHS)
    middle = 2 * np.pi * (np.arange(BINS) - np.repeat(_FIRST, AZIMUTHS) + 0.5) / counts
    means, degrees = [], []
    sectoral = np.full_like(angles, np.sqrt(1 / (4 * np.pi)))
    for m in range(_MOMENTS + 1):
        if m:
            sectoral = sectoral * sine * np.sqrt((2 * m + 1) / (2 * m) * (2 if m == 1 else 1))
        before, legendre = np.zeros_like(sectoral), sectoral
        around = [np.ones(BINS)] if m == 0 else [f(m * middle) * np.sinc(m / counts) for f in (np.cos, np.sin)]
        for degree in range(m, _MOMENTS + 1):
            of_rings = np.repeat((weights * legendre).sum(axis=1), AZIMUTHS)
            means += [of_rings * of_azimuths for of_azimuths in around]
            degrees += [degree] * len(around)
            raised = (degree + 1) ** 2 - m**2
            kept = (degree**2 - m**2) / (4 * degree**2 - 1)
            following = np.sqrt((4 * (degree + 1) ** 2 - 1) / raised) * (cosine * legendre - np.sqrt(kept) * before)
            before, legendre = legendre, following
    return np.array(means).T, np.array(degrees)


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
