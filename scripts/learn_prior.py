"""Learns the mixtures of the patch prior that come with the package, from generated clouds.

    python scripts/learn_prior.py

Of cumuli alone and in fields, on grids from coarse to fine, one mixture is made for each of four shapes of voxels. The
same seed gives the same numbers with the same NumPy and BLAS. `cloudtomo prior learn` does it with clouds of your own.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from varied_cumuli import varied_cumuli

from cloudtomo_cl.commands.provenance import source, versions
from cloudtomo_cl.inversion.learning import Learning, learnt_mixture
from cloudtomo_cl.inversion.mixture_file import SHIPPED, MixtureFile

# Heights of voxels over their widths.
ASPECTS = (0.5, 1.0, 2.0, 4.0)


def learnt(aspects: list[float], count: int, learning: Learning, seed: int) -> MixtureFile:
    """A mixture for each shape of voxels, of so many clouds."""
    random, mixtures = np.random.default_rng(seed), []
    # All clouds before any patch: so the file was made that comes with the package.
    sources = {aspect: varied_cumuli(count, aspect, random) for aspect in aspects}
    for aspect, clouds in sources.items():
        mixture, patches = learnt_mixture(clouds, learning, random)
        print(f"aspect {aspect:g}: {len(clouds)} clouds, {patches} patches", flush=True)
        mixtures.append(mixture)
    return MixtureFile(tuple(aspects), tuple(mixtures))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--output", type=Path, default=SHIPPED)
    parser.add_argument("--seed", type=int, default=7)
    parser.add_argument("--components", type=int, default=Learning.components)
    parser.add_argument("--rounds", type=int, default=Learning.rounds, help="of expectation maximisation")
    parser.add_argument("--patches", type=int, default=Learning.patches, help="at most, for each shape of voxels")
    parser.add_argument("--count", type=int, default=24, help="clouds for each shape of voxels")
    parser.add_argument("--aspects", type=float, nargs="+", default=list(ASPECTS), help="heights of voxels over widths")
    options = vars(parser.parse_args())
    output = options.pop("output")
    learning = Learning(options["components"], options["patches"], options["rounds"])
    mixtures = learnt(options["aspects"], options["count"], learning, options["seed"])
    mixtures.write(
        output, {"source": source(), "versions": versions(), "settings": {"script": Path(__file__).name, **options}}
    )


if __name__ == "__main__":
    main()
