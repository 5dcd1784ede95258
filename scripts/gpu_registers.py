"""Compiles the hot kernels for GPUs that need not be there, and prints what each work item takes.

    python scripts/gpu_registers.py [--nvidia sm_90] [--amd gfx1100]

Registers per work item decide how many of them a GPU keeps at a time, and spilled ones go to memory: the
goal is fewer than 64 and none. Needs clang 16 or newer with libclc (Debian: clang-16, libclc-16, or others
by --clang and --libclc), and for NVIDIA ptxas (Debian's nvidia-cuda-toolkit, or the wheel nvidia-cuda-nvcc).
NVIDIA's and AMD's own OpenCL compilers are other builds of the same code generators.
"""

from __future__ import annotations

import argparse
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pyopencl

from cloudtomo_cl.opencl.device import choose_device, kernels_folder
from cloudtomo_cl.transport.derivatives import _FEATURES as TABLE_FEATURES

# File, kernel, macros. The last two show what optional features cost.
KERNELS = (
    ("image", "render_paths", ()),
    ("replay", "replay_paths", ()),
    ("derivatives", "gradient_paths", TABLE_FEATURES),
    ("flux", "trace_photons", ()),
    ("image", "render_paths", ("CLOUDTOMO_PHASE_TABLE",)),
    ("image", "render_paths", ("CLOUDTOMO_PHASE_TABLE", "CLOUDTOMO_ATMOSPHERE")),
)

# libclc lacks it for NVIDIA, whose own library has it.
_ATOMIC_ADD = """#ifdef __NVPTX__
long __attribute__((overloadable)) atom_add(volatile __global long *sum, long value)
{
    long before;
    __asm__ volatile("atom.global.add.u64 %0, [%1], %2;" : "=l"(before) : "l"(sum), "l"(value) : "memory");
    return before;
}
long __attribute__((overloadable)) atom_xchg(volatile __global long *sum, long value)
{
    long before;
    __asm__ volatile("atom.global.exch.b64 %0, [%1], %2;" : "=l"(before) : "l"(sum), "l"(value) : "memory");
    return before;
}
#endif
"""


class CompilerError(Exception):
    """A compiler is missing, or refused."""


@dataclass(frozen=True)
class Use:
    """What a work item of a kernel takes.

    Attributes
    ----------
    registers : of 32 bits
    spills : bytes stored and loaded for lack of registers; AMD: registers spilled
    stack : bytes of memory of its own
    """

    registers: int
    spills: int
    stack: int


def run(command: list[str]) -> str:
    """What a command prints on both streams. Raises CompilerError."""
    if shutil.which(command[0]) is None:
        raise CompilerError(f"{command[0]} is not there")
    process = subprocess.run(command, capture_output=True, text=True)
    if process.returncode:
        raise CompilerError(f"{' '.join(command)}\n{process.stderr}")
    return process.stdout + process.stderr


def compile_options(clang: str, source: Path) -> list[str]:
    """Of clang for any GPU, as cloudtomo_cl.opencl.device has them."""
    ours = kernels_folder()
    theirs = Path(pyopencl.__file__).parent / "cl"
    return [
        clang, "-x", "cl", "-cl-std=CL1.2", "-O3", "-w", "-DCLOUDTOMO_WIDE_ATOMICS", f"-I{ours}", f"-I{theirs}",
        "-S", str(source),
    ]  # fmt: skip


def for_nvidia(clang: str, libclc: Path, architecture: str, source: Path, kernel: str) -> Use:
    """By way of PTX and ptxas."""
    ptx = source.with_suffix(".ptx")
    library = libclc / "nvptx64--nvidiacl.bc"
    target = [
        "-target", "nvptx64-nvidia-nvcl", "-Xclang", "-mlink-builtin-bitcode", "-Xclang", str(library),
        "-Xclang", "-cl-ext=+cl_khr_int64_base_atomics",  # NVIDIA's own has it
    ]  # fmt: skip
    run([*compile_options(clang, source), *target, "-o", str(ptx)])
    text = run(["ptxas", "-v", f"-arch={architecture}", str(ptx), "-o", str(source.with_suffix(".cubin"))])
    part = text[text.index(f"'{kernel}'") :]
    stack, stored, loaded = (
        int(n) for n in re.search(r"(\d+) bytes stack frame, (\d+) bytes spill stores, (\d+)", part).groups()
    )
    return Use(int(re.search(r"Used (\d+) registers", part)[1]), stored + loaded, stack)


def for_amd(clang: str, libclc: Path, architecture: str, source: Path, kernel: str) -> Use:
    """By the metadata of the assembly; vector registers count, the scalar ones are a wave's."""
    assembly = source.with_suffix(".s")
    library = libclc / "amdgcn--amdhsa.bc"
    target = [
        "-target", "amdgcn-amd-amdhsa", f"-mcpu={architecture}", "-nogpulib",
        "-Xclang", "-mlink-builtin-bitcode", "-Xclang", str(library),
    ]  # fmt: skip
    run([*compile_options(clang, source), *target, "-o", str(assembly)])
    text = assembly.read_text()
    metadata = next(m for m in re.split(r"\n  - ", text[text.index(".amdgpu_metadata") :]) if f" {kernel}\n" in m)
    number = {key: int(value) for key, value in re.findall(r"\.(\w+):\s+(\d+)\n", metadata)}
    return Use(number["vgpr_count"], number["vgpr_spill_count"], number["private_segment_fixed_size"])


def table(arguments: argparse.Namespace) -> Iterator[str]:
    """The lines of the table."""
    preamble = choose_device().preamble
    targets = [
        (name, compiler, architecture)
        for name, compiler, architectures in (
            ("NVIDIA", for_nvidia, arguments.nvidia), ("AMD", for_amd, arguments.amd),
        )
        for architecture in architectures
    ]  # fmt: skip
    yield "| kernel | with | for | registers | spills | stack, bytes |"
    yield "|---|---|---|---|---|---|"
    with tempfile.TemporaryDirectory() as folder:
        for file, kernel, features in KERNELS:
            macros = "".join(f"#define {feature}\n" for feature in features)
            source = Path(folder, f"{kernel}.cl")
            source.write_text(f'{preamble}\n{_ATOMIC_ADD}\n{macros}#include "{file}.cl"\n')
            shown = ", ".join(f.removeprefix("CLOUDTOMO_").lower() for f in features if f.startswith("CLOUDTOMO_"))
            for name, compiler, architecture in targets:
                use = compiler(arguments.clang, arguments.libclc, architecture, source, kernel)
                yield f"| {kernel} | {shown} | {name} {architecture} | {use.registers} | {use.spills} | {use.stack} |"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--nvidia", nargs="*", default=["sm_80", "sm_90"], help="architectures")
    parser.add_argument("--amd", nargs="*", default=["gfx90a", "gfx1100"], help="architectures")
    parser.add_argument("--clang", default="clang-16", help="the compiler")
    parser.add_argument("--libclc", type=Path, default=Path("/usr/lib/clc"), help="folder of libclc's *.bc")
    try:
        for line in table(parser.parse_args()):
            print(line, flush=True)
    except CompilerError as error:
        print(error, file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
