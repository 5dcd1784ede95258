"""The derivative of a path's radiance, by collisions with droplets and with virtual ones.

Written from the equations, one path after the other, to check the kernels by (kernels/replay.cl, virtual.cl): with
virtual droplets of extinction e beside those of extinction b, flights meet virtual ones at the rate e per km. A path
that begins at one of them, as if it had scattered there, brings S; it deposits S / (b + e) into its voxel, a real
collision before the radiance R deposits R / (b + e), and l km of flight before the radiance R deposit -l R.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np

from cloudtomo_cl.reference.branches import BLOCKS_PER_EVENT, Branches, Event
from cloudtomo_cl.reference.flights import voxel_crossings
from cloudtomo_cl.reference.paths import (
    VirtualCollision,
    first_ray,
    gather,
    local_estimate,
    walk,
    walks,
)
from cloudtomo_cl.reference.random import uniforms
from cloudtomo_cl.reference.scattering import droplet_in_voxel, scatter_density
from cloudtomo_cl.scene.scene import Scene
from cloudtomo_cl.scene.sensors import View

VIRTUAL_COLLISIONS_VIEW, VIRTUAL_PATHS_VIEW = 2**31, 2**30


class Deposits(NamedTuple):
    """Of one path.

    Attributes
    ----------
    radiance : of the path, sr^-1
    real : derivative by its own crossings and collisions, sr^-1 km, shape of the grid
    virtual : by its virtual collisions, same unit and shape
    collisions : number of the latter
    """

    radiance: float
    real: np.ndarray
    virtual: np.ndarray
    collisions: int


@dataclass(frozen=True, eq=False)
class _Flown:
    """A flight: as `VirtualCollision`; it starts at `start`, and is `length` km long or leaves the grid."""

    number: int
    start: np.ndarray
    direction: np.ndarray
    length: float
    weight: float
    share: float
    aside: bool


def path_deposits(
    scene: Scene,
    extinction: np.ndarray,
    virtual: np.ndarray,
    view: View,
    seed: int,
    stream: int,
    view_index: int,
    pixel: int,
    sample: int,
    with_side_flights: bool,
    effective_radius: np.ndarray | None = None,
    truncation: float = np.inf,
    with_branches: bool = False,
) -> Deposits:
    """What a path adds to the derivative of its pixel's radiance.

    Parameters
    ----------
    virtual : extinction of the virtual droplets, km^-1, shape of the grid; below 0: none, and nothing is deposited

    The others as in `paths.path`. Random numbers: docs/reference/random-numbers.md.
    """
    key = (seed, stream, view_index, pixel, sample)
    added = np.maximum(virtual, 0.0)
    flights: list[_Flown] = []
    shares: dict[int, float] = {}  # of the walk's flights but the first, by number
    of_first = 1.0

    def own(number: int, start: np.ndarray, direction: np.ndarray, length: float, weight: float) -> None:
        flights.append(_Flown(number, start, direction, length, weight, shares.get(number, of_first), False))

    def aside(event: Event, direction: np.ndarray, length: float, share: float) -> None:
        flights.append(_Flown(event.number + 1, event.position, direction, length, event.survivor, share, True))

    def shared(event: Event, share: float) -> None:
        shares[event.number + 1] = share

    first, branches = first_ray(scene, view, pixel, _blocks(key, 0)(0)), Branches(scene) if with_branches else None
    blocks, found = partial(_blocks, key), []
    ways = walks(scene, extinction, effective_radius, first, blocks, branches, virtual=added, flown=own)
    for events, of_first, block in ways:
        shares.clear()
        found += gather(
            scene, extinction, effective_radius, events, block, with_side_flights, truncation, of_first, added, aside,
            shared, branches,
        )  # fmt: skip
    inside = virtual >= 0
    real = sum((c.derivative for c in found), np.zeros(scene.grid.shape)) * inside
    deposited = np.zeros(scene.grid.shape)
    kept, number = _kept_collision(_collisions(scene, added, flights, _blocks(key, VIRTUAL_COLLISIONS_VIEW)))
    if kept is not None:
        brought = _brought(
            scene, extinction, effective_radius, kept, _blocks(key, VIRTUAL_PATHS_VIEW), with_side_flights, truncation
        )
        deposited[kept.voxel] = number * brought / (extinction[kept.voxel] + added[kept.voxel])
    return Deposits(sum(c.radiance for c in found), real, deposited, number)


def _blocks(key: tuple[int, int, int, int, int], view: int) -> Callable[[int], np.ndarray]:
    seed, stream, view_index, pixel, sample = key
    return lambda number: uniforms(seed, stream, view_index + view, pixel, sample, number)


def _collisions(
    scene: Scene, added: np.ndarray, flights: list[_Flown], block: Callable[[int], np.ndarray]
) -> Iterator[tuple[VirtualCollision, float]]:
    """All virtual collisions of a path in their order, each with a uniform number to choose by."""
    number = 0
    depth = -np.log(block(0)[0])  # of virtual droplets before the next one
    for flown in flights:
        periodic = scene.boundary.horizontal == "periodic"
        for voxel, start, crossed in zip(*voxel_crossings(scene.grid, flown.start, flown.direction, periodic)):
            x, y, z = (int(i) for i in voxel)
            rate, at = added[x, y, z], start
            end = min(start + crossed, flown.length)
            while rate > 0 and rate * (end - at) > depth:
                at += depth / rate
                number += 1
                u = block(number)
                depth = -np.log(u[0])
                place = flown.start + at * flown.direction
                yield (
                    VirtualCollision(
                        flown.number, place, flown.direction, (x, y, z), flown.weight, flown.share, flown.aside
                    ),
                    u[1],
                )
            depth -= rate * max(end - at, 0.0)


def _kept_collision(collisions: Iterator[tuple[VirtualCollision, float]]) -> tuple[VirtualCollision | None, int]:
    """One of them, each with the same probability, and their number."""
    kept, number = None, 0
    for collision, u in collisions:
        number += 1
        if number == 1 or u * number < 1:
            kept = collision
    return kept, number


def _brought(
    scene: Scene,
    extinction: np.ndarray,
    effective_radius: np.ndarray | None,
    start: VirtualCollision,
    block: Callable[[int], np.ndarray],
    with_side_flights: bool,
    truncation: float,
) -> float:
    """Radiance of the path that begins at a virtual collision, sr^-1."""
    nothing = np.zeros(scene.grid.shape)
    if not start.aside:
        events = walk(scene, extinction, effective_radius, start.position, start.direction, block, start=start)
        found = gather(scene, extinction, effective_radius, events, block, with_side_flights, truncation, start.share)
        return sum(c.radiance for c in found)
    v = block(BLOCKS_PER_EVENT * start.number + 1)
    radius = None if effective_radius is None else effective_radius[start.voxel]
    droplet, albedo = droplet_in_voxel(scene, radius, v[3])
    towards_sun = start.weight * start.share * albedo
    towards_sun *= scatter_density(scene, droplet, start.direction, scene.sun.direction)
    return local_estimate(scene, extinction, start.position, towards_sun, nothing, v[0], truncation).radiance
