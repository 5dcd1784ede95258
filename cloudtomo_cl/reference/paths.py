"""A slow, plain transport and gradient in double precision, to check the fast ones by.

Everything here is written from the equations, one path at a time, with no thought of speed.
It draws the random numbers of docs/reference/random-numbers.md, as the kernels do, so that a path of the
kernels and its path here are the same one up to rounding.

In the order of reading: flights.py, paths; random numbers and scattering have files of their own. Lengths are
in km, extinction in km^-1, radiances in sr^-1 (for a sun of irradiance 1). Equation numbers
are those of the supplement on the monotonicity prior.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from cloudtomo_cl.reference.branches import (
    BLOCKS_PER_EVENT,
    BRANCH_VIEW,
    Branch,
    Branches,
    Companions,
    Event,
    after_roulette,
    companions_at,
)
from cloudtomo_cl.reference.flights import Flight, camera_ray, fly, met_particle
from cloudtomo_cl.reference.random import uniforms
from cloudtomo_cl.reference.scattering import (
    Particle,
    direction_around,
    droplet_in_voxel,
    middle_row,
    sample_droplet,
    scatter,
    scatter_density,
)
from cloudtomo_cl.scene.scene import Scene
from cloudtomo_cl.scene.sensors import View

# docs/reference/random-numbers.md gives the meaning of these numbers.
SUN_VIEW = 2**32 - 1
LOCAL_ESTIMATE_ROULETTE = 0.03


@dataclass(frozen=True, eq=False)
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
    scene: Scene,
    extinction: np.ndarray,
    position: np.ndarray,
    weight: float,
    history: np.ndarray,
    u_roulette: float | None,
    truncation: float = np.inf,
) -> Contribution:
    """Sunlight at a collision (Eq. 4), with the gradient of Eqs. 13-18.

    Parameters
    ----------
    weight : sr^-1, all but the transmittance to the sun
    history : d log(density of the path up to here) / d extinction, km, shape of the grid
    u_roulette : plays the roulette on what the estimate is worth; None: no roulette
    truncation : sr^-1, what is cut to it no longer depends on the way to the sun

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
    if radiance >= truncation:
        return Contribution(truncation, truncation * history)
    return Contribution(radiance, radiance * (history - way.lengths))


def side_flights(
    scene: Scene,
    extinction: np.ndarray,
    effective_radius: np.ndarray | None,
    position: np.ndarray,
    before: np.ndarray,
    particle: Particle,
    weight: float,
    companions: Companions,
    history: np.ndarray,
    number: int,
    random: Iterator[np.ndarray],
    truncation: float = np.inf,
    virtual: np.ndarray | None = None,
    flown: Callable[[np.ndarray, float, float], None] = lambda *_: None,
) -> Iterator[Contribution]:
    """The next order's sunlight by `number` flights drawn around the sun (docs/reference/random-numbers.md).

    They share the estimate with the path's own next flight, and with branches, by the balance heuristic
    (Veach and Guibas 1995); `companions` has the mean of `number`. `flown` is called with every flight's
    direction, length (km) and share of the estimate.
    """
    sun, row = scene.sun.direction, middle_row(scene)
    for _ in range(number):
        w, w_next = next(random), next(random)
        direction = direction_around(sun, sample_droplet(scene, row, w[2]), w[3])
        share = companions.share_of_side_flight(particle, before, direction)
        if share == 0:
            continue
        flight = fly(scene, extinction, position, direction, -np.log(w[0]))
        flown(direction, flight.length_from(position), share)
        if not flight.collided:
            continue
        assert flight.position is not None, "what collided is somewhere"
        target, albedo, inverse = met_particle(scene, extinction, effective_radius, flight, w[1], w_next[1], virtual)
        estimate = weight * albedo * share * scatter_density(scene, target, direction, sun)
        onward = history - flight.lengths
        if inverse:
            onward[flight.voxel] += inverse
        yield local_estimate(scene, extinction, flight.position, estimate, onward, w_next[0], truncation)


@dataclass(frozen=True, eq=False)
class VirtualCollision:
    """Where another path begins: with a droplet that is not there (gradient.py).

    Attributes
    ----------
    number : of the path's flight that meets it
    position, direction : km; the direction the flight comes along
    voxel : that holds the position
    weight : of the path on the flight
    share : of the flight in the local estimate at its end
    aside : whether it is a side flight
    """

    number: int
    position: np.ndarray
    direction: np.ndarray
    voxel: tuple[int, int, int]
    weight: float
    share: float
    aside: bool


