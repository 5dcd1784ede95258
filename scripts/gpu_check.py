"""All that is to be known of a GPU, by one command: what it computes, whether it is right, and how fast it is.

    python scripts/gpu_check.py                       # the first GPU, or what CLOUDTOMO_DEVICE names; 5 to 10 minutes
    python scripts/gpu_check.py --device pthread --quick   # the rehearsal on a CPU
    python scripts/gpu_check.py --parts bits audits   # some of it
    python scripts/gpu_check.py --store               # on a CPU: writes the bits that a GPU's are compared with

Prints a table, and writes it as JSON. Every part runs in a process of its own, for so long as it may (gpu/parts.py);
one that fails, crashes or hangs is a row that says so. Mitsuba is compared with if it is installed. Scene C's file is
looked for in CLOUDTOMO_DATA, or ../shared/data; without it there are generated clouds only. NVIDIA's OpenCL is found
even if it is not registered. docs/measurements/gpu.md says what came out so far.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from dataclasses import asdict
from pathlib import Path

from gpu import rows as table
from gpu.parts import PARTS, rows
from gpu.registration import environment
from gpu.rows import Row

# Prints the index of the device that is chosen and that of a CPU beside it, -1 if there is none, or it is that one.
_CHOICE = """
import cloudtomo_cl as ct
from cloudtomo_cl.opencl.devices import choose_device
devices, chosen = ct.list_devices(), choose_device({name!r})
own = next(one.index for one in devices if one.name == chosen.name)
cpus = [one.index for one in devices if "CPU" in one.kind and one.index != own]
print(own, cpus[0] if cpus and "CPU" not in devices[own].kind else -1)
"""


def chosen_devices(name: str | None, variables: dict[str, str]) -> tuple[int, int]:
    """Indices of the device, and of a CPU to compare with (-1: none). RuntimeError if there is no device."""
    path = os.pathsep.join(filter(None, [str(Path(__file__).parents[1]), os.environ.get("PYTHONPATH", "")]))
    process = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", _CHOICE.format(name=name)], capture_output=True, text=True, timeout=120,
        env={**os.environ, **variables, "PYTHONPATH": path},
    )  # fmt: skip
    if process.returncode:
        raise RuntimeError(process.stderr.strip().splitlines()[-1])
    own, cpu = map(int, process.stdout.split()[-2:])
    return own, cpu


def beside_the_cpu(found: list[Row]) -> list[Row]:
    """How many times as fast as the CPU beside it the device is."""
    cpu = {row.what: row.value for row in found if row.part == "speed of the CPU"}
    return [
        Row("speed", f"{row.what}: times the CPU's", row.value / cpu[row.what])
        for row in found
        if row.part == "speed" and row.unit == "paths/s" and isinstance(row.value, float)
        and isinstance(cpu.get(row.what), float)
    ]  # fmt: skip


def checked(arguments: argparse.Namespace, variables: dict[str, str]) -> list[Row]:
    """All rows; printed as they come."""
    own, cpu = chosen_devices(arguments.device, variables)
    print(table.HEAD, flush=True)
    found: list[Row] = []

    def take(row: Row) -> None:
        found.append(row)
        print(row.markdown, flush=True)

    for name in arguments.parts:
        index = cpu if PARTS[name].on_cpu else own
        if index < 0:
            take(Row(name, "left out", "-", note="no CPU beside the device, or it is one"))
            continue
        for row in rows(name, PARTS[name], arguments.quick, {**variables, "CLOUDTOMO_DEVICE": str(index)}):
            # One module measures both devices.
            take(Row(**{**asdict(row), "part": name}))
    for row in beside_the_cpu(found):
        take(row)
    return found


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--device", help="an index or a part of a name; by default as the program chooses")
    parser.add_argument("--quick", action="store_true", help="less work: for a rehearsal on a CPU")
    parser.add_argument("--parts", nargs="+", choices=PARTS, metavar="PART", default=list(PARTS), help=", ".join(PARTS))
    parser.add_argument("--output", type=Path, default=Path("gpu_check.json"), help="the JSON (gpu_check.json)")
    parser.add_argument("--store", action="store_true", help="write gpu/reference.npz by the device, and stop")
    arguments = parser.parse_args()
    start = time.monotonic()
    with tempfile.TemporaryDirectory() as folder:
        variables = environment(Path(folder))
        if arguments.store:
            os.environ.update(variables)
            from gpu import compared

            compared.store()
            return 0
        try:
            found = checked(arguments, variables)
        except RuntimeError as error:
            print(error, file=sys.stderr)
            return 2
    wrong = [row for row in found if row.holds is False]
    seconds = round(time.monotonic() - start, 1)
    stored = {"seconds": seconds, "rows": [asdict(row) for row in found]}
    arguments.output.write_text(json.dumps(stored, indent=1) + "\n")
    print(f"\n{seconds} s, {len(wrong)} rows that are not as they should be; {arguments.output}", file=sys.stderr)
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
