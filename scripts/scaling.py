"""How recoveries scale with ranks: what one and two take here, and a model of many.

    python scripts/scaling.py measure scaling.json       # scene C: two threads of one process, and two ranks, in turn
    python scripts/scaling.py measure memory.json --repeats 1 --kinds memory    # the memory of a cloud of 128^3 voxels
    python scripts/scaling.py efficiency scaling.json    # what came of it: two ranks against two threads
    python scripts/scaling.py predict scaling.json       # a model; its assumptions are options, and printed with it

Measures renders (the same paths: strong; as many more as there are ranks: weak), iterations of Gauss-Newton on the
finest grid, and how much memory one iteration takes on a large grid. Needs mpi4py and mpiexec, and scene C's file
(CLOUDTOMO_DATA). Times are the clock's, on a machine with nothing else on it, and CPU seconds of each rank.
docs/measurements/scaling.md holds the last tables.
"""

from __future__ import annotations

import argparse
import functools
import json
import os
import subprocess
import sys
import time
from collections import defaultdict
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

RENDER_SAMPLES, IMAGE_SAMPLES, ITERATIONS = 128, 64, int(os.environ.get("SCALING_ITERATIONS", "3"))
SEED = 2
# Beside the true cloud voxels that a mask from carving would have, too.
MARGIN = 2
# Memory is that of a generated cloud on so many voxels along an axis, seen by nine images of so many pixels along one,
# with a mask of so many times the cloud's voxels as carving leaves; with few paths, which take no memory to speak of.
LARGE_GRID, LARGE_IMAGE, CARVED, FEW_SAMPLES = 128, 256, 5.3, 4


def timed_methods(ranks: Any) -> dict[str, list[tuple[Any, str]]]:
    """What is timed, by kind; what is told other ranks is part of the other kinds, too."""
    from cloudtomo_cl.inversion.patch_components import ComponentChoice
    from cloudtomo_cl.inversion.patch_quadratic import PatchQuadratic
    from cloudtomo_cl.inversion.stencil import StencilTiles
    from cloudtomo_cl.transport.jacobian import Jacobian
    from cloudtomo_cl.transport.jacobian_average import JacobianAverage
    from cloudtomo_cl.transport.path_sums import PathSums
    from cloudtomo_cl.transport.table_builder import RadianceTableBuilder

    return {
        "paths": [(PathSums, "of"), (JacobianAverage, "_add_rows")],
        "products": [(Jacobian, "times"), (Jacobian, "transposed"), (Jacobian, "curvature")],
        "prior": [
            (ComponentChoice, "at"), (StencilTiles, "assembled"), (PatchQuadratic, "add_product"),
        ],
        "table": [(RadianceTableBuilder, "at")],
        "told": [(type(ranks), name) for name in ("joined", "exchange", "_added", "all", "any") if ranks.size > 1],
    }  # fmt: skip


def _awaited(result: Any, owner: Any) -> Any:
    """A result, once the kernels have run that products only start."""
    names = ("_structure", "_operator", "_kernels", "_pace")
    part = next((getattr(owner, name) for name in names if hasattr(owner, name)), owner)
    if hasattr(part, "device"):
        part.device.queue.finish()
    return result


class Clock:
    """Seconds by kind, of the clock and of the processor, and how many calls.

    Launches that are made again without a call (`Device.repeated`) are counted as calls; their seconds are told of
    whole iterations only.
    """

    def __init__(self, ranks: Any) -> None:
        from cloudtomo_cl.opencl.device import Device

        self.clear()
        Device.repeated = self._counted(Device.repeated)  # type: ignore[method-assign]
        for kind, methods in timed_methods(ranks).items():
            for owner, name in methods:
                setattr(owner, name, self._timed(kind, getattr(owner, name)))

    def clear(self) -> None:
        self.wall: dict[str, float] = defaultdict(float)
        self.cpu: dict[str, float] = defaultdict(float)
        self.calls: dict[str, int] = defaultdict(int)

    def _timed(self, kind: str, method: Any) -> Any:
        @functools.wraps(method)
        def timed(*arguments: Any, **named: Any) -> Any:
            return self.of(kind, lambda: _awaited(method(*arguments, **named), arguments[0]))

        return timed

    def _counted(self, repeated: Any) -> Any:
        @contextmanager
        def counted(device: Any, function: Any) -> Any:
            made: dict[str, int] = {}

            def again(launch: Any) -> None:
                before = dict(self.calls)
                launch()
                if not made:  # it was recorded
                    made.update({kind: calls - before.get(kind, 0) for kind, calls in self.calls.items()})
                for kind, calls in made.items():
                    self.calls[kind] = before.get(kind, 0) + calls

            with repeated(device, function) as launch:
                yield functools.partial(again, launch)

        return counted

    def of(self, kind: str, work: Any) -> Any:
        wall, cpu = time.perf_counter(), time.process_time()
        result = work()
        self.wall[kind] += time.perf_counter() - wall
        self.cpu[kind] += time.process_time() - cpu
        self.calls[kind] += 1
        return result


