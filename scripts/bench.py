"""How fast this is, in ratios: one command prints the table.

    python scripts/bench.py                 # everything; some ten minutes on two free cores
    python scripts/bench.py --quick         # fewer repeats and paths: a few minutes
    python scripts/bench.py --rows forward-c overhead

Needs `pip install '.[bench]'`, for Mitsuba's rows an LLVM library (Debian's libllvm19), and for scene C
its file (CLOUDTOMO_DATA, or ../shared/data). Only ratios of what was measured in turn in one run are
printed: each is the median of the repeats, with the least and the most of them. CPU seconds are those of
all threads together. docs/measurements/speed.md holds the last full table.
"""

from __future__ import annotations

import argparse
import sys
import time
from functools import partial

from benchmarks import own, peers, photons
from benchmarks.timing import Line

ROWS = {
    "forward-c": partial(peers.forward, "c"),
    "forward-generated": partial(peers.forward, "generated"),
    "gradient-c": partial(peers.gradient, "c"),
    "gradient-generated": partial(peers.gradient, "generated"),
    "pmcxcl": photons.scattering_events,
    "gradient-over-forward": own.gradient_over_forward,
    "growth": own.growth,
    "cores": own.cores,
    "overhead": own.overhead,
    "start": own.start,
}


def text(line: Line) -> str:
    return f"| {line.row} | {line.what} | {line.number} | {line.spread} | {line.goal} | {line.note} |"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="fewer repeats and paths")
    parser.add_argument("--rows", nargs="+", choices=ROWS, metavar="ROW", default=list(ROWS), help=", ".join(ROWS))
    arguments = parser.parse_args()
    start = time.perf_counter()
    print(own.machine())
    print("\n| row | what | ratio | spread | goal | note |\n|---|---|---|---|---|---|", flush=True)
    for row in arguments.rows:
        for line in ROWS[row](arguments.quick):
            print(text(line), flush=True)
    print(f"\n{time.perf_counter() - start:.0f} s", file=sys.stderr)
    return 0


if __name__ == "__main__":
    sys.exit(main())
