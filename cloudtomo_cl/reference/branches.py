"""What starts where a path scatters, beside the path itself: side flights and branches.

docs/reference/random-numbers.md gives the numbers, docs/explanation/radiance.md the reasons.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from cloudtomo_cl.reference.scattering import (
    Particle,
    direction_around,
    droplet_density,
    henyey_greenstein,
    middle_row,
    sample_henyey_greenstein,
    scatter_density,
)
from cloudtomo_cl.scene.scene import Scene

BLOCKS_PER_EVENT, BLOCK_BRANCH, BRANCH_VIEW = 64, 63, 2**20
PATH_ROULETTE_WEIGHT = 0.1
SIDE_FLIGHT_LEAST = 0.05
SIDE_FLIGHT_MOST = {False: 6.0, True: 12.0}  # by whether paths branch; also the rate
BRANCH_RATE, BRANCH_EVENTS, MOST_BRANCHES = 0.2, 5, 4


@dataclass(frozen=True)
class Companions:
    """Expected numbers of what starts at an event, and shares of the light of a direction that follow from them.

    Attributes
    ----------
    branches, side_flights : expected numbers
    """

    scene: Scene
    branches: float
    side_flights: float

    def _densities(self, particle: Particle, before: np.ndarray, after: np.ndarray) -> tuple[float, float, float]:
        """Expected numbers, sr^-1, of the path itself, branches and side flights in a direction."""
        cosine = after @ self.scene.sun.direction
        around_sun = henyey_greenstein(cosine, wide_g(self.scene))
        flights = self.side_flights * droplet_density(self.scene, middle_row(self.scene), cosine)
        return scatter_density(self.scene, particle, before, after), self.branches * around_sun, flights

    def share_of_side_flight(self, particle: Particle, before: np.ndarray, after: np.ndarray) -> float:
        """Of a side flight in the local estimate at its end."""
        path, branches, flights = self._densities(particle, before, after)
        return path / (path + branches + flights) if path else 0.0

    def share_beside_side_flights(self, particle: Particle, before: np.ndarray, after: np.ndarray) -> float:
        """Of a path, or a branch, in the local estimate at its next collision."""
        path, branches, flights = self._densities(particle, before, after)
        return (path + branches) / (path + branches + flights)

    def share_beside_each_other(self, particle: Particle, before: np.ndarray, after: np.ndarray) -> float:
        """Of a path, or of a branch, in the light of a direction."""
        path, branches, _ = self._densities(particle, before, after)
        return path / (path + branches)


@dataclass(frozen=True, eq=False)
class Event:
    """An interaction of a path.

    Attributes
    ----------
    number : 1, 2, ...
    position, direction : km; the direction it comes along
    particle, albedo : what it met
    weight : that the path came with
    survivor : the weight it goes on with, after albedo and roulette; 0 if it ends here
    onward : the direction it goes on in
    history : d log(density of the path up to here) / d extinction, km, shape of the grid
    """

    number: int
    position: np.ndarray
    direction: np.ndarray
    particle: Particle
    albedo: float
    weight: float
    survivor: float
    onward: np.ndarray
    history: np.ndarray


@dataclass(frozen=True, eq=False)
class Branch:
    """A path that begins where another scatters.

    Attributes
    ----------
    position, direction : km
    weight : that it begins with
    event : number of the event where it begins
    number : 1, 2, ..., in the order in which a path's branches begin
    share : of its first flight in the local estimate at its end
    history : d log(density of the path up to there) / d extinction, km, shape of the grid
    """

    position: np.ndarray
    direction: np.ndarray
    weight: float
    event: int
    number: int
    share: float
    history: np.ndarray


class Branches:
    """Those of one path: they wait, and the last that began is walked first."""

    def __init__(self, scene: Scene) -> None:
        self._scene = scene
        self.waiting: list[Branch] = []
        self.begun = 0
        self.kept = 1.0  # share of the path's weight that the branches of the last event leave to it

    def next(self) -> Branch | None:
        """The branch to be walked now; its random numbers have `number` times BRANCH_VIEW added to their view."""
        return self.waiting.pop() if self.waiting else None

    def expected(self, number: int) -> float:
        """Number of branches at an event."""
        if self.begun == MOST_BRANCHES:
            return 0.0
        return BRANCH_RATE * BRANCH_EVENTS / (BRANCH_EVENTS + number - 1)

    def begin(
        self, event: Event, companions: Companions, u_companions: float, block: Callable[[int], np.ndarray]
    ) -> None:
        """Begins a branch at an event, or none."""
        self.kept = companions.share_beside_each_other(event.particle, event.direction, event.onward)
        if u_companions >= companions.branches:
            return
        u = block(BLOCKS_PER_EVENT * event.number + BLOCK_BRANCH)
        sun = self._scene.sun.direction
        direction = direction_around(sun, sample_henyey_greenstein(u[0], wide_g(self._scene)), u[1])
        weight = event.survivor * companions.share_beside_each_other(event.particle, event.direction, direction)
        weight = after_roulette(weight, u[2])
        if weight:
            share = companions.share_beside_side_flights(event.particle, event.direction, direction)
            self.begun += 1
            branch = Branch(event.position, direction, weight, event.number, self.begun, share, event.history)
            self.waiting.append(branch)


def after_roulette(weight: float, u: float) -> float:
    """The weight that a path goes on with; 0 if it ends."""
    if weight >= PATH_ROULETTE_WEIGHT:
        return weight
    return PATH_ROULETTE_WEIGHT if u * PATH_ROULETTE_WEIGHT < weight else 0.0


def companions_at(scene: Scene, event: Event, branches: Branches | None) -> Companions:
    """What starts at an event of a path that may have branches."""
    most = SIDE_FLIGHT_MOST[branches is not None]
    count = most * event.survivor * henyey_greenstein(event.direction @ scene.sun.direction, wide_g(scene))
    expected = branches.expected(event.number) if branches else 0.0
    return Companions(scene, expected, min(max(count, SIDE_FLIGHT_LEAST), most))


def wide_g(scene: Scene) -> float:
    """Asymmetry of the lobe around the sun that branches are drawn from."""
    return scene.cloud.phase_function.g**2
