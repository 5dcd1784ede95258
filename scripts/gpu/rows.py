"""Lines of the table of scripts/gpu_check.py, as the parts print them and the command reads them."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import asdict, dataclass

# Begins the lines of a part's output that are rows; whatever else it prints is a driver's.
_MARK = "@row "


@dataclass(frozen=True)
class Row:
    """A line of the table.

    Attributes
    ----------
    part : of the check
    what : the number is
    value : a number, or words
    unit : of the number
    note : how it came about
    holds : whether it is as it should be; None where nothing is demanded
    """

    part: str
    what: str
    value: float | str
    unit: str = ""
    note: str = ""
    holds: bool | None = None

    @property
    def text(self) -> str:
        """The value as it is printed."""
        return self.value if isinstance(self.value, str) else f"{self.value:.4g}"

    @property
    def markdown(self) -> str:
        """As a line of a table."""
        verdict = {True: "yes", False: "NO", None: ""}[self.holds]
        cells = (self.part, self.what, self.text, self.unit, verdict, self.note)
        return f"| {' | '.join(cell.replace('|', '/') for cell in cells)} |"

    def print(self) -> None:
        """For the command to read."""
        print(_MARK + json.dumps(asdict(self)), flush=True)


HEAD = "| part | what | value | unit | holds | note |\n|---|---|---|---|---|---|"


def failed(part: str, reason: str) -> Row:
    """What says that a part, or a piece of it, has come to nothing."""
    return Row(part, "failed", "-", note=" ".join(reason.split())[:300], holds=False)


def read(line: str) -> Iterator[Row]:
    """The row that a line of a part's output is, or nothing."""
    if line.startswith(_MARK):
        yield Row(**json.loads(line.removeprefix(_MARK)))
