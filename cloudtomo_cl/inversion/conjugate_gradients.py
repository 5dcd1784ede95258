"""Conjugate gradients with bounds: the minimum of terms on a device over what is not negative."""

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
from cloudtomo_cl.opencl.device import Device, device_errors
from cloudtomo_cl.opencl.gathering import Gathering
from cloudtomo_cl.opencl.layout import STRUCTS

# Ended when two steps in a row have gained less than this share of all that was gained.
TOLERANCE = 1e-7
# A step that goes farther than a term of unknown form was looked at: at most so many times as far.
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
    """The x from 0 to an upper bound that makes a sum of terms least, as far as so many products come.

    Every iteration takes one product with the second derivatives. A direction is the scaled gradient of what is free,
    and as much of the last change as makes it conjugate to it. A step along it is put onto the bounds where it crosses
    them, and the minimum on the way there is the next point: so the active bounds change by many at once, the function
    never rises, and where no bound is met these are conjugate gradients with a diagonal preconditioner. The device
    chooses steps, too: it never waits for the host. (docs/decisions/inner-minimisation.md compares it with others.)

    Parameters
    ----------
    terms : convex, or nearly so
    start : shape (unknowns,), within the bounds
    hessian_diagonal : about the second derivative's diagonal, positive, shape (unknowns,)
    iterations : at most, at least 1
    device : where to compute
    tolerance : share of all that was gained that two iterations in a row gain in the end
    upper : shape (unknowns,); by default there is no bound but 0

    Returns
    -------
    shape (unknowns,), float64
    """
    return _Minimisation(terms, start, hessian_diagonal, np.inf if upper is None else upper, device).run(
        iterations, tolerance
    )


class _Minimisation:
    """Where a minimisation stands: x, the terms' gradient there, the last change and the Hessian's product with it.

    All on the device.
    """

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
        # Where that costs the host nothing it is an iteration ahead, so that the device has something to do while it
        # looks whether that was the last one; one too many changes nothing. After as many as may be it is not.
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
        """Makes the next change, and the Hessian's product with it."""
        vectors = self._vectors
        vectors.launch(
            "next_change", x=self._x, upper=self._upper, gradient=self._gradient,
            inverse_diagonal=self._inverse_diagonal, state=self._state, change=self._change, product=self._product,
        )  # fmt: skip
        for term in self._quadratic:
            term.add_product(self._change, self._product)
        # Of several ranks, once for all terms.
        self._gathering.complete(self._product)
        self._hessian_change = self._secant() if self._others else self._product

    def _secant(self) -> DeviceArray:
        """The product, and how much the other terms' gradient changes along the change."""
        vectors = self._vectors
        there, product, gradient = self._x.copy(), self._product.copy(), vectors.zeros()
        vectors.add(1.0, self._change, there)
        for term in self._others:
            term.add_gradient(there, gradient)
        vectors.add(1.0, gradient, product)
        vectors.add(-1.0, self._of_others, product)
        return product

    def _step(self, iterations: int, tolerance: float) -> None:
        """Takes as much of the change as makes the function least, and sees what makes the next one conjugate."""
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
