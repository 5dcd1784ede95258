"""Tables of droplets' optics by Mie's theory, averaged over a distribution of sizes.

miepython (extra `mie`) computes efficiencies and the coefficients a_n, b_n of single spheres;
what is here sums them over angles and sizes. Equations: Bohren and Huffman 1983 (BH), Hansen
and Travis 1974 (HT).
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from numbers import Complex
from types import ModuleType

import numpy as np

from cloudtomo_cl.arguments import CALLABLE, NUMBER, NUMBERS, many, require_kinds
from cloudtomo_cl.errors import DataError, MissingPackageError
from cloudtomo_cl.scene.arrays import as_numbers
from cloudtomo_cl.scene.droplets import DropletTable
from cloudtomo_cl.scene.phase import TabulatedPhaseFunction
from cloudtomo_cl.scene.water import water_refractive_index

# Sizes are this far apart in the size parameter 2 pi r / wavelength (intensities oscillate
# with periods of about 1 and more), and each effective radius has at least so many of them.
SIZE_STEP = 0.02
_FEWEST_SIZES = 400
# What lies outside the range of sizes, as a fraction of the cross-section; for large ones of r^4,
# to which they add in the forward direction.
_TAIL = 1e-6
# A table's error between its angles, relative, before it is normalised.
INTERPOLATION_ERROR = 2e-3
# The angles from which the table's are chosen: degrees, and radians times the largest size parameter.
_COARSEST_STEP = 0.1
_FINEST_STEP = 0.03
_STEP_GROWTH = 0.01
_SIZES_AT_ONCE = 256
_LARGEST_SIZE_PARAMETER = 2e4

_INDICES = many(Complex)
Progress = Callable[[int, int], None]


def _miepython() -> ModuleType:
    # Compiled, it is 50 times faster; it looks at the environment when it is imported.
    before = os.environ.get("MIEPYTHON_USE_JIT")
    os.environ.setdefault("MIEPYTHON_USE_JIT", "1")
    try:
        import miepython
    except ImportError as error:
        raise MissingPackageError(
            f"Mie tables need the package miepython ({error}): pip install 'miepython >= 3.0.2'"
        ) from None
    finally:
        if before is None:
            del os.environ["MIEPYTHON_USE_JIT"]
    return miepython


def droplet_table(
    wavelength_nm: float,
    effective_radius: Sequence[float] | np.ndarray | float,
    effective_variance: float = 0.1,
    refractive_index: complex | None = None,
    progress: Progress | None = None,
) -> DropletTable:
    """Optics of spherical droplets with the gamma distribution of sizes of HT Eq. 2.56.

        n(r) ~ r^((1 - 3 v) / v) exp(-r / (v r_e)),   r_e, v: effective radius and variance

    The angles of the table are chosen so that between them, linear in the cosine, every row errs
    by less than 0.5 %.

    Parameters
    ----------
    wavelength_nm : in air
    effective_radius : r_e, micrometres, increasing; one or several
    effective_variance : v, 0.001 to 0.4; 0.1 is usual for clouds (HT sec. 2.4)
    refractive_index : of the droplets; the sign of the imaginary part does not matter, it absorbs;
        None for water at this wavelength
    progress : is called with the sizes done and their number

    Raises
    ------
    DataError : an argument out of range, or of another kind (InvalidArgumentError)
    MissingPackageError : miepython is not installed
    """
    require_kinds("droplet_table", wavelength_nm=(wavelength_nm, NUMBER))
    indices = None if refractive_index is None else [refractive_index]
    return droplet_tables([wavelength_nm], effective_radius, effective_variance, indices, progress)[0]


def droplet_tables(
    wavelengths_nm: Sequence[float],
    effective_radius: Sequence[float] | np.ndarray | float,
    effective_variance: float = 0.1,
    refractive_indices: Sequence[complex] | None = None,
    progress: Progress | None = None,
) -> tuple[DropletTable, ...]:
    """`droplet_table` at several wavelengths, on common angles, so that they go into one file.

    Parameters
    ----------
    wavelengths_nm : in air, increasing
    effective_radius, effective_variance, progress : as in `droplet_table`
    refractive_indices : of the droplets at each wavelength; None for water

    Raises
    ------
    DataError : an argument out of range, or of another kind (InvalidArgumentError)
    MissingPackageError : miepython is not installed
    """
    require_kinds(
        "droplet_tables",
        wavelengths_nm=(wavelengths_nm, NUMBERS),
        effective_variance=(effective_variance, NUMBER),
        refractive_indices=(refractive_indices, _INDICES.or_none()),
        progress=(progress, CALLABLE.or_none()),
    )
    radii = np.atleast_1d(as_numbers(effective_radius, "effective_radius"))
    for wavelength in wavelengths_nm:
        _check(wavelength, radii, effective_variance)
    if not len(wavelengths_nm) or not (np.diff(wavelengths_nm) > 0).all():
        raise DataError(f"wavelengths are {list(wavelengths_nm)} nm: at least one is needed, and they must increase")
    if refractive_indices is not None and len(refractive_indices) != len(wavelengths_nm):
        raise DataError(f"{len(refractive_indices)} refractive indices for {len(wavelengths_nm)} wavelengths")
    miepython = _miepython()
    given = [None] * len(wavelengths_nm) if refractive_indices is None else refractive_indices
    every = [_sizes(*each, radii, effective_variance) for each in zip(wavelengths_nm, given)]
    angle = _fine_angles(max(one.largest for one in every))
    counts = np.cumsum([0, *(len(one.sizes) for one in every)])
    sums = [
        _summed(miepython, one, angle, _counting(progress, int(before), int(counts[-1])))
        for before, one in zip(counts, every)
    ]
    values = [differential / scattered[:, None] for differential, scattered, _ in sums]
    chosen = _choose_angles(angle, np.concatenate(values))
    tables = []
    for wavelength, one, rows, (_, scattered, efficiency) in zip(wavelengths_nm, every, values, sums):
        albedo = np.minimum(scattered / efficiency, 1.0)
        # Amplitudes and efficiencies are summed apart: that the integral is 1 checks both.
        function = TabulatedPhaseFunction(
            angle=tuple(angle[chosen].tolist()),
            values=tuple(map(tuple, rows[:, chosen].tolist())),
            effective_radius=tuple(radii.tolist()),
            single_scattering_albedo=tuple(albedo.tolist()),
        )
        about = float(wavelength), float(effective_variance), one.index.real, -one.index.imag
        tables.append(DropletTable(function, tuple(efficiency.tolist()), *about))
    return tuple(tables)


@dataclass(frozen=True, eq=False)
class _Sizes:
    """Size parameters of droplets at one wavelength.

    Attributes
    ----------
    sizes : shape (n,)
    weights : the geometric cross-section in droplets of each size, for each effective radius, shape (k, n)
    largest : that of the largest effective radius
    index : of refraction, n - i k
    """

    sizes: np.ndarray
    weights: np.ndarray
    largest: float
    index: complex


def _sizes(
    wavelength_nm: float, refractive_index: complex | None, radii: np.ndarray, effective_variance: float
) -> _Sizes:
    from scipy.stats import gamma

    if refractive_index is None:
        refractive_index = water_refractive_index(wavelength_nm)
    index = complex(refractive_index.real, -abs(refractive_index.imag))
    if not (np.isfinite(index) and index.real > 0):
        raise DataError(f"refractive_index is {refractive_index}: it must be finite, with a positive real part")
    # r^2 n(r) and r^4 n(r) are gamma distributions too.
    wave_number = 2e3 * np.pi / wavelength_nm  # per micrometre
    scales = wave_number * effective_variance * radii
    shape = 1 / effective_variance
    smallest, largest = gamma.ppf(_TAIL, shape) * scales, gamma.isf(_TAIL, shape + 2) * scales
    if largest[-1] > _LARGEST_SIZE_PARAMETER:
        raise DataError(
            f"the largest droplets have a size parameter of {largest[-1]:.3g}, at most {_LARGEST_SIZE_PARAMETER:g} is "
            "possible: choose a smaller effective radius or a longer wavelength"
        )
    step = min(SIZE_STEP, float((largest - smallest).min()) / _FEWEST_SIZES)
    sizes = np.arange(smallest[0], largest[-1] + step, step)
    weights = gamma.pdf(sizes, shape, scale=scales[:, None])
    weights /= weights.sum(axis=1, keepdims=True)
    return _Sizes(sizes, weights, float(largest[-1]), index)


def _counting(progress: Progress | None, before: int, total: int) -> Callable[[int], None]:
    """Tells how many of all sizes are done, after those of the wavelengths before."""

    def tell(done: int) -> None:
        if progress is not None:
            progress(before + done, total)

    return tell


def _summed(
    miepython: ModuleType, droplets: _Sizes, angle: np.ndarray, progress: Callable[[int], None]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Differential, scattering and extinction over geometric cross-section, summed over the sizes.

    Returns
    -------
    differential : sr^-1, shape (k, angles)
    scattered, efficiency : shape (k,)
    """
    sizes, weights, index = droplets.sizes, droplets.weights, droplets.index
    differential = np.zeros((len(weights), len(angle)))
    efficiency, scattered = np.zeros((2, len(weights)))
    functions = _angular_functions(np.cos(np.radians(angle)), miepython.coefficients(index, sizes[-1]).shape[1])
    for start in range(0, len(sizes), _SIZES_AT_ONCE):
        chunk = slice(start, start + _SIZES_AT_ONCE)
        extinction, scattering, _, _ = np.array([miepython.efficiencies_mx(index, size) for size in sizes[chunk]]).T
        efficiency += weights[:, chunk] @ extinction
        scattered += weights[:, chunk] @ scattering
        coefficients = [miepython.coefficients(index, size) for size in sizes[chunk]]
        intensity = _intensity(coefficients, functions)
        differential += (weights[:, chunk] / (np.pi * sizes[chunk] ** 2)) @ intensity
        progress(min(start + _SIZES_AT_ONCE, len(sizes)))
    return differential, scattered, efficiency


