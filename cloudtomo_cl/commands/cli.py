"""The command line: what `cloudtomo` understands. The work is in commands.py."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from cloudtomo_cl.commands import cloud as cloud_command
from cloudtomo_cl.commands import init as init_command
from cloudtomo_cl.commands import mie as mie_command
from cloudtomo_cl.commands import validate as validate_command
from cloudtomo_cl.commands.stopping import ending_tidily
from cloudtomo_cl.errors import CloudtomoError, Interrupted

EXIT_ERROR = 2
EXIT_INTERRUPTED = 130

DESCRIPTION = """\
3-D cloud extinction from images taken from several directions.

Lengths are in km, extinction in km^-1, angles in degrees, radiance in W m^-2 sr^-1.
x runs east, y north, z up; the ground is z = 0."""

EPILOG = """\
a whole example:
  cloudtomo cloud --generate cumulus --output cloud.nc
  cloudtomo init render --cloud cloud.nc
  cloudtomo render scene.toml --output images.nc --png previews
  cloudtomo init reconstruct --truth cloud.nc
  cloudtomo reconstruct run.toml --seed 2 --output run --set run.time_limit=600
  cloudtomo report run

`cloudtomo COMMAND --help` explains a command and its files."""

RENDER = """\
Compute the images of a scene, with the standard error of every pixel.

The output is netCDF with radiance(view, row, column) and radiance_standard_error; it keeps the
views and the scene, so that it can be reconstructed without saying them again."""

RENDER_EXAMPLES = """\
example:
  cloudtomo render scene.toml --samples 256 --seed 1 --output images.nc --png previews
  cloudtomo render images.nc --output again.nc      # the same once more, from that file alone

scene.toml:
  [cloud]
  file = "cloud.nc"                 # relative to this file
  single_scattering_albedo = 1.0
  phase_function = { type = "henyey-greenstein", g = 0.85 }   # or "double-henyey-greenstein", or "table" with file
  [sun]
  zenith = 30.0                     # degrees
  azimuth = 200.0                   # degrees, from +x (east) towards +y (north)
  [[view]]                          # as many as there are images
  type = "perspective"
  position = [2.4, -1.0, 1.9]       # km
  target = [0.4, 0.4, 0.4]          # km
  field_of_view = 32.0              # degrees, across the image's width
  pixels = [48, 48]                 # width, height
  [[view]]
  type = "orthographic"
  zenith = 40.0                     # direction from the scene to the sensor
  azimuth = 90.0
  width = 1.6                       # km across the image
  pixels = [48, 48]
other types of view: "push-broom", "radiometer", "rays" (a file); "ring", "string", "scans" (several
views each). optional tables: [air], [surface] albedo, [boundary] horizontal = "open" or "periodic"."""

FLUX = """\
Compute the fluxes of a scene by following photons from the sun.

Prints the domain's means; the output is netCDF with, for every column: reflected (upward through
the top), direct and diffuse (downward through the bottom), absorbed, and their standard errors."""

FLUX_EXAMPLES = """\
example:
  cloudtomo flux scene.toml --photons 1e7 --seed 1 --output fluxes.nc
  cloudtomo flux fluxes.nc --output again.nc      # the same once more, from that file alone

scene.toml is that of `cloudtomo render`; views may be absent. Sides must be periodic if there is a
surface that reflects, or air outside of the cloud's grid."""

RECONSTRUCT = """\
Recover the extinction from images, coarse to fine.

The folder gets reconstruction.nc, history.csv (a line for each iteration, as it goes), settings.json, modelled.nc
(the images of the recovered cloud), figures/ and report.html.

checkpoint.npz is kept up to date: after Ctrl-C, SIGTERM, a failure or a power cut the same command with --resume
goes on, and ends with the same bits as a run that was never stopped."""

