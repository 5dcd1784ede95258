"""Gradients against finite differences, by kinds of voxels, in scenes that are hard for derivatives.

    python scripts/derivatives_check.py [--scenes NAME ...] [--batches 40] [--samples 1000] [--seed 1]
    python scripts/derivatives_check.py --by table --against replay --batches 24 --samples 2000

Every batch has random numbers of its own, which the differences' renders share. For every kind of voxel (and the whole
cloud, along itself) a line gives the derivative by finite differences, the gradient's over it, and how many standard
errors the two are apart. Exit status 1 if the whole cloud's ratio is not 1.00 +- 0.03 or some kind's not within 10 %,
and is more than 3 standard errors off. Some minutes a scene and core.

The gradient is that by replay, which is unbiased, or that by the radiance table, the default. The table's can be held
against replay, which has less noise than differences; its own noise is smaller, and a sixth of the batches enough.

Steps are small against what curvature would show: 0.04 of the extinction, 0.02 where voxels are deep, and in empty
voxels, by differences of second order to one side, an optical depth of 0.02 per voxel.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from cloudtomo_cl.scene.grid import Grid
from cloudtomo_cl.scene.phase import DoubleHenyeyGreenstein, HenyeyGreenstein, TabulatedPhaseFunction
from cloudtomo_cl.scene.scene import Air, Boundary, Cloud, Scene, Sun, Surface
from cloudtomo_cl.scene.sensors import OrthographicView, PerspectiveView, View
from cloudtomo_cl.transport.radiance import RadianceOperator
from cloudtomo_cl.transport.table_gradient import TableGradient

SHAPE, EDGE = (12, 10, 8), 0.04  # voxels; km
GRID = Grid(shape=SHAPE, spacing=(EDGE, EDGE, EDGE), origin=(0.0, 0.0, 0.1))
ALLOWED, ALLOWED_WHOLE, SIGMAS = 0.10, 0.03, 3.0
BATCHES_OF_TABLE = 6  # of replay, or of differences, for each of the table's; two at least
TWO = [OrthographicView(width=0.6, pixels=(8, 8), zenith=zenith, azimuth=40) for zenith in (0, 50)]
CAMERA = PerspectiveView((0.1, -0.5, 0.9), (0.24, 0.2, 0.26), 30.0, (8, 8))
SUN = Sun(zenith=30, azimuth=10)
PERIODIC = Boundary(horizontal="periodic")


def droplets(g: float, albedo: float = 1.0) -> Cloud:
    """Of a Henyey-Greenstein phase function."""
    return Cloud(albedo, HenyeyGreenstein(g=g))


def table() -> TabulatedPhaseFunction:
    """A peak of 10 degrees on a broad lobe, for two radii; with a weak bow."""
    angles = np.array([0.0, 1, 2, 4, 7, 11, 16, 24, 40, 60, 80, 100, 120, 135, 140, 145, 160, 180])
    rows = [
        30 * width * np.exp(-angles / 4 * width) + 3 * np.exp(-angles / 25)
        + 0.1 * (1 + np.exp(-(((angles - 140) / 6) ** 2)))
        for width in (1.0, 1.6)
    ]  # fmt: skip
    return TabulatedPhaseFunction.normalised(
        tuple(angles), rows, effective_radius=(5.0, 15.0), single_scattering_albedo=(0.99, 0.97)
    )


@dataclass(frozen=True)
class Case:
    """A cloud whose densest voxel has an optical depth, and who looks at it."""

    depth: float
    scene: Scene
    views: list[View]


CASES = {
    "3.7": Case(3.7, Scene(GRID, SUN, droplets(0.85)), TWO),
    "3.7 ground": Case(3.7, Scene(GRID, SUN, droplets(0.85), surface=Surface(0.4)), TWO),
    "3.7 isotropic": Case(3.7, Scene(GRID, SUN, droplets(0.0)), TWO),
    "9": Case(9.0, Scene(GRID, SUN, droplets(0.85)), TWO),
    "19": Case(19.0, Scene(GRID, SUN, droplets(0.85)), TWO),
    "19 nadir": Case(19.0, Scene(GRID, Sun(zenith=0), droplets(0.85)), TWO[:1]),
    "periodic, air, ground, absorption": Case(
        3.7,
        Scene(GRID, Sun(zenith=50, azimuth=200), droplets(0.7, 0.95), Air(1.0), Surface(0.4), PERIODIC),
        TWO,
    ),
    "phase table, camera": Case(
        1.5, Scene(GRID, Sun(zenith=60, azimuth=300), Cloud(phase_function=table(), effective_radius=9.0)), [CAMERA]
    ),
    "double HG, air outside": Case(
        6.0,
        Scene(
            GRID, Sun(zenith=20, azimuth=130), Cloud(0.98, DoubleHenyeyGreenstein(0.9, -0.4, 0.9)),
            Air((0.4, 0.3, 0.2), 0.9, levels=(0.0, 0.15, 0.5, 1.0)), Surface(0.2),
        ),
        [CAMERA, TWO[1]],
    ),
}  # fmt: skip


def cloud(depth: float) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Extinction, km^-1, and which voxels are of a kind: core, edge, thin, hole, empty, on the domain's boundary."""
    x, y, z = np.meshgrid(*[(np.arange(n) + 0.5) / n * 2 - 1 for n in SHAPE], indexing="ij")
    radius = np.sqrt(x**2 + y**2 + z**2)
    density = np.clip(1.15 - radius, 0, None) ** 0.7 * (1 + 0.5 * np.sin(5 * x + 3 * y) * np.cos(4 * z))
    density[(radius > 0.95) | (x > 0.75)] = 0
    hole = np.zeros(SHAPE, bool)
    hole[4:6, 4:6, 4:6] = True
    density[hole] = 0
    density[0, 4:7, 3:5] = 0.3
    thin = (density > 0) & (radius > 0.75)
    density[thin] *= 0.1
    boundary = np.ones(SHAPE, bool)
    boundary[1:-1, 1:-1, 1:-1] = False
    cloudy = density > 0
    kinds = {
        "core": cloudy & (radius < 0.45),
        "edge": cloudy & (radius >= 0.45) & ~thin & ~boundary,
        "thin": thin & ~boundary,
        "hole": hole,
        "empty beside": ~cloudy & ~hole & ~boundary,
        "boundary cloudy": boundary & cloudy,
        "boundary empty": boundary & ~cloudy,
    }
    return (density / density.max() * depth / EDGE).astype(np.float32), kinds


