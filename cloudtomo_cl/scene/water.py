"""The refractive index of liquid water."""

from __future__ import annotations

import numpy as np

from cloudtomo_cl.errors import DataError

# Hale and Querry 1973, Optical constants of water in the 200-nm to 200-um wavelength region, Appl.
# Opt. 12, 555-563, Table I, at 25 degrees C up to 4 um: wavelength (um), real part n, imaginary part k.
# (Segelstein's table of 1981, which is in wide use, has an n that is 0.004 too large at 500 nm.)
_HALE_QUERRY = """
0.200 1.396 1.10e-7  0.225 1.373 4.90e-8  0.250 1.362 3.35e-8  0.275 1.354 2.35e-8  0.300 1.349 1.60e-8
0.325 1.346 1.08e-8  0.350 1.343 6.50e-9  0.375 1.341 3.50e-9  0.400 1.339 1.86e-9  0.425 1.338 1.30e-9
0.450 1.337 1.02e-9  0.475 1.336 9.35e-10 0.500 1.335 1.00e-9  0.525 1.334 1.32e-9  0.550 1.333 1.96e-9
0.575 1.333 3.60e-9  0.600 1.332 1.09e-8  0.625 1.332 1.39e-8  0.650 1.331 1.64e-8  0.675 1.331 2.23e-8
0.700 1.331 3.35e-8  0.725 1.330 9.15e-8  0.750 1.330 1.56e-7  0.775 1.330 1.48e-7  0.800 1.329 1.25e-7
0.825 1.329 1.82e-7  0.850 1.329 2.93e-7  0.875 1.328 3.91e-7  0.900 1.328 4.86e-7  0.925 1.328 1.06e-6
0.950 1.327 2.93e-6  0.975 1.327 3.48e-6  1.000 1.327 2.89e-6  1.200 1.324 9.89e-6  1.400 1.321 1.38e-4
1.600 1.317 8.55e-5  1.800 1.312 1.15e-4  2.000 1.306 1.10e-3  2.200 1.296 2.89e-4  2.400 1.279 9.56e-4
2.600 1.242 3.17e-3  2.650 1.219 6.70e-3  2.700 1.188 1.90e-2  2.750 1.157 5.90e-2  2.800 1.142 1.15e-1
2.850 1.149 1.85e-1  2.900 1.201 2.68e-1  2.950 1.292 2.98e-1  3.000 1.371 2.72e-1  3.050 1.426 2.40e-1
3.100 1.467 1.92e-1  3.150 1.483 1.35e-1  3.200 1.478 9.24e-2  3.250 1.467 6.10e-2  3.300 1.450 3.68e-2
3.350 1.432 2.61e-2  3.400 1.420 1.95e-2  3.450 1.410 1.32e-2  3.500 1.400 9.40e-3  3.600 1.385 5.15e-3
3.700 1.374 3.60e-3  3.800 1.364 3.40e-3  3.900 1.357 3.80e-3  4.000 1.351 4.60e-3
"""


def water_refractive_index(wavelength_nm: float) -> complex:
    """The refractive index of liquid water, n - i k, at 25 degrees C.

    Hale and Querry 1973, Table I, from 200 to 4000 nm; between its wavelengths n and log k are
    linear in the wavelength. Beyond 1000 nm the table has steps of 200 nm: absorption bands between
    them (1450 nm, 1930 nm) are cut, so give an index of your own there.

    Raises
    ------
    DataError : a wavelength outside of the table
    """
    micrometres, real, imaginary = np.array(_HALE_QUERRY.split(), dtype=np.float64).reshape(-1, 3).T
    place = wavelength_nm / 1e3
    if not micrometres[0] <= place <= micrometres[-1]:
        raise DataError(
            f"wavelength is {wavelength_nm:g} nm: water's refractive index is known from {micrometres[0] * 1e3:g} "
            f"to {micrometres[-1] * 1e3:g} nm: give the refractive index too"
        )
    return complex(np.interp(place, micrometres, real), -np.exp(np.interp(place, micrometres, np.log(imaginary))))