def walk(
    scene: Scene,
    extinction: np.ndarray,
    effective_radius: np.ndarray | None,
    position: np.ndarray,
    direction: np.ndarray,
    block: Callable[[int], np.ndarray],
    leave: Callable[[int, Flight, np.ndarray, float], None] = lambda *_: None,
    virtual: np.ndarray | None = None,
    flown: Callable[[int, np.ndarray, np.ndarray, float, float], None] = lambda *_: None,
    start: VirtualCollision | Branch | None = None,
    branches: Branches | None = None,
) -> Iterator[Event]:
    """The random walk.

    Parameters
    ----------
    position, direction : of its first ray, km
    block : the uniform numbers of a block
    leave : called with event number, flight, direction and weight wherever the path leaves all that
        scatters, also on its way to the surface
    virtual : as in `met_particle`
    flown : called with event number, start, direction, length (km) and weight of every flight
    start : a virtual collision: begins with scattering by a droplet there, instead of a flight; or a branch
    branches : those of the path, which leave it a share of its weight

    Source: docs/reference/random-numbers.md.
    """
    history, weight, number = np.zeros(scene.grid.shape), 1.0, 0
    if isinstance(start, Branch):
        history, weight, number, start = start.history, start.weight, start.event, None
    if start is not None:
        weight, number = start.weight, start.number - 1
    while True:
        number += 1
        u, v = block(BLOCKS_PER_EVENT * number), block(BLOCKS_PER_EVENT * number + 1)
        if start is not None and number == start.number:
            radius = None if effective_radius is None else effective_radius[start.voxel]
            particle, albedo = droplet_in_voxel(scene, radius, v[3])
            flight = Flight(np.zeros(scene.grid.shape), 0.0, position, True, start.voxel)
            inverse = 0.0
        else:
            flight = fly(scene, extinction, position, direction, -np.log(u[0]))
            flown(number, position, direction, flight.length_from(position), weight)
        history = history - flight.lengths
        if flight.position is not None:
            position = flight.position
        if flight.collided:
            if start is None or number > start.number:
                met = met_particle(scene, extinction, effective_radius, flight, u[1], v[3], virtual)
                particle, albedo, inverse = met
            if inverse:
                history[flight.voxel] += inverse
        else:
            leave(number, flight, direction, weight)
            if scene.surface.albedo == 0 or direction[2] >= 0:
                return
            particle, albedo = Particle("surface"), scene.surface.albedo
            position = position + direction * (position[2] / -direction[2])
            position[2] = 0.0
        survivor = after_roulette(weight * albedo, v[1])
        onward = scatter(scene, particle, direction, u[2], u[3])
        yield Event(number, position, direction, particle, albedo, weight, survivor, onward, history)
        if survivor == 0:
            return
        weight, direction = survivor * (branches.kept if branches else 1.0), onward


def path(
    scene: Scene,
    extinction: np.ndarray,
    view: View,
    seed: int,
    iteration: int,
    view_index: int,
    pixel: int,
    sample: int,
    with_side_flights: bool,
    effective_radius: np.ndarray | None = None,
    truncation: float = np.inf,
    with_branches: bool = False,
) -> list[Contribution]:
    """All contributions of one path; their sum is its radiance.

    Parameters
    ----------
    extinction : of the droplets, km^-1, shape of the grid
    view_index : the view's index among all views, one of the counters of the random numbers
    pixel : row * width + column
    effective_radius : micrometres, shape of the grid; by default the scene's
    truncation : of every contribution, sr^-1

    Source: Eqs. 1-4, 12, 16; the random numbers are laid out as in docs/reference/random-numbers.md.
    """

    def blocks(view: int) -> Callable[[int], np.ndarray]:
        return lambda number: uniforms(seed, iteration, view_index + view, pixel, sample, number)

    first, branches = first_ray(scene, view, pixel, blocks(0)(0)), Branches(scene) if with_branches else None
    contributions: list[Contribution] = []
    for events, share, block in walks(scene, extinction, effective_radius, first, blocks, branches):
        contributions += gather(
            scene, extinction, effective_radius, events, block, with_side_flights, truncation, share, branches=branches
        )
    return contributions


def walks(
    scene: Scene,
    extinction: np.ndarray,
    effective_radius: np.ndarray | None,
    first: tuple[np.ndarray, np.ndarray],
    blocks: Callable[[int], Callable[[int], np.ndarray]],
    branches: Branches | None,
    **watched: Any,
) -> Iterator[tuple[Iterator[Event], float, Callable[[int], np.ndarray]]]:
    """A path and its branches, one after the other: each one's events, its first flight's share, and its numbers.

    Parameters
    ----------
    first : position and direction of the path's first ray, km
    blocks : given what is added to the view: the uniform numbers of a block
    branches : to which gathering the events adds those that begin; None: there are none
    watched : virtual, flown; as of `walk`
    """
    (position, direction), share, block, branch = first, 1.0, blocks(0), None
    while True:
        ray = (position, direction, block)
        path = walk(scene, extinction, effective_radius, *ray, start=branch, branches=branches, **watched)
        yield path, share, block
        branch = branches.next() if branches else None
        if branch is None:
            return
        position, direction, share = branch.position, branch.direction, branch.share
        block = blocks(branch.number * BRANCH_VIEW)