def directions(values: np.ndarray, kinds: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Changes of the extinction, km^-1: of cloudy voxels in proportion, of empty ones by 1."""
    changes = {name: values * kind if values[kind].any() else kind.astype(float) for name, kind in kinds.items()}
    return changes | {"whole": values.astype(float)}


def difference(operator: RadianceOperator, values: np.ndarray, change: np.ndarray, samples: int, seed: int,
               stream: int) -> float:  # fmt: skip
    """The derivative of the images' mean along a change."""
    empty = not (values * change).any()
    step = 0.02 / EDGE if empty else 0.02 if values.max() * EDGE > 5 else 0.04

    def mean(times: float) -> float:
        changed = (values + times * step * change).astype(np.float32)
        return float(operator.render(changed, samples, seed, stream).mean.mean())

    if empty:
        return (4 * mean(1) - 3 * mean(0) - mean(2)) / (2 * step)
    return (mean(1) - mean(-1)) / (2 * step)


# From a batch's number to derivatives along all changes.
Estimator = Callable[[int], list[float]]


def by_replay(operator: RadianceOperator, values: np.ndarray, changes: list[np.ndarray], samples: int, seed: int,
              limit: float | None) -> Estimator:  # fmt: skip
    """Unbiased gradients."""
    adjoint = mean_adjoint(operator)

    def along(batch: int) -> list[float]:
        rendering = operator.render(values, samples, seed, batch, store_paths=True)
        gradient = operator.gradient(rendering, adjoint, limit).get().astype(float)
        return [float(np.sum(gradient * change)) for change in changes]

    return along


def by_table(operator: RadianceOperator, values: np.ndarray, changes: list[np.ndarray], samples: int, seed: int
             ) -> Estimator:  # fmt: skip
    """Gradients by the radiance table."""
    table, adjoint = TableGradient(operator), mean_adjoint(operator)

    def along(batch: int) -> list[float]:
        rendering = operator.render(values, samples, seed, batch, store_paths=True)
        gradient = table.gradient(rendering, adjoint)[0].get().astype(float)
        return [float(np.sum(gradient * change)) for change in changes]

    return along


def mean_adjoint(operator: RadianceOperator) -> np.ndarray:
    """Of the mean of all pixels."""
    return np.full((len(operator.pixels), 2), 0.5 / len(operator.pixels))


def check(name: str, given: argparse.Namespace) -> bool:
    """Prints a scene's table; returns whether all is as it should be."""
    case = CASES[name]
    values, kinds = cloud(case.depth)
    operator = RadianceOperator(case.scene, case.views, mask=np.ones(values.shape, bool))
    changes = directions(values, kinds)
    along, samples = list(changes.values()), given.samples
    batches = given.batches
    if given.by == "table":
        gradients, batches = by_table(operator, values, along, samples, given.seed), -(-batches // BATCHES_OF_TABLE)
    else:
        gradients = by_replay(operator, values, along, samples, given.seed, given.limit)
    start = time.perf_counter()
    found = np.array([gradients(batch) for batch in range(max(batches, 2))])
    seconds = time.perf_counter() - start
    if given.against == "replay":
        expected = np.array(
            list(map(by_replay(operator, values, along, samples, given.seed + 1, given.limit), range(given.batches)))
        )
    else:
        expected = np.array([
            [difference(operator, values, change, samples, given.seed + 1, batch) for change in along]
            for batch in range(given.batches)
        ])  # fmt: skip
    what = f"{len(found)} batches of {samples} paths a pixel, seed {given.seed}, by {given.by}"
    print(f"{name}: {what}, took {seconds:.0f} s; {given.batches} batches by {given.against}", flush=True)
    return all([agrees(kind, found[:, n], expected[:, n]) for n, kind in enumerate(changes)])


def agrees(kind: str, found: np.ndarray, expected: np.ndarray) -> bool:
    """Prints a kind's line; returns whether batches of both agree."""
    mean, truth = found.mean(), expected.mean()
    errors = [side.std(ddof=1) / np.sqrt(len(side)) for side in (found, expected)]
    error = float(np.hypot(*errors))
    apart, ratio = (mean - truth) / error, mean / truth
    of_ratio = float(np.hypot(errors[0], ratio * errors[1])) / abs(truth)
    allowed = ALLOWED_WHOLE if kind == "whole" else ALLOWED
    right = bool(abs(ratio - 1) <= allowed or abs(apart) <= SIGMAS)
    print(
        f"    {kind:16s} {truth * 1e5:10.3f} +- {errors[1] * 1e5:7.3f}  ratio {ratio:6.3f} +- {of_ratio:5.3f}  "
        f"{apart:+5.1f} sigma{'' if right else '  WRONG'}",
        flush=True,
    )
    return right


def main() -> None:
    """See above."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", nargs="*", choices=CASES, default=list(CASES))
    parser.add_argument("--batches", type=int, default=40)
    parser.add_argument("--samples", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--by", choices=("replay", "table"), default="replay", help="whose gradient is checked")
    parser.add_argument("--against", choices=("differences", "replay"), default="differences")
    parser.add_argument("--limit", type=float, help="virtual_limit of gradients by replay, km^-1")
    given = parser.parse_args()
    good = [check(name, given) for name in given.scenes]
    sys.exit(0 if all(good) else 1)


if __name__ == "__main__":
    main()