def scene() -> tuple[Any, tuple[Any, ...], np.ndarray]:
    """Scene C with the paper's nine cameras, and its extinction."""
    from benchmarks.scenes import scene_c

    import cloudtomo_cl as ct

    case = scene_c()
    views = ct.RingOfViews(
        target=(0.38, 0.38, 1.013), height=1.647, radius=0.5, count=8, field_of_view=85.4, pixels=(76, 76)
    ).views()
    return case.scene, views, case.extinction


def counted_cells() -> list[int]:
    """Cells of the radiance tables that are made from now on, one after the other."""
    from cloudtomo_cl.transport.table_builder import RadianceTableBuilder

    cells, at = [], RadianceTableBuilder.at

    def counted(builder: Any, rendering: Any) -> Any:
        table = at(builder, rendering)
        cells.append(len(table))
        return table

    RadianceTableBuilder.at = counted  # type: ignore[method-assign]
    return cells


def work(kind: str) -> dict[str, Any]:
    """What one rank measures: a dict of numbers."""
    import cloudtomo_cl as ct
    from cloudtomo_cl.parallel.launched import launched_ranks

    device = ct.choose_device(communicator=launched_ranks())
    ranks = device.ranks
    found = MEASURED[kind](device)
    status = Path("/proc/self/status").read_text()
    found["peak"] = int(status.split("VmHWM:")[1].split()[0]) * 1024
    return {"ranks": ranks.size, "rank": ranks.all(found)} if ranks.size > 1 else {"ranks": 1, "rank": [found]}


def renders(device: Any) -> dict[str, Any]:
    import cloudtomo_cl as ct

    clock = Clock(device.ranks)
    given, views, extinction = scene()
    operator = ct.RadianceOperator(given, views, device)
    operator.render(extinction, 8)
    found = {}
    for name, samples in (("strong", RENDER_SAMPLES), ("weak", RENDER_SAMPLES * device.ranks.size)):
        clock.clear()
        device.ranks.all(None)
        clock.of(name, lambda samples=samples: operator.render(extinction, samples, SEED))
        found[name] = {"wall": clock.wall[name], "cpu": clock.cpu["paths"], "told": clock.cpu["told"]}
    return found


def iterations(device: Any) -> dict[str, Any]:
    from scipy.ndimage import binary_dilation

    import cloudtomo_cl as ct
    from cloudtomo_cl.transport.directions import BINS

    clock = Clock(device.ranks)
    given, views, extinction = scene()
    operator = ct.RadianceOperator(given, views, device)
    measured = ct.Measurements.rendered(operator, operator.render(extinction, IMAGE_SAMPLES, 1))
    mask = binary_dilation(extinction > 0, iterations=MARGIN)
    problem, solver = ct.Problem.of(given, measured, mask=mask, device=device), ct.GaussNewton()
    state = solver.init(problem, np.full(len(problem.voxels), 5.0))
    state, _ = solver.step(problem, state, seed=SEED, stream=1)
    clock.clear()
    cells = counted_cells()
    sent, paths = device.ranks.sent, 0
    for stream in range(2, 2 + ITERATIONS):
        state, progress = clock.of(
            "iteration", lambda stream=stream, state=state: solver.step(problem, state, seed=SEED, stream=stream)
        )
        paths += progress.paths
    structure = state.derivatives.structure
    return {
        "wall": {name: value / ITERATIONS for name, value in clock.wall.items()},
        "cpu": {name: value / ITERATIONS for name, value in clock.cpu.items()},
        "products": clock.calls["products"] / ITERATIONS,
        "prior": clock.calls["prior"] / ITERATIONS,
        "sent": (device.ranks.sent - sent) / ITERATIONS,
        "paths": paths / ITERATIONS,
        "pixels": len(problem.active),
        "voxels": len(problem.voxels),
        "entries": structure.near.count,
        "cells": cells[-1],
        "bins": BINS,
    }


