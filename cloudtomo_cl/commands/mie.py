"""`cloudtomo mie`: tables of droplets' phase functions. Imports what is slow when it runs."""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from cloudtomo_cl.commands import options, stopping
from cloudtomo_cl.errors import SettingsError

if TYPE_CHECKING:
    from cloudtomo_cl.scene.droplets import DropletTable

HELP = "phase functions of droplets by Mie's theory"

DESCRIPTION = """\
Compute phase functions and other optics of cloud droplets by Mie's theory.

The droplets are spheres of water (or of --refractive-index) whose sizes follow a gamma distribution with the given
effective radius and variance. The output is netCDF with phase_function(effective_radius, angle) in sr^-1,
single_scattering_albedo, extinction_efficiency and mass_extinction (m^2 g^-1); of several wavelengths each of them has
a first dimension wavelength. It needs the package miepython: pip install 'miepython >= 3.0.2'."""

EXAMPLES = """\
examples:
  cloudtomo mie --wavelength 672 --effective-radius 10 --output mie.nc
  cloudtomo mie --wavelength 672 --effective-radius 5 25 --count 11 --output mie.nc --png mie.png
  cloudtomo mie --wavelength 672 2130 --effective-radius 5 25 --count 21 --output mie.nc     # [spectrum] of a scene

and in a scene:
  [cloud]
  phase_function = { type = "table", file = "mie.nc" }"""

_LARGEST_COUNT = 200


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of the command; they are the parameters of `run`."""
    parser.add_argument(
        "--wavelength", type=float, nargs="+", required=True, metavar="NM", help="nm; several, increasing, in one file"
    )
    parser.add_argument(
        "--effective-radius", type=float, nargs="+", required=True, metavar="UM", help="of the droplets, um, increasing"
    )
    parser.add_argument("--count", type=int, metavar="N", help="so many radii, evenly from the first to the last")
    parser.add_argument(
        "--effective-variance", type=float, default=0.1, metavar="V", help="of the size distribution (default 0.1)"
    )
    parser.add_argument(
        "--refractive-index",
        type=float,
        nargs=2,
        metavar=("N", "K"),
        help="real and imaginary part, of one wavelength (default: water at 25 degrees C, Hale and Querry 1973)",
    )
    parser.add_argument("--output", type=Path, required=True, metavar="FILE", help="the table, netCDF")
    parser.add_argument("--png", type=Path, metavar="FILE", help="a picture of it (.png, .pdf, .svg)")
    options.add_overwrite(parser)
    options.add_quiet(parser)


def run(
    wavelength: list[float],
    effective_radius: list[float],
    count: int | None,
    effective_variance: float,
    refractive_index: list[float] | None,
    output: Path,
    png: Path | None,
    quiet: bool,
    overwrite: bool,
) -> None:
    """Makes a table of droplets' optics."""
    from rich.console import Console

    from cloudtomo_cl.clouds.mie import droplet_tables
    from cloudtomo_cl.commands import progress
    from cloudtomo_cl.commands.provenance import source, versions
    from cloudtomo_cl.files.phase import write_phase_function

    options.check_outputs(overwrite, output=output, png=png)
    radii = _radii(effective_radius, count)
    if refractive_index is not None and len(wavelength) > 1:
        raise SettingsError(f"--refractive-index is of one wavelength, and there are {len(wavelength)}: leave it out")
    index = None if refractive_index is None else [complex(refractive_index[0], -refractive_index[1])]
    console = Console(markup=False, emoji=False, quiet=quiet)
    with progress.counting(console, "droplet sizes") as show:
        tables = droplet_tables(wavelength, radii, effective_variance, index, show)
    indices = [[table.refractive_index_real, table.refractive_index_imag] for table in tables]
    settings = {
        "wavelength": wavelength[0] if len(tables) == 1 else wavelength,
        "effective_radius": radii,
        "effective_variance": effective_variance,
        "refractive_index": indices[0] if len(tables) == 1 else indices,
    }
    write_phase_function(output, tables, {"source": source(), "versions": versions(), "settings": settings})
    lines = [line for table in tables for line in _lines(table, len(tables) > 1)]
    for line in (*lines, str(output)):
        console.print(line, highlight=False, soft_wrap=True)
    if png is not None:
        stopping.check()
        _plot(png, tables)


def _radii(given: list[float], count: int | None) -> list[float]:
    """Those that were given, or as many as were asked for from the first to the last."""
    import numpy as np

    if count is None:
        return list(given)
    if len(given) != 2 or not 2 <= count <= _LARGEST_COUNT:
        raise SettingsError(
            f"--count {count} with {len(given)} radii: it needs the first and the last --effective-radius, "
            f"and must lie between 2 and {_LARGEST_COUNT}"
        )
    # Without the noise of divisions: 5.8, not 5.800000000000001.
    return [float(f"{radius:.6g}") for radius in np.linspace(given[0], given[1], count)]


def _lines(table: DropletTable, with_wavelength: bool) -> Iterator[str]:
    """What is printed of a table."""
    if with_wavelength:
        yield f"{table.wavelength_nm:g} nm"
    function = table.phase_function
    index = f"{table.refractive_index_real:.5g} - {table.refractive_index_imag:.3g} i"
    yield f"refractive index {index}, {len(function.angle)} angles"
    albedos = function.single_scattering_albedo or ()
    for row in zip(
        function.effective_radius, function.asymmetry(), albedos, table.extinction_efficiency, table.mass_extinction
    ):
        yield (
            "radius {:g} um: asymmetry {:.4f}, single-scattering albedo {:.6f}, extinction efficiency {:.4f}, "
            "mass extinction {:.4g} m^2 g^-1".format(*row)
        )


def _plot(png: Path, tables: Sequence[DropletTable]) -> None:
    from cloudtomo_cl.report.plots import new_figure, plot_phase_function, save_figure

    figure = new_figure(7, 4.5 * len(tables))
    panels = figure.subplots(len(tables), squeeze=False)[:, 0]
    for panel, table in zip(panels, tables):
        plot_phase_function(panel, table.phase_function)
        if len(tables) > 1:
            panel.set_title(f"{table.wavelength_nm:g} nm")
    save_figure(png, figure)