def _check(wavelength_nm: float, radii: np.ndarray, variance: float) -> None:
    if not 0 < wavelength_nm < np.inf:
        raise DataError(f"wavelength is {wavelength_nm:g} nm: it must be greater than 0")
    if radii.ndim != 1 or not len(radii) or not (np.isfinite(radii) & (radii > 0)).all():
        raise DataError(f"effective_radius is {list(radii.flat)}: it must be a list of micrometres, all greater than 0")
    if not (np.diff(radii) > 0).all():
        raise DataError(f"effective_radius is {radii.tolist()}: it must increase")
    if not 0.001 <= variance <= 0.4:
        raise DataError(f"effective_variance is {variance:g}: it must lie between 0.001 and 0.4")


def _fine_angles(largest_size: float) -> np.ndarray:
    """Angles in degrees from 0 to 180, close together in the forward peak and in the glory."""
    finest = min(np.degrees(_FINEST_STEP / largest_size), _COARSEST_STEP)
    angles = [0.0]
    while angles[-1] < 90:
        angles.append(angles[-1] + min(max(finest, _STEP_GROWTH * angles[-1]), _COARSEST_STEP))
    forward = np.array(angles) * 90 / angles[-1]
    return np.concatenate([forward, 180 - forward[-2::-1]])


def _angular_functions(cosine: np.ndarray, terms: int) -> tuple[np.ndarray, np.ndarray]:
    """(pi_n + tau_n) and (pi_n - tau_n) times (2n + 1) / (n (n + 1)), BH Eq. 4.47, shape (terms, angles)."""
    functions = np.empty((2, terms, len(cosine)))
    before, present = np.zeros_like(cosine), np.ones_like(cosine)
    for n in range(1, terms + 1):
        tau = n * cosine * present - (n + 1) * before
        factor = (2 * n + 1) / (n * (n + 1))
        functions[:, n - 1] = factor * (present + tau), factor * (present - tau)
        before, present = present, ((2 * n + 1) * cosine * present - (n + 1) * before) / n
    return functions[0], functions[1]