def memory(device: Any) -> dict[str, Any]:
    """One iteration with few paths: memory is largest while derivatives get their structure."""
    from benchmarks.scenes import generated
    from scipy.ndimage import distance_transform_edt

    import cloudtomo_cl as ct

    case = generated(LARGE_GRID)
    cloud, centre = case.extinction > 0, case.scene.grid.centre
    ring = ct.RingOfViews(target=centre, height=5.0, radius=3.5, field_of_view=22.0, pixels=(LARGE_IMAGE, LARGE_IMAGE))
    operator = ct.RadianceOperator(case.scene, ring.views(), device)
    measured = ct.Measurements.rendered(operator, operator.render(case.extinction, FEW_SAMPLES, 1))
    voxels = round(CARVED * np.count_nonzero(cloud))
    nearest = np.argsort(distance_transform_edt(~cloud), axis=None, kind="stable")[:voxels]
    mask = np.zeros(cloud.shape, bool)
    mask.flat[nearest] = True
    problem = ct.Problem.of(case.scene, measured, mask=mask, device=device, samples=FEW_SAMPLES)
    solver = ct.GaussNewton(image_samples=0, inner_iterations=1)
    state = solver.init(problem, np.full(len(problem.voxels), 5.0))
    state, _ = solver.step(problem, state, seed=SEED, stream=1)
    entries = state.derivatives.structure.near.count
    return {"pixels": len(problem.active), "voxels": len(problem.voxels), "entries": entries}


MEASURED = {"renders": renders, "iterations": iterations, "memory": memory}


def launched(kind: str, ranks: int, mpiexec: list[str]) -> dict[str, Any]:
    """A process with two threads, or two ranks with one each."""
    command = [sys.executable, __file__, "work", kind]
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1"}
    if ranks > 1:
        command = [*mpiexec, "-n", str(ranks), *command]
    done = subprocess.run(command, env=environment, capture_output=True, text=True)
    if done.returncode:
        raise SystemExit(f"{kind} on {ranks} ranks failed:\n{done.stderr}")
    return json.loads(done.stdout.splitlines()[-1])


def measure(file: Path, repeats: int, kinds: list[str], mpiexec: list[str]) -> None:
    found: dict[str, list[Any]] = defaultdict(list)
    for kind in kinds:
        for turn in range(repeats):
            for ranks in (1, 2) if turn % 2 == 0 else (2, 1):
                found[kind].append({"load": os.getloadavg()[0], **launched(kind, ranks, mpiexec)})
                print(json.dumps(found[kind][-1]), flush=True)
    file.write_text(json.dumps(found, indent=1) + "\n")
    efficiency(file)


