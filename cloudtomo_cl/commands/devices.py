"""`cloudtomo devices`: what there is to compute on. Imports what is slow when it runs."""

from __future__ import annotations

import argparse

HELP = "list the OpenCL devices"

DESCRIPTION = "List the OpenCL devices."

EXAMPLES = """\
example:
  cloudtomo devices"""

_HEADINGS = ("index", "platform", "name", "type", "compute units", "memory", "OpenCL version", "accumulation")
_WIDE_TABLE = 160


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """None: the command has no options."""


def run() -> None:
    """Prints a table of the OpenCL devices."""
    from rich.console import Console
    from rich.table import Table

    from cloudtomo_cl.opencl.device import list_devices

    console = Console(markup=False, emoji=False)
    if not console.is_terminal:
        # Lines for another program to read are not folded.
        console = Console(markup=False, emoji=False, width=_WIDE_TABLE)
    table = Table(*_HEADINGS, box=None)
    for device in list_devices():
        table.add_row(
            str(device.index),
            device.platform,
            device.name,
            device.kind,
            str(device.compute_units),
            f"{device.memory / 2**30:.1f} GiB",
            # "OpenCL 3.0", without what the vendor adds.
            " ".join(device.version.split()[:2]),
            device.accumulation,
        )
    console.print(table)
