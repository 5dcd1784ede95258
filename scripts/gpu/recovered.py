"""A recovery by the clock: seconds to an error eps, the best one, and what part of the time the device works."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from benchmarks.scenes import generated, scene_c

import cloudtomo_cl as ct
from gpu.profiled import Recorder
from gpu.rows import Row

_PART = "recovery"
_TARGETS = (0.50, 0.40, 0.36)
# Goals on a GPU, seconds: of scene C.
_GOALS = {0.40: 20.0, 0.36: 60.0}
_SECONDS, _QUICK_SECONDS = 65.0, 60.0
_SAMPLES, _QUICK_SAMPLES = 8192, 1024


@dataclass(frozen=True)
class Question:
    """What is recovered."""

    name: str
    scene: ct.Scene
    views: tuple[ct.PerspectiveView, ...]
    truth: np.ndarray


def question(quick: bool) -> Question:
    """Scene C by its nine cameras where its file is; else, and for a quick check, a generated cloud by as many."""
    try:
        case = generated(16) if quick else scene_c()
    except FileNotFoundError:
        case = generated(38)
    width, height = case.scene.grid.extent[0], case.scene.grid.extent[2]
    if case.name == "scene C":
        ring = ct.RingOfViews(target=(0.38, 0.38, 1.013), height=1.647, radius=0.5, field_of_view=85.4, pixels=(76, 76))
    else:
        ring = ct.RingOfViews(
            target=(width / 2, width / 2, height / 2), height=4 * height, radius=2 * width, field_of_view=32.0,
            pixels=(24, 24) if quick else (76, 76),
        )  # fmt: skip
    return Question(case.name, case.scene, ring.views(), case.extinction)


def rows(quick: bool) -> Iterator[Row]:
    asked, recorder = question(quick), Recorder()
    device = recorder.device
    operator = ct.RadianceOperator(asked.scene, asked.views, device)
    start = time.perf_counter()
    rendering = operator.render(asked.truth, _QUICK_SAMPLES if quick else _SAMPLES, seed=1)
    took = time.perf_counter() - start
    note = f"{asked.name}, {len(asked.views)} views, {rendering.samples} paths a pixel"
    yield Row(_PART, "images", took, "s", note)
    measurements = ct.Measurements.rendered(operator, rendering)
    history: list[ct.IterationRecord] = []
    recorder.clear()
    start = time.perf_counter()
    ct.reconstruct(
        asked.scene, measurements, device=device, seed=2, truth=asked.truth, callback=history.append, uncertainty=0,
        time_limit=_QUICK_SECONDS if quick else _SECONDS,
    )  # fmt: skip
    took = time.perf_counter() - start
    for target in _TARGETS:
        reached = [record.seconds for record in history if record.epsilon is not None and record.epsilon <= target]
        goal = _GOALS.get(target)
        note = f"goal on a GPU, of scene C: {goal:g} s" if goal else ""
        yield Row(_PART, f"time to eps {target:.2f}", reached[0] if reached else "not reached", "s", note)
    best = min(history, key=lambda record: record.epsilon or np.inf)
    yield Row(_PART, "best eps", best.epsilon or np.nan, "", f"after {best.seconds:.1f} s, {best.paths:.3g} paths")
    last = [record.seconds for record in history if record.stage == history[-1].stage]
    if len(last) > 1:
        note = f"median of {len(last) - 1}, stage {history[-1].stage + 1} of {history[-1].stages}"
        yield Row(_PART, "an iteration of the last stage", float(np.median(np.diff(last))), "s", note)
    busy = recorder.seconds()
    yield Row(
        _PART, "share of the time in which the device has nothing to do", 1 - sum(busy.values()) / took, "",
        f"{took:.1f} s, carving and all; {len(recorder.events)} launches",
    )  # fmt: skip
    for name, seconds in sorted(busy.items(), key=lambda item: -item[1])[:8]:
        yield Row(_PART, f"{name}: share of the device's time", seconds / sum(busy.values()))
