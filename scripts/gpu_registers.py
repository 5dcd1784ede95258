"""Compiles the hot kernels for GPUs that need not be there, and prints what each work item takes.

    python scripts/gpu_registers.py [--nvidia sm_90] [--amd gfx1100] [--only replay]
    python scripts/gpu_registers.py --store      # writes what tests/kernels/test_gpu_registers.py compares with

What compilers are needed is said in scripts/gpu/compilers.py.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from dataclasses import asdict
from pathlib import Path

from gpu.compilers import AMD, KERNELS, NVIDIA, CompilerError, Compilers

STORED = Path(__file__).with_name("gpu") / "registers.json"


def measured(compilers: Compilers, arguments: argparse.Namespace) -> dict[str, dict[str, dict[str, int]]]:
    """By kernel and architecture; prints each kernel's lines when it is compiled."""
    print("| kernel | for | registers | spills | stack, bytes |\n|---|---|---|---|---|", flush=True)
    found = {}
    for kernel in KERNELS:
        if arguments.only not in str(kernel):
            continue
        uses = compilers.uses(kernel, tuple(arguments.nvidia), tuple(arguments.amd))
        for architecture, use in uses.items():
            print(f"| {kernel} | {architecture} | {use.registers} | {use.spills} | {use.stack} |", flush=True)
        found[str(kernel)] = {architecture: asdict(use) for architecture, use in uses.items()}
    return found


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--nvidia", nargs="*", default=NVIDIA, help="architectures")
    parser.add_argument("--amd", nargs="*", default=AMD, help="architectures")
    parser.add_argument("--only", default="", help="kernels whose names have this in them")
    parser.add_argument("--clang", default="clang-16", help="the compiler")
    parser.add_argument("--libclc", type=Path, default=Path("/usr/lib/clc"), help="folder of libclc's *.bc")
    parser.add_argument("--store", action="store_true", help=f"write {STORED.name}, of all kernels and architectures")
    arguments = parser.parse_args()
    if arguments.store:
        arguments.nvidia, arguments.amd, arguments.only = NVIDIA, AMD, ""
    try:
        with tempfile.TemporaryDirectory() as folder:
            compilers = Compilers(Path(folder), arguments.clang, libclc=arguments.libclc)
            versions = compilers.versions()
            found = measured(compilers, arguments)
    except CompilerError as error:
        print(error, file=sys.stderr)
        return 2
    if arguments.store:
        STORED.write_text(json.dumps({"compilers": versions, "kernels": found}, indent=1) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