def first_ray(scene: Scene, view: View, pixel: int, jitter: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The ray of a pixel's sample, as `camera_ray`; `jitter` places it in the pixel."""
    width = view.pixels[0]
    return camera_ray(view, scene.grid, pixel % width + jitter[0], pixel // width + jitter[1])


def gather(
    scene: Scene,
    extinction: np.ndarray,
    effective_radius: np.ndarray | None,
    events: Iterator[Event],
    block: Callable[[int], np.ndarray],
    with_side_flights: bool,
    truncation: float = np.inf,
    own_share: float = 1.0,
    virtual: np.ndarray | None = None,
    flown: Callable[[Event, np.ndarray, float, float], None] = lambda *_: None,
    shared: Callable[[Event, float], None] = lambda *_: None,
    branches: Branches | None = None,
) -> list[Contribution]:
    """Local estimates at the events of a walk, and those of side flights.

    Parameters
    ----------
    own_share : of the walk's first flight in the local estimate at its end
    flown : called with the event, direction, length (km) and share of every side flight
    shared : called with the event and the share of the flight that goes on from there
    branches : to which those are added that begin at the events
    """
    sun = scene.sun.direction
    contributions: list[Contribution] = []
    for event in events:
        if event.particle.kind == "surface":
            own_share = 1.0  # side flights estimate collisions only
        towards_sun = own_share * event.weight * event.albedo
        towards_sun *= scatter_density(scene, event.particle, event.direction, sun)
        v = block(BLOCKS_PER_EVENT * event.number + 1)
        # What a camera sees directly, and the ground, stay free of the roulette's noise.
        plays = with_side_flights and event.number > 1 and event.particle.kind != "surface"
        roulette = v[0] if plays else None
        contributions.append(
            local_estimate(scene, extinction, event.position, towards_sun, event.history, roulette, truncation)
        )
        own_share = 1.0
        if with_side_flights and event.survivor > 0:
            companions = companions_at(scene, event, branches)
            first = BLOCKS_PER_EVENT * event.number + 2
            random = (block(first + n) for n in range(BLOCKS_PER_EVENT - 2))
            contributions.extend(
                side_flights(
                    scene,
                    extinction,
                    effective_radius,
                    event.position,
                    event.direction,
                    event.particle,
                    event.survivor,
                    companions,
                    event.history,
                    int(companions.side_flights + v[2]),
                    random,
                    truncation,
                    virtual,
                    partial(flown, event),
                )
            )
            own_share = companions.share_beside_side_flights(event.particle, event.direction, event.onward)
            if branches is not None:
                branches.begin(event, companions, v[2], block)
        shared(event, own_share)
    return contributions


def photon(
    scene: Scene,
    extinction: np.ndarray,
    seed: int,
    position: np.ndarray,
    pixel: int,
    sample: int,
    effective_radius: np.ndarray | None = None,
) -> list[tuple[str, tuple[int, int], float]]:
    """What a photon from the sun leaves behind in the columns of the grid: (flux, column, weight).

    Parameters
    ----------
    position : where it starts, km, on the top of all that scatters; its first two uniform numbers
        are given to it by the caller
    """
    grid, periodic = scene.grid, scene.boundary.horizontal == "periodic"
    tally: list[tuple[str, tuple[int, int], float]] = []

    def column(place: np.ndarray) -> tuple[int, int]:
        x, y = (int(i) for i in np.floor((place[:2] - grid.origin[:2]) / grid.spacing[:2]))
        return (x % grid.shape[0], y % grid.shape[1]) if periodic else (x, y)

    def leave(number: int, flight: Flight, direction: np.ndarray, weight: float) -> None:
        if not periodic and (flight.through_side or flight.position is None):
            return
        assert flight.position is not None, "without a way out there is no column"
        down = "direct" if number == 1 else "diffuse"
        tally.append(("reflected" if direction[2] > 0 else down, column(flight.position), weight))

    def block(number: int) -> np.ndarray:
        return uniforms(seed, 0, SUN_VIEW, pixel, sample, number)

    for event in walk(scene, extinction, effective_radius, position, -scene.sun.direction, block, leave):
        if event.particle.kind != "surface" and event.albedo < 1:
            tally.append(("absorbed", column(event.position), event.weight * (1 - event.albedo)))
    return tally
