"""What the iterations of a stage have in common, whatever the optimizer."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from cloudtomo_cl.errors import TransportError


@dataclass(frozen=True)
class Progress:
    """What an iteration tells: the data term at its start, its standard error, the prior, and paths walked."""

    cost: float
    cost_standard_error: float
    prior: float
    photons: int


class Method(Protocol):
    """How a stage's iterations find the extinction."""

    @property
    def extinction(self) -> np.ndarray: ...

    def iterate(self, key: int, where: str) -> Progress: ...

    def estimate(self) -> np.ndarray: ...

    def standard_error(self, draws: int) -> np.ndarray | None: ...

    def state(self) -> dict[str, np.ndarray]: ...

    def restore(self, state: dict[str, np.ndarray]) -> None: ...


def check_gradient(gradient: np.ndarray, where: str) -> None:
    """TransportError if one is not finite: a step's bounds would turn it into a clear voxel, unseen."""
    wrong = ~np.isfinite(gradient)
    if wrong.any():
        voxel = tuple(int(i) for i in np.argwhere(wrong)[0])
        raise TransportError(
            f"the gradient is not finite at voxel {voxel} of the grid {wrong.shape}, in {where}: "
            "the device or its driver is at fault, or the optics are extreme; try another device"
        )
