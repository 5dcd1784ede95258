"""How far an extinction is from the truth: the two errors of cloud tomography."""

from __future__ import annotations

from typing import Any

import numpy as np

from cloudtomo_cl.errors import DataError
from cloudtomo_cl.scene.arrays import as_numbers


def _checked(estimate: Any, truth: Any) -> tuple[np.ndarray, np.ndarray, float]:
    """Both arrays in double precision, and the optical mass of the truth."""
    estimate, truth = as_numbers(estimate, "estimate"), as_numbers(truth, "truth")
    if estimate.shape != truth.shape:
        raise DataError(
            f"estimate has shape {estimate.shape}, truth {truth.shape}: "
            "both must lie on the same grid, so resample one of them first"
        )
    for name, values in (("estimate", estimate), ("truth", truth)):
        wrong = ~np.isfinite(values)
        if wrong.any():
            voxel = tuple(int(i) for i in np.argwhere(wrong)[0])
            raise DataError(f"{name} at voxel {voxel} is {values[voxel]}: it must be finite")
    mass = float(np.abs(truth).sum())
    if mass == 0:
        raise DataError("truth is zero in every voxel: errors relative to an empty cloud are not defined")
    return estimate, truth, mass


def epsilon(estimate: Any, truth: Any) -> float:
    """Local error: ||estimate - truth||_1 / ||truth||_1 (the supplement's Eq. 25).

    0 is perfect; an empty estimate scores 1.

    Parameters
    ----------
    estimate, truth : extinctions in the same unit, on the same grid

    Raises
    ------
    DataError : other shapes, values that are not finite, a truth of zeros
    """
    estimate, truth, mass = _checked(estimate, truth)
    return float(np.abs(estimate - truth).sum() / mass)


def delta(estimate: Any, truth: Any) -> float:
    """Bias of the optical mass: (||estimate||_1 - ||truth||_1) / ||truth||_1.

    Negative where the estimate holds too little cloud. Parameters and errors as in `epsilon`.
    """
    estimate, truth, mass = _checked(estimate, truth)
    return float((np.abs(estimate).sum() - mass) / mass)
