"""The energy audit: what became of the weight that was launched."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from cloudtomo_cl.errors import AuditError
from cloudtomo_cl.opencl.device import Device
from cloudtomo_cl.opencl.fixed_point import summed
from cloudtomo_cl.opencl.layout import BUDGET_COPIES, TERMINATIONS, WEIGHT_UNIT

# Each path's balance is rounded to single precision, a few hundred times in thick clouds.
_ROUNDING = 1e-4
# Roulettes and branches give as much as they take, but for chance: 6 standard errors are 2e-9 of all runs.
_SIGNIFICANCE = 6.0
_LOST_SHARE_LIMIT = 1e-4


@dataclass(frozen=True)
class Audit:
    """Where the paths' weights went, as shares of what was launched (every path starts with 1).

    A rendering's paths start in its cameras and fluxes' in the sun, so that "top" is what leaves to
    space, for a flux run the reflected light.

    Attributes
    ----------
    launched : paths
    top, bottom, sides : left through there, and met no surface
    missed : never met an open domain
    absorbed : by droplets and molecules
    surface : absorbed by the surface
    killed : ended by roulettes, less what their survivors gained, and left to branches, less what those took: 0 but
        for `killed_standard_error`
    lost : given up in endless horizontal flight
    truncated : radiance that a truncation removed, as a share of what there was
    """

    launched: int
    top: float
    bottom: float
    sides: float
    missed: float
    absorbed: float
    surface: float
    killed: float
    killed_standard_error: float
    lost: float
    truncated: float = 0.0

    @property
    def balance(self) -> float:
        """The sum of all shares, less 1: rounding."""
        return (
            self.top + self.bottom + self.sides + self.missed + self.absorbed + self.surface + self.killed + self.lost
        ) - 1.0

    def check(self, expected: int) -> None:
        """Compares with the number of paths that were to be launched.

        Raises
        ------
        AuditError : paths are missing, weight came from nowhere or went nowhere, roulettes or
            branches are unfair, or too many paths were lost
        """
        if self.launched != expected:
            raise AuditError(f"{self.launched} of {expected} paths came to an end: {_ADVICE}")
        if not abs(self.balance) <= _ROUNDING:
            raise AuditError(f"the paths' weights add up to {1 + self.balance:.6g} instead of 1: {_ADVICE}")
        # Of few paths the error itself is uncertain: one more that ends with all its weight is within it.
        error = (self.killed_standard_error**2 + 1.0 / max(self.launched, 1) ** 2) ** 0.5
        if not abs(self.killed) <= _SIGNIFICANCE * error + 1.0 / WEIGHT_UNIT:
            raise AuditError(
                f"roulettes and branches took {self.killed:.3g} ± {self.killed_standard_error:.2g} of the weight "
                f"instead of 0: {_ADVICE}"
            )
        if self.lost > _LOST_SHARE_LIMIT:
            raise AuditError(
                f"{self.lost:.2%} of the weight was lost in horizontal flight: with periodic sides, tilt the views "
                "that look along the horizon"
            )


def check_replays(astray: int, paths: int) -> None:
    """AuditError if of so many paths that were walked again too many brought another radiance than before."""
    if astray > _LOST_SHARE_LIMIT * paths:
        raise AuditError(f"{astray} of {paths} paths brought another radiance when they were walked again: {_ADVICE}")


def combined(audits: Sequence[Audit]) -> Audit:
    """The audit of several runs of paths together."""
    launched = sum(audit.launched for audit in audits)
    values = {
        field.name: sum(getattr(audit, field.name) * audit.launched for audit in audits) / launched
        for field in fields(Audit)
    }
    error = sum((audit.killed_standard_error * audit.launched) ** 2 for audit in audits) ** 0.5 / launched
    return Audit(**values | {"launched": launched, "killed_standard_error": error})


_ADVICE = "the device computes wrongly; try another (cloudtomo devices), and please report this with its output"


class Budget:
    """The budget on the device, one per run of paths."""

    def __init__(self, device: Device) -> None:
        self.sums = device.zeros((BUDGET_COPIES, len(TERMINATIONS)), np.int64)
        self._ranks = device.ranks

    @property
    def data(self) -> Any:
        """The buffer that kernels add to."""
        return self.sums.data

    def audit(self, radiance_sum: float = 0.0) -> Audit:
        """What the budget says.

        radiance_sum : of all paths, sr^-1, what a truncation left

        Raises
        ------
        TransportError : a sum has overflowed
        """
        copies = summed(self.sums.get(), self._ranks, "the budget of the paths' weights", "copy and termination")
        # Exact: the same bits however launches and ranks have dealt the paths out among the copies.
        sums = dict(zip(TERMINATIONS, copies.astype(object).sum(axis=0).astype(float) / WEIGHT_UNIT))
        launched = sums["LAUNCHED"]
        shares = {name: float(value / max(launched, 1.0)) for name, value in sums.items()}
        removed = float(sums["TRUNCATED"])
        return Audit(
            launched=round(launched),
            **{name.lower(): shares[name] for name in TERMINATIONS[: TERMINATIONS.index("LAUNCHED")]},
            killed_standard_error=float(np.sqrt(max(sums["KILLED_VARIANCE"], 0.0)) / max(launched, 1.0)),
            truncated=removed / (removed + radiance_sum) if removed else 0.0,
        )
