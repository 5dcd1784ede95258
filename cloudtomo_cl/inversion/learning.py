"""How the patch prior's mixtures are learnt from clouds."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from cloudtomo_cl.errors import DataError
from cloudtomo_cl.inversion.mixture import Mixture
from cloudtomo_cl.inversion.mixture_file import MixtureFile, aspect_ratio
from cloudtomo_cl.inversion.mixture_fit import cloudy_patches, fitted_mixture
from cloudtomo_cl.memory import require
from cloudtomo_cl.scene.grid import Grid

# Size of a patch, voxels along x, y, z.
SIZE = (5, 5, 3)
# Voxels have the same shape if their aspect ratios differ by no more than this factor.
SAME_SHAPE = 1.1
# Copies of the patches and their shares that exist while a mixture is fitted, and bytes of a number.
_COPIES, _BYTES = 4, 4
# Function that is called with the number of rounds that are done, and of all rounds.
Rounds = Callable[[int, int], None]


@dataclass(frozen=True)
class Learning:
    """How a mixture is learnt.

    Attributes
    ----------
    components : number of components for patches with cloud; one more is for patches without
    patches : largest number of patches for voxels of one shape, the same number from each cloud
    rounds : number of rounds of expectation maximisation
    """

    components: int = 30
    patches: int = 60_000
    rounds: int = 25


@dataclass(frozen=True, eq=False)
class LearntMixture:
    """A mixture, and what it was learnt from.

    Attributes
    ----------
    aspect : height of the voxels over their width, geometric mean over the clouds
    clouds : indices of the clouds among those given
    patches : number of patches
    mixture : mixture fitted to the patches
    """

    aspect: float
    clouds: tuple[int, ...]
    patches: int
    mixture: Mixture


def learnt_mixture(
    clouds: Sequence[np.ndarray], learning: Learning, random: np.random.Generator, progress: Rounds | None = None
) -> tuple[Mixture, int]:
    """The mixture of clouds whose voxels have one shape, and the number of patches it was learnt from.

    Parameters
    ----------
    clouds : extinctions in any unit, since each is divided by its mean extinction; clear air is added around them
    learning : numbers of components, patches and rounds
    random : generator for the choice of patches and the start of the fit
    progress : function that is called after every round

    Raises
    ------
    DataError : a cloud without extinction; too few patches with cloud for the components; too little memory
    """
    numbers = learning.patches * (math.prod(SIZE) + learning.components)
    require(_COPIES * _BYTES * numbers, f"learning from {learning.patches} patches", "take fewer patches")
    patches = cloudy_patches(clouds, SIZE, learning.patches, random)
    return fitted_mixture(patches, SIZE, learning.components, learning.rounds, random, progress), len(patches)


def learnt_mixtures(
    clouds: Sequence[tuple[Grid, np.ndarray]], learning: Learning, seed: int, progress: Rounds | None = None
) -> list[LearntMixture]:
    """A mixture for each shape of the clouds' voxels, the flattest first.

    Parameters
    ----------
    clouds : grid and extinction of each cloud
    learning : numbers of components, patches and rounds
    seed : seed of the random numbers; the same one gives the same mixtures, with the same NumPy and BLAS
    progress : function that is called after every round, with the rounds of all shapes

    Raises
    ------
    DataError : there is no cloud; otherwise as `learnt_mixture`
    """
    if not clouds:
        raise DataError("there is no cloud to learn from: give at least one")
    random = np.random.default_rng(seed)
    aspects = [aspect_ratio(grid.spacing) for grid, _ in clouds]
    groups = by_shape(aspects)
    learnt = []
    for number, group in enumerate(groups):
        aspect = math.exp(float(np.mean(np.log([aspects[place] for place in group]))))
        rounds = _rounds_before(progress, number, len(groups))
        try:
            mixture, patches = learnt_mixture([clouds[place][1] for place in group], learning, random, rounds)
        except DataError as error:
            raise DataError(f"of voxels {aspect:.3g} times as high as wide: {error}") from None
        learnt.append(LearntMixture(aspect, tuple(group), patches, mixture))
    return learnt


def mixture_file(learnt: Sequence[LearntMixture]) -> MixtureFile:
    """Mixtures as a file for the setting `[prior] file`."""
    return MixtureFile(tuple(one.aspect for one in learnt), tuple(one.mixture for one in learnt))


def by_shape(aspects: Sequence[float]) -> list[list[int]]:
    """Indices of aspect ratios in groups of one shape: none is more than a tenth above the least of its group."""
    groups: list[list[int]] = []
    for place in sorted(range(len(aspects)), key=lambda place: aspects[place]):
        if not groups or aspects[place] > SAME_SHAPE * aspects[groups[-1][0]]:
            groups.append([])
        groups[-1].append(place)
    return groups


def _rounds_before(progress: Rounds | None, number: int, groups: int) -> Rounds | None:
    """`progress` for the rounds of the group `number`; all groups have the same number of rounds."""
    if progress is None:
        return None
    return lambda done, rounds: progress(number * rounds + done, groups * rounds)
