"""Options that several commands have, and what their values may be. Imports nothing slow: the help waits for it."""

from __future__ import annotations

import argparse
from collections.abc import Callable

_SEEDS = 2**32


def add_device(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--device",
        metavar="NAME",
        help="index or part of a name in `cloudtomo devices` (default: CLOUDTOMO_DEVICE, or the first GPU, or a CPU)",
    )


def add_quiet(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--quiet", action="store_true", help="print errors only")


def add_overwrite(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--overwrite", action="store_true", help="replace an output that exists")


def add_overrides(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        dest="overrides",
        metavar="KEY=VALUE",
        help="in place of a key of the file, for instance sun.zenith=45 or 'view[0].pixels=[64, 64]'; repeatable",
    )


def seed(text: str) -> int:
    """A seed of the kernels: 32 bits, unsigned."""
    if not text.isdigit() or int(text) >= _SEEDS:
        raise argparse.ArgumentTypeError(f"{text!r} is no whole number from 0 to {_SEEDS - 1}")
    return int(text)


def share(text: str) -> float:
    """A share, as 1% or 0.01."""
    try:
        value = float(text.rstrip("%")) / (100 if text.endswith("%") else 1)
    except ValueError:
        value = float("nan")
    if not 0 < value < 10:
        raise argparse.ArgumentTypeError(f"{text!r} is no share above 0, such as 1%% or 0.01")
    return value


def photons(least: float, most: float) -> Callable[[str], int]:
    """A reader of numbers of photons between two bounds, also as 1e7."""

    def number(text: str) -> int:
        try:
            value = float(text)
        except ValueError:
            value = float("nan")
        if not least <= value <= most:
            raise argparse.ArgumentTypeError(f"{text!r} is no number of photons from {least:g} to {most:g}")
        return round(value)

    return number
