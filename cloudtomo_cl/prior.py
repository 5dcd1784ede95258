"""What is known of clouds before any image: smoothness, growth with height, and much clear air."""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np
from pydantic import ConfigDict, Field
from pydantic.dataclasses import dataclass

from cloudtomo_cl.device import Device, device_errors
from cloudtomo_cl.scene import NotNegative, Positive


@dataclass(frozen=True, config=ConfigDict(extra="forbid"))
class Prior:
    """R = smoothness / 2 ||A b||^2 + monotonicity R_mon + sparsity R_clear, b the extinction in km^-1.

    A is the mean of a voxel's 26 neighbours minus itself; R_mon = -sum tanh(c1 Dz b) tanh(c2 b)
    over voxels with b > threshold, Dz the central difference along z from voxel to voxel.
    Source: the supplement's Eqs. 20-23, with the gradient corrected (docs/estimators.md), and
    the constants of the paper's released code.

    R_clear = n sum log(1 + b / clear), n the mean of the weighted variances of the images' noise.
    It is ours: minus the logarithm, in the data term's units, of a density 1 / (b + clear) for every
    voxel, Jeffreys's for a scale with no preferred value. What the images leave open becomes clear.

    Attributes
    ----------
    smoothness : mu1, km^2
    monotonicity : mu2
    c1, c2 : km
    threshold : km^-1
    sparsity : 0 for none, 1 for the density above
    clear : km^-1
    """

    smoothness: NotNegative = 5e-5
    monotonicity: NotNegative = 0.0
    c1: Positive = 0.2
    c2: Positive = 0.05
    threshold: Annotated[float, Field(ge=0)] = 0.01
    sparsity: NotNegative = 1.0
    clear: Positive = 1.0


class PriorOperator:
    """Value and gradient of a prior on a device, for one shape of grid."""

    @device_errors("the prior")
    def __init__(self, prior: Prior, shape: tuple[int, int, int], device: Device) -> None:
        import pyopencl.array as cl_array
        from pyopencl import cltypes

        self.prior = prior
        self.device = device
        self.shape = shape
        self._cl_array = cl_array
        self._kernels = {
            name: device.kernel("prior", name)
            for name in ("laplacian", "monotonicity_terms", "prior_gradient")
        }
        self._smooth, self._work, self._value, self._outer, self._inner = (
            cl_array.zeros(device.queue, shape, np.float32) for _ in range(5)
        )
        self._shape = cltypes.make_int3(*shape)  # type: ignore[attr-defined]  # made when pyopencl is imported

    def _launch(self, name: str, *arguments: Any) -> None:
        self.device.launch(self._kernels[name], int(np.prod(self.shape)), *arguments)

    @device_errors("the prior")
    def value_and_gradient(self, extinction: Any, weight: float = 1.0, noise: float = 0.0) -> tuple[float, Any]:
        """The prior's value, and its gradient (km) on the device, for an extinction on the device.

        weight : factor of smoothness and monotonicity
        noise : n of the sparsity, the data term's unit
        """
        prior, shape = self.prior, self._shape
        self._launch("laplacian", extinction.data, shape, self._work.data)
        self._launch("laplacian", self._work.data, shape, self._smooth.data)
        self._launch(
            "monotonicity_terms",
            extinction.data,
            shape,
            *(np.float32(c) for c in (prior.c1, prior.c2, prior.threshold)),
            *(a.data for a in (self._value, self._outer, self._inner)),
        )
        gradient = self._cl_array.empty_like(extinction)
        self._launch(
            "prior_gradient",
            *(a.data for a in (self._smooth, self._outer, self._inner)),
            shape,
            np.float32(weight * prior.smoothness),
            np.float32(weight * prior.monotonicity),
            extinction.data,
            np.float32(noise * prior.sparsity),
            np.float32(prior.clear),
            gradient.data,
        )
        smooth = np.square(self._work.get(), dtype=np.float64).sum()
        monotone = self._value.get().sum(dtype=np.float64)
        value = weight * (prior.smoothness / 2 * smooth + prior.monotonicity * monotone)
        if noise * prior.sparsity > 0:
            value += noise * prior.sparsity * float(np.log1p(extinction.get() / prior.clear, dtype=np.float64).sum())
        return float(value), gradient
