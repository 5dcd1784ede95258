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

# The imaginary part from 1000 to 2400 nm, where Hale and Querry's steps of 200 nm cut the bands at 1450 and 1940 nm and
# fill the windows beside them (by 15 to 48 % at 1240, 1650 and 2130 nm): Segelstein 1981, The complex refractive index
# of water, M.S. thesis, University of Missouri-Kansas City: wavelength (um), imaginary part.
_SEGELSTEIN = """
1.000 3.000e-6  1.009 2.688e-6  1.021 2.352e-6  1.030 2.001e-6  1.040 1.690e-6  1.050 1.419e-6  1.059 1.299e-6
1.069 1.259e-6  1.079 1.329e-6  1.089 1.499e-6  1.099 1.708e-6  1.109 2.038e-6  1.119 2.628e-6  1.130 3.869e-6
1.140 5.951e-6  1.151 9.306e-6  1.159 1.069e-5  1.169 1.120e-5  1.180 1.160e-5  1.191 1.181e-5  1.199 1.199e-5
1.211 1.191e-5  1.219 1.179e-5  1.230 1.160e-5  1.239 1.139e-5  1.250 1.100e-5  1.259 1.079e-5  1.271 1.090e-5
1.279 1.139e-5  1.291 1.221e-5  1.300 1.400e-5  1.309 1.639e-5  1.321 1.912e-5  1.330 2.251e-5  1.340 2.849e-5
1.349 4.047e-5  1.361 4.505e-5  1.371 5.804e-5  1.380 7.802e-5  1.390 1.060e-4  1.400 1.530e-4  1.409 2.540e-4
1.419 3.197e-4  1.429 3.538e-4  1.439 3.629e-4  1.449 3.637e-4  1.459 3.604e-4  1.469 3.387e-4  1.479 3.018e-4
1.489 2.659e-4  1.500 2.248e-4  1.510 1.958e-4  1.521 1.741e-4  1.531 1.602e-4  1.542 1.441e-4  1.549 1.348e-4
1.560 1.240e-4  1.570 1.140e-4  1.581 1.071e-4  1.589 9.940e-5  1.600 9.347e-5  1.611 8.804e-5  1.622 8.310e-5
1.629 8.096e-5  1.641 7.903e-5  1.648 7.591e-5  1.660 7.398e-5  1.671 7.404e-5  1.679 7.495e-5  1.690 7.601e-5
1.698 7.743e-5  1.710 8.050e-5  1.722 8.410e-5  1.730 8.900e-5  1.742 9.510e-5  1.750 1.000e-4  1.762 1.051e-4
1.770 1.120e-4  1.778 1.219e-4  1.791 1.330e-4  1.799 1.359e-4  1.811 1.371e-4  1.820 1.380e-4  1.828 1.418e-4
1.841 1.552e-4  1.849 1.861e-4  1.862 3.205e-4  1.871 5.209e-4  1.879 7.224e-4  1.888 9.221e-4  1.901 1.161e-3
1.910 1.678e-3  1.919 1.827e-3  1.932 1.922e-3  1.941 1.909e-3  1.950 1.848e-3  1.959 1.717e-3  1.968 1.548e-3
1.982 1.402e-3  1.991 1.250e-3  2.000 1.101e-3  2.009 9.904e-4  2.018 8.888e-4  2.028 8.050e-4  2.042 7.392e-4
2.051 6.742e-4  2.061 6.206e-4  2.070 5.725e-4  2.080 5.294e-4  2.089 4.884e-4  2.099 4.643e-4  2.109 4.403e-4
2.118 4.176e-4  2.128 3.970e-4  2.138 3.826e-4  2.148 3.705e-4  2.158 3.587e-4  2.168 3.506e-4  2.178 3.434e-4
2.188 3.395e-4  2.198 3.379e-4  2.208 3.387e-4  2.218 3.410e-4  2.228 3.458e-4  2.239 3.571e-4  2.249 3.739e-4
2.259 3.898e-4  2.270 4.081e-4  2.280 4.293e-4  2.291 4.506e-4  2.301 4.686e-4  2.312 4.918e-4  2.317 5.114e-4
2.328 5.430e-4  2.339 5.995e-4  2.350 6.365e-4  2.360 6.852e-4  2.371 7.427e-4  2.382 7.921e-4  2.388 8.488e-4
2.399 9.095e-4
"""


def water_refractive_index(wavelength_nm: float) -> complex:
    """The refractive index of liquid water, n - i k, at 25 degrees C.

    From Hale and Querry 1973, Table I, 200 to 4000 nm; but k from 1000 to 2400 nm is that of Segelstein 1981, in steps
    of 10 nm. Between a table's wavelengths n and log k are linear in the wavelength.

    Raises
    ------
    DataError : the wavelength is outside of the table
    """
    micrometres, real, imaginary = np.array(_HALE_QUERRY.split(), dtype=np.float64).reshape(-1, 3).T
    place = wavelength_nm / 1e3
    if not micrometres[0] <= place <= micrometres[-1]:
        raise DataError(
            f"wavelength is {wavelength_nm:g} nm: water's refractive index is known from {micrometres[0] * 1e3:g} "
            f"to {micrometres[-1] * 1e3:g} nm: give the refractive index too"
        )
    finer, absorption = np.array(_SEGELSTEIN.split(), dtype=np.float64).reshape(-1, 2).T
    if finer[0] <= place <= finer[-1]:
        k = np.exp(np.interp(place, finer, np.log(absorption)))
    else:
        k = np.exp(np.interp(place, micrometres, np.log(imaginary)))
    return complex(np.interp(place, micrometres, real), -k)
