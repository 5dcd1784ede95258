"""Phase functions of droplets: densities over the sphere in sr^-1, integral 1."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import ConfigDict, Field
from pydantic.dataclasses import dataclass


@dataclass(frozen=True, config=ConfigDict(extra="forbid"))
class HenyeyGreenstein:
    """Henyey and Greenstein 1941; g is the asymmetry, positive for forward scattering.

    Beyond 0.99 the peak is too sharp for the kernels' single precision."""

    g: Annotated[float, Field(ge=-0.99, le=0.99)]
    type: Literal["henyey-greenstein"] = "henyey-greenstein"


PhaseFunction = HenyeyGreenstein
