"""Rows of this program alone: the gradient, growth with the grid, cores, the host's share, the start."""

from __future__ import annotations

import importlib.metadata
import platform
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

import cloudtomo_cl as ct
from benchmarks.children import child
from benchmarks.scenes import generated
from benchmarks.timing import Line, cpu_seconds, timed
from cloudtomo_cl.transport.table_gradient import TableGradient


def machine() -> str:
    """What a table was measured on."""
    device = ct.choose_device()
    versions = [f"Python {platform.python_version()}"]
    for package in ("cloudtomo-cl", "pyopencl", "pocl-binary-distribution", "mitsuba", "pmcxcl"):
        try:
            versions.append(f"{package} {importlib.metadata.version(package)}")
        except importlib.metadata.PackageNotFoundError:
            continue
    opencl = device.opencl
    return f"{device.name}, {opencl.max_compute_units} cores; {opencl.version.strip()}; {'; '.join(versions)}"


def gradient_over_forward(quick: bool) -> Iterator[Line]:
    """CPU seconds of a gradient over those of the render whose paths it walks again."""
    case = generated(32, 48)
    operator = ct.RadianceOperator(case.scene, (case.view,), mask=case.extinction > 0)
    adjoint = np.full((len(operator.pixels), 2), 1.0)
    field = TableGradient(operator)
    samples, repeats = (64, 4) if quick else (256, 8)
    ratios = {"replay": [], "field": []}
    for n in range(repeats + 1):
        rendering, seconds = timed(lambda n=n: operator.render(case.extinction, samples, n, store_paths=True))
        for name, run in (
            ("replay", lambda r=rendering: operator.gradient(r, adjoint).get()),
            ("field", lambda r=rendering: field.gradient(r, adjoint)[0].get()),
        ):
            _, gradient_seconds = timed(run)
            if n > 0:  # the first built the kernels
                ratios[name].append(gradient_seconds / seconds)
    for name, values in ratios.items():
        yield Line("gradient-over-forward", f"CPU time, {name}", values, "2.5", "of a gradient over its render", 2)


def growth(quick: bool) -> Iterator[Line]:
    """The same 32^3 voxels of cloud on finer and finer grids, each in a process of its own."""
    sizes = (32, 64, 128, 256)
    samples, repeats = (256, 3) if quick else (512, 5)
    times: dict[int, list[float]] = {size: [] for size in sizes}
    peaks: dict[int, float] = {}
    for _ in range(repeats):
        for size in sizes:
            result = child("own", "grown", size, samples)
            times[size].append(result["seconds"])
            peaks[size] = result["peak"]
    for size in sizes[1:]:
        ratios = np.divide(times[size], times[sizes[0]])
        goal = "2" if size == sizes[-1] else ""
        yield Line("growth", f"CPU time of a path, {size}^3 over {sizes[0]}^3", ratios, goal, "", 2)
    voxels = sizes[-1] ** 3 - sizes[0] ** 3
    bytes_per_voxel = (peaks[sizes[-1]] - peaks[sizes[0]]) / voxels
    note = "a render, making the cloud too"
    yield Line("growth", "bytes a voxel, peak of the process", (bytes_per_voxel,), "64", note)
    if not quick:
        result = child("own", "grown", 512, 64)
        note = f"peak {result['peak'] / 1e9:.1f} GB"
        ratio = result["seconds"] / np.median(times[32])
        yield Line("growth", "CPU time of a path, 512^3 over 32^3", (ratio,), "", note)


def grown(size: int, samples: int) -> dict[str, float]:
    """CPU seconds of a path, and this process's peak of memory in bytes."""
    import pyopencl.array

    case = generated(size, 48, 32)
    operator = ct.RadianceOperator(case.scene, (case.view,), mask=case.extinction > 0)
    extinction = pyopencl.array.to_device(operator.device.queue, case.extinction)
    operator.render(extinction, 64, 1)
    _, seconds = timed(lambda: operator.render(extinction, samples, 2))
    # Not getrusage's peak, which begins with that of the parent.
    status = Path("/proc/self/status").read_text()
    peak = int(status.split("VmHWM:")[1].split()[0]) * 1024
    return {"seconds": seconds / samples / len(operator.pixels), "peak": peak}


