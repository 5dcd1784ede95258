"""The unknowns that Gauss-Newton steps in: like the extinction where it is small, like its logarithm where it is large.

Images hardly change any more with what is optically deep: of a cloud of which a part is missing, a model that is linear
in the extinction is wrong after a few per cent of the way, and its steps stay small. In the logarithm it holds for much
longer.
"""

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

    def of(self, extinction: np.ndarray) -> np.ndarray:
        """u, km^-1."""
        return extinction if np.isinf(self.scale) else self.scale * np.log1p(extinction / self.scale)

    def extinction(self, u: np.ndarray) -> np.ndarray:
        """b, km^-1."""
        return u if np.isinf(self.scale) else self.scale * np.expm1(u / self.scale)

    def slope(self, extinction: np.ndarray) -> np.ndarray:
        """db / du."""
        return np.ones_like(extinction) if np.isinf(self.scale) else 1.0 + extinction / self.scale
