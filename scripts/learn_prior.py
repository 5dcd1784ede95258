"""Learns the mixtures of the patch prior, from generated clouds or from given ones.

    python scripts/learn_prior.py                                # the file that comes with the package
    python scripts/learn_prior.py les-1.nc les-2.nc --output prior.npz

Of generated clouds (cumuli alone and in fields, on grids from coarse to fine) mixtures are made for voxels of four
shapes, of given ones for the shape that theirs have. The same seed gives the same file with the same NumPy and BLAS.
"""

from __future__ import annotations

import argparse
import math
import sys
from pathlib import Path

import numpy as np

from cloudtomo_cl.clouds.generate import cumulus
from cloudtomo_cl.errors import CloudtomoError, DataError
from cloudtomo_cl.files.extinction import read_extinction
from cloudtomo_cl.inversion.mixture import MixtureFile
from cloudtomo_cl.inversion.mixture_fit import cloudy_patches, fitted_mixture
from cloudtomo_cl.scene.grid import Grid

SHIPPED = Path(__file__).parents[1] / "cloudtomo_cl/inversion/patches.npz"
SIZE = (5, 5, 3)
# Heights of voxels over their widths.
ASPECTS = (0.5, 1.0, 2.0, 4.0)
# Of generated clouds: voxels across a domain, how much wider it is for a field of clouds, and how tall.
FEWEST, MOST = 12, 56
WIDER, FIELD_CLOUDS = 1.6, 3
TALL, FIELD_TALL = (1.4, 2.4), (0.8, 1.2)
# Heights of base and top, as shares of the domain's.
BASE, TOP = (0.1, 0.35), (0.65, 0.95)


def generated(count: int, aspect: float, random: np.random.Generator) -> list[np.ndarray]:
    """Clouds of the generator on voxels of this shape; every fourth is a field of three."""
    clouds = []
    while len(clouds) < count:
        field = len(clouds) % 4 == 3
        across = round(math.exp(random.uniform(math.log(FEWEST), math.log(MOST))) * (WIDER if field else 1.0))
        layers = max(6, round(across * random.uniform(*(FIELD_TALL if field else TALL)) / aspect))
        grid = Grid((across, across, layers), (1.0, 1.0, aspect))
        base, top = (random.uniform(*shares) * grid.extent[2] for shares in (BASE, TOP))
        seed = int(random.integers(1 << 31))
        try:
            clouds.append(cumulus(grid, seed, clouds=FIELD_CLOUDS if field else 1, base=base, top=top))
        except DataError:  # so coarse a grid that no voxel's middle lies in the cloud
            continue
    return clouds


def learnt(arguments: argparse.Namespace) -> MixtureFile:
    """What the arguments ask for."""
    random = np.random.default_rng(arguments.seed)
    if arguments.clouds:
        read = [read_extinction(path) for path in arguments.clouds]
        shapes = [grid.spacing[2] / math.sqrt(grid.spacing[0] * grid.spacing[1]) for grid, _ in read]
        if max(shapes) > 1.1 * min(shapes):
            raise DataError(f"the clouds' voxels have different heights over widths, {shapes}: learn from one shape")
        sources = {float(np.mean(shapes)): [extinction for _, extinction in read]}
    else:
        sources = {aspect: generated(arguments.count, aspect, random) for aspect in arguments.aspects}
    mixtures = []
    for aspect, clouds in sources.items():
        patches = cloudy_patches(clouds, SIZE, arguments.patches, random)
        print(f"aspect {aspect:g}: {len(clouds)} clouds, {len(patches)} patches", flush=True)
        mixtures.append(fitted_mixture(patches, SIZE, arguments.components, arguments.rounds, random))
    return MixtureFile(tuple(sources), tuple(mixtures))


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("clouds", nargs="*", type=Path, metavar="CLOUD", help="netCDF; by default generated ones")
    parser.add_argument("--output", type=Path, default=SHIPPED)
    parser.add_argument("--seed", type=int, default=7)
    parser.add_argument("--components", type=int, default=30)
    parser.add_argument("--rounds", type=int, default=25, help="of expectation maximisation")
    parser.add_argument("--patches", type=int, default=60_000, help="at most, for each shape of voxels")
    parser.add_argument("--count", type=int, default=24, help="generated clouds for each shape of voxels")
    parser.add_argument("--aspects", type=float, nargs="+", default=ASPECTS, help="of generated clouds' voxels")
    arguments = parser.parse_args()
    try:
        learnt(arguments).write(arguments.output)
    except CloudtomoError as error:
        print(error, file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
