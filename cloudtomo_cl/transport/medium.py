"""What walks go through: a scene with its extinction, on the device."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from cloudtomo_cl.errors import DataError

# Optical depth across a voxel's shortest edge; the densest clouds have some 10.
LARGEST_VOXEL_DEPTH = 1e5


@dataclass(frozen=True, eq=False)
class Medium:
    """An extinction on the device, and what walks through it take along.

    Attributes
    ----------
    struct, inside_struct : the kernels' Scene; the same over a black surface
    extinction : km^-1, array on the device
    skips_zeros : whether walks skip voxels because their extinction is 0: gradients would miss them
    """

    struct: Any
    inside_struct: Any
    extinction: Any
    skips_zeros: bool
    _made_by: object  # the DeviceScene
    _buffers: dict[str, Any]

    @property
    def arguments(self) -> dict[str, Any]:
        """What every kernel that walks paths takes of the medium, by name (parameters.MEDIUM)."""
        return {"scene": self.struct, "extinction": self.extinction, **self._buffers}


def check_extinction(values: np.ndarray) -> None:
    """Raises DataError if an extinction is negative or not finite anywhere."""
    wrong = ~(np.isfinite(values) & (values >= 0))
    if wrong.any():
        voxel = tuple(int(i) for i in np.unravel_index(np.argmax(wrong), values.shape))
        raise DataError(f"extinction at voxel {voxel} is {values[voxel]}: it must be finite and at least 0 km^-1")


def check_depth(values: np.ndarray, edge: float) -> None:
    """Raises DataError if an optical depth is so large that paths would scatter in one voxel for ever."""
    voxel = tuple(int(i) for i in np.unravel_index(np.argmax(values), values.shape))
    depth = float(values[voxel]) * edge
    if depth > LARGEST_VOXEL_DEPTH:
        raise DataError(
            f"extinction at voxel {voxel} is {values[voxel]:.4g} km^-1, an optical depth of {depth:.3g} across "
            f"{edge:g} km (at most {LARGEST_VOXEL_DEPTH:g}): are its unit (km^-1) and the coordinates' (km) right?"
        )
