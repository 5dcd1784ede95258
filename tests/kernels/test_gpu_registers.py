"""What the kernels take of a GPU, by compilers that need none: one variable too many costs a share of its speed."""

import json
import sys
from pathlib import Path

import pytest

SCRIPTS = Path(__file__).parents[2] / "scripts"
STORED = json.loads((SCRIPTS / "gpu" / "registers.json").read_text())
# The kernels where a recovery's time goes; scripts/gpu_registers.py has more.
KERNELS = ("render_paths, branches", "render_paths", "replay_paths, branches", "trace_photons")


@pytest.fixture(scope="module")
def registers(tmp_path_factory):
    """Compiles a kernel, once: what it takes, by architecture."""
    sys.path.insert(0, str(SCRIPTS))
    try:
        from gpu import compilers
    finally:
        sys.path.remove(str(SCRIPTS))
    tools = compilers.Compilers(tmp_path_factory.mktemp("gpu"))
    try:
        versions = tools.versions()
    except compilers.CompilerError as error:
        pytest.skip(f"no compilers for GPUs: {error}")
    if versions != STORED["compilers"]:
        pytest.skip(f"compilers are {versions}, those of the stored numbers {STORED['compilers']}")
    listed = {str(kernel): kernel for kernel in compilers.KERNELS}
    return lambda name: tools.uses(listed[name])


@pytest.mark.parametrize("kernel", KERNELS)
def test_a_kernel_takes_no_more_of_a_gpu_than_it_did(registers, kernel):
    more = [
        f"{kernel} on {architecture}: {value} {name}, were {before[name]}"
        for architecture, use in registers(kernel).items()
        for before in [STORED["kernels"][kernel][architecture]]
        for name, value in vars(use).items()
        if value > before[name]
    ]
    assert not more, (
        f"{more}: shorten what lives across a flight, or, if it is worth it, say so in docs/measurements/gpu.md and "
        "store the new numbers: python scripts/gpu_registers.py --store"
    )
