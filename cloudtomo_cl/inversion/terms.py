"""Terms of a function of the extinction, on a device: what solvers minimise, and users' priors as such."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, ClassVar, Protocol

import numpy as np

from cloudtomo_cl.inversion.vectors import Vectors
from cloudtomo_cl.opencl.arrays import DeviceArray
from cloudtomo_cl.opencl.device import Device
from cloudtomo_cl.parallel.ranks import Shares

if TYPE_CHECKING:
    from cloudtomo_cl.inversion.stage_prior import FrozenPrior, NoiseUnits


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


class HostHessian:
    """The Gaussian part of a prior that knows arrays of the host alone, around 0."""

    quadratic: ClassVar[bool] = True

    def __init__(self, prior: FrozenPrior, units: NoiseUnits, device: Device) -> None:
        self._prior, self._units, self._device = prior, units, device

    def add_gradient(self, x: DeviceArray, result: DeviceArray) -> None:
        self.add_product(x, result)

    def add_product(self, x: DeviceArray, result: DeviceArray) -> None:
        product = self._prior.hessian_times(x.get().astype(float)[:, None], self._units)[:, 0]
        vectors = Vectors(self._device, len(product))
        vectors.add(1.0, vectors.of(product), result)


def hessian_of(prior: FrozenPrior, units: NoiseUnits, device: Device) -> Term:
    """A prior's second derivative as that of a term, as far as it is Gaussian."""
    term = term_of(prior, units, device)
    return term if term.quadratic else HostHessian(prior, units, device)


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