def efficiency(file: Path) -> None:
    """Prints how fast two ranks are over one process, by the medians of all runs."""
    found = json.loads(file.read_text())
    for kind, place in (("renders", "strong"), ("iterations", None)):
        numbers: dict[tuple[int, str], list[float]] = defaultdict(list)
        for run in found.get(kind, []):
            ranks = [rank[place] if place else rank for rank in run["rank"]]
            walls, cpus = (
                [one[name] if place else one[name]["iteration"] for one in ranks] for name in ("wall", "cpu")
            )
            told = [one["told"] if place else one["cpu"].get("told", 0.0) for one in ranks]
            numbers[run["ranks"], "clock"].append(max(walls))
            numbers[run["ranks"], "CPU seconds"].append(max(cpus) * run["ranks"])
            work = max(cpu - part for cpu, part in zip(cpus, told))
            numbers[run["ranks"], "CPU seconds without those in MPI"].append(work * run["ranks"])
        for name in ("clock", "CPU seconds", "CPU seconds without those in MPI"):
            if numbers[1, name] and numbers[2, name]:
                one, two = (float(np.median(numbers[ranks, name])) for ranks in (1, 2))
                print(f"{kind}, by {name}: {one:.2f} s, {two:.2f} s: efficiency of two ranks {one / two:.2f}")
    for kind in ("iterations", "memory"):
        peaks: dict[int, list[int]] = {1: [], 2: []}
        for run in found.get(kind, []):
            peaks[run["ranks"]].append(max(rank["peak"] for rank in run["rank"]))
        if peaks[1] and peaks[2]:
            one, two = (min(peaks[ranks]) / 1e6 for ranks in (1, 2))
            print(
                f"{kind}, memory at its largest: {one:.0f} MB, the larger rank of two {two:.0f}, {two / one:.2f} of it"
            )


@dataclass(frozen=True)
class Assumptions:
    """Of the model: those of a GPU are of an H200 (docs/measurements/gpu.md), the others are guesses.

    Attributes
    ----------
    image : paths per second of images, scene C
    steps : what an iteration of scene C takes beside paths, s: launches and small kernels of the minimisation, which
        neither ranks nor fewer voxels make shorter
    memory : bytes per second that a device reads
    bus : bytes per second between device and host
    copy : that a small copy between them takes, s
    network : bytes per second of a rank to others
    latency : of a message, s
    host : NumPy's work of scene C that grows with the voxels, s
    balance : the mean over the largest share of the paths' work
    """

    image: float = 3.8e8
    steps: float = 0.47
    memory: float = 1.5e12
    bus: float = 2.5e10
    copy: float = 2e-5
    network: float = 1.0e10
    latency: float = 5e-6
    host: float = 0.01
    balance: float = 0.95


# Bytes of the prior's stencil for a voxel, of scene C.
STENCIL = 2450
# Of an H200, on grids of so many voxels: paths per second of derivatives, photons per second.
GRIDS = (38**3, 64**3, 128**3)
DERIVATIVES, PHOTONS = (2.5e7, 1.2e7, 6.0e6), (9.3e8, 1.1e9, 6.8e8)


@dataclass(frozen=True)
class Size:
    """Of a scene: its grid, voxels that may hold cloud, pixels that see them, slabs in a tile, work of its paths."""

    name: str
    grid: float
    voxels: float
    pixels: float
    slabs: float
    path: float  # of an image, over scene C's (docs/measurements/speed.md, growth)

    def rate(self, rates: tuple[float, ...]) -> float:
        """Between and beyond the grids that were measured, by powers."""
        places, logs, at = np.log(GRIDS), np.log(rates), np.log(self.grid)
        beyond = max(at - places[-1], 0.0) * (logs[-1] - logs[-2]) / (places[-1] - places[-2])
        return float(np.exp(np.interp(at, places, logs) + beyond))


def sizes(measured: dict[str, Any]) -> list[Size]:
    """Scene C as measured; the others by their grids: as large a share of voxels and pixels."""
    slabs = measured["entries"] / measured["pixels"] / 25
    c = Size("C, 38^3", 38**3, measured["voxels"], measured["pixels"], slabs, 1.0)

    def like_c(name: str, voxels: float, pixels: float, edge: float, path: float) -> Size:
        share = voxels / c.grid
        return Size(name, voxels, c.voxels * share, c.pixels * pixels / 76**2, c.slabs * edge / 38, path)

    return [
        c,
        like_c("F, 86 x 86 x 27", 86 * 86 * 27, 86**2, 27, 1.3),
        like_c("128^3, 9 x 256^2", 128**3, 256**2, 128, 1.5),
        like_c("512^3, 9 x 1024^2", 512**3, 1024**2, 512, 2.4),
    ]


