"""3-D cloud extinction from images taken from several directions.

Lengths are in km, extinction in km^-1, angles in degrees, radiance in W m^-2 sr^-1; x runs
east, y north, z up, and the ground is z = 0.

The public names are in __init__.pyi. What they come from is imported when they are first used: importing the
package takes a few hundredths of a second and touches no device.
"""

import logging

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

# A library does not decide where messages go.
logging.getLogger(__name__).addHandler(logging.NullHandler())