def cores(quick: bool) -> Iterator[Line]:
    """Paths per second of the clock on all cores over those on one, in turn."""
    count = ct.choose_device().opencl.max_compute_units
    samples, repeats = (64, 3) if quick else (384, 7)
    wall, cpu = [], []
    for _ in range(repeats):
        one = child("own", "rendered", samples, environment={"POCL_MAX_PTHREAD_COUNT": "1"})
        every = child("own", "rendered", samples)
        wall.append(one["wall"] / every["wall"])
        cpu.append(count * one["cpu"] / every["cpu"])
    what = f"speed on {count} over 1"
    yield Line("cores", f"{what}, by the clock", wall, "1.9", "needs a machine with nothing else on it", 2)
    yield Line("cores", f"{what}, by CPU time", cpu, "1.9", "as if every CPU second had its own core", 2)


def rendered(samples: int) -> dict[str, float]:
    """Seconds by the clock and of CPU time of a render."""
    case = generated(32)
    operator = ct.RadianceOperator(case.scene, (case.view,))
    operator.render(case.extinction, 64, 1)
    start = time.perf_counter()
    _, seconds = timed(lambda: operator.render(case.extinction, samples, 2))
    return {"wall": time.perf_counter() - start, "cpu": seconds}


def overhead(quick: bool) -> Iterator[Line]:
    """CPU time of the host's own thread over that of all, in a reconstruction of two stages.

    PoCL's kernels run in threads of their own; what else happens, happens in the first.
    """
    iterations, repeats = (8, 2) if quick else (30, 4)
    result = [child("own", "reconstructed", iterations) for _ in range(repeats)]
    yield Line(
        "overhead", "host's work in an iteration, %", [100 * r["iteration"] for r in result], "5",
        "of CPU time; ADAM, 60,000 paths an iteration",
    )  # fmt: skip
    yield Line(
        "overhead", "stage transition, % of an iteration", [100 * r["transition"] for r in result], "5", "of CPU time"
    )


def reconstructed(iterations: int) -> dict[str, float]:
    """Shares of CPU time that are the host's, in a small reconstruction."""
    case = generated(32, 48)
    views = (case.view,)
    operator = ct.RadianceOperator(case.scene, views)
    images = operator.render(case.extinction, 64, 1)
    measurements = ct.Measurements.rendered(operator, images)
    stages = [ct.Stage(grid=(size,) * 3, iterations=iterations) for size in (16, 32)]
    marks: list[tuple[int, float, float]] = []
    begun: list[float] = []
    step = ct.Adam.step

    def mark(record: ct.IterationRecord) -> None:
        marks.append((record.stage, time.thread_time(), cpu_seconds()))

    def begin(solver: ct.Adam, *arguments: Any, **keywords: Any) -> Any:
        begun.append(cpu_seconds())
        return step(solver, *arguments, **keywords)

    ct.Adam.step = begin  # type: ignore[method-assign]
    for _ in range(2):  # the first builds the kernels
        marks.clear()
        begun.clear()
        ct.reconstruct(
            case.scene, measurements, stages, solver=ct.Adam(), mask=case.extinction > 0, seed=2,
            callback=mark,
        )  # fmt: skip
    host = np.diff([thread for _, thread, _ in marks])
    everything = np.diff([total for _, _, total in marks])
    first = next(n for n, (stage, _, _) in enumerate(marks) if stage == 1) - 1
    last_stage = slice(first + 1, None)
    # From the end of a stage's last iteration to the beginning of the next stage's first.
    transition = begun[first + 1] - marks[first][2]
    return {
        "iteration": float(host[last_stage].sum() / everything[last_stage].sum()),
        "transition": float(transition / np.median(everything[last_stage])),
    }


def start(quick: bool) -> Iterator[Line]:
    """Seconds from the process's start to the end of a tiny render: with empty caches, and again."""
    firsts, seconds, warm = [], [], []
    for _ in range(1 if quick else 3):
        with tempfile.TemporaryDirectory() as folder:
            caches = {"POCL_CACHE_DIR": f"{folder}/pocl", "XDG_CACHE_HOME": f"{folder}/xdg"}
            for values in (firsts, seconds, warm):
                values.append(child("own", "started", environment=caches)["cpu"])
    note = "the process from its start to a render's end"
    yield Line("start", "first run, CPU seconds", firsts, "", f"kernels built; {note}")
    yield Line("start", "second run, CPU seconds", seconds, "1", "kernels cached", 2)
    yield Line("start", "third run, CPU seconds", warm, "1", "", 2)


def started() -> dict[str, float]:
    """CPU seconds of this process at the end of a tiny render."""
    case = generated(8, 4)
    ct.RadianceOperator(case.scene, (case.view,)).render(case.extinction, 2, 1)
    return {"cpu": cpu_seconds()}
