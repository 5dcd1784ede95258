"""Terms of a function of the extinction, on a device: what solvers minimise."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar, Protocol

import numpy as np

from cloudtomo_cl.inversion.vectors import Vectors
from cloudtomo_cl.opencl.arrays import DeviceArray
from cloudtomo_cl.opencl.device import Device
from cloudtomo_cl.parallel.ranks import Shares


class Term(Protocol):
    """One of the functions whose sum is minimised. Arrays are on the device: float32, shape (unknowns,).

    Of terms with a true `repeatable`, products are launches on arrays that stay the same, and `Device.step`s, and
    nothing else: they may be made again without a call (`Device.repeated`). Of terms with `shares` each rank makes its
    own numbers of gradients and products, and whoever adds them up hands them out; of others every rank makes all.

    Attributes
    ----------
    quadratic : whether it is, and has `add_product`
    """

    quadratic: ClassVar[bool]

    def add_gradient(self, x: DeviceArray, result: DeviceArray) -> None:
        """Adds its gradient at x."""
        ...

    def add_product(self, x: DeviceArray, result: DeviceArray) -> None:
        """Adds its second derivative times x."""
        ...


def shares_of(terms: Sequence[Term]) -> Shares | None:
    """Which rank makes which numbers of the sum of some terms; none where each makes all."""
    found = [shares for shares in (getattr(term, "shares", None) for term in terms) if shares is not None]
    owners = [shares.owner for shares in found if shares.owner is not None]
    assert all(np.array_equal(owners[0], other) for other in owners), "a sum is made whole by one rank"
    return found[0] if found else None


class Around:
    """The function with the second derivatives of some terms, and a slope at a centre.

    Parameters
    ----------
    terms : quadratic
    centre : shape (unknowns,)
    slope : there
    device : where to compute
    """

    quadratic: ClassVar[bool] = True

    def __init__(self, terms: Sequence[Term], centre: np.ndarray, slope: np.ndarray, device: Device) -> None:
        self._terms, self._vectors = terms, Vectors(device, len(centre))
        self._centre, self._slope = self._vectors.of(centre), self._vectors.of(slope)
        self._change = self._vectors.zeros()

    @property
    def repeatable(self) -> bool:
        """See `Term`."""
        return all(getattr(term, "repeatable", False) for term in self._terms)

    @property
    def shares(self) -> Shares | None:
        """See `Term`."""
        return shares_of(self._terms)

    def add_gradient(self, x: DeviceArray, result: DeviceArray) -> None:
        self._vectors.launch("find_change", x=x, start=self._centre, result=self._change)
        self.add_product(self._change, result)
        self._vectors.add(1.0, self._slope, result)

    def add_product(self, x: DeviceArray, result: DeviceArray) -> None:
        for term in self._terms:
            term.add_product(x, result)
