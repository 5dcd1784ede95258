"""How much of a GPU would idle, and what its memory would carry: counted on the walks, without a GPU.

    python scripts/divergence.py [--paths 64]

Every path is walked by a kernel that counts its events and, in each event, its crossings of voxels: those of
the flight, of side flights and of shadow rays (a jump through clear space counts as one). The work items
of a GPU go in step, in warps of 32 or waves of 64, and all wait for the one with most to do. A step here is a
crossing, plus EVENT_STEPS for what an event does beside them. Compared are:

- one pixel: a work item walks a path, and its neighbours others of the same pixel, as the kernels have it;
- many pixels: neighbours walk paths of neighbouring pixels, as the kernels had it before;
- regeneration: a work item whose path has ended takes the next at once; neighbours still wait for each other
  within an event.

Idle is the share of the lanes' steps in which a lane waits.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pyopencl as cl
from benchmarks.scenes import Case, generated, scene_c

import cloudtomo_cl as ct
from cloudtomo_cl.opencl.parameters import PATHS, Kernel, macro

# What an event takes beside its crossings, in crossings: random numbers, phase functions, starts of flights
# (from the profile in docs/decisions/work-item-order.md).
EVENT_STEPS = 10
_EVENTS = 128  # those told apart, as in count.cl
_SOURCE = Path(__file__).with_name("benchmarks") / "count.cl"
_PARAMETERS = (*PATHS, "__global ushort *crossings", "__global uint *events")
# Bytes that a crossing, and that a path brings through the memory: extinction and clear distance; radiance written
# and read for the sum, the pixel's number.
_CROSSING_BYTES, _PATH_BYTES = 5, 16
# Atomic sums of the audit at a path's end: launched, its fate, and about one more.
_PATH_ATOMICS = 3


def steps_by_event(case: Case, paths: int, seed: int = 1) -> np.ndarray:
    """Steps of every path, int of shape (pixels, paths, events); 0 after its end."""
    operator = ct.RadianceOperator(case.scene, (case.view,))
    device, queue = operator.device, operator.device.queue
    pixels = len(operator.pixels)
    count = pixels * paths
    program = device.build(f"{macro('count_paths', _PARAMETERS)}\n{_SOURCE.read_text()}")
    kernel = Kernel(cl.Kernel(program, "count_paths"), "count_paths", _PARAMETERS)
    crossings, events = np.zeros((count, _EVENTS), np.uint16), np.zeros(count, np.uint32)
    counted, ended = device.constant(crossings), device.constant(events)
    medium = operator._device_scene.medium(case.extinction, skips_empty=True)
    given = operator._pixels.paths(medium, 0, count, seed, 0)
    device.launch(kernel, count, **given, crossings=counted, events=ended)
    cl.enqueue_copy(queue, crossings, counted)
    cl.enqueue_copy(queue, events, ended)
    lived = np.arange(_EVENTS) < events[:, None]
    steps = crossings.astype(np.int64) + EVENT_STEPS * lived
    return steps.reshape(paths, pixels, _EVENTS).transpose(1, 0, 2)


def idle_in_step(lanes: np.ndarray) -> float:
    """Share of idle steps where each lane has one path: lanes wait within events, and for the longest path.

    lanes : steps, shape (warps, width, events)
    """
    return float(1 - lanes.sum() / (lanes.max(axis=1).sum() * lanes.shape[1]))


def idle_with_regeneration(steps: np.ndarray, width: int, warps: int = 64) -> float:
    """Share of idle steps where each lane takes the next path when its own has ended.

    steps : shape (paths, events), in the order in which lanes take them
    """
    busy = waited = 0
    for part in np.array_split(steps, warps):
        alive = part > 0
        # What a lane does one event after another: the paths of the part, dealt out in turn.
        lanes = [part[lane::width][alive[lane::width]] for lane in range(width)]
        shortest = min(map(len, lanes))
        if shortest == 0:
            continue
        table = np.array([lane[:shortest] for lane in lanes])  # the ends, where lanes run dry, are left out
        busy += table.sum()
        waited += table.max(axis=0).sum() * width
    return 1 - busy / waited


def lines(case: Case, paths: int) -> Iterator[str]:
    """The case's lines of the table."""
    steps = steps_by_event(case, paths)
    events = (steps > 0).sum(axis=2)
    crossings = steps.sum(axis=2) - EVENT_STEPS * events
    for width in (32, 64):
        whole = paths // width * width
        same = steps[:, :whole].reshape(-1, width, _EVENTS)
        pixels = len(steps) // width * width
        many = steps[:pixels].transpose(1, 0, 2).reshape(-1, width, _EVENTS)
        ordered = steps.reshape(-1, _EVENTS)
        shares = idle_in_step(same), idle_in_step(many), idle_with_regeneration(ordered, width)
        yield f"| {case.name} | {width} | " + " | ".join(f"{100 * share:.0f} %" for share in shares) + " |"
    yield (
        f"{case.name}: {events.mean():.2f} events and {crossings.mean():.1f} crossings a path (largest: "
        f"{events.max()} events); {_CROSSING_BYTES * crossings.mean() + _PATH_BYTES:.0f} bytes and about "
        f"{_PATH_ATOMICS} atomic sums a path; replay: {crossings.mean():.0f} atomic sums more at most"
    )


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--paths", type=int, default=64, help="for each pixel, a multiple of 64")
    arguments = parser.parse_args()
    print("| scene | width | one pixel | many pixels | regeneration |\n|---|---|---|---|---|")
    for make in (scene_c, lambda: generated(64, 64)):
        for line in lines(make(), arguments.paths):
            print(line, flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
