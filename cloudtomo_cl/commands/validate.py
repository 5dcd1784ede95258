"""`cloudtomo validate`: the table of `validation`, on the screen and in a file. Imports what is slow when it runs."""

from __future__ import annotations

import argparse
import csv
import io
import sys
import time
from collections.abc import Callable, Sequence
from datetime import date
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from cloudtomo_cl.errors import SettingsError

if TYPE_CHECKING:
    from cloudtomo_cl.validation import Row

EXIT_FAILED = 1

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

HEADINGS = ("case", "quantity", "source", "published", "ours", "standard error", "difference", "in s.e.", "photons", "")


def add_arguments(parser: argparse.ArgumentParser, seed: Callable[[str], int]) -> None:
    """The options of the command; they are the parameters of `validate`. `seed` reads one."""
    parser.add_argument("--data", type=Path, metavar="DIR", help="has i3rc in it (default: CLOUDTOMO_DATA, if set)")
    number = parser.add_mutually_exclusive_group()
    number.add_argument("--quick", action="store_true", help="few photons: a minute or two, and less strict")
    number.add_argument("--photons", type=_photons, metavar="N", help="for each radiance and flux run (default 1e6)")
    parser.add_argument("--only", metavar="WORD", help="only cases with this in their name")
    parser.add_argument("--seed", type=seed, default=0, help="of the random numbers (default 0)")
    parser.add_argument("--output", type=Path, metavar="FILE", help="the table, .csv or .md")


def _photons(text: str) -> int:
    try:
        number = float(text)
    except ValueError:
        number = 0.0
    if not 100 <= number <= 1e12:
        raise argparse.ArgumentTypeError(f"{text!r} is no number from 100 to 1e12")
    return int(number)


def validate(
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
    """Runs the command; returns the exit status."""
    from rich.console import Console

    from cloudtomo_cl import validation
    from cloudtomo_cl.commands.progress import duration
    from cloudtomo_cl.commands.provenance import describe_device, source
    from cloudtomo_cl.files import i3rc
    from cloudtomo_cl.files.netcdf import check_output
    from cloudtomo_cl.files.whole import written_whole
    from cloudtomo_cl.opencl.device import choose_device

    if output is not None:
        if output.suffix not in _WRITERS:
            raise SettingsError(f"--output {output}: the name must end in {' or '.join(_WRITERS)}")
        check_output(output, overwrite)
    files = i3rc.folder(data)
    cases = [case for case in validation.cases(files) if only is None or only.lower() in case.name.lower()]
    if not cases:
        raise SettingsError(f"--only {only}: no case has this in its name; without --only the table lists them")
    number = photons or (validation.QUICK_PHOTONS if quick else validation.PHOTONS)
    chosen = choose_device(device)
    console = Console(quiet=quiet)
    rows: list[Row] = []
    start = time.perf_counter()
    for case in cases:
        began = time.perf_counter()
        rows += validation.run(case, chosen, number, seed, files)
        took = duration(time.perf_counter() - began)
        console.print(f"{len(rows):>3} lines, {case.name}: {took}", highlight=False, soft_wrap=True)
    failed = [row for row in rows if not row.passed]
    described = describe_device(chosen)
    took = duration(time.perf_counter() - start)
    notes = [
        f"{source()}, {date.today().isoformat()}, seed {seed}, {number:.3g} photons, {took}",
        f"device {described['name']}, {described['platform']}, {chosen.opencl.version.strip()}",
        f"{len(rows) - len(failed)} of {len(rows)} lines passed",
    ]
    if files is None:
        notes.append("not compared: I3RC's columns and Landsat cloud, which need --data")
    if output is not None:
        with written_whole(output) as partial:
            partial.write_text(_WRITERS[output.suffix](rows, notes), encoding="utf-8")
    if not quiet:
        _print(rows, notes)
    for row in failed:
        print(f"cloudtomo validate: failed: {', '.join(cells(row))}", file=sys.stderr)
    return EXIT_FAILED if failed else 0


def cells(row: Row) -> tuple[str, ...]:
    """A line of the table as text, as in HEADINGS."""
    in_standard_errors = row.standard_errors
    numbers = ("", "r.m.s.", f"{row.standard_error:.2%}") if row.columns else _means(row)
    return (
        row.experiment,
        row.quantity,
        row.source,
        *numbers,
        f"{row.difference:.2%}" if row.columns else _difference(row),
        "" if row.columns or np.isnan(in_standard_errors) else f"{in_standard_errors:+.1f}",
        f"{row.photons:.2g}",
        "pass" if row.passed else "FAIL",
    )


def _means(row: Row) -> tuple[str, str, str]:
    # As many digits as were published, or where radiances are tiny as many as tell something.
    form = ".5f" if abs(row.published) >= 1e-3 or row.published == 0 else ".5g"
    return f"{row.published:{form}}", f"{row.value:{form}}", f"{row.standard_error:.1e}"


def _difference(row: Row) -> str:
    return f"{row.difference:+.2%}" if row.published else f"{row.difference:+.1e}"


def _print(rows: Sequence[Row], notes: Sequence[str]) -> None:
    from rich.console import Console
    from rich.table import Table

    console = Console()
    if not console.is_terminal:
        # Lines for another program to read are not folded.
        console = Console(width=180)
    table = Table(box=None)
    for heading in HEADINGS:
        right = heading in HEADINGS[3:9]
        table.add_column(heading, justify="right" if right else "left", no_wrap=right)
    for row in rows:
        table.add_row(*cells(row), style=None if row.passed else "bold red")
    console.print(table)
    for note in notes:
        console.print(note, highlight=False, soft_wrap=True)


def _csv(rows: Sequence[Row], notes: Sequence[str]) -> str:
    """Numbers in full; differences as fractions."""
    text = io.StringIO()
    for note in notes:
        text.write(f"# {note}\n")
    writer = csv.writer(text, lineterminator="\n")
    names = "case quantity source published published_error value standard_error difference standard_errors photons"
    writer.writerow([*names.split(), "passed"])
    for row in rows:
        numbers = (row.published, row.published_error, row.value, row.standard_error, row.difference)
        published, *others = [f"{number:.7g}" for number in numbers]
        sigmas = "" if row.columns or np.isnan(row.standard_errors) else f"{row.standard_errors:.3g}"
        line = [row.experiment, row.quantity, row.source, "" if row.columns else published, *others, sigmas]
        writer.writerow([*line, row.photons, row.passed])
    return text.getvalue()


def _markdown(rows: Sequence[Row], notes: Sequence[str]) -> str:
    rules = ["---:" if heading in HEADINGS[3:9] else "---" for heading in HEADINGS]
    lines = [HEADINGS, tuple(rules), *(cells(row) for row in rows)]
    return "\n".join(["| " + " | ".join(line) + " |" for line in lines] + ["", *(f"{note}.  " for note in notes), ""])


_WRITERS = {".csv": _csv, ".md": _markdown}

