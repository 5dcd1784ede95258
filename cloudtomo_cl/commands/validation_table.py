"""The table of `cloudtomo validate`: on the screen, as CSV and as Markdown."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from rich.console import Console
from rich.table import Table

if TYPE_CHECKING:
    from cloudtomo_cl.validation import Row

HEADINGS = ("case", "quantity", "source", "published", "ours", "standard error", "difference", "in s.e.", "photons", "")
_WIDE_TABLE = 180


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


def print_table(rows: Sequence[Row], notes: Sequence[str]) -> None:
    """On standard output."""
    console = Console(markup=False, emoji=False)
    if not console.is_terminal:
        # Lines for another program to read are not folded.
        console = Console(markup=False, emoji=False, width=_WIDE_TABLE)
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


# By the ending of the file's name.
WRITERS = {".csv": _csv, ".md": _markdown}
