"""Units of files, understood: products of powers of named units, in the spellings of CF, UDUNITS and people.

`km-1`, `km^-1`, `km**-1`, `1/km`, `W m-2 sr-1`, `W/(m^2 sr)`, `g m⁻³`, `per km` say what they look like. A name
that is not in the short list below is refused, never guessed: what is read here are lengths, masses, angles and
radiances, and a list of all of physics (pint, cf-units) would understand `h` as a Planck constant or `Re` as nothing.
pint is pure Python, but needs cf_xarray's rewriting to read `m-1` as other than m minus 1; cf-units brings the
compiled library UDUNITS-2. Both agree with this list on what it knows (tests/unit/test_units.py has the numbers).
"""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np

# Base dimensions, in this order in `Unit.dimension`: length, mass, time, angle, solid angle. Angles are kept apart
# from pure numbers, so that a radiance is no flux.
Dimension = tuple[int, int, int, int, int]

_L: Dimension = (1, 0, 0, 0, 0)
_M: Dimension = (0, 1, 0, 0, 0)
_T: Dimension = (0, 0, 1, 0, 0)
_ANGLE: Dimension = (0, 0, 0, 1, 0)
_SOLID: Dimension = (0, 0, 0, 0, 1)
_NONE: Dimension = (0, 0, 0, 0, 0)
_POWER: Dimension = (2, 1, -3, 0, 0)
_ENERGY: Dimension = (2, 1, -2, 0, 0)
_PRESSURE: Dimension = (-1, 1, -2, 0, 0)

LENGTH, NUMBER, ANGLE = _L, _NONE, _ANGLE
INVERSE_LENGTH: Dimension = (-1, 0, 0, 0, 0)
MASS_DENSITY: Dimension = (-3, 1, 0, 0, 0)
RADIANCE: Dimension = (0, 1, -3, 0, -1)
PER_SOLID_ANGLE: Dimension = (0, 0, 0, 0, -1)
PRESSURE = _PRESSURE

_FOOT = 0.3048
# Factors to m, kg, s, rad, sr.
_SYMBOLS: dict[str, tuple[float, Dimension]] = {
    "m": (1.0, _L),
    "g": (1e-3, _M),
    "s": (1.0, _T),
    "W": (1.0, _POWER),
    "J": (1.0, _ENERGY),
    "Pa": (1.0, _PRESSURE),
    "rad": (1.0, _ANGLE),
    "sr": (1.0, _SOLID),
}
_PREFIXES = {"M": 1e6, "k": 1e3, "h": 1e2, "d": 1e-1, "c": 1e-2, "m": 1e-3, "u": 1e-6, "µ": 1e-6, "μ": 1e-6, "n": 1e-9}
_WORDS: dict[str, tuple[float, Dimension]] = {
    "metre": (1.0, _L),
    "gram": (1e-3, _M),
    "gramme": (1e-3, _M),
    "second": (1.0, _T),
    "watt": (1.0, _POWER),
    "joule": (1.0, _ENERGY),
    "pascal": (1.0, _PRESSURE),
    "radian": (1.0, _ANGLE),
    "steradian": (1.0, _SOLID),
}
_WORD_PREFIXES = {"kilo": 1e3, "hecto": 1e2, "deci": 0.1, "centi": 1e-2, "milli": 1e-3, "micro": 1e-6, "nano": 1e-9}
_OTHERS: dict[str, tuple[float, Dimension]] = {
    **dict.fromkeys(("micron", "mum", "micrometer"), (1e-6, _L)),
    **dict.fromkeys(("ft", "foot", "feet", "international_foot"), (_FOOT, _L)),
    **dict.fromkeys(("degree", "deg", "arc_degree", "arcdeg", "°"), (np.pi / 180, _ANGLE)),
    **dict.fromkeys(("mbar", "millibar", "mb"), (100.0, _PRESSURE)),
    "bar": (1e5, _PRESSURE),
    **dict.fromkeys(("cc", "cm3"), (1e-6, (3, 0, 0, 0, 0))),
    **dict.fromkeys(("%", "percent"), (1e-2, _NONE)),
    **dict.fromkeys(("l", "L", "liter", "litre"), (1e-3, (3, 0, 0, 0, 0))),
}
# What people write without a space between mass and the rest.
_RUN_TOGETHER = {"gm-3": "g m-3", "kgm-3": "kg m-3", "mgm-3": "mg m-3", "gkg-1": "g kg-1", "kgkg-1": "kg kg-1"}
_SUPERSCRIPTS = str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹−", "-0123456789-")
# Power, product, division, bracket, number, name.
_TOKEN = re.compile(
    r"\s*(?:(\*\*|\^)|([*.·×])|(/|\bper\b)|([()])|([+-]?\d+(?:\.\d+)?(?:[eE][+-]?\d+)?)|([^\W\d_]+|_|%|°))"
)
_LONGEST = 100


