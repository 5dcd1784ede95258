"""Compilers for GPUs that need not be there, and what each work item of a kernel takes by them.

Registers per work item decide how many of them a GPU keeps at a time, and spilled ones go to memory. Needed are clang
16 or newer with libclc (Debian: clang-16, libclc-16), and for NVIDIA ptxas (Debian's nvidia-cuda-toolkit, or the wheel
nvidia-cuda-nvcc). NVIDIA's and AMD's own OpenCL compilers are other builds of the same code generators.
"""

from __future__ import annotations

import re
import shutil
import subprocess
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pyopencl

from cloudtomo_cl.opencl.devices import choose_device
from cloudtomo_cl.opencl.dialect import GROUP_SIZE_ON_NVIDIA, WORK_GROUP_SIZE
from cloudtomo_cl.opencl.programs import kernels_folder
from cloudtomo_cl.transport.directions import FEATURES as TABLE_FEATURES

NVIDIA, AMD = ("sm_80", "sm_90"), ("gfx90a", "gfx1100")

# libclc lacks them for NVIDIA, whose own library has them.
_ATOMIC = """long __attribute__((overloadable)) {name}(volatile {space} long *sum, long value)
{{
    long before;
    __asm__ volatile("atom.{state}.{operation} %0, [%1], %2;" : "=l"(before) : "l"(sum), "l"(value) : "memory");
    return before;
}}
"""
_ATOMICS = "".join(
    _ATOMIC.format(name=name, operation=operation, space=space, state=state)
    for name, operation in (("atom_add", "add.u64"), ("atom_xchg", "exch.b64"))
    for space, state in (("__global", "global"), ("__local", "shared"))
)
_OFFSET = """size_t __attribute__((overloadable)) get_global_offset(uint dimension)
{
    uint offset;
    __asm__("mov.u32 %0, %%envreg3;" : "=r"(offset));
    return offset;
}
"""
_MACROS = ("-DCLOUDTOMO_WIDE_ATOMICS",)


class CompilerError(Exception):
    """A compiler is missing, or refused."""


@dataclass(frozen=True)
class KernelSource:
    """A kernel as it is compiled.

    Attributes
    ----------
    file : among the kernels, without its ending
    name : of the kernel
    features : macros of the scene
    label : what is printed; by default the name
    """

    file: str
    name: str
    features: tuple[str, ...] = ()
    label: str = ""

    def __str__(self) -> str:
        return self.label or self.name


# The last two show what optional features cost.
KERNELS = (
    KernelSource("image", "render_paths"),
    KernelSource("image", "render_paths", ("CLOUDTOMO_BRANCHES",), "render_paths, branches"),
    KernelSource("replay", "replay_paths"),
    KernelSource("replay", "replay_paths", ("CLOUDTOMO_BRANCHES",), "replay_paths, branches"),
    KernelSource("virtual", "virtual_paths"),
    KernelSource("lengths", "path_lengths"),
    KernelSource("derivatives", "gradient_paths", TABLE_FEATURES),
    KernelSource("jacobian", "jacobian_paths", TABLE_FEATURES),
    KernelSource("jacobian", "jacobian_rays", TABLE_FEATURES),
    KernelSource("photons", "fill_table", TABLE_FEATURES),
    KernelSource("flux", "trace_photons"),
    KernelSource("image", "render_paths", ("CLOUDTOMO_PHASE_TABLE",), "render_paths, phase table"),
    KernelSource(
        "image", "render_paths", ("CLOUDTOMO_PHASE_TABLE", "CLOUDTOMO_ATMOSPHERE"),
        "render_paths, phase table and atmosphere",
    ),
)  # fmt: skip


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


