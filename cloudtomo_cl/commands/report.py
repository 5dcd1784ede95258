"""`cloudtomo report`: figures and page of a run folder. Imports what is slow when it runs."""

from __future__ import annotations

import argparse
from pathlib import Path

from cloudtomo_cl.commands import options

HELP = "make a run's figures again"

DESCRIPTION = """\
Make the figures of a run folder and its page report.html again: slices, maps, history, measured and
modelled images, and what else is known. A reconstruction does it by itself. What was not made of the result that is
there (of an earlier iteration, another truth) is made again, or left out with a sentence."""

EXAMPLES = """\
examples:
  cloudtomo report run
  cloudtomo report run --vti run.vti"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of the command."""
    parser.add_argument("folder", type=options.folder, metavar="DIR", help="a run folder")
    options.add_vti(parser)
    options.add_device(parser)
    options.add_overwrite(parser)
    options.add_quiet(parser)


def run(folder: Path, vti: Path | None, device: str | None, overwrite: bool, quiet: bool) -> None:
    """Makes figures/*.png, figures/*.pdf and report.html, and modelled.nc if it is not of the result.

    overwrite : whether a file `vti` is replaced; the run's own files are always made again
    """
    from cloudtomo_cl.commands.reporting import export_vti, make_report, renew_modelled
    from cloudtomo_cl.commands.run_folder import RunFolder

    of_run = RunFolder(folder)
    options.check_outputs(overwrite, output=None, vti=vti, inputs=of_run.files.outputs)
    of_run.check_finished()
    with of_run.held():
        renew_modelled(of_run, device, quiet)
        make_report(of_run, quiet)
        if vti is not None:
            export_vti(of_run, vti, quiet)
