"""`cloudtomo report`: figures and page of a run folder. Imports what is slow when it runs."""

from __future__ import annotations

import argparse
from pathlib import Path

from cloudtomo_cl.commands import options

HELP = "make a run's figures again"

DESCRIPTION = """\
Make the figures of a run folder and its page report.html again: slices, maps, history, measured and
modelled images, and what else is known. A reconstruction does it by itself."""

EXAMPLES = """\
example:
  cloudtomo report run"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of the command."""
    parser.add_argument("folder", type=Path, metavar="DIR", help="a run folder")
    options.add_quiet(parser)


def run(folder: Path, quiet: bool) -> None:
    """Makes figures/*.png, figures/*.pdf and report.html."""
    from cloudtomo_cl.commands.reporting import make_report

    make_report(folder, quiet)
