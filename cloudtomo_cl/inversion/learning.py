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

# Voxels of a patch along x, y, z.
SIZE = (5, 5, 3)
# Voxels are of one shape whose aspect ratios differ by no more.
SAME_SHAPE = 1.1
# Of patches and of their shares there are copies while a mixture is fitted.
_COPIES, _BYTES = 4, 4
# Called with how many rounds are done, and of how many.
Rounds = Callable[[int, int], None]


@dataclass(frozen=True)
class Learning:
    """How a mixture is learnt.

    Attributes
    ----------
    components : of patches with cloud; one more is of patches without
    patches : at most, of clouds whose voxels have one shape, in equal parts
    rounds : of expectation maximisation
    """

    components: int = 30
    patches: int = 60_000
    rounds: int = 25


@dataclass(frozen=True, eq=False)
class LearntMixture:
    """A mixture, and what it was learnt from.

    Attributes
    ----------
    aspect : height of the voxels over their width, the clouds' geometric mean
    clouds : their places among those given
    patches : how many
    mixture : of them
    """

    aspect: float
    clouds: tuple[int, ...]
    patches: int
    mixture: Mixture


def learnt_mixture(
    clouds: Sequence[np.ndarray], learning: Learning, random: np.random.Generator, progress: Rounds | None = None
) -> tuple[Mixture, int]:
    """The mixture of clouds whose voxels have one shape, and how many patches it was learnt from.

    Parameters
    ----------
    clouds : extinctions of any unit, each by its own mean extinction; clear air stands around them
    learning : how
    random : what patches and the start are drawn from
    progress : called after every round

    Raises
    ------
    DataError : a cloud without extinction; too few patches with cloud for so many components; too little memory
    """
    numbers = learning.patches * (math.prod(SIZE) + learning.components)
    require(_COPIES * _BYTES * numbers, f"learning from {learning.patches} patches", "take fewer patches")
    patches = cloudy_patches(clouds, SIZE, learning.patches, random)
    return fitted_mixture(patches, SIZE, learning.components, learning.rounds, random, progress), len(patches)


def learnt_mixtures(
    clouds: Sequence[tuple[Grid, np.ndarray]], learning: Learning, seed: int, progress: Rounds | None = None
) -> list[LearntMixture]:
    """A mixture for each shape that the clouds' voxels have, the flattest first.

    Parameters
    ----------
    clouds : grid and extinction of each
    learning : how
    seed : the same gives the same mixtures, with the same NumPy and BLAS
    progress : called after every round, of all shapes together

    Raises
    ------
    DataError : as `learnt_mixture`; there is no cloud
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
    """What `[prior] file` takes."""
    return MixtureFile(tuple(one.aspect for one in learnt), tuple(one.mixture for one in learnt))


def by_shape(aspects: Sequence[float]) -> list[list[int]]:
    """Places of aspect ratios that are one shape: none is more than a tenth above the least of its group."""
    groups: list[list[int]] = []
    for place in sorted(range(len(aspects)), key=lambda place: aspects[place]):
        if not groups or aspects[place] > SAME_SHAPE * aspects[groups[-1][0]]:
            groups.append([])
        groups[-1].append(place)
    return groups


def _rounds_before(progress: Rounds | None, number: int, groups: int) -> Rounds | None:
    """The same, of one group's rounds; as many are of each."""
    if progress is None:
        return None
    return lambda done, rounds: progress(number * rounds + done, groups * rounds)