@dataclass(frozen=True)
class Unit:
    """A unit: its factor to m, kg, s, rad, sr, and its powers of them."""

    factor: float
    dimension: Dimension

    def __mul__(self, other: Unit) -> Unit:
        return Unit(self.factor * other.factor, tuple(map(sum, zip(self.dimension, other.dimension))))  # type: ignore[arg-type]

    def power(self, exponent: int) -> Unit:
        """This unit to an integer power."""
        return Unit(self.factor**exponent, tuple(exponent * part for part in self.dimension))  # type: ignore[arg-type]


def parse_unit(text: object) -> Unit | None:
    """The unit that a text names; None if it is not understood, or says nothing.

    Parameters
    ----------
    text : as an attribute `units` has it; anything but text is not understood
    """
    if not isinstance(text, str) or len(text) > _LONGEST:
        return None
    text = text.strip().strip("[]").translate(_SUPERSCRIPTS)
    text = _RUN_TOGETHER.get(text.replace("^", "").replace("**", ""), text)
    if not text:
        return None
    try:
        tokens = _tokens(text)
        unit, rest = _product(tokens)
    except (ValueError, KeyError, IndexError, OverflowError, ZeroDivisionError):
        return None
    return None if rest or not (0 < unit.factor < np.inf) else unit


def _tokens(text: str) -> list[str]:
    found, place = [], 0
    while place < len(text):
        match = _TOKEN.match(text, place)
        if match is None or match.end() == place:
            if text[place:].strip():
                raise ValueError(text)
            break
        power, times, per, bracket, number, name = match.groups()
        if name is not None:
            # Names go on over underscores: international_foot.
            end = match.end()
            longer = re.compile(r"[\w%°]*?(?=[-+]?\d|\W|$)").match(text, end)
            if longer is not None and name not in "%°":
                name += longer.group()
                end = longer.end()
            found.append(name)
            place = end
            continue
        found.append("^" if power else "*" if times else "/" if per else bracket or number)
        place = match.end()
    return found


def _product(tokens: list[str], closing: bool = False) -> tuple[Unit, list[str]]:
    """Factors one after the other; a slash divides by the next one alone, as in UDUNITS."""
    result, divide, expected = Unit(1.0, _NONE), False, True
    while tokens:
        token = tokens[0]
        if token == ")":
            if not closing or expected:
                raise ValueError(token)
            return result, tokens[1:]
        if token in ("*", "/"):
            if expected and not (token == "/" and result == Unit(1.0, _NONE) and not divide):
                raise ValueError(token)
            divide, expected, tokens = token == "/", True, tokens[1:]
            continue
        factor, tokens = _factor(tokens)
        result, divide, expected = result * factor.power(-1 if divide else 1), False, False
    if closing or expected:
        raise ValueError("ends too early")
    return result, tokens


def _factor(tokens: list[str]) -> tuple[Unit, list[str]]:
    token, tokens = tokens[0], tokens[1:]
    if token == "(":
        unit, tokens = _product(tokens, closing=True)
    elif _is_number(token):
        if token[0] in "+-":
            raise ValueError(token)
        unit = Unit(float(token), _NONE)
        if tokens and tokens[0] == "^":
            unit, tokens = Unit(float(token) ** int(tokens[1]), _NONE), tokens[2:]
        return unit, tokens
    else:
        unit = _named(token)
    if tokens and tokens[0] == "^":
        # Also in brackets: m^(-3).
        if tokens[1] == "(":
            if tokens[3] != ")":
                raise ValueError(token)
            return unit.power(_exponent(tokens[2])), tokens[4:]
        return unit.power(_exponent(tokens[1])), tokens[2:]
    if tokens and _is_number(tokens[0]):
        return unit.power(_exponent(tokens[0])), tokens[1:]
    return unit, tokens


def _exponent(text: str) -> int:
    exponent = int(text)
    if abs(exponent) > 9:
        raise ValueError(text)
    return exponent


def _is_number(token: str) -> bool:
    return token[0].isdigit() or (token[0] in "+-" and token[1:2].isdigit())


def _named(name: str) -> Unit:
    if name in _OTHERS:
        return Unit(*_OTHERS[name])
    if name in _SYMBOLS:
        return Unit(*_SYMBOLS[name])
    if len(name) > 1 and name[0] in _PREFIXES and name[1:] in _SYMBOLS:
        factor, dimension = _SYMBOLS[name[1:]]
        return Unit(_PREFIXES[name[0]] * factor, dimension)
    word = name.lower()
    if word == "kms" or (len(name) <= 2 and name not in ("KM", "Km")):
        raise ValueError(name)
    if word == "km":
        return Unit(1e3, _L)
    for singular in (word, word.removesuffix("s")):
        singular = singular.removesuffix("meter") + "metre" if singular.endswith("meter") else singular
        if singular in _OTHERS:
            return Unit(*_OTHERS[singular])
        for prefix, share in (("", 1.0), *_WORD_PREFIXES.items()):
            if singular.startswith(prefix) and singular[len(prefix) :] in _WORDS:
                factor, dimension = _WORDS[singular[len(prefix) :]]
                return Unit(share * factor, dimension)
    raise ValueError(name)
