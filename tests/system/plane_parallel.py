"""Plane-parallel layers by doubling: an independent, deterministic check of the Monte Carlo.

Azimuthal means only: enough for fluxes, and for radiances straight up and down under any sun.
Written from Stamnes, Thomas and Stamnes 2017, "Radiative Transfer in the Atmosphere and Ocean"
(the discrete-ordinate equations) and Grant and Hunt 1969 (the interaction principle).
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import expm

# A direction that is only looked at or from, not a node of the quadrature, gets this weight.
TINY = 1e-9


def henyey_greenstein_moments(g, count=96):
    """Legendre coefficients of the phase function without the factors 2 l + 1; shape (count,)."""
    return float(g) ** np.arange(count)


def rayleigh_moments():
    return np.array([1.0, 0.0, 0.1])


@dataclass(frozen=True)
class Layer:
    """Fluxes over the incident one, and radiances as reflectance factors pi L / (mu0 F0)."""

    reflected: float
    diffuse: float  # transmitted
    direct: float
    nadir: float  # light going straight up, at the top
    zenith: float  # light going straight down, at the bottom; without the sun itself


def layer(optical_depth, albedo, moments, sun_cosine, surface_albedo=0.0, nodes=48):
    """A homogeneous layer over a Lambertian surface."""
    mu, weight = np.polynomial.legendre.leggauss(nodes)
    # Half ranges; then the zenith and the sun.
    mu = np.concatenate([(mu + 1) / 2, [1.0, sun_cosine]])
    weight = np.concatenate([weight / 2, [TINY, TINY]])
    size, sun = len(mu), len(mu) - 1
    orders = np.arange(len(moments))
    legendre = np.polynomial.legendre.legvander(mu, len(moments) - 1)
    coefficients = (2 * orders + 1) * moments
    # Azimuthal mean of the phase function, mean 1 over the sphere, into the same and the other hemisphere.
    same = legendre * coefficients @ legendre.T
    other = legendre * coefficients * (-1.0) ** orders @ legendre.T
    # Fluxes G = mu weight I of the nodes: dG/dtau = -forward G + backward G(other hemisphere).
    forward = np.diag(1 / mu) - albedo / 2 * weight[:, None] * same / mu
    backward = albedo / 2 * weight[:, None] * other / mu
    # A sheet thin enough for its matrix exponential to be well conditioned.
    doublings = max(int(np.ceil(np.log2(optical_depth / mu.min()))), 0)
    thin = optical_depth / 2.0**doublings
    transfer = expm(thin * np.block([[-forward, backward], [-backward, forward]]))
    a, b, c, d = transfer[:size, :size], transfer[:size, size:], transfer[size:, :size], transfer[size:, size:]
    # Downward light obeys the first row, upward light the second; solve for what goes out.
    reflect = -np.linalg.solve(d, c)
    transmit = a + b @ reflect
    for _ in range(doublings):
        between = np.linalg.inv(np.eye(size) - reflect @ reflect)
        reflect, transmit = (
            reflect + transmit @ reflect @ between @ transmit,
            transmit @ between @ transmit,
        )
    # A Lambertian surface spreads the flux that reaches it as mu weight.
    surface = surface_albedo * np.outer(2 * mu * weight, np.ones(size))
    below = np.linalg.solve(np.eye(size) - reflect @ surface, transmit)
    down = below[:, sun]
    up = reflect[:, sun] + transmit @ surface @ down
    direct = np.exp(-optical_depth / sun_cosine)
    zenith = sun - 1
    return Layer(
        reflected=up.sum(),
        diffuse=down.sum() - direct,
        direct=direct,
        nadir=up[zenith] / (2 * weight[zenith]),
        zenith=down[zenith] / (2 * weight[zenith]),
    )


def h_function(mu, albedo, nodes=64):
    """Chandrasekhar's H for isotropic scattering (1960, chapter V, Eq. 5 in the form without cancellation).

    1 / H(mu) = sqrt(1 - albedo) + albedo / 2 int_0^1 mu' H(mu') / (mu + mu') dmu'
    """
    points, weights = np.polynomial.legendre.leggauss(nodes)
    points, weights = (points + 1) / 2, weights / 2

    def inverse(at, h):
        return np.sqrt(1 - albedo) + albedo / 2 * (weights * points * h / (at[..., None] + points)).sum(axis=-1)

    h = np.ones(nodes)
    for _ in range(200):
        h = (h + 1 / inverse(points, h)) / 2
    return 1 / inverse(np.asarray(mu, float), h)
