"""What priors are multiplied with."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class NoiseUnits:
    """What priors are multiplied with, for the data term is no logarithm: mean weighted variances of a pixel's noise.

    Attributes
    ----------
    measured : n, of the measured images, times the stage's weight
    both : N, of measured and modelled images
    weight : factor of all that is multiplied with N: the stage's, times that of a step
    """

    measured: float
    both: float
    weight: float = 1.0

    @property
    def weighted(self) -> float:
        """The weight times N."""
        return self.weight * self.both
