"""The prior of smoothness, growth with height and clear air for the voxels of a stage (kernels/prior.cl)."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np

from cloudtomo_cl.inversion.noise_units import NoiseUnits
from cloudtomo_cl.inversion.priors import Prior
from cloudtomo_cl.inversion.stage_prior import FrozenPrior
from cloudtomo_cl.inversion.vectors import Vectors
from cloudtomo_cl.inversion.voxels import Voxels
from cloudtomo_cl.opencl.arrays import DeviceArray
from cloudtomo_cl.opencl.device import Device
from cloudtomo_cl.opencl.driver import device_errors

# Diagonal of A^T A away from the edges: 1 + 26 / 26^2.
SMOOTHNESS_CURVATURE = 27 / 26


def roughness(extinction: np.ndarray) -> np.ndarray:
    """A b: the mean of a voxel's 26 neighbours minus the voxel; beyond the edges the nearest voxel is repeated."""
    from scipy.ndimage import uniform_filter

    return (27 * uniform_filter(extinction, 3, mode="nearest") - extinction) / 26 - extinction


class StageSmoothness:
    """`Prior` for the voxels of one stage, by the kernels of prior.cl."""

    def __init__(self, prior: Prior, voxels: Voxels, device: Device) -> None:
        self._prior = prior
        self._voxels = voxels
        self._operator = PriorOperator(prior, voxels.grid.shape, device)

    def value_and_gradient(self, extinction: np.ndarray, units: NoiseUnits) -> tuple[float, np.ndarray]:
        value, gradient = self._operator.of_array(self._voxels.on_grid(extinction), units.weighted, units.measured)
        return value, gradient[self._voxels.mask].astype(float)

    def curvature(self, extinction: np.ndarray, units: NoiseUnits) -> float:
        prior = self._prior
        of_sparsity = units.measured * (prior.sparsity / prior.sparsity_scale**2)
        return units.weighted * prior.smoothness * SMOOTHNESS_CURVATURE + of_sparsity

    def frozen(
        self, extinction: np.ndarray, iteration: int | None = None, mass_share: float | None = None
    ) -> FrozenPrior:
        return self

    def hessian_times(self, columns: np.ndarray, units: NoiseUnits) -> np.ndarray:
        """The Hessian of the smoothness alone, A^T A = A A, times columns."""
        products = [roughness(roughness(self._on_grid(column)))[self._voxels.mask] for column in columns.T]
        return units.weighted * self._prior.smoothness * np.column_stack(products)

    def term(self, units: NoiseUnits, scale: float = 1.0) -> PriorTerm:
        """See `DevicePrior`."""
        return PriorTerm(self._operator, self._voxels.mask, units, scale)

    def perturbation(self, random: np.random.Generator, units: NoiseUnits) -> np.ndarray:
        draw = roughness(random.standard_normal(self._voxels.mask.shape))[self._voxels.mask]
        return np.sqrt(units.weighted * self._prior.smoothness * units.both) * draw

    def _on_grid(self, values: np.ndarray) -> np.ndarray:
        full = np.zeros(self._voxels.mask.shape)
        full[self._voxels.mask] = values
        return full


class PriorTerm:
    """A `Prior` as a term on the device; see `Term`.

    Parameters
    ----------
    operator : value and gradient of the prior on the device
    mask : voxels that are unknowns, bool, shape of the grid
    units : factors of the prior
    scale : factor from the unknowns to extinctions for which the prior's numbers hold
    """

    quadratic: ClassVar[bool] = False

    def __init__(self, operator: PriorOperator, mask: np.ndarray, units: NoiseUnits, scale: float) -> None:
        self._operator, self._units, self._scale = operator, units, scale
        places = np.flatnonzero(mask)
        self._vectors = Vectors(operator.device, len(places))
        self._place = operator.device.constant(places.astype(np.uint32))
        self._extinction = operator.device.zeros(operator.shape, np.float32)

    def add_gradient(self, x: DeviceArray, result: DeviceArray) -> None:
        self._vectors.launch("spread_values", factor=self._scale, place=self._place, x=x, values=self._extinction)
        gradient = self._operator.gradient(self._extinction, self._units.weighted, self._units.measured)
        self._vectors.launch("add_gathered", factor=self._scale, place=self._place, values=gradient, result=result)

    def add_product(self, x: DeviceArray, result: DeviceArray) -> None:
        raise NotImplementedError("the prior is not quadratic")


class PriorOperator:
    """Value and gradient of a prior on a device, for one shape of grid."""

    @device_errors("the prior")
    def __init__(self, prior: Prior, shape: tuple[int, int, int], device: Device) -> None:
        self.prior = prior
        self.device = device
        self.shape = shape
        self._kernels = {
            name: device.kernel("prior", name) for name in ("laplacian", "monotonicity_terms", "prior_gradient")
        }
        self._smooth, self._work, self._value, self._outer, self._inner = (
            device.zeros(shape, np.float32) for _ in range(5)
        )

    def _launch(self, name: str, *arguments: Any, **named: Any) -> None:
        self.device.launch(self._kernels[name], int(np.prod(self.shape)), *arguments, **named)

    @device_errors("the prior")
    def value_and_gradient(
        self, extinction: DeviceArray, weight: float = 1.0, noise: float = 0.0
    ) -> tuple[float, DeviceArray]:
        """The prior's value, and its gradient (km) on the device, for an extinction on the device.

        weight : factor N of smoothness and monotonicity
        noise : factor n of the sparsity
        """
        prior = self.prior
        gradient = self.gradient(extinction, weight, noise)
        smooth = np.square(self._work.get(), dtype=np.float64).sum()
        monotone = self._value.get().sum(dtype=np.float64)
        value = weight * (prior.smoothness / 2 * smooth + prior.monotonicity * monotone)
        if noise * prior.sparsity > 0:
            b = extinction.get().astype(float)
            value += noise * prior.sparsity * float(np.sum(b / (b + prior.sparsity_scale)))
        return float(value), gradient

    @device_errors("the prior")
    def gradient(self, extinction: DeviceArray, weight: float = 1.0, noise: float = 0.0) -> DeviceArray:
        """As `value_and_gradient`, but the gradient alone, which stays on the device."""
        prior, shape = self.prior, self.shape
        self._launch("laplacian", extinction, shape, self._work)
        self._launch("laplacian", self._work, shape, self._smooth)
        self._launch(
            "monotonicity_terms",
            extinction, shape, prior.c1, prior.c2, prior.threshold, self._value, self._outer, self._inner,
        )  # fmt: skip
        gradient = self.device.empty(shape, np.float32)
        self._launch(
            "prior_gradient",
            smooth=self._smooth,
            outer=self._outer,
            inner=self._inner,
            shape=shape,
            smoothness=weight * prior.smoothness,
            monotonicity=weight * prior.monotonicity,
            extinction=extinction,
            sparsity=noise * prior.sparsity,
            sparsity_scale=prior.sparsity_scale,
            gradient=gradient,
        )
        return gradient

    def of_array(self, extinction: np.ndarray, weight: float, noise: float) -> tuple[float, np.ndarray]:
        """As `value_and_gradient`, for an array on the host; the gradient is on the host, too."""
        value, gradient = self.value_and_gradient(self.device.array(extinction), weight, noise)
        return value, gradient.get()
