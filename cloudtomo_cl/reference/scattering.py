"""Scattering in double precision, to check the kernels by: densities, and directions drawn from them.

Directions are unit vectors, shape (3,); densities are over the sphere, sr^-1. docs/reference/random-numbers.md says
which uniform number draws what.
"""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np
import scipy.optimize

from cloudtomo_cl.scene.scene import Scene


class Particle(NamedTuple):
    """What a path has met; droplets have a row of the phase table (0 without a table)."""

    kind: Literal["droplet", "molecule", "surface"]
    row: int = 0


def henyey_greenstein(cosine: float, g: float) -> float:
    """Density of scattering, sr^-1 (Henyey and Greenstein 1941)."""
    return (1 - g * g) / (4 * np.pi * (1 + g * g - 2 * g * cosine) ** 1.5)


def rayleigh(cosine: float) -> float:
    """Density of scattering, sr^-1, of unpolarised light."""
    return 3 / (16 * np.pi) * (1 + cosine * cosine)


def sample_henyey_greenstein(u: float, g: float) -> float:
    """The cosine below which a share u of the light is scattered."""
    s = 2 * u - 1
    # ((1 + g^2) - ((1 - g^2) / (1 + g s))^2) / (2 g), without its cancellation for small g.
    return float(np.clip((s + g * g * s + g * (s * s * (1 + g * g) + 3 - g * g) / 2) / (1 + g * s) ** 2, -1, 1))


def sample_rayleigh(u: float) -> float:
    """The cosine below which a share u of the light is scattered: c^3 + 3 c + 4 = 8 u."""
    roots = np.roots([1.0, 0.0, 3.0, 4.0 - 8.0 * u])
    return float(np.clip(roots[np.argmin(np.abs(roots.imag))].real, -1, 1))


def direction_around(axis: np.ndarray, cosine: float, u: float) -> np.ndarray:
    """The unit vector at a cosine from `axis` and at azimuth 2 pi u in the frame of Duff et al. 2017."""
    x, y, z = axis
    sign = np.copysign(1.0, z)
    a = -1 / (sign + z)
    b = x * y * a
    first = np.array([1 + sign * x * x * a, sign * b, -sign * x])
    second = np.array([b, sign + y * y * a, -y])
    sine = np.sqrt(max(1 - cosine * cosine, 0.0))
    result = sine * (np.cos(2 * np.pi * u) * first + np.sin(2 * np.pi * u) * second) + cosine * axis
    return result / np.linalg.norm(result)


def sample_double_henyey_greenstein(u: float, forward_g: float, backward_g: float, forward_fraction: float) -> float:
    """The lobe is chosen by u, the cosine by what is left of u."""
    backward_fraction = 1 - forward_fraction
    if u < backward_fraction:
        return sample_henyey_greenstein(u / backward_fraction, backward_g)
    return sample_henyey_greenstein((u - backward_fraction) / forward_fraction, forward_g)


def sample_table(u: float, cosines: np.ndarray, densities: np.ndarray) -> float:
    """The cosine below which a share u of the light is scattered, for a density linear in the cosine.

    cosines : decreasing from 1 to -1, shape (n,); densities : sr^-1, shape (n,)
    """
    cosine, density = cosines[::-1], densities[::-1]
    shares = np.concatenate([[0.0], np.cumsum(np.pi * np.diff(cosine) * (density[1:] + density[:-1]))])

    def share(c: float) -> float:
        j = min(int(np.searchsorted(cosine, c, side="right")) - 1, len(cosine) - 2)
        return shares[j] + np.pi * (c - cosine[j]) * (density[j] + np.interp(c, cosine, density)) - u * shares[-1]

    return float(scipy.optimize.brentq(share, -1.0, 1.0, xtol=1e-15))


def droplet_density(scene: Scene, row: int, cosine: float) -> float:
    """Density of scattering by a droplet, sr^-1."""
    phase = scene.cloud.phase_function
    if phase.type == "table":
        cosines = np.cos(np.radians(phase.angle))
        return float(np.interp(cosine, cosines[::-1], phase.values[row][::-1]))
    if phase.type == "double-henyey-greenstein":
        forward, backward = henyey_greenstein(cosine, phase.forward_g), henyey_greenstein(cosine, phase.backward_g)
        return phase.forward_fraction * forward + (1 - phase.forward_fraction) * backward
    return henyey_greenstein(cosine, phase.g)


def sample_droplet(scene: Scene, row: int, u: float) -> float:
    """The cosine of scattering by a droplet."""
    phase = scene.cloud.phase_function
    if phase.type == "table":
        return sample_table(u, np.cos(np.radians(phase.angle)), np.array(phase.values[row]))
    if phase.type == "double-henyey-greenstein":
        return sample_double_henyey_greenstein(u, phase.forward_g, phase.backward_g, phase.forward_fraction)
    return sample_henyey_greenstein(u, phase.g)


def droplet_in_voxel(scene: Scene, effective_radius: float | None, u: float) -> tuple[Particle, float]:
    """A droplet of a voxel and its single-scattering albedo.

    Between two radii of the phase table (micrometres; None: the scene's) droplets are a mixture,
    of which u chooses one.
    """
    phase, albedo = scene.cloud.phase_function, scene.cloud.single_scattering_albedo
    if phase.type != "table":
        return Particle("droplet"), albedo
    row = 0
    if len(phase.values) > 1:
        radius = scene.cloud.effective_radius if effective_radius is None else effective_radius
        assert radius is not None, "a table of several radii needs one of the droplets"
        between = np.interp(radius, phase.effective_radius, np.arange(len(phase.values)))
        row = int(between) + int(u < between % 1)
    if phase.single_scattering_albedo is not None:
        albedo = phase.single_scattering_albedo[row]
    return Particle("droplet", row), albedo


def middle_row(scene: Scene) -> int:
    """The row of the phase table that directions around the sun are drawn from."""
    return len(scene.cloud.phase_function.values) // 2 if scene.cloud.phase_function.type == "table" else 0


def scatter_density(scene: Scene, particle: Particle, before: np.ndarray, after: np.ndarray) -> float:
    """Density, sr^-1, of scattering from one direction of a path into another."""
    if particle.kind == "droplet":
        return droplet_density(scene, particle.row, before @ after)
    return rayleigh(before @ after) if particle.kind == "molecule" else max(after[2], 0.0) / np.pi


def scatter(scene: Scene, particle: Particle, before: np.ndarray, u: float, u_azimuth: float) -> np.ndarray:
    """A direction drawn from `scatter_density`."""
    if particle.kind == "surface":
        return direction_around(np.array([0.0, 0.0, 1.0]), np.sqrt(u), u_azimuth)
    cosine = sample_droplet(scene, particle.row, u) if particle.kind == "droplet" else sample_rayleigh(u)
    return direction_around(before, cosine, u_azimuth)
