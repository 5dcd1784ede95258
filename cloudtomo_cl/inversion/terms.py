"""Terms of a function of the extinction, on a device: what solvers minimise, and users' priors as such."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar, Protocol

from cloudtomo_cl.inversion.vectors import Vectors
from cloudtomo_cl.opencl.arrays import DeviceArray
from cloudtomo_cl.opencl.device import Device

if TYPE_CHECKING:
    from cloudtomo_cl.inversion.bound_prior import FrozenPrior, NoiseUnits


class Term(Protocol):
    """One of the functions whose sum is minimised. Arrays are on the device: float32, shape (unknowns,).

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