def _intensity(coefficients: list[np.ndarray], functions: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    """(|S1|^2 + |S2|^2) / 2 of BH Eq. 4.74 for spheres with these a_n and b_n, shape (spheres, angles).

    S1 + S2 and S1 - S2 have the sum (a + b)(pi + tau) and (a - b)(pi - tau): two matrix products.
    """
    terms = max(pair.shape[1] for pair in coefficients)
    padded = np.zeros((2, len(coefficients), terms), dtype=np.complex128)
    for row, (a, b) in enumerate(coefficients):
        padded[0, row, : len(a)] = a + b
        padded[1, row, : len(a)] = a - b
    total = np.zeros((len(coefficients), functions[0].shape[1]))
    for series, function in zip(padded, functions):
        # (|S1 + S2|^2 + |S1 - S2|^2) / 4 = (|S1|^2 + |S2|^2) / 2
        for part in (series.real, series.imag):
            total += (part @ function[:terms]) ** 2
    return total / 4


def _choose_angles(angle: np.ndarray, values: np.ndarray) -> np.ndarray:
    """The indices between which linear interpolation in the cosine errs by less than INTERPOLATION_ERROR.

    Intervals are halved at the worst angle (Ramer 1972, Douglas and Peucker 1973).
    """
    # 1 - cos, without cancellation.
    place = 2 * np.sin(np.radians(angle) / 2) ** 2
    chosen, intervals = {0, len(angle) - 1}, [(0, len(angle) - 1)]
    while intervals:
        first, last = intervals.pop()
        if last - first < 2:
            continue
        between = slice(first + 1, last)
        share = (place[between] - place[first]) / (place[last] - place[first])
        linear = values[:, [first]] + share * (values[:, [last]] - values[:, [first]])
        error = np.abs(linear / values[:, between] - 1).max(axis=0)
        worst = int(np.argmax(error))
        if error[worst] > INTERPOLATION_ERROR:
            middle = first + 1 + worst
            chosen.add(middle)
            intervals += [(first, middle), (middle, last)]
    return np.array(sorted(chosen))
