"""Terms of a function of the extinction, on a device: what solvers minimise, and users' priors as such."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, ClassVar, Protocol

import numpy as np

from cloudtomo_cl.inversion.vectors import Vectors
from cloudtomo_cl.opencl.arrays import DeviceArray
from cloudtomo_cl.opencl.device import Device

if TYPE_CHECKING:
    from cloudtomo_cl.inversion.bound_prior import FrozenPrior, NoiseUnits


class Term(Protocol):
    """One of the functions whose sum is minimised. Arrays are on the device: float32, shape (unknowns,).

    Of terms with a true `launches_alone`, products are launches on arrays that stay the same and nothing else, which
    may be made again without a call (`Device.repeated`).

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


class HostTerm:
    """A prior that knows arrays of the host alone, as users write them."""

    quadratic: ClassVar[bool] = False

    def __init__(self, prior: FrozenPrior, units: NoiseUnits, device: Device) -> None:
        self._prior, self._units, self._device = prior, units, device

    def add_gradient(self, x: DeviceArray, result: DeviceArray) -> None:
        _, gradient = self._prior.value_and_gradient(x.get().astype(float), self._units)
        vectors = Vectors(self._device, len(gradient))
        vectors.add(1.0, vectors.of(gradient), result)

    def add_product(self, x: DeviceArray, result: DeviceArray) -> None:
        raise NotImplementedError("a function of unknown form has no second derivative")


def term_of(prior: FrozenPrior, units: NoiseUnits, device: Device) -> Term:
    """A prior as one of the terms that a step minimises: on the device where it can."""
    made = getattr(prior, "term", None)
    return HostTerm(prior, units, device) if made is None else made(units)


class HostStiffness:
    """The Gaussian part of a prior that knows arrays of the host alone, around 0."""

    quadratic: ClassVar[bool] = True

    def __init__(self, prior: FrozenPrior, units: NoiseUnits, device: Device) -> None:
        self._prior, self._units, self._device = prior, units, device

    def add_gradient(self, x: DeviceArray, result: DeviceArray) -> None:
        self.add_product(x, result)

    def add_product(self, x: DeviceArray, result: DeviceArray) -> None:
        product = self._prior.stiffness(x.get().astype(float)[:, None], self._units)[:, 0]
        vectors = Vectors(self._device, len(product))
        vectors.add(1.0, vectors.of(product), result)


def stiffness_of(prior: FrozenPrior, units: NoiseUnits, device: Device) -> Term:
    """A prior's second derivative as that of a term, as far as it is Gaussian."""
    term = term_of(prior, units, device)
    return term if term.quadratic else HostStiffness(prior, units, device)


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
    def launches_alone(self) -> bool:
        """See `Term`."""
        return all(getattr(term, "launches_alone", False) for term in self._terms)

    def add_gradient(self, x: DeviceArray, result: DeviceArray) -> None:
        self._vectors.launch("find_change", x=x, start=self._centre, result=self._change)
        self.add_product(self._change, result)
        self._vectors.add(1.0, self._slope, result)

    def add_product(self, x: DeviceArray, result: DeviceArray) -> None:
        for term in self._terms:
            term.add_product(x, result)
