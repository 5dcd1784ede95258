"""Conjugate gradients with bounds: the minimum of terms on a device over what is not negative."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cloudtomo_cl.inversion.terms import Term
from cloudtomo_cl.inversion.vectors import Vectors, sum_of
from cloudtomo_cl.opencl.arrays import DeviceArray
from cloudtomo_cl.opencl.device import Device, device_errors

# A step aims so much farther than the last one should have gone, lest bounds cut it short, and at most changes its
# length by this factor.
_AIM, _LARGEST_CHANGE = 1.3, 2.0
# Ended when so many steps in a row have gained less than this share of all that was gained.
TOLERANCE, _PATIENCE = 1e-7, 2
# A step that goes farther than a term of unknown form was looked at: at most so many times as far.
_EXTRAPOLATION = 2.0


@device_errors("the minimisation")
def minimised(
    terms: Sequence[Term],
    start: np.ndarray,
    stiffness: np.ndarray,
    iterations: int,
    device: Device,
    tolerance: float = TOLERANCE,
) -> np.ndarray:
    """The x >= 0 that makes a sum of terms least, as far as so many products come.

    Every iteration takes one product with the second derivatives. A direction is the scaled gradient of what is free,
    and as much of the last change as makes it conjugate to it. A step along it is put onto the bounds where it crosses
    them, and the minimum on the way there is the next point: so the active bounds change by many at once, the function
    never rises, and where no bound is met these are conjugate gradients with a diagonal preconditioner. Only sums come
    to the host. (docs/decisions/inner-minimisation.md compares it with others.)

    Parameters
    ----------
    terms : convex, or nearly so
    start : shape (unknowns,), not negative
    stiffness : about the second derivative's diagonal, positive, shape (unknowns,)
    iterations : at most
    device : where to compute
    tolerance : share of all that was gained that two iterations in a row gain in the end

    Returns
    -------
    shape (unknowns,), float64
    """
    return _Descent(terms, start, stiffness, device).run(iterations, tolerance)


class _Descent:
    """Where a minimisation stands: x, the terms' gradient there, the last change and its image."""

    def __init__(self, terms: Sequence[Term], start: np.ndarray, stiffness: np.ndarray, device: Device) -> None:
        self._quadratic = [term for term in terms if term.quadratic]
        self._others = [term for term in terms if not term.quadratic]
        vectors = self._vectors = Vectors(device, len(start))
        self._x, self._scale = vectors.of(start), vectors.of(1 / stiffness)
        self._change, self._image = vectors.zeros(), vectors.zeros()
        self._linear = vectors.zeros()
        for term in self._quadratic:
            term.add_gradient(self._x, self._linear)
        self._gradient = self._whole_gradient()

    def run(self, iterations: int, tolerance: float) -> np.ndarray:
        """See `minimised`."""
        length, conjugation, gained, poor = 1.0, 0.0, 0.0, 0
        for _ in range(iterations):
            slope, curvature, farthest = self._looked(conjugation, length)
            if slope >= 0 and conjugation > 0:
                slope, curvature, farthest = self._looked(0.0, length)
            if not slope < 0:
                break
            best = -slope / curvature if curvature > 0 else np.inf
            taken = min(best, farthest, _EXTRAPOLATION if self._others else np.inf)
            if not np.isfinite(taken):
                break
            self._step(taken)
            gain = -taken * (slope + 0.5 * taken * curvature)
            gained += gain
            poor = poor + 1 if gain <= tolerance * gained else 0
            if poor == _PATIENCE:
                break
            length *= min(max(_AIM * best, 1 / _LARGEST_CHANGE), _LARGEST_CHANGE)
            conjugation = self._conjugation(curvature)
        return self._x.get().astype(float)

    def _looked(self, conjugation: float, length: float) -> tuple[float, float, float]:
        """Makes the next change: slope and curvature along it, and how many times as far x stays feasible."""
        vectors = self._vectors
        vectors.launch(
            "next_change", x=self._x, gradient=self._gradient, scale=self._scale, conjugation=conjugation,
            length=length, change=self._change,
        )  # fmt: skip
        self._product = vectors.zeros()
        for term in self._quadratic:
            term.add_product(self._change, self._product)
        self._image = self._secant() if self._others else self._product
        slopes, curvatures, farthest = vectors.parts(
            "sums_of_change", x=self._x, gradient=self._gradient, change=self._change, image=self._image
        )
        return sum_of(slopes), sum_of(curvatures), float(farthest.min())

    def _secant(self) -> DeviceArray:
        """The product, and how much the other terms' gradient changes along the change."""
        vectors = self._vectors
        there, image, gradient = self._x.copy(), self._product.copy(), vectors.zeros()
        vectors.add(1.0, self._change, there)
        for term in self._others:
            term.add_gradient(there, gradient)
        vectors.add(1.0, gradient, image)
        vectors.add(-1.0, self._of_others, image)
        return image

    def _step(self, length: float) -> None:
        self._vectors.launch(
            "take_step", length=length, change=self._change, image=self._product, x=self._x, gradient=self._linear
        )
        self._gradient = self._whole_gradient()

    def _whole_gradient(self) -> DeviceArray:
        if not self._others:
            return self._linear
        gradient, self._of_others = self._linear.copy(), self._vectors.zeros()
        for term in self._others:
            term.add_gradient(self._x, self._of_others)
        self._vectors.add(1.0, self._of_others, gradient)
        return gradient

    def _conjugation(self, curvature: float) -> float:
        """How much of the last change makes the next direction conjugate to it."""
        if not curvature > 0:
            return 0.0
        (parts, _, _) = self._vectors.parts(
            "sums_of_gradient", x=self._x, gradient=self._gradient, scale=self._scale, image=self._image
        )
        return max(-sum_of(parts) / curvature, 0.0)
