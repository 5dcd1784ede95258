"""Priors as terms of what solvers minimise, those among them that users write for the host."""

from __future__ import annotations

from typing import ClassVar

from cloudtomo_cl.inversion.noise_units import NoiseUnits
from cloudtomo_cl.inversion.stage_prior import FrozenPrior
from cloudtomo_cl.inversion.terms import Term
from cloudtomo_cl.inversion.vectors import Vectors
from cloudtomo_cl.opencl.arrays import DeviceArray
from cloudtomo_cl.opencl.device import Device


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
