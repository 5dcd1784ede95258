"""`cloudtomo validate`: the table of `validation`, on the screen and in a file. Imports what is slow when it runs."""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cloudtomo_cl.commands import options, ranks
from cloudtomo_cl.errors import SettingsError

if TYPE_CHECKING:
    from cloudtomo_cl.opencl.device import Device
    from cloudtomo_cl.validation import Row

EXIT_FAILED = 1

HELP = "compare with published numbers"

DESCRIPTION = """\
Compare the forward model with numbers that others published, and with exact results.

The table has the published value, ours, its standard error, and the difference, relative and in standard errors.
A mean passes within 0.3 % or 3 standard errors, whichever is larger. Radiances are pi L / (mu0 F0), fluxes are over
the incident one. The exit status is 1 if a line fails.

I3RC's files are not part of this program: with DIR/i3rc, which holds them as they were distributed (case 1 and 3:
consensus results, scene43.tau.128x128, scene43.dz.128x128), columns are compared too, and the Landsat cloud."""

EXAMPLES = """\
examples:
  cloudtomo validate --quick
  cloudtomo validate --data data --photons 4e6 --output table.md"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of the command; they are the parameters of `run`."""
    parser.add_argument("--data", type=Path, metavar="DIR", help="has i3rc in it (default: CLOUDTOMO_DATA, if set)")
    number = parser.add_mutually_exclusive_group()
    number.add_argument("--quick", action="store_true", help="few photons: a minute or two, and less strict")
    number.add_argument(
        "--photons",
        type=options.photons(100, 1e12),
        metavar="N",
        help="for each radiance and flux run (default 1e6)",
    )
    parser.add_argument("--only", metavar="WORD", help="only cases with this in their name")
    parser.add_argument("--seed", type=options.seed, default=0, help="of the random numbers (default 0)")
    parser.add_argument("--output", type=Path, metavar="FILE", help="the table, .csv or .md")
    options.add_device(parser)
    options.add_overwrite(parser)
    options.add_quiet(parser)


def run(**given: Any) -> int:
    """Compares; returns the exit status."""
    return ranks.on_devices(_run, given)


def _run(
    data: Path | None,
    quick: bool,
    photons: int | None,
    only: str | None,
    seed: int,
    output: Path | None,
    device: str | None,
    quiet: bool,
    overwrite: bool,
) -> int:
    from rich.console import Console

    from cloudtomo_cl import validation
    from cloudtomo_cl.commands.progress import duration
    from cloudtomo_cl.commands.validation_table import WRITERS, cells, print_table
    from cloudtomo_cl.files import i3rc
    from cloudtomo_cl.files.netcdf import check_output
    from cloudtomo_cl.files.whole import written_whole
    from cloudtomo_cl.opencl.devices import choose_device

    if output is not None:
        check_output(output, overwrite, tuple(WRITERS))
    files = i3rc.folder(data)
    cases = [case for case in validation.cases(files) if only is None or only.lower() in case.name.lower()]
    if not cases:
        raise SettingsError(f"--only {only}: no case has this in its name; without --only the table lists them")
    number = photons or (validation.QUICK_PHOTONS if quick else validation.PHOTONS)
    chosen = choose_device(device, ranks.current())
    console = Console(markup=False, emoji=False, quiet=quiet)
    rows: list[Row] = []
    start = time.perf_counter()
    for case in cases:
        ranks.check_together()
        began = time.perf_counter()
        rows += validation.run(case, chosen, number, seed, files)
        took = duration(time.perf_counter() - began)
        console.print(f"{len(rows):>3} lines, {case.name}: {took}", highlight=False, soft_wrap=True)
    failed = [row for row in rows if not row.passed]
    notes = [
        f"{_made_today()}, seed {seed}, {number:.3g} photons, {duration(time.perf_counter() - start)}",
        _described(chosen),
        f"{len(rows) - len(failed)} of {len(rows)} lines passed",
    ]
    if files is None:
        notes.append("not compared: I3RC's columns and Landsat cloud, which need --data")
    if output is not None and ranks.current().is_first:
        with written_whole(output) as partial:
            partial.write_text(WRITERS[output.suffix](rows, notes), encoding="utf-8")
    if not quiet:
        print_table(rows, notes)
    for row in failed if ranks.current().is_first else ():
        print(f"cloudtomo validate: failed: {', '.join(cells(row))}", file=sys.stderr)
    return EXIT_FAILED if failed else 0


def _made_today() -> str:
    from datetime import date

    from cloudtomo_cl.commands.provenance import source

    return f"{source()}, {date.today().isoformat()}"


def _described(device: Device) -> str:
    from cloudtomo_cl.commands.provenance import describe_device

    described = describe_device(device)
    return f"device {described['name']}, {described['platform']}, {device.opencl.version.strip()}"