@dataclass(frozen=True)
class Compilers:
    """Where the compilers are.

    Attributes
    ----------
    folder : where their files go
    clang, ptxas : the commands
    libclc : folder of its *.bc
    """

    folder: Path
    clang: str = "clang-16"
    ptxas: str = "ptxas"
    libclc: Path = Path("/usr/lib/clc")

    def versions(self) -> dict[str, str]:
        """Of clang and ptxas. Raises CompilerError if one is not there, or libclc is not."""
        for name in ("nvptx64--nvidiacl.bc", "amdgcn--amdhsa.bc"):
            if not (self.libclc / name).exists():
                raise CompilerError(f"{self.libclc / name} is not there")
        found = {}
        for name, command in (("clang", self.clang), ("ptxas", self.ptxas)):
            text = run([command, "--version"])
            version = re.search(r"(?:version|V)\s*(\d+\.\d+\.\d+)", text)
            found[name] = version[1] if version else text.strip().splitlines()[-1]
        return found

    def _source(self, kernel: KernelSource, keeps_local: bool) -> Path:
        device = choose_device()
        device.regenerates, device.keeps_local = True, keeps_local
        device.group_size = GROUP_SIZE_ON_NVIDIA if keeps_local else WORK_GROUP_SIZE
        macros = "".join(f"#define {feature}\n" for feature in kernel.features)
        path = self.folder / f"{re.sub(r'[^a-z]+', '_', str(kernel))}.cl"
        missing = f"#ifdef __NVPTX__\n{_ATOMICS}{_OFFSET}#endif\n"
        path.write_text(f'{device.preamble}\n{missing}{macros}#include "{kernel.file}.cl"\n')
        return path

    def _options(self, source: Path) -> list[str]:
        """Of clang for any GPU."""
        theirs = Path(pyopencl.__file__).parent / "cl"
        return [
            self.clang, "-x", "cl", "-cl-std=CL1.2", "-O3", "-w", *_MACROS, f"-I{kernels_folder()}", f"-I{theirs}",
            "-S", str(source),
        ]  # fmt: skip

    def ptx(self, kernel: KernelSource) -> Path:
        """The kernel for NVIDIA's GPUs, before registers are given out."""
        source = self._source(kernel, keeps_local=True)
        ptx = source.with_suffix(".ptx")
        target = [
            "-target", "nvptx64-nvidia-nvcl", "-Xclang", "-mlink-builtin-bitcode",
            "-Xclang", str(self.libclc / "nvptx64--nvidiacl.bc"),
            "-Xclang", "-cl-ext=+cl_khr_int64_base_atomics",  # NVIDIA's own has it
        ]  # fmt: skip
        run([*self._options(source), *target, "-o", str(ptx)])
        return ptx

    def for_nvidia(self, kernel: KernelSource, architectures: tuple[str, ...] = NVIDIA) -> Iterator[tuple[str, Use]]:
        """By way of PTX and ptxas."""
        ptx = self.ptx(kernel)
        for architecture in architectures:
            text = run([self.ptxas, "-v", f"-arch={architecture}", str(ptx), "-o", str(ptx.with_suffix(".cubin"))])
            # From the kernel's own line to the next one's: what it is made of, functions that it calls included.
            part = re.search(rf"entry function '{kernel.name}'.*?Used (\d+) registers", text, flags=re.DOTALL)
            if part is None:
                raise CompilerError(f"ptxas says nothing of {kernel.name}:\n{text}")
            frames = re.findall(r"(\d+) bytes stack frame, (\d+) bytes spill stores, (\d+)", part[0])
            stacks, stored, loaded = zip(*(map(int, frame) for frame in frames))
            yield architecture, Use(int(part[1]), sum(stored) + sum(loaded), max(stacks))

    def for_amd(self, kernel: KernelSource, architectures: tuple[str, ...] = AMD) -> Iterator[tuple[str, Use]]:
        """By the metadata of the assembly; vector registers count, the scalar ones are a wave's."""
        source = self._source(kernel, keeps_local=False)
        assembly = source.with_suffix(".s")
        for architecture in architectures:
            target = [
                "-target", "amdgcn-amd-amdhsa", f"-mcpu={architecture}", "-nogpulib", "-Xclang",
                "-mlink-builtin-bitcode", "-Xclang", str(self.libclc / "amdgcn--amdhsa.bc"),
            ]  # fmt: skip
            run([*self._options(source), *target, "-o", str(assembly)])
            text = assembly.read_text()
            listed = re.split(r"\n  - ", text[text.index(".amdgpu_metadata") :])
            metadata = next(one for one in listed if f" {kernel.name}\n" in one)
            number = {key: int(value) for key, value in re.findall(r"\.(\w+):\s+(\d+)\n", metadata)}
            yield (
                architecture,
                Use(number["vgpr_count"], number["vgpr_spill_count"], number["private_segment_fixed_size"]),
            )

    def uses(
        self, kernel: KernelSource, nvidia: tuple[str, ...] = NVIDIA, amd: tuple[str, ...] = AMD
    ) -> dict[str, Use]:
        """By architecture."""
        return {**dict(self.for_nvidia(kernel, nvidia)), **dict(self.for_amd(kernel, amd))}
