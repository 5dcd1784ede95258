"""Conjugate gradients with bounds: the minimum of a sum of terms, over x >= 0, on a device."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from contextlib import nullcontext
from itertools import count
from typing import Any

import numpy as np

from cloudtomo_cl.inversion.terms import Term, shares_of
from cloudtomo_cl.inversion.vectors import PARTS, Vectors
from cloudtomo_cl.opencl.arrays import DeviceArray
from cloudtomo_cl.opencl.device import Device
from cloudtomo_cl.opencl.driver import device_errors
from cloudtomo_cl.opencl.gathering import Gathering
from cloudtomo_cl.opencl.layout import STRUCTS

# A minimisation ends when each of two steps in a row gains less than this share of all gains so far.
TOLERANCE = 1e-7
# Where a term is not quadratic, whose gradient is known at the tried change alone, a step is at most this many times as
# long as that change.
_EXTRAPOLATION = 2.0


@device_errors("the minimisation")
def minimised(
    terms: Sequence[Term],
    start: np.ndarray,
    hessian_diagonal: np.ndarray,
    iterations: int,
    device: Device,
    tolerance: float = TOLERANCE,
    upper: np.ndarray | None = None,
) -> np.ndarray:
    """The x between 0 and an upper bound that minimises a sum of terms, as far as `iterations` iterations come.

    Every iteration takes one product with the Hessian. Its direction is the scaled negative gradient, plus as much of
    the last change as makes it conjugate to that change. A step along the direction is projected onto the bounds where
    it crosses them, and the minimum on the straight line to there is the next point. So many active bounds change at
    once, the function never rises, and where no bound is met this is the method of conjugate gradients with a diagonal
    preconditioner. The device chooses the steps, too, and never waits for the host.
    (docs/decisions/inner-minimisation.md compares this with other methods.)

    Parameters
    ----------
    terms : terms of the function, convex or nearly so
    start : x to begin with, shape (unknowns,), within the bounds
    hessian_diagonal : approximate diagonal of the Hessian, positive, shape (unknowns,)
    iterations : largest number of iterations, at least 1
    device : device that computes
    tolerance : least gain of an iteration, as a share of all gains; two poorer ones in a row end the minimisation
    upper : upper bound of x, shape (unknowns,); by default the only bound is 0

    Returns
    -------
    x at the minimum, shape (unknowns,), float64
    """
    return _Minimisation(terms, start, hessian_diagonal, np.inf if upper is None else upper, device).run(
        iterations, tolerance
    )


class _Minimisation:
    """State of a minimisation, on the device: x, the gradient there, the last change, the Hessian times that change."""

    def __init__(
        self,
        terms: Sequence[Term],
        start: np.ndarray,
        hessian_diagonal: np.ndarray,
        upper: np.ndarray | float,
        device: Device,
    ) -> None:
        self._quadratic = [term for term in terms if term.quadratic]
        self._others = [term for term in terms if not term.quadratic]
        self._repeats = all(getattr(term, "repeatable", False) for term in terms)
        self._device = device
        self._gathering = Gathering(device, shares_of(self._quadratic))
        vectors = self._vectors = Vectors(device, len(start))
        self._x, self._inverse_diagonal = vectors.of(start), vectors.of(1 / hessian_diagonal)
        self._upper = vectors.of(np.broadcast_to(upper, start.shape))
        self._change, self._product, self._linear = (vectors.zeros() for _ in range(3))
        self._sums = device.empty((3, PARTS), np.float32)
        begin = np.zeros(1, STRUCTS["Minimisation"])
        begin["length"] = 1.0
        self._state = device.array(begin)
        for term in self._quadratic:
            term.add_gradient(self._x, self._linear)
        self._gathering.complete(self._linear)
        self._gradient = self._whole_gradient()

    def run(self, iterations: int, tolerance: float) -> np.ndarray:
        """See `minimised`."""

        def iterate() -> None:
            self._look()
            self._step(iterations, tolerance)

        repeated = self._device.repeated if self._repeats else nullcontext
        # If repeating an iteration costs the host little, it queues one iteration ahead: the device has work while the
        # host looks whether the one before was the last. A superfluous iteration changes nothing.
        behind: deque[tuple[np.ndarray, Any]] = deque()
        with repeated(iterate) as again:
            for number in count(1):
                again()
                behind.append(self._state.get_async())
                while len(behind) > (self._repeats and number < iterations):
                    state, copied = behind.popleft()
                    copied.wait()
                    if state["ended"][0]:
                        return self._x.get().astype(float)
        raise AssertionError("a minimisation has no end")

    def _look(self) -> None:
        """Computes the next change that is tried, and the Hessian's product with it."""
        vectors = self._vectors
        vectors.launch(
            "next_change", x=self._x, upper=self._upper, gradient=self._gradient,
            inverse_diagonal=self._inverse_diagonal, state=self._state, change=self._change, product=self._product,
        )  # fmt: skip
        for term in self._quadratic:
            term.add_product(self._change, self._product)
        # With several ranks: one exchange for the sum of all terms.
        self._gathering.complete(self._product)
        self._hessian_change = self._secant() if self._others else self._product

    def _secant(self) -> DeviceArray:
        """The Hessian's product, plus the change of the other terms' gradient along the change."""
        vectors = self._vectors
        there, product, gradient = self._x.copy(), self._product.copy(), vectors.zeros()
        vectors.add(1.0, self._change, there)
        for term in self._others:
            term.add_gradient(there, gradient)
        vectors.add(1.0, gradient, product)
        vectors.add(-1.0, self._of_others, product)
        return product

    def _step(self, iterations: int, tolerance: float) -> None:
        """Takes the part of the change that minimises the function, and makes the next direction conjugate to it."""
        vectors, state, sums = self._vectors, self._state, self._sums
        vectors.launch_parts(
            "sums_of_change", x=self._x, upper=self._upper, gradient=self._gradient, change=self._change,
            hessian_change=self._hessian_change, sums=sums,
        )  # fmt: skip
        vectors.launch_once(
            "choose_step", sums=sums, longest=_EXTRAPOLATION if self._others else np.inf, most_steps=iterations,
            tolerance=tolerance, state=state,
        )  # fmt: skip
        vectors.launch(
            "take_step", state=state, change=self._change, hessian_change=self._product, x=self._x, upper=self._upper,
            gradient=self._linear,
        )  # fmt: skip
        self._gradient = self._whole_gradient()
        vectors.launch_parts(
            "sums_of_gradient", x=self._x, upper=self._upper, gradient=self._gradient,
            inverse_diagonal=self._inverse_diagonal, hessian_change=self._hessian_change, sums=sums,
        )  # fmt: skip
        vectors.launch_once("choose_conjugation", sums=sums, state=state)

    def _whole_gradient(self) -> DeviceArray:
        if not self._others:
            return self._linear
        gradient, self._of_others = self._linear.copy(), self._vectors.zeros()
        for term in self._others:
            term.add_gradient(self._x, self._of_others)
        self._vectors.add(1.0, self._of_others, gradient)
        return gradient
