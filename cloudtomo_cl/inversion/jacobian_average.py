"""Derivatives of all pixels, averaged over iterations."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from cloudtomo_cl.inversion.problem import Problem
from cloudtomo_cl.transport.jacobian import Jacobian, JacobianSums
from cloudtomo_cl.transport.radiance import Rendering


class JacobianAverage:
    """The average of the derivatives of some iterations; it is changed in place, for it is large.

    Parameters
    ----------
    problem : whose pixels and voxels
    rate : share of an iteration, counted from 0, in the average
    """

    def __init__(self, problem: Problem, rate: Callable[[int], float]) -> None:
        self._sums = JacobianSums(problem.operator)
        self._rate = rate
        self._iterations = 0
        self.jacobian: Jacobian = self._sums.jacobian

    def add(self, problem: Problem, extinction: np.ndarray, seed: int, stream: int) -> Rendering:
        """Renders an extinction, km^-1, shape (voxels,), and averages its derivatives in; returns the rendering."""
        samples = problem.default_samples if problem.samples is None else problem.samples
        rendering = problem.operator.render(problem.on_grid(extinction), samples, seed, stream, store_paths=True)
        self._sums.add(rendering, self._rate(self._iterations))
        self._iterations += 1
        return rendering
