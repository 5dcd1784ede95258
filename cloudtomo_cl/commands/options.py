"""Options that several commands have, and what their values may be. Imports nothing slow: the help waits for it."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from pathlib import Path


def add_device(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--device",
        metavar="NAME",
        help="index or part of a name in `cloudtomo devices` (default: CLOUDTOMO_DEVICE, or the first GPU, or a CPU); "
        "several, as 0,1, share the work",
    )


def add_quiet(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--quiet", action="store_true", help="print errors only")


def add_vti(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--vti", type=Path, metavar="FILE", help="a file for ParaView and its like (.vti)")


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


def check_outputs(
    overwrite: bool,
    output: Path | None,
    png: Path | None = None,
    vti: Path | None = None,
    inputs: Sequence[Path | None] = (),
) -> None:
    """Checks where a netCDF file, a picture and a .vti file shall go, before the work. DataError as `check_output`.

    inputs : files that are read, of which none may be written; None: no file
    """
    from cloudtomo_cl.files.netcdf import ENDINGS, check_output
    from cloudtomo_cl.files.vti import ENDINGS as VTI
    from cloudtomo_cl.report.plots import PICTURES

    read = [file for file in inputs if file is not None]
    if output is not None:
        check_output(output, overwrite, ENDINGS, inputs=read)
    if png is not None:
        check_output(png, overwrite, PICTURES, "--png", read)
    if vti is not None:
        check_output(vti, overwrite, VTI, "--vti", read)


def folder(text: str) -> Path:
    """A folder. An empty name would be the one that the program was started in, which would then be written to."""
    if not text:
        raise argparse.ArgumentTypeError("is empty: name a folder (is a variable of the shell unset?)")
    return Path(text)


def seed(text: str) -> int:
    """A seed of the kernels: 32 bits, unsigned."""
    from cloudtomo_cl.scene.seeds import SEEDS

    if not text.isdigit() or int(text) >= SEEDS:
        raise argparse.ArgumentTypeError(f"{text!r} is no whole number from 0 to {SEEDS - 1}")
    return int(text)


def share(text: str) -> float:
    """A share, as 1% or 0.01."""
    try:
        value = float(text.removesuffix("%")) / (100 if text.endswith("%") else 1)
    except ValueError:
        value = float("nan")
    if not 0 < value < 1:
        hint = f" ({text} would be {value:.0%}; {text} per cent are {text}%)" if 1 <= value < 100 else ""
        raise argparse.ArgumentTypeError(f"{text!r} is no share between 0 and 1, such as 1% or 0.01{hint}")
    return value


def samples(text: str) -> int:
    """A number of paths per pixel: even, so that halves may be compared."""
    if not text.isdigit() or int(text) < 2 or int(text) % 2:
        raise argparse.ArgumentTypeError(f"{text!r} is no even number of paths per pixel from 2 on")
    return int(text)


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
