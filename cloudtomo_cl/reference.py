"""A slow, plain transport and gradient in double precision, to check the fast ones by.

Everything here is written from the equations, one path at a time, with no thought of speed.
It draws the random numbers of docs/sampling.md, as the kernels do, so that a path of the
kernels and its path here are the same one up to rounding.

In the order of reading: random numbers, rays, flights, scattering, paths. Lengths are
in km, extinction in km^-1, radiances in sr^-1 (for a sun of irradiance 1). Equation numbers
are those of the supplement on the monotonicity prior.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

import numpy as np

from cloudtomo_cl.grid import Grid
from cloudtomo_cl.scene import Scene
from cloudtomo_cl.sensors import View

Particle = Literal["droplet", "molecule", "surface"]

# docs/sampling.md gives the meaning of these numbers.
BLOCKS_PER_EVENT = 64
PATH_ROULETTE_WEIGHT = 0.1
LOCAL_ESTIMATE_ROULETTE = 0.03
SIDE_FLIGHT_RATE, SIDE_FLIGHT_LEAST, SIDE_FLIGHT_MOST = 6.0, 0.05, 6.0


# --- random numbers ---------------------------------------------------------------------


def philox(counter: np.ndarray, key: np.ndarray) -> np.ndarray:
    """Philox4x32-10: 128 random bits of a counter and a key.

    Parameters
    ----------
    counter : shape (..., 4), of 32 bits each
    key : shape (..., 2), of 32 bits each

    Returns uint32, shape (..., 4).

    Source: Salmon et al. 2011, "Parallel random numbers: as easy as 1, 2, 3", section 3.3.
    """
    word, low = np.uint64(32), np.uint64(0xFFFFFFFF)
    counter, key = np.asarray(counter, np.uint64), np.asarray(key, np.uint64)
    left_0, right_0, left_1, right_1 = (counter[..., i] for i in range(4))
    for n in range(10):
        # The key is bumped by Weyl sequences of the golden ratio and of sqrt(3) - 1.
        key_0 = (key[..., 0] + np.uint64(n * 0x9E3779B9)) & low
        key_1 = (key[..., 1] + np.uint64(n * 0xBB67AE85)) & low
        product_0 = np.uint64(0xD2511F53) * left_0
        product_1 = np.uint64(0xCD9E8D57) * left_1
        left_0, right_0 = (product_1 >> word) ^ right_0 ^ key_0, product_1 & low
        left_1, right_1 = (product_0 >> word) ^ right_1 ^ key_1, product_0 & low
    return np.stack([left_0, right_0, left_1, right_1], axis=-1).astype(np.uint32)


def open_uniform(bits: np.ndarray) -> np.ndarray:
    """32 random bits as a float32 in the open interval (0, 1); the same shape."""
    scaled = (np.asarray(bits, np.uint32).astype(np.float32) + np.float32(0.5)) * np.float32(2.0**-32)
    return np.minimum(scaled, np.float32(1 - 2.0**-24))


def uniforms(seed: int, iteration: int, view: int, pixel: int, sample: int, block: int) -> np.ndarray:
    """The four uniform numbers of one block, float64 (of float32 values), shape (4,)."""
    return open_uniform(philox(np.array([pixel, view, sample, block]), np.array([seed, iteration]))).astype(float)


# --- rays -------------------------------------------------------------------------------


def camera_ray(view: View, grid: Grid, column: float, row: float) -> tuple[np.ndarray, np.ndarray]:
    """The ray of a point of an image.

    Parameters
    ----------
    column, row : in pixels from the upper left corner of the image; pixel (i, j) is the
        square from (i, j) to (i + 1, j + 1)

    Returns its origin (km, shape (3,)) and its direction, a unit vector.
    """
    width, height = view.pixels
    if view.type == "rays":
        index = int(row) * width + int(column)
        return view.origins[index], view.directions[index]
    top = grid.origin[2] + grid.extent[2]
    if view.type == "push-broom":
        start, end = np.array(view.start), np.array(view.end)
        ahead = (end - start) / np.sqrt(np.sum((end - start) ** 2))
        to_the_right = np.array([ahead[1], -ahead[0], 0.0])
        tilt = np.radians(view.along_track_angle)
        slope = (2 * column / width - 1) * np.tan(np.radians(view.field_of_view) / 2)
        direction = np.sin(tilt) * ahead + slope * to_the_right
        direction[2] -= np.cos(tilt)
        # The track ends at the top of the image.
        return start + (1 - row / height) * (end - start), direction / np.linalg.norm(direction)
    if view.type == "radiometer":
        theta, phi = np.radians(view.zenith), np.radians(view.azimuth)
        direction = -np.array([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)])
        east = grid.origin[0] + column / width * grid.extent[0]
        north = grid.origin[1] + (1 - row / height) * grid.extent[1]
        return np.array([east, north, top if view.zenith < 90 else grid.origin[2]]), direction
    if view.position is not None and view.target is not None:
        sight = np.subtract(view.target, view.position).astype(float)
        sight /= np.linalg.norm(sight)
    else:
        theta, phi = np.radians(view.zenith), np.radians(view.azimuth)
        sight = -np.array([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)])
    up = view.up
    if up is None:
        up = (0.0, 1.0, 0.0) if abs(sight[2]) > 1 - 1e-12 else (0.0, 0.0, 1.0)
    right = np.cross(sight, up)
    right /= np.linalg.norm(right)
    upward = np.cross(right, sight)
    # From the image's centre, in units of half its width: pixels are square.
    to_right, to_top = 2 * column / width - 1, (height - 2 * row) / width
    if view.type == "perspective":
        tangent = np.tan(np.radians(view.field_of_view / 2))
        direction = sight + tangent * (to_right * right + to_top * upward)
        return np.array(view.position, float), direction / np.linalg.norm(direction)
    offset = view.width / 2 * (to_right * right + to_top * upward)
    if view.position is not None:
        return np.array(view.position, float) + offset, sight
    centre = np.array(grid.centre if view.target is None else view.target, float) + offset
    # From above any atmosphere.
    return centre - sight * (max(top - centre[2], 0.0) + 100.0) / -sight[2], sight


# --- flights ----------------------------------------------------------------------------


def voxel_crossings(
    grid: Grid, position: np.ndarray, direction: np.ndarray, periodic: bool = False
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Every voxel that a ray crosses: all intersections with faces, sorted.

    Parameters
    ----------
    position : km, shape (3,), anywhere
    direction : a unit vector, shape (3,)
    periodic : whether the domain is repeated horizontally

    Returns the voxels, int of shape (n, 3); the distances at which the ray enters them (km
    from position, shape (n,)); and the lengths of the crossings (km, shape (n,)). Crossings
    of no length are left out. A ray that runs inside a face belongs to the upper voxel.

    Raises
    ------
    ValueError : the ray stays in a periodic domain for ever
    """
    start = (np.asarray(position, float) - grid.origin) / grid.spacing  # voxel units
    speed = np.asarray(direction, float) / grid.spacing  # voxels per km
    near, far = 0.0, np.inf
    for axis in (2,) if periodic else (0, 1, 2):
        if speed[axis] == 0:
            if not 0 <= start[axis] <= grid.shape[axis]:
                far = -np.inf
            continue
        ends = np.sort((np.array([0, grid.shape[axis]]) - start[axis]) / speed[axis])
        near, far = max(near, ends[0]), min(far, ends[1])
    if not near < far:
        return np.zeros((0, 3), int), np.zeros(0), np.zeros(0)
    if far == np.inf:
        raise ValueError("a horizontal ray never leaves a periodic domain")
    cuts = [near, far]
    for axis in range(3):
        if speed[axis] != 0:
            lower, upper = np.sort(start[axis] + np.array([near, far]) * speed[axis])
            faces = np.arange(np.ceil(lower), np.floor(upper) + 1)
            cuts.extend((faces - start[axis]) / speed[axis])
    distances = np.sort(np.clip(cuts, near, far))
    lengths = np.diff(distances)
    middles = start + (distances[:-1] + lengths / 2)[:, None] * speed
    voxels = np.floor(middles).astype(int)
    shape = np.array(grid.shape)
    horizontal = voxels[:, :2] % shape[:2] if periodic else np.clip(voxels[:, :2], 0, shape[:2] - 1)
    voxels = np.column_stack([horizontal, np.clip(voxels[:, 2], 0, shape[2] - 1)])
    # Faces that differ by rounding only would cut off slivers.
    real = lengths > 1e-13 * max(1.0, far)
    return voxels[real], distances[:-1][real], lengths[real]


