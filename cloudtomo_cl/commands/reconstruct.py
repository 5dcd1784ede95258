"""`cloudtomo reconstruct`: the extinction that images tell. Imports what is slow when it runs."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from cloudtomo_cl.commands import options, ranks

HELP = "recover a cloud from images"

DESCRIPTION = """\
Recover the extinction from images, coarse to fine.

The folder gets reconstruction.nc, history.csv (a line for each iteration, as it goes), settings.json, modelled.nc
(the images of the recovered cloud), figures/ and report.html.

checkpoint.npz is kept up to date: after Ctrl-C, SIGTERM, a failure or a power cut the same command with --resume
goes on, and ends with the same bits as a run that was never stopped."""

EXAMPLES = """\
example:
  cloudtomo reconstruct run.toml --seed 2 --output run
  cloudtomo reconstruct run.toml --seed 2 --output run --resume

run.toml:
  [measurements]
  file = "images.nc"                # all that is needed, if cloudtomo render made it
  wavelength = 2130.0               # nm; only where the file holds several
  [truth]                           # optional: tells the errors eps and delta, and nothing else
  file = "cloud.nc"
  [run]                             # optional
  time_limit = 600.0                # s, counted over all resumes
  checkpoint_interval = 60.0        # s
optional tables: [[stage]] (automatic otherwise), [prior], [solver], [grid]; and those of a
scene ([sun], [cloud], [air], [surface], [boundary], [[view]]), each in place of the one that
the images were made with."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of the command; they are the fields of `reconstruction.Request`."""
    parser.add_argument("run", type=Path, metavar="RUN.toml", help="or a reconstruction.nc, to recover it again")
    parser.add_argument("--seed", type=options.seed, help="of the random numbers (default: [run] seed, or 0)")
    parser.add_argument("--output", type=options.folder, required=True, metavar="DIR", help="the run folder")
    parser.add_argument(
        "--resume", action="store_true", help="go on from the checkpoint in DIR (start, where there is none)"
    )
    parser.add_argument(
        "--no-report",
        dest="with_report",
        action="store_false",
        help="leave figures and report.html to `cloudtomo report DIR`, for instance in a batch of many runs",
    )
    options.add_overrides(parser)
    options.add_device(parser)
    options.add_overwrite(parser)
    options.add_quiet(parser)


def run(**given: Any) -> None:
    """Reconstructs after a run file into a run folder."""
    ranks.on_devices(_run, given)


def _run(**given: Any) -> None:
    from cloudtomo_cl.commands import reconstruction
    from cloudtomo_cl.files.netcdf import require_file

    request = reconstruction.Request(**given)
    require_file(request.run)
    with ranks.held_by_first(request.folder.held):
        job = ranks.current().in_turn(lambda: reconstruction.prepare(request))
        reconstruction.deliver(job, reconstruction.execute(job))
