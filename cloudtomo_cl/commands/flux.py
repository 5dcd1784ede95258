"""`cloudtomo flux`: fluxes of a scene. Imports what is slow when it runs."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from cloudtomo_cl.commands import options, ranks

HELP = "compute fluxes and absorption"

DESCRIPTION = """\
Compute the fluxes of a scene by following photons from the sun.

Prints the domain's means; the output is netCDF with, for every column: reflected (upward through
the top), direct and diffuse (downward through the bottom), absorbed, and their standard errors."""

EXAMPLES = """\
example:
  cloudtomo flux scene.toml --photons 1e7 --seed 1 --output fluxes.nc
  cloudtomo flux fluxes.nc --output again.nc      # the same once more, from that file alone

scene.toml is that of `cloudtomo render`; views may be absent. Where there is a surface that
reflects, or air outside of the cloud's grid, sides must be periodic, and are without a table [boundary]."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of the command; they are the fields of `fluxes.Request`."""
    parser.add_argument("scene", type=Path, metavar="SCENE.toml", help="or fluxes.nc or images.nc, to take their scene")
    parser.add_argument(
        "--photons", type=options.photons(1, 1e13), help="from the sun, at least (default 1e6, or as fluxes.nc)"
    )
    parser.add_argument("--seed", type=options.seed, help="of the random numbers (default 0, or as fluxes.nc)")
    parser.add_argument("--output", type=Path, metavar="FILE", help="fluxes by column, netCDF")
    options.add_overrides(parser)
    options.add_device(parser)
    options.add_overwrite(parser)
    options.add_quiet(parser)


def run(**given: Any) -> None:
    """Computes the fluxes of a scene file, or of the scene of a file of fluxes or images, column by column."""
    ranks.on_devices(_run, given)


def _run(**given: Any) -> None:
    from cloudtomo_cl.commands import fluxes

    job = ranks.current().in_turn(lambda: fluxes.prepare(fluxes.Request(**given)))
    result = fluxes.execute(job)
    ranks.first_alone(lambda: fluxes.deliver(job, result))
