"""`cloudtomo devices`: what there is to compute on. Imports what is slow when it runs."""

from __future__ import annotations

import argparse

HELP = "list the OpenCL devices"

DESCRIPTION = """\
List the OpenCL devices.

Under MPI those that every rank sees, with a * at the one that it takes."""

EXAMPLES = """\
examples:
  cloudtomo devices
  mpiexec -n 4 cloudtomo devices"""

_HEADINGS = ("index", "platform", "name", "type", "compute units", "memory", "OpenCL version", "accumulation")
_WIDE_TABLE = 160


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """None: the command has no options."""


def run() -> None:
    """Prints a table of the OpenCL devices."""
    from rich.console import Console
    from rich.table import Table

    from cloudtomo_cl.commands import ranks
    from cloudtomo_cl.opencl.devices import chosen_index, list_devices

    console = Console(markup=False, emoji=False)
    if not console.is_terminal:
        # Lines for another program to read are not folded.
        console = Console(markup=False, emoji=False, width=_WIDE_TABLE)
    own = ranks.current()
    listed = own.together(lambda: (own.name, chosen_index(communicator=own), list_devices()))
    table = Table(*_HEADINGS if own.size == 1 else ("rank", *_HEADINGS), box=None)
    for name, chosen, device in [(name, chosen, one) for name, chosen, all_ in own.all(listed) for one in all_]:
        row = [] if own.size == 1 else [name]
        table.add_row(
            *row,
            f"{device.index}{' *' if row and device.index == chosen else ''}",
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
