"""Paths per second, by the clock: of renders, gradients by replay, derivatives, and photons of fluxes."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
from benchmarks.scenes import Case, generated, scene_c

import cloudtomo_cl as ct
from cloudtomo_cl.transport.jacobian_average import JacobianAverage
from gpu.rows import Row, failed

_PART = "speed"
# What one measurement should take, seconds, and how often it is made.
_SECONDS, _QUICK_SECONDS, _REPEATS = 0.8, 0.2, 3
_MOST_STORED = 1 << 27  # paths of a render that is replayed: half a GB
_GOALS = {("scene C", "render"): 1e8}


def cases(quick: bool) -> Iterator[Case]:
    """Scene C's whole images, where its file is; two generated clouds, one of them for a quick check."""
    try:
        yield scene_c()
    except FileNotFoundError:
        pass
    yield generated(64)
    if not quick:
        yield generated(128)


def speed(work: Callable[[int], float], samples: int, most: int, seconds: float) -> tuple[list[float], int]:
    """Paths a second of repeats.

    Parameters
    ----------
    work : does its work with so many samples, and returns the seconds by the clock that it took
    samples, most : to begin with; no more
    seconds : that one repeat should take
    """
    took = work(samples)  # builds kernels
    while (took := work(samples)) < seconds / 2 and samples < most:
        samples = min(most, samples * int(np.clip(seconds / max(took, 1e-4), 2, 8)))
    return [samples / work(samples) for _ in range(_REPEATS)], samples


class Works:
    """What is timed on a case; each method takes a number of paths a pixel, and returns seconds."""

    def __init__(self, case: Case) -> None:
        self.case = case
        self.plain = ct.RadianceOperator(case.scene, (case.view,))
        self.masked = ct.RadianceOperator(case.scene, (case.view,), mask=case.extinction > 0)
        self.adjoint = np.full((len(self.plain.pixels), 2), 0.5)
        self.medium = self.plain.on_device(case.extinction)
        # Fluxes with open sides have no surface.
        self.fluxes_of = ct.FluxOperator(replace(case.scene, surface=ct.Surface(0.0)))
        self.sums: JacobianAverage | None = None
        self.seed = 0

    def _timed(self, work: Callable[[], object]) -> float:
        self.plain.device.queue.finish()
        start = time.perf_counter()
        work()
        self.plain.device.queue.finish()
        return time.perf_counter() - start

    def _stored(self, samples: int) -> ct.Rendering:
        self.seed += 1
        return self.masked.render(self.case.extinction, samples, self.seed, store_paths=True)

    def render(self, samples: int) -> float:
        self.seed += 1
        return self._timed(lambda: self.plain.render(self.medium, samples, self.seed))

    def replay(self, samples: int) -> float:
        rendering = self._stored(samples)
        return self._timed(lambda: self.masked.gradient(rendering, self.adjoint).get())

    def jacobian(self, samples: int) -> float:
        rendering = self._stored(samples)
        self.sums = self.sums or JacobianAverage(self.masked)
        return self._timed(lambda: self.sums.add(rendering, 1.0))

    def fluxes(self, samples: int) -> float:
        self.seed += 1
        photons = samples * len(self.plain.pixels)
        return self._timed(lambda: self.fluxes_of.compute(self.case.extinction, photons, self.seed))


def rows(quick: bool) -> Iterator[Row]:
    seconds = _QUICK_SECONDS if quick else _SECONDS
    for case in cases(quick):
        works = Works(case)
        pixels = len(works.plain.pixels)
        for name in ("render", "replay", "jacobian", "fluxes"):
            most = 1 << 22 if name in ("render", "fluxes") else max(_MOST_STORED // pixels // 2 * 2, 2)
            try:
                speeds, samples = speed(getattr(works, name), 8, most, seconds)
            except (ct.CloudtomoError, AssertionError) as error:
                yield failed(_PART, f"{case.name}, {name}: {error}")
                continue
            values = np.multiply(speeds, pixels)
            goal = _GOALS.get((case.name, name))
            note = f"{values.min():.3g} .. {values.max():.3g}; {samples} paths a pixel, {pixels} pixels"
            if goal is not None:
                note += f"; goal on a GPU {goal:g}"
            yield Row(_PART, f"{case.name}, {name}", float(np.median(values)), "paths/s", note)