@lru_cache
def air_profile(scene: Scene) -> np.ndarray:
    """Extinction of the molecules per layer, km^-1, shape (nz,)."""
    return scene.air.profile(scene.grid) if scene.air else np.zeros(scene.grid.shape[2])


@dataclass(frozen=True)
class Flight:
    """A free flight, or the way to the sun.

    Attributes
    ----------
    lengths : flown in every voxel, km, shape of the grid
    depth : optical depth flown through
    position : where it collided or left the domain, km (None: it never met the domain)
    voxel : where it collided (None: it left the domain)
    """

    lengths: np.ndarray
    depth: float
    position: np.ndarray | None = None
    voxel: tuple[int, int, int] | None = None


def fly(
    scene: Scene, extinction: np.ndarray, position: np.ndarray, direction: np.ndarray, reach: float = np.inf
) -> Flight:
    """Flies until an optical depth `reach` of droplets and air, or out of the domain (Eqs. 3, 12, 16)."""
    voxels, starts, crossed = voxel_crossings(scene.grid, position, direction, scene.boundary.horizontal == "periodic")
    lengths = np.zeros(scene.grid.shape)
    if len(voxels) == 0:
        return Flight(lengths, 0.0)
    total = extinction[tuple(voxels.T)] + air_profile(scene)[voxels[:, 2]]
    depths = np.concatenate([[0.0], np.cumsum(total * crossed)])  # at the faces
    collided = depths[-1] >= reach
    if collided:
        last = int(np.argmax(depths >= reach)) - 1
        voxels, starts, crossed = voxels[: last + 1], starts[: last + 1], crossed[: last + 1].copy()
        crossed[last] = (reach - depths[last]) / total[last]
    np.add.at(lengths, tuple(voxels.T), crossed)
    end = position + (starts[-1] + crossed[-1]) * direction
    if collided:
        x, y, z = voxels[-1]
        return Flight(lengths, reach, end, (int(x), int(y), int(z)))
    return Flight(lengths, float(depths[-1]), end)


