"""The patch prior of one step: a quadratic function, and its products (patches.cl)."""

from __future__ import annotations

from functools import cached_property

import numpy as np

from cloudtomo_cl.inversion.patch_components import Components
from cloudtomo_cl.inversion.patch_operator import PatchOperator
from cloudtomo_cl.opencl.arrays import DeviceArray
from cloudtomo_cl.opencl.driver import device_errors
from cloudtomo_cl.opencl.gathering import Gathering


class PatchQuadratic:
    """The sum of all patches' quadratic forms, with the components that are likeliest at u, minus a clear sky's value.

    Parameters
    ----------
    operator : patch prior on the device
    u : extinction in units of s, shape (voxels,)
    noise : standard deviation of the patches' noise, in units of s
    weight_of_clear : weight of patches without cloud; others have the weight 1

    Attributes
    ----------
    value : value of the function at u
    shares : which rank computes which elements of products
    """

    @device_errors("the prior")
    def __init__(self, operator: PatchOperator, u: np.ndarray, noise: float, weight_of_clear: float = 1.0) -> None:
        self._operator, self._at, self.shares = operator, u, operator.voxel_shares
        self._gradient: np.ndarray | None = None
        device = operator.device
        self._component, self.value = operator.choice.at(device.array(u.astype(np.float32)), noise)
        components = operator.choice.components(noise)
        self._stencil = device.ranks.together(lambda: operator.tiles.assembled(self._component, components.precision))
        self._sum_patches(components, weight_of_clear)
        self.value += 0.5 * (1 - 1 / weight_of_clear) * float(self.clear @ np.square(u))

    def _sum_patches(self, components: Components, weight_of_clear: float) -> None:
        operator, device = self._operator, self._operator.device
        count, shape = operator.vectors.count, operator.patches.voxels.mask.shape
        diagonals = components.diagonal.copy()
        diagonals[0] *= weight_of_clear  # the first component stands for patches without cloud
        self._of_means, self._clear, self._diagonal = (device.empty(count, np.float32) for _ in range(3))
        operator.kernels.launch(
            "sum_patches", count, voxel_count=count, voxel=operator.voxel, shape=shape, component=self._component,
            slope=components.slope, diagonal_of=device.constant(diagonals.astype(np.float32)),
            of_means=self._of_means, clear=self._clear, diagonal=self._diagonal,
        )  # fmt: skip
        # The means' part is used in products alone, of which each rank computes the elements of its voxels.
        gathering = Gathering(device, self.shares)
        gathering.complete(self._clear)
        gathering.complete(self._diagonal)

    @cached_property
    def components(self) -> np.ndarray:
        """The number of each patch's component, shape (patches,)."""
        return self._component.get()[tuple(self._operator.patches.centres.T)]

    @cached_property
    def diagonal(self) -> np.ndarray:
        """The diagonal of the Hessian, shape (voxels,)."""
        return self._diagonal.get().astype(float)

    @cached_property
    def clear(self) -> np.ndarray:
        """The part of patches without cloud in that diagonal, shape (voxels,): it is their whole Hessian."""
        return self._clear.get().astype(float)

    @device_errors("the prior")
    def add_product(
        self, x: DeviceArray, result: DeviceArray, factor: float, scale: float = 1.0, means: float = 0.0
    ) -> None:
        """Adds factor times the Hessian's product with scale x to a result, shape (voxels,).

        Each of several ranks computes the elements of its voxels (`shares`); the others are undefined.

        means : 0 for this product; 1 for the gradient at scale x
        """
        kernels, halo, count = self._operator.kernels, self._operator.halo, len(self._at)
        halo.spread(x, scale)
        self._stencil.add_product(factor, result)
        kernels.launch(
            "add_diagonal_product", count, voxel_count=count, place=halo.place, clear=self._clear,
            of_means=self._of_means, means=means, values=halo.values, factor=factor, result=result,
        )  # fmt: skip

    def _gradient_at_u(self) -> np.ndarray:
        # No cached_property: before Python 3.12 it holds one lock for all objects, and ranks that are threads wait for
        # each other in here.
        if self._gradient is None:
            self._gradient = self._product(self._at, means=1.0)
        return self._gradient

    def times(self, change: np.ndarray) -> np.ndarray:
        """The Hessian's product with a vector, shape (voxels,), float64."""
        # Often the change is 0: where the function is asked for at the u of its components.
        return self._product(change, means=0.0) if np.any(change) else np.zeros(len(change))

    def value_and_gradient(self, u: np.ndarray) -> tuple[float, np.ndarray]:
        """Value and gradient at another u, shape (voxels,)."""
        change = u - self._at
        product = self.times(change)
        gradient = self._gradient_at_u()
        return self.value + float((gradient + 0.5 * product) @ change), gradient + product

    def _product(self, x: np.ndarray, means: float) -> np.ndarray:
        device = self._operator.device
        result = device.zeros(len(x), np.float32)
        self.add_product(device.array(x.astype(np.float32)), result, 1.0, means=means)
        Gathering(device, self.shares).complete(result)
        return result.get().astype(float)
