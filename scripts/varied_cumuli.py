"""Clouds of the generator of many sizes and on many grids, to learn from."""

from __future__ import annotations

import math

import numpy as np

from cloudtomo_cl.clouds.generate import cumulus
from cloudtomo_cl.errors import DataError
from cloudtomo_cl.scene.grid import Grid

# Voxels across a domain, how much wider it is for a field of clouds, and how tall; every so many-th is a field.
_FEWEST, _MOST = 12, 56
_WIDER, _FIELD_CLOUDS, _EVERY = 1.6, 3, 4
_TALL, _FIELD_TALL = (1.4, 2.4), (0.8, 1.2)
_FEWEST_LAYERS = 6
# Heights of base and top, as shares of the domain's.
_BASE, _TOP = (0.1, 0.35), (0.65, 0.95)


def varied_cumuli(count: int, aspect: float, random: np.random.Generator) -> list[np.ndarray]:
    """Cumuli, every fourth of them a field of three, on grids from coarse to fine.

    Parameters
    ----------
    count : of clouds
    aspect : height of the voxels over their width
    random : what everything is drawn from

    Returns
    -------
    extinctions, km^-1, float32, each of another shape
    """
    clouds: list[np.ndarray] = []
    while len(clouds) < count:
        field = len(clouds) % _EVERY == _EVERY - 1
        across = round(math.exp(random.uniform(math.log(_FEWEST), math.log(_MOST))) * (_WIDER if field else 1.0))
        layers = max(_FEWEST_LAYERS, round(across * random.uniform(*(_FIELD_TALL if field else _TALL)) / aspect))
        grid = Grid((across, across, layers), (1.0, 1.0, aspect))
        base, top = (random.uniform(*shares) * grid.extent[2] for shares in (_BASE, _TOP))
        seed = int(random.integers(1 << 31))
        try:
            clouds.append(cumulus(grid, seed, clouds=_FIELD_CLOUDS if field else 1, base=base, top=top))
        except DataError:  # so coarse a grid that no voxel's middle lies in the cloud
            continue
    return clouds
