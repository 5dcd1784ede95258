"""How recoveries scale with ranks: what one and two take here, and a model of many.

    python scripts/scaling.py measure scaling.json       # scene C: two threads of one process, and two ranks, in turn
    python scripts/scaling.py predict scaling.json       # a model; its assumptions are options, and printed with it

Measures renders (the same paths: strong; as many more as there are ranks: weak) and iterations of Gauss-Newton on the
finest grid. Needs mpi4py and mpiexec, and scene C's file (CLOUDTOMO_DATA). Times are the clock's, on a machine with
nothing else on it, and CPU seconds of each rank. docs/measurements/scaling.md holds the last tables.
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
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

RENDER_SAMPLES, IMAGE_SAMPLES, ITERATIONS = 128, 64, int(os.environ.get("SCALING_ITERATIONS", "3"))
SEED = 2
# Beside the true cloud voxels that a mask from carving would have, too.
MARGIN = 2


def timed_methods() -> dict[str, list[tuple[Any, str]]]:
    """What is timed, by kind: work that ranks share (paths, products, exchange), and what every rank does."""
    from cloudtomo_cl.transport.derivatives import RadianceTable
    from cloudtomo_cl.transport.jacobian import Jacobian, JacobianSums
    from cloudtomo_cl.transport.radiance import RadianceOperator

    return {
        "paths": [(RadianceOperator, "_walk"), (JacobianSums, "_add_rows"), (RadianceTable, "_walk")],
        "products": [(Jacobian, "times"), (Jacobian, "transposed"), (Jacobian, "curvature")],
        "table": [(RadianceTable, "prepare")],
    }


def _awaited(result: Any, owner: Any) -> Any:
    """A result, once the kernels have run that products only start."""
    structure = getattr(owner, "_structure", None)
    if structure is not None:
        structure.device.queue.finish()
    return result


class Clock:
    """Seconds by kind, of the clock and of the processor, and how many calls."""

    def __init__(self) -> None:
        self.clear()
        for kind, methods in timed_methods().items():
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


def work(kind: str) -> dict[str, Any]:
    """What one rank measures: a dict of numbers."""
    import cloudtomo_cl as ct
    from cloudtomo_cl.parallel.launched import launched_ranks

    device = ct.choose_device(communicator=launched_ranks())
    ranks, clock = device.ranks, Clock()
    found = (renders if kind == "renders" else iterations)(device, clock)
    status = Path("/proc/self/status").read_text()
    found["peak"] = int(status.split("VmHWM:")[1].split()[0]) * 1024
    return {"ranks": ranks.size, "rank": ranks.all(found)} if ranks.size > 1 else {"ranks": 1, "rank": [found]}


def renders(device: Any, clock: Clock) -> dict[str, Any]:
    import cloudtomo_cl as ct

    given, views, extinction = scene()
    operator = ct.RadianceOperator(given, views, device)
    operator.render(extinction, 8)
    found = {}
    for name, samples in (("strong", RENDER_SAMPLES), ("weak", RENDER_SAMPLES * device.ranks.size)):
        clock.clear()
        device.ranks.all(None)
        clock.of(name, lambda samples=samples: operator.render(extinction, samples, SEED))
        found[name] = {"wall": clock.wall[name], "cpu": clock.cpu["paths"]}
    return found


def iterations(device: Any, clock: Clock) -> dict[str, Any]:
    from scipy.ndimage import binary_dilation

    import cloudtomo_cl as ct
    from cloudtomo_cl.transport.directions import BINS

    given, views, extinction = scene()
    operator = ct.RadianceOperator(given, views, device)
    measured = ct.Measurements.rendered(operator, operator.render(extinction, IMAGE_SAMPLES, 1))
    mask = binary_dilation(extinction > 0, iterations=MARGIN)
    problem, solver = ct.Problem.of(given, measured, mask=mask, device=device), ct.GaussNewton()
    state = solver.init(problem, np.full(len(problem.voxels), 5.0))
    state, _ = solver.step(problem, state, seed=SEED, stream=1)
    clock.clear()
    sent, paths = device.ranks.sent, 0
    for stream in range(2, 2 + ITERATIONS):
        state, progress = clock.of(
            "iteration", lambda stream=stream, state=state: solver.step(problem, state, seed=SEED, stream=stream)
        )
        paths += progress.paths
    structure, table = state.derivatives._sums.structure, state.derivatives._sums._table
    return {
        "wall": {name: value / ITERATIONS for name, value in clock.wall.items()},
        "cpu": {name: value / ITERATIONS for name, value in clock.cpu.items()},
        "products": clock.calls["products"] / ITERATIONS,
        "sent": (device.ranks.sent - sent) / ITERATIONS,
        "paths": paths / ITERATIONS,
        "pixels": len(problem.active),
        "voxels": len(problem.voxels),
        "entries": structure.entries,
        "cells": table.cells,
        "bins": BINS,
    }


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


@dataclass(frozen=True)
class Assumptions:
    """Of the model. Seconds and bytes; speeds are those of one core of the machine that was measured, times a factor.

    Attributes
    ----------
    cores : of a device: what its speed in paths is, over one core
    memory : bytes per second that products with the Jacobian read, on a device
    host : speed of what every rank does alike, over one core here
    network : bytes per second of a rank to others
    latency : of a message, s
    balance : the mean over the largest share of the paths' work
    """

    cores: float = 80.0
    memory: float = 1.5e12
    host: float = 1.0
    network: float = 1.0e10
    latency: float = 5e-6
    balance: float = 0.95


@dataclass(frozen=True)
class Size:
    """Of a scene: voxels that may hold cloud, pixels that see them, slabs of voxels in a tile, work of a path."""

    name: str
    voxels: float
    pixels: float
    slabs: float
    path: float  # over scene C's (docs/measurements/speed.md, growth)


def sizes(measured: dict[str, Any]) -> list[Size]:
    """Scene C as measured; the others by their grids: as large a share of voxels and pixels."""
    c = Size("C, 38^3", measured["voxels"], measured["pixels"], measured["entries"] / measured["pixels"] / 25, 1.0)

    def like_c(name: str, voxels: float, pixels: float, edge: float, path: float) -> Size:
        return Size(name, c.voxels * voxels / 38**3, c.pixels * pixels / 76**2, c.slabs * edge / 38, path)

    return [
        c,
        like_c("F, 86 x 86 x 27", 86 * 86 * 27, 86**2, 27, 1.3),
        like_c("128^3, 9 x 256^2", 128**3, 256**2, 128, 1.5),
        like_c("512^3, 9 x 1024^2", 512**3, 1024**2, 512, 2.4),
    ]


def predicted(size: Size, measured: dict[str, Any], ranks: int, given: Assumptions) -> dict[str, float]:
    """Seconds of an iteration, by kind, and GB on a rank and sent by it."""
    cells = measured["cells"] / measured["voxels"] * size.voxels
    table = 8 * measured["bins"] * cells
    entries = 25 * size.slabs * size.pixels
    paths = measured["paths"] / measured["voxels"] * size.voxels
    hops = np.ceil(np.log2(ranks)) if ranks > 1 else 0.0
    own, alike = measured["cpu"], measured["cpu"]
    beside = alike["iteration"] - own["paths"] - own["products"]
    grown = size.voxels / measured["voxels"]
    several = (ranks - 1) / ranks
    vectors = measured["products"] * 2 * (size.pixels + size.voxels)  # 4 bytes each, one of two in each product
    seconds = {
        "paths": own["paths"] / measured["paths"] * paths * size.path / given.cores / ranks / given.balance,
        "products": measured["products"] * 12 * entries / given.memory / ranks,
        "alike": beside * grown / given.host,
        "table": 2 * several * table / given.network + 2 * hops * given.latency,
        "vectors": several * vectors / given.network + measured["products"] * hops * given.latency,
        "values": several * 4 * entries / ranks / given.network + (ranks - 1) * given.latency,
    }
    gb = (20 * entries / ranks + 1.5 * table + 4 * paths / 6 / ranks) / 1e9
    return seconds | {"GB": gb, "sent GB": (table + vectors / ranks + 4 * entries / ranks) / 1e9 * (ranks > 1)}


def predict(file: Path, given: Assumptions) -> None:
    runs = [run["rank"][0] for run in json.loads(file.read_text())["iterations"] if run["ranks"] == 1]
    measured = runs[int(np.argmin([run["cpu"]["iteration"] for run in runs]))]
    print("A model, no measurement:", ", ".join(f"{name} {value:g}" for name, value in asdict(given).items()))
    kinds_ = ("paths", "products", "alike", "table", "vectors", "values")
    print("\n| scene | ranks | s an iteration | speed-up | " + " | ".join(kinds_) + " | GB a rank | GB sent |")
    print("|---" * (len(kinds_) + 6) + "|")
    for size in sizes(measured):
        alone = 0.0
        for ranks in (1, 8, 64, 256, 1000):
            found = predicted(size, measured, ranks, given)
            total = sum(found[kind] for kind in kinds_)
            alone = alone or total
            shares = " | ".join(f"{found[kind] / total:.0%}" for kind in kinds_)
            ends = f"{found['GB']:.3g} | {found['sent GB']:.3g}"
            print(f"| {size.name} | {ranks} | {total:.3g} | {alone / total:.1f} | {shares} | {ends} |")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    one = commands.add_parser("measure", help="one process and two ranks, in turn")
    one.add_argument("file", type=Path)
    one.add_argument("--repeats", type=int, default=3)
    one.add_argument("--kinds", nargs="+", choices=("renders", "iterations"), default=["renders", "iterations"])
    one.add_argument("--mpiexec", nargs="+", default=["mpiexec"], help="and its options")
    commands.add_parser("work", help="what ranks do").add_argument("kind", choices=("renders", "iterations"))
    model = commands.add_parser("predict", help="by a model")
    model.add_argument("file", type=Path)
    for name, value in asdict(Assumptions()).items():
        model.add_argument(f"--{name}", type=float, default=value)
    options = vars(parser.parse_args())
    command = options.pop("command")
    if command == "measure":
        measure(**options)
    elif command == "predict":
        predict(options.pop("file"), Assumptions(**options))
    else:
        found = work(options["kind"])
        if int(os.environ.get("PMI_RANK", os.environ.get("OMPI_COMM_WORLD_RANK", "0"))) == 0:
            print(json.dumps(found))


if __name__ == "__main__":
    main()