def transmittance(scene: Scene, extinction: np.ndarray, position: np.ndarray, direction: np.ndarray) -> float:
    """From a position to where a ray leaves the domain."""
    return float(np.exp(-fly(scene, extinction, position, direction).depth))


# --- scattering -------------------------------------------------------------------------


def henyey_greenstein(cosine: float, g: float) -> float:
    """Density of scattering, sr^-1 (Henyey and Greenstein 1941)."""
    return (1 - g * g) / (4 * np.pi * (1 + g * g - 2 * g * cosine) ** 1.5)


def rayleigh(cosine: float) -> float:
    """Density of scattering, sr^-1, of unpolarised light."""
    return 3 / (16 * np.pi) * (1 + cosine * cosine)


def sample_henyey_greenstein(u: float, g: float) -> float:
    """The cosine below which a share u of the light is scattered."""
    if g == 0:
        return 2 * u - 1
    return float(np.clip((1 + g * g - ((1 - g * g) / (1 - g + 2 * g * u)) ** 2) / (2 * g), -1, 1))


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


def scatter_density(scene: Scene, particle: Particle, before: np.ndarray, after: np.ndarray) -> float:
    """Density, sr^-1, of scattering from one direction of a path into another."""
    if particle == "droplet":
        return henyey_greenstein(before @ after, scene.cloud.phase_function.g)
    return rayleigh(before @ after) if particle == "molecule" else max(after[2], 0.0) / np.pi


def scatter(scene: Scene, particle: Particle, before: np.ndarray, u: float, u_azimuth: float) -> np.ndarray:
    """A direction drawn from `scatter_density`."""
    if particle == "surface":
        return direction_around(np.array([0.0, 0.0, 1.0]), np.sqrt(u), u_azimuth)
    g = scene.cloud.phase_function.g
    cosine = sample_henyey_greenstein(u, g) if particle == "droplet" else sample_rayleigh(u)
    return direction_around(before, cosine, u_azimuth)


def met_particle(
    scene: Scene, extinction: np.ndarray, voxel: tuple[int, int, int], u: float
) -> tuple[Particle, float, float]:
    """The particle of a collision, its single-scattering albedo, and 1 / extinction of a droplet, else 0."""
    air, droplets = air_profile(scene)[voxel[2]], extinction[voxel]
    if u * (droplets + air) < droplets:
        return "droplet", scene.cloud.single_scattering_albedo, 1 / droplets
    return "molecule", scene.air.single_scattering_albedo, 0.0  # type: ignore[union-attr]


# --- paths ------------------------------------------------------------------------------


@dataclass(frozen=True)
class Contribution:
    """What one local estimate adds to a path.

    Attributes
    ----------
    radiance : sr^-1, for a sun of irradiance 1
    derivative : of its mean, by the voxels' extinction, sr^-1 km, shape of the grid
    """

    radiance: float
    derivative: np.ndarray


def local_estimate(
    scene: Scene, extinction: np.ndarray, position: np.ndarray, weight: float, history: np.ndarray,
    u_roulette: float | None,
) -> Contribution:
    """Sunlight at a collision (Eq. 4), with the gradient of Eqs. 13-18.

    Parameters
    ----------
    weight : sr^-1, all but the transmittance to the sun
    history : d log(density of the path up to here) / d extinction, km, shape of the grid
    u_roulette : plays the roulette on what the estimate is worth; None: no roulette

    The derivative of the density of a path and its transmittance to the sun is minus the
    lengths of all segments, plus 1 / extinction at every collision with a droplet.
    """
    way = fly(scene, extinction, position, scene.sun.direction)
    worth = weight * np.exp(-way.depth)
    if u_roulette is None:
        radiance = worth
    else:
        survives = worth > u_roulette * LOCAL_ESTIMATE_ROULETTE
        radiance = max(worth, LOCAL_ESTIMATE_ROULETTE) if survives else 0.0
    return Contribution(radiance, radiance * (history - way.lengths))


