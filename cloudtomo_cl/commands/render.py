"""`cloudtomo render`: images of a scene. Imports what is slow when it runs."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from cloudtomo_cl.commands import options, ranks

HELP = "compute images of a scene"

DESCRIPTION = """\
Compute the images of a scene, with the standard error of every pixel.

The output is netCDF with radiance(view, row, column) and radiance_standard_error; it keeps the
views and the scene, so that it can be reconstructed without saying them again."""

EXAMPLES = """\
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
views each). optional tables: [spectrum] wavelengths (nm; all of them go into one file), [air],
[surface] albedo, [boundary] horizontal = "open" or "periodic"."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of the command; they are the fields of `rendering.Request`."""
    parser.add_argument("scene", type=Path, metavar="SCENE.toml", help="or images.nc, to render it again")
    parser.add_argument(
        "--samples",
        type=options.samples,
        help="paths per pixel, even (default 256); with --target-error the most, on average",
    )
    parser.add_argument(
        "--target-error",
        type=options.share,
        metavar="SHARE",
        help="instead of a number of paths: render until the pixels' noise (root mean square, relative to the mean "
        "of the view) is so small in every view, for instance 1%%",
    )
    parser.add_argument("--seed", type=options.seed, help="of the random numbers (default 0)")
    parser.add_argument("--output", type=Path, required=True, metavar="FILE", help="the images, netCDF")
    parser.add_argument("--png", type=options.folder, metavar="DIR", help="also previews, one grey scale for all views")
    parser.add_argument(
        "--blind", action="store_true", help="keep nothing of the cloud in the file: for blind tests of recoveries"
    )
    options.add_overrides(parser)
    options.add_device(parser)
    options.add_overwrite(parser)
    options.add_quiet(parser)


def run(**given: Any) -> None:
    """Renders a scene file, or images again, into a file of measurements."""
    ranks.on_devices(_run, given)


def _run(**given: Any) -> None:
    from cloudtomo_cl.commands import rendering

    job = ranks.current().in_turn(lambda: rendering.prepare(rendering.Request(**given)))
    result = rendering.execute(job)
    ranks.first_alone(lambda: rendering.deliver(job, result))