def predicted(size: Size, measured: dict[str, Any], ranks: int, given: Assumptions) -> dict[str, float]:
    """Seconds of an iteration, by kind, and GB on a rank and sent by it."""
    from cloudtomo_cl.inversion.problem import PATHS_PER_VOXEL, VOXELS_PER_PIXEL

    grown = size.voxels / measured["voxels"]
    entries, cells = 25 * size.slabs * size.pixels, measured["cells"] * grown
    table, stencil = 8 * measured["bins"] * cells, STENCIL * size.voxels
    # Of derivatives, and images.
    paths = min(measured["paths"] * grown, PATHS_PER_VOXEL * VOXELS_PER_PIXEL * size.pixels)
    products, of_prior = measured["products"], measured["prior"]
    hops, several = float(np.ceil(np.log2(ranks))), (ranks - 1) / ranks
    traffic = (products * 12 * entries + of_prior * stencil) / given.memory
    # The prior's part of a product goes with that of the transpose.
    vectors = 4 * products / 2 * (size.pixels + size.voxels)
    messages = products * (ranks > 1)
    walked = paths / size.rate(DERIVATIVES) + paths * size.path / given.image + paths / size.rate(PHOTONS)
    seconds = {
        "paths": walked / ranks / given.balance if ranks > 1 else walked,
        "steps": given.steps + traffic / ranks,
        "host": given.host * grown,
        "table": (ranks > 1) * 2 * table / given.bus + 2 * several * table / given.network + 2 * hops * given.latency,
        "vectors": several * vectors / given.network + messages * (2 * given.copy + hops * given.latency),
        "values": several * 8 * entries / ranks * (1 / given.network + 1 / given.bus),
    }
    gb = ((20 if ranks == 1 else 24) * entries / ranks + table + stencil / ranks + 4 * paths / ranks) / 1e9
    return seconds | {"GB": gb, "sent GB": (table + vectors / ranks + 4 * entries / ranks) / 1e9 * (ranks > 1)}


def predict(file: Path, given: Assumptions) -> None:
    runs = [run["rank"][0] for run in json.loads(file.read_text())["iterations"] if run["ranks"] == 1]
    measured, kinds_ = runs[0], ("paths", "steps", "host", "table", "vectors", "values")
    print("A model, no measurement:", ", ".join(f"{name} {value:g}" for name, value in asdict(given).items()))
    print("\n| scene | ranks | s an iteration | speed-up | " + " | ".join(kinds_) + " | GB a rank | GB sent |")
    print("|---" * (len(kinds_) + 6) + "|")
    for size in sizes(measured):
        alone = 0.0
        for ranks in (1, 8, 64, 1000):
            found = predicted(size, measured, ranks, given)
            total = sum(found[kind] for kind in kinds_)
            alone = alone or total
            shares = " | ".join(f"{found[kind]:.2g}" for kind in kinds_)
            ends = f"{found['GB']:.2g} | {found['sent GB']:.2g}"
            print(f"| {size.name} | {ranks} | {total:.3g} | {alone / total:.1f} | {shares} | {ends} |")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    one = commands.add_parser("measure", help="one process and two ranks, in turn")
    one.add_argument("file", type=Path)
    one.add_argument("--repeats", type=int, default=3)
    one.add_argument("--kinds", nargs="+", choices=[*MEASURED], default=["renders", "iterations"])
    one.add_argument("--mpiexec", nargs="+", default=["mpiexec"], help="and its options")
    commands.add_parser("efficiency", help="what was measured").add_argument("file", type=Path)
    commands.add_parser("work", help="what ranks do").add_argument("kind", choices=[*MEASURED])
    model = commands.add_parser("predict", help="by a model")
    model.add_argument("file", type=Path)
    for name, value in asdict(Assumptions()).items():
        model.add_argument(f"--{name}", type=float, default=value)
    options = vars(parser.parse_args())
    command = options.pop("command")
    if command == "measure":
        measure(**options)
    elif command == "efficiency":
        efficiency(**options)
    elif command == "predict":
        predict(options.pop("file"), Assumptions(**options))
    else:
        found = work(options["kind"])
        if int(os.environ.get("PMI_RANK", os.environ.get("OMPI_COMM_WORLD_RANK", "0"))) == 0:
            print(json.dumps(found))


if __name__ == "__main__":
    main()
