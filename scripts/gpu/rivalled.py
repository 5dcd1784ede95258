"""Mitsuba 3 on the same GPU (cuda_ad_mono; on a CPU llvm_ad_mono): efficiency = 1 / (variance x seconds)."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from typing import TypeVar

import numpy as np
from benchmarks import mitsuba_peer
from benchmarks.scenes import Case, generated, scene_c
from benchmarks.timing import Disagreement, require_agreement

import cloudtomo_cl as ct
from cloudtomo_cl.opencl.devices import choose_device
from gpu.rows import Row, failed

_PART = "mitsuba"
_GOAL = 30.0
_REPEATS = 3
Result = TypeVar("Result")


def clocked(work: Callable[[], Result]) -> tuple[Result, float]:
    """What the work returns, and the seconds by the clock that it took."""
    start = time.perf_counter()
    result = work()
    return result, time.perf_counter() - start


def rows(quick: bool) -> Iterator[Row]:
    on_gpu = "GPU" in {info.kind for info in ct.list_devices() if info.name == choose_device().name}
    mitsuba_peer.VARIANT = "cuda_ad_mono" if on_gpu else "llvm_ad_mono"
    try:
        try:
            case = scene_c()
        except FileNotFoundError:
            case = generated(64)
        yield from forward(case, mitsuba_peer.MitsubaScene(case), on_gpu, quick)
    except mitsuba_peer.Missing as reason:
        yield Row(_PART, "efficiency over Mitsuba's volpath", "-", note=f"left out: {reason}")


def forward(case: Case, peer: mitsuba_peer.MitsubaScene, on_gpu: bool, quick: bool) -> Iterator[Row]:
    """One view's image, by both in turn; more paths on a GPU, lest launches count."""
    theirs, ours = (2048, 1 << 16) if on_gpu else (32, 256) if quick else (64, 512)
    operator = ct.RadianceOperator(case.scene, (case.view,))
    operator.render(case.extinction, 16, 1000)
    peer.sample_variance(theirs, 1000)
    peer.render(theirs, 1001)
    count = len(operator.pixels)
    variances, times, means = (np.zeros((_REPEATS, 2)) for _ in range(3))
    for n in range(_REPEATS):
        rendering, seconds = clocked(lambda n=n: operator.render(case.extinction, ours, n))
        image, their_seconds = clocked(lambda n=n: peer.render(theirs, 2 * n))
        _, single = peer.sample_variance(theirs, 2 * n + 1)
        variances[n] = np.mean(rendering.standard_error**2) * ours, single.mean()
        times[n] = seconds / ours / count, their_seconds / theirs / count
        means[n] = rendering.mean.mean(), image.mean()
    variance, mean = variances.mean(axis=0), means.mean(axis=0)
    error = np.sqrt(variance / count / (ours, theirs) / _REPEATS)
    try:
        note = require_agreement("radiance", mean[0], error[0], mean[1], error[1])
    except Disagreement as reason:
        yield failed(_PART, f"radiances differ: {reason}")
        return
    ratios = variance[1] * times[:, 1] / (variance[0] * times[:, 0])
    goal = f"; goal on a GPU {_GOAL:g}" if on_gpu else ""
    spread = f"{ratios.min():.3g} .. {ratios.max():.3g}"
    what = f"{case.name}: efficiency over Mitsuba's {mitsuba_peer.VARIANT}, by the clock"
    yield Row(_PART, what, float(np.median(ratios)), "", f"{spread}; {note}{goal}")
    speeds = np.median(1 / times, axis=0)
    yield Row(_PART, "Mitsuba's paths a second", float(speeds[1]), "paths/s", f"ours {speeds[0]:.3g}")