def side_flights(
    scene: Scene, extinction: np.ndarray, position: np.ndarray, before: np.ndarray, particle: Particle,
    weight: float, count: float, history: np.ndarray, number: int, random: Iterator[np.ndarray],
) -> Iterator[Contribution]:
    """The next order's sunlight by `number` flights drawn around the sun (docs/sampling.md).

    They share the estimate with the path's own next flight by the balance heuristic
    (Veach and Guibas 1995); `count` is the mean of `number`.
    """
    sun, g = scene.sun.direction, scene.cloud.phase_function.g
    for _ in range(number):
        w, w_roulette = next(random), next(random)[0]
        direction = direction_around(sun, sample_henyey_greenstein(w[2], g), w[3])
        flight = fly(scene, extinction, position, direction, -np.log(w[0]))
        if flight.voxel is None:
            continue
        target, albedo, inverse = met_particle(scene, extinction, flight.voxel, w[1])
        density = scatter_density(scene, particle, before, direction)
        sun_density = henyey_greenstein(direction @ sun, g)
        estimate = weight * albedo * density * scatter_density(scene, target, direction, sun)
        estimate /= density + count * sun_density
        onward = history - flight.lengths
        onward[flight.voxel] += inverse
        yield local_estimate(scene, extinction, flight.position, estimate, onward, w_roulette)


def path(
    scene: Scene, extinction: np.ndarray, view: View, seed: int, iteration: int,
    view_index: int, pixel: int, sample: int, with_side_flights: bool,
) -> list[Contribution]:
    """All contributions of one path; their sum is its radiance.

    Parameters
    ----------
    extinction : of the droplets, km^-1, shape of the grid
    view_index : the view's index among all views, one of the counters of the random numbers
    pixel : row * width + column

    Source: Eqs. 1-4, 12, 16; the random numbers are laid out as in docs/sampling.md.
    """

    def block(number: int) -> np.ndarray:
        return uniforms(seed, iteration, view_index, pixel, sample, number)

    sun, g = scene.sun.direction, scene.cloud.phase_function.g
    jitter = block(0)
    width = view.pixels[0]
    position, direction = camera_ray(view, scene.grid, pixel % width + jitter[0], pixel // width + jitter[1])
    contributions: list[Contribution] = []
    history = np.zeros(scene.grid.shape)
    weight, own_share, event = 1.0, 1.0, 0
    while True:
        event += 1
        u, v = block(BLOCKS_PER_EVENT * event), block(BLOCKS_PER_EVENT * event + 1)
        flight = fly(scene, extinction, position, direction, -np.log(u[0]))
        history = history - flight.lengths
        if flight.position is not None:
            position = flight.position
        particle: Particle
        if flight.voxel is not None:
            particle, albedo, inverse = met_particle(scene, extinction, flight.voxel, u[1])
            history[flight.voxel] += inverse
        elif scene.surface.albedo > 0 and direction[2] < 0:
            particle, albedo = "surface", scene.surface.albedo
            position = position + direction * (position[2] / -direction[2])
            position[2] = 0.0
            own_share = 1.0  # side flights estimate collisions only
        else:
            return contributions
        weight *= albedo
        towards_sun = own_share * weight * scatter_density(scene, particle, direction, sun)
        # What a camera sees directly, and the ground, stay free of the roulette's noise.
        plays = with_side_flights and event > 1 and particle != "surface"
        roulette = v[0] if plays else None
        contributions.append(local_estimate(scene, extinction, position, towards_sun, history, roulette))
        if weight < PATH_ROULETTE_WEIGHT:
            if v[1] * PATH_ROULETTE_WEIGHT >= weight:
                return contributions
            weight = PATH_ROULETTE_WEIGHT
        onward = scatter(scene, particle, direction, u[2], u[3])
        if with_side_flights:
            count = SIDE_FLIGHT_RATE * weight * henyey_greenstein(direction @ sun, g * g)
            count = min(max(count, SIDE_FLIGHT_LEAST), SIDE_FLIGHT_MOST)
            random = (block(BLOCKS_PER_EVENT * event + 2 + n) for n in range(BLOCKS_PER_EVENT - 2))
            contributions.extend(
                side_flights(
                    scene, extinction, position, direction, particle, weight, count, history, int(count + v[2]), random
                )
            )
            density = scatter_density(scene, particle, direction, onward)
            own_share = density / (density + count * henyey_greenstein(onward @ sun, g))
        direction = onward
