"""Clouds in text files: lines of voxels of pyshdom, AT3D and SHDOM. Every mistake has its line and column."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cloudtomo_cl.clouds.quantities import Quantity, ReadingOptions, box_edges, cloud_volume
from cloudtomo_cl.clouds.volume import CloudVolume
from cloudtomo_cl.errors import DataError
from cloudtomo_cl.files.axes import edges_between
from cloudtomo_cl.memory import require, require_countable, shape_text, voxels_of

_EXPECTED = (
    "text must hold '# comment', 'nx ny nz', 'dx dy z1 ... znz' (km), and lines "
    "'ix iy iz water_content effective_radius' (g m^-3, um); names of columns may stand above them"
)
# Of the arrays that live at the same time.
_BYTES_PER_VOXEL = 64
# The format has lengths in km and says so nowhere: what is larger is in metres.
_LARGEST_STEP, _HIGHEST = 5.0, 30.0
_INDICES = (("x", "y", "z"), ("i", "j", "k"), ("ix", "iy", "iz"), ("x_idx", "y_idx", "z_idx"))
WATER_COLUMNS = ("lwc", "density", "liquid_water_content", "cloud_water_content", "clwc", "water_content")
RADIUS_COLUMNS = ("reff", "effective_radius", "re", "r_eff", "reffective")
# A number as C, Fortran (1.0D-3, 1.0E-3) and spreadsheets write it.
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eEdD][+-]?\d+)?")
_MISSING = {"nan", "na", "n/a", "null", "none", "missing", "-nan", "+nan", "nan(ind)", "-nan(ind)", "*", "--"}


@dataclass(frozen=True)
class _Line:
    """Words of a line, with its number and where each word begins (both from 1)."""

    number: int
    words: list[str]
    columns: list[int]


def read_text_cloud(path: Path, text: str, options: ReadingOptions) -> CloudVolume:
    """Liquid water content and effective radius of voxels by their indices.

    Raises
    ------
    DataError : what is wrong, on which line, in which column
    """
    for name, value in (("--variable", options.variable), ("--units", options.units), ("--spacing", options.spacing)):
        if value is not None:
            raise DataError(f"{path}: {name} has no effect on this text, which says it itself; leave it out")
    lines = list(_lines(text))
    first = 0
    if lines and "2 parameter lwc" in text.splitlines()[lines[0].number - 1].lower():
        # SHDOM: numbers of points, spacing, levels, temperatures, then points counted from 1.
        lines, first = lines[1:], 1
    shape = _shape(path, _next(path, lines))
    spacing, levels = _levels(path, lines, shape)
    if first:
        temperatures = 0
        while lines and temperatures < shape[2]:
            temperatures += len(lines.pop(0).words)
        if temperatures != shape[2]:
            raise DataError(f"{path}: has {temperatures} temperatures for {shape[2]} levels")
    wanted = _columns(path, lines)
    require_countable(voxels_of(shape), 0, f"{path}: {shape_text(shape)} voxels")
    require(_BYTES_PER_VOXEL * voxels_of(shape), f"{path}: an extinction of {shape_text(shape)} voxels", "crop it")
    water, radius, missing = _voxels(path, lines, shape, first, wanted)
    radius_read = Quantity(f"column {missing[1]}", "effective radius", radius, "um", True)
    # The levels are points on which SHDOM interpolates; x and y are told by their spacing only, and start at 0.
    edges = [*box_edges(shape[:2], spacing), edges_between(path, "z", levels, spacing[0])]
    rows = (
        ("x, y", "by their spacing, km (by the format), from 0"),
        ("z", f"{shape[2]} levels, km (by the format), {levels[0]:g} to {levels[-1]:g} km"),
    )
    field = Quantity(f"column {missing[0]}", "liquid water content", water, "g m-3, by the format", True)
    return cloud_volume(path, field, edges, radius_read, options, rows)


def _lines(text: str) -> Iterator[_Line]:
    """The lines that say something: without comments and empty ones."""
    for number, line in enumerate(text.splitlines(), 1):
        line = line.split("#", 1)[0]
        words, columns = [], []
        # Semicolons, commas and tabs stand between words; between two of them nothing is a word, too.
        separator = next((mark for mark in (";", ",", "\t") if mark in line), None)
        if separator == ";" and re.search(r"\d,\d", line):
            line = line.replace(",", ".")
        pattern = r"\S+" if separator is None or separator == "\t" else rf"[^{separator}]*"
        if separator in (";", ","):
            place = 0
            for part in line.split(separator):
                stripped = part.strip().strip("'\"").strip()
                words.append(stripped)
                columns.append(place + 1 + len(part) - len(part.lstrip()))
                place += len(part) + 1
            while words and not words[-1]:
                words.pop()
                columns.pop()
        else:
            for match in re.finditer(pattern, line):
                words.append(match.group().strip("'\""))
                columns.append(match.start() + 1)
        if any(words):
            yield _Line(number, words, columns)


def _next(path: Path, lines: list[_Line]) -> _Line:
    if not lines:
        raise DataError(f"{path}: is no cloud that can be read: it ends too early: {_EXPECTED}")
    return lines.pop(0)


def _number(path: Path, line: _Line, index: int, what: str) -> float:
    """A word of a line as a number; NaN where it says that it is missing."""
    if index >= len(line.words):
        raise DataError(f"{path}: line {line.number} has {len(line.words)} numbers and no {what}: {_EXPECTED}")
    word = line.words[index]
    if _NUMBER.fullmatch(word):
        return float(word.lower().replace("d", "e"))
    if word.lower() in _MISSING:
        return np.nan
    raise DataError(
        f"{path}: is no cloud that can be read: line {line.number}, column {line.columns[index]}: {word[:40]!r} is no "
        f"number, it must be the {what}: {_EXPECTED}"
    )


def _shape(path: Path, line: _Line) -> tuple[int, int, int]:
    numbers = [_number(path, line, index, "number of points") for index in range(len(line.words))]
    if len(numbers) != 3 or not all(number >= 1 and number == np.floor(number) for number in numbers):
        raise DataError(
            f"{path}: line {line.number} must be nx ny nz, is {' '.join(line.words)[:60]!r}: is no cloud that can be "
            f"read: {_EXPECTED}"
        )
    return int(numbers[0]), int(numbers[1]), int(numbers[2])


def _levels(path: Path, lines: list[_Line], shape: tuple[int, int, int]) -> tuple[tuple[float, float], np.ndarray]:
    """Spacing along x and y, and the levels, which may stand on lines of their own."""
    line = _next(path, lines)
    numbers = [_number(path, line, index, "spacing or level") for index in range(len(line.words))]
    where = line.number
    while len(numbers) < 2 + shape[2] and lines and all(map(_NUMBER.fullmatch, lines[0].words)):
        more = [_number(path, lines[0], index, "level") for index in range(len(lines[0].words))]
        # A voxel's line does not rise; levels do, and are no more than there must be.
        if (np.diff(numbers[2:] + more) <= 0).any() or len(numbers) + len(more) > 2 + shape[2]:
            break
        numbers += more
        lines.pop(0)
    spacing, levels = numbers[:2], np.array(numbers[2:])
    if len(spacing) < 2 or not (np.isfinite(spacing).all() and min(spacing) > 0):
        raise DataError(f"{path}: line {where} must begin with dx dy, both above 0 km: {_EXPECTED}")
    if len(levels) != shape[2]:
        raise DataError(f"{path}: line {where} has {len(levels)} levels, the first line says {shape[2]}")
    steps = np.abs([*spacing, *np.diff(levels)])
    if steps.max() > _LARGEST_STEP or levels.max() > _HIGHEST:
        raise DataError(
            f"{path}: line {where} has steps of {steps.max():g} and levels up to {levels.max():g} km, and no cloud "
            f"has: they must be in km, not in metres"
        )
    return (spacing[0], spacing[1]), levels


def _columns(path: Path, lines: list[_Line]) -> list[int]:
    """Where x, y, z, water and radius stand: by the names above them, or the first five."""
    if not lines or all(_NUMBER.fullmatch(word) or word.lower() in _MISSING for word in lines[0].words):
        return [0, 1, 2, 3, 4]
    line = lines.pop(0)
    names = [re.sub(r"\s*[\[(].*", "", word).strip().lower() for word in line.words]
    indices = next((triple for triple in _INDICES if set(triple) <= set(names)), None)
    water = next((names.index(name) for name in WATER_COLUMNS if name in names), None)
    radius = next((names.index(name) for name in RADIUS_COLUMNS if name in names), None)
    if indices is None or water is None or radius is None:
        raise DataError(
            f"{path}: line {line.number}: has the columns {', '.join(line.words)[:80]}; it must have x, y, z (or i, j, "
            f"k), lwc and reff, or be a voxel: {_EXPECTED}"
        )
    _refuse_other_units(path, line, {water: "g m-3", radius: "um"})
    return [*(names.index(name) for name in indices), water, radius]


def _refuse_other_units(path: Path, line: _Line, ours: dict[int, str]) -> None:
    """Names of columns may have a unit in brackets behind them, which must be that of the format."""
    from cloudtomo_cl.files.units import parse_unit

    for index, unit in ours.items():
        found = re.search(r"[\[(]([^\])]*)[\])]", line.words[index])
        if found and parse_unit(found.group(1)) != parse_unit(unit):
            raise DataError(
                f"{path}: line {line.number}, column {line.columns[index]}: {line.words[index]!r} must be in {unit}"
            )


def _voxels(
    path: Path, lines: list[_Line], shape: tuple[int, int, int], first: int, wanted: list[int]
) -> tuple[np.ndarray, np.ndarray, tuple[int, int]]:
    """Water and radius on the voxels, and in which columns they stand."""
    water, radius = np.zeros(shape), np.full(shape, np.nan)
    taken: dict[tuple[int, ...], int] = {}
    for line in lines:
        voxel = []
        for letter, column, count in zip("xyz", wanted, shape):
            number = _number(path, line, column, f"index along {letter}")
            if not number == np.floor(number):
                raise DataError(
                    f"{path}: line {line.number}, column {line.columns[column]}: {line.words[column]} is no whole "
                    f"number: it must be the index of a voxel along {letter}, counted from {first}, not its place in km"
                )
            if not first <= number < first + count:
                raise DataError(
                    f"{path}: line {line.number}, column {line.columns[column]}: the voxel {line.words[column]} along "
                    f"{letter} lies outside of {count} voxels, which are counted from {first}"
                )
            voxel.append(int(number) - first)
        place = tuple(voxel)
        if place in taken:
            raise DataError(
                f"{path}: line {line.number}: the voxel {' '.join(line.words[column] for column in wanted[:3])} stands "
                f"on line {taken[place]}, too: each must be there once"
            )
        taken[place] = line.number
        water[place] = _number(path, line, wanted[3], "water content")
        radius[place] = _number(path, line, wanted[4], "effective radius")
    if not taken:
        raise DataError(f"{path}: has no voxels below its header: {_EXPECTED}")
    return water, radius, (wanted[3] + 1, wanted[4] + 1)
