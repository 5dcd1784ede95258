"""3-D cloud extinction from images taken from several directions.

Lengths are in km, extinction in km^-1, angles in degrees, radiance in W m^-2 sr^-1; x runs
east, y north, z up, and the ground is z = 0.

The public names are in __init__.pyi. What they come from is imported when they are first used: importing the
package takes a few hundredths of a second and touches no device.
"""

import logging
from typing import Any

import lazy_loader

_lazy, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

# Public names of 0.1 that are no more, and what took their place.
_RENAMED = {"Optimizer": "GaussNewton, Adam or SGD, whose arguments were those of Optimizer"}


def __getattr__(name: str) -> Any:
    if name in _RENAMED:
        raise AttributeError(f"cloudtomo_cl.{name} is now {_RENAMED[name]}")
    return _lazy(name)


# A library does not decide where messages go.
logging.getLogger(__name__).addHandler(logging.NullHandler())
