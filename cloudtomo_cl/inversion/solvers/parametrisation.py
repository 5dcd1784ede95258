"""The unknowns that Gauss-Newton steps in: the extinction, or what is like its logarithm where it is large."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Parametrisation:
    """u = s ln(1 + b / s), of an extinction b.

    Attributes
    ----------
    scale : s, km^-1; infinite: u is the extinction
    """

    scale: float

    @classmethod
    def beyond(cls, depth: float | None, edge: float) -> Parametrisation:
        """Like the logarithm beyond an optical depth of voxels with this edge, km; None: nowhere."""
        return cls(np.inf if depth is None else depth / edge)

    def of(self, extinction: np.ndarray) -> np.ndarray:
        """u, km^-1."""
        return extinction if np.isinf(self.scale) else self.scale * np.log1p(extinction / self.scale)

    def extinction(self, u: np.ndarray) -> np.ndarray:
        """b, km^-1."""
        return u if np.isinf(self.scale) else self.scale * np.expm1(u / self.scale)

    def slope(self, extinction: np.ndarray) -> np.ndarray:
        """db / du."""
        return np.ones_like(extinction) if np.isinf(self.scale) else 1.0 + extinction / self.scale