RECONSTRUCT_EXAMPLES = """\
example:
  cloudtomo reconstruct run.toml --seed 2 --output run
  cloudtomo reconstruct run.toml --seed 2 --output run --resume

run.toml:
  [measurements]
  file = "images.nc"                # all that is needed, if cloudtomo render made it
  [truth]                           # optional: tells the errors eps and delta, and nothing else
  file = "cloud.nc"
  [run]                             # optional
  time_limit = 600.0                # s, counted over all resumes
  checkpoint_interval = 60.0        # s
optional tables: [[stage]] (automatic otherwise), [prior], [solver], [grid]; and those of a
scene ([sun], [cloud], [air], [surface], [boundary], [[view]]), each in place of the one that
the images were made with."""

REPORT = """\
Make the figures of a run folder and its page report.html again: slices, maps, history, measured and
modelled images, and what else is known. A reconstruction does it by itself."""


def parser() -> argparse.ArgumentParser:
    """Commands and options."""
    top = argparse.ArgumentParser(
        prog="cloudtomo", description=DESCRIPTION, epilog=EPILOG, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    top.add_argument("--version", action=_Version)
    commands = top.add_subparsers(title="commands", metavar="COMMAND", dest="command", required=True)

    device = argparse.ArgumentParser(add_help=False)
    device.add_argument(
        "--device",
        metavar="NAME",
        help="index or part of a name in `cloudtomo devices` (default: CLOUDTOMO_DEVICE, or the first GPU, or a CPU)",
    )
    quiet = argparse.ArgumentParser(add_help=False)
    quiet.add_argument("--quiet", action="store_true", help="print errors only")
    overwrite = argparse.ArgumentParser(add_help=False)
    overwrite.add_argument("--overwrite", action="store_true", help="replace an output that exists")

    changes = argparse.ArgumentParser(add_help=False)
    changes.add_argument(
        "--set",
        action="append",
        default=[],
        dest="overrides",
        metavar="KEY=VALUE",
        help="in place of a key of the file, for instance sun.zenith=45 or 'view[0].pixels=[64, 64]'; repeatable",
    )

    def add(
        name: str, summary: str, description: str, examples: str, *parents: argparse.ArgumentParser
    ) -> argparse.ArgumentParser:
        return commands.add_parser(
            name,
            help=summary,
            description=description,
            epilog=examples,
            parents=parents,
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )

    add("devices", "list the OpenCL devices", "List the OpenCL devices.", "example:\n  cloudtomo devices")

    texts = (cloud_command.DESCRIPTION, cloud_command.EXAMPLES)
    cloud_command.add_arguments(add("cloud", "read, change or generate a cloud", *texts, quiet, overwrite), _seed)

    texts = (init_command.DESCRIPTION, init_command.EXAMPLES)
    init_command.add_arguments(add("init", "write a settings file to start from", *texts, quiet, overwrite))

    texts = (mie_command.DESCRIPTION, mie_command.EXAMPLES)
    mie_command.add_arguments(add("mie", "phase functions of droplets by Mie's theory", *texts, quiet, overwrite))

    render = add("render", "compute images of a scene", RENDER, RENDER_EXAMPLES, device, quiet, overwrite, changes)
    render.add_argument("scene", type=Path, metavar="SCENE.toml", help="or images.nc, to render it again")
    render.add_argument(
        "--samples", type=int, help="photons per pixel, even (default 256); with --target-error the most, on average"
    )
    render.add_argument(
        "--target-error",
        type=_share,
        metavar="SHARE",
        help="instead of a number of photons: render until the pixels' noise (root mean square, relative to the mean "
        "of the view) is so small in every view, for instance 1%%",
    )
    render.add_argument("--seed", type=_seed, help="of the random numbers (default 0)")
    render.add_argument("--output", type=Path, required=True, metavar="FILE", help="the images, netCDF")
    render.add_argument("--png", type=Path, metavar="DIR", help="also previews, one grey scale for all views")

    flux = add("flux", "compute fluxes and absorption", FLUX, FLUX_EXAMPLES, device, quiet, overwrite, changes)
    flux.add_argument("scene", type=Path, metavar="SCENE.toml", help="or fluxes.nc or images.nc, to take their scene")
    flux.add_argument("--photons", type=_photons, help="from the sun, at least (default 1e6, or as fluxes.nc)")
    flux.add_argument("--seed", type=_seed, help="of the random numbers (default 0, or as fluxes.nc)")
    flux.add_argument("--output", type=Path, metavar="FILE", help="fluxes by column, netCDF")

    reconstruct = add(
        "reconstruct",
        "recover a cloud from images",
        RECONSTRUCT,
        RECONSTRUCT_EXAMPLES,
        *(device, quiet, overwrite, changes),
    )
    reconstruct.add_argument("run", type=Path, metavar="RUN.toml", help="or a reconstruction.nc, to recover it again")
    reconstruct.add_argument("--seed", type=_seed, help="of the random numbers (default: [run] seed, or 0)")
    reconstruct.add_argument("--output", type=Path, required=True, metavar="DIR", help="the run folder")
    reconstruct.add_argument(
        "--resume", action="store_true", help="go on from the checkpoint in DIR (start, where there is none)"
    )

    reconstruct.add_argument(
        "--no-report",
        dest="with_report",
        action="store_false",
        help="leave figures and report.html to `cloudtomo report DIR`, for instance in a batch of many runs",
    )

    report = add("report", "make a run's figures again", REPORT, "example:\n  cloudtomo report run", quiet)
    report.add_argument("folder", type=Path, metavar="DIR", help="a run folder")

    texts = (validate_command.DESCRIPTION, validate_command.EXAMPLES)
    validate = add("validate", "compare with published numbers", *texts, device, quiet, overwrite)
    validate_command.add_arguments(validate, _seed)
    return top


class _Version(argparse.Action):
    """Looks the version up only when asked: importlib.metadata is slow to import."""

    def __init__(self, option_strings: Sequence[str], dest: str) -> None:
        nothing = argparse.SUPPRESS
        super().__init__(option_strings, nothing, default=nothing, nargs=0, help="print the version and exit")

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> None:
        from importlib.metadata import version

        print(f"cloudtomo {version('cloudtomo-cl')}")
        parser.exit()


def _seed(text: str) -> int:
    """A seed of the kernels: 32 bits, unsigned."""
    if not text.isdigit() or int(text) >= 2**32:
        raise argparse.ArgumentTypeError(f"{text!r} is no whole number from 0 to {2**32 - 1}")
    return int(text)


def _share(text: str) -> float:
    """A share, as 1% or 0.01."""
    try:
        value = float(text.rstrip("%")) / (100 if text.endswith("%") else 1)
    except ValueError:
        value = float("nan")
    if not 0 < value < 10:
        raise argparse.ArgumentTypeError(f"{text!r} is no share above 0, such as 1%% or 0.01")
    return value


def _photons(text: str) -> int:
    """A number of photons, also as 1e7."""
    try:
        value = float(text)
    except ValueError:
        value = float("nan")
    if not 1 <= value <= 1e13:
        raise argparse.ArgumentTypeError(f"{text!r} is no number of photons from 1 to 1e13")
    return round(value)


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs a command; returns the exit status."""
    options = vars(parser().parse_args(arguments))
    command = options.pop("command")
    try:
        # Only now: `cloudtomo --help` must not wait for OpenCL and netCDF.
        from cloudtomo_cl.commands import reconstruct as commands

        with ending_tidily():
            status = getattr(commands, command)(**options)
    except Interrupted as interrupted:
        print(f"cloudtomo {command}: {interrupted}", file=sys.stderr)
        return interrupted.status
    except CloudtomoError as error:
        print(f"cloudtomo {command}: {error}", file=sys.stderr)
        return EXIT_ERROR
    except MemoryError as error:
        print(f"cloudtomo {command}: not enough memory ({error}): choose fewer pixels or voxels", file=sys.stderr)
        return EXIT_ERROR
    except OSError as error:
        # A disk, a terminal or a network drive that fails between the places that look for it.
        print(f"cloudtomo {command}: {error}: check the disk, permissions and the space left", file=sys.stderr)
        return EXIT_ERROR
    except KeyboardInterrupt:
        print(f"cloudtomo {command}: interrupted", file=sys.stderr)
        return EXIT_INTERRUPTED
    return status or 0


if __name__ == "__main__":
    sys.exit(main())
