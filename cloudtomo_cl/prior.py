"""What is known of clouds before any image: smoothness, growth with height, and much clear air."""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np
from pydantic import ConfigDict, Field
from pydantic.dataclasses import dataclass

from cloudtomo_cl.device import Device, device_errors
from cloudtomo_cl.scene import NotNegative, Positive

# Diagonal of A^T A away from the edges: 1 + 26 / 26^2.
SMOOTHNESS_CURVATURE = 27 / 26


@dataclass(frozen=True, config=ConfigDict(extra="forbid"))
class Prior:
    """R = N (smoothness / 2 ||A b||^2 + monotonicity R_mon) + n sparsity R_clear, b the extinction in km^-1.

    n is the data term's unit, the mean over pixels of the weighted variances of the measured images' noise; N has
    the modelled images' noise in it, too, and falls during a run. So the weights say what clouds are like, and follow
    neither from the images nor from their number: the prior is Gaussian with an rms (A b) of smoothness^-1/2.

    A is the mean of a voxel's 26 neighbours minus itself; R_mon = -sum tanh(c1 Dz b) tanh(c2 b)
    over voxels with b > threshold, Dz the central difference along z from voxel to voxel.
    Source: the supplement's Eqs. 20-23, with the gradient corrected (docs/estimators.md), and
    the constants of the paper's released code.

    R_clear = sum b / (b + clear). It is ours: every voxel that holds cloud costs as much as its one
    parameter would fit of the noise (Akaike 1974's criterion, made smooth as by Geman and McClure 1985),
    so that what the images leave open stays clear.

    Attributes
    ----------
    smoothness : mu1, km^2; by default an rms (A b) of 7 km^-1
    monotonicity : mu2
    c1, c2 : km
    threshold : km^-1
    sparsity : 1 for the criterion above, 0 for none
    clear : km^-1, the extinction at which half of the cost is due
    """

    smoothness: NotNegative = 0.02
    monotonicity: NotNegative = 0.0
    c1: Positive = 0.2
    c2: Positive = 0.05
    threshold: Annotated[float, Field(ge=0)] = 0.01
    sparsity: NotNegative = 1.0
    clear: Positive = 3.0


class PriorOperator:
    """Value and gradient of a prior on a device, for one shape of grid."""

    @device_errors("the prior")
    def __init__(self, prior: Prior, shape: tuple[int, int, int], device: Device) -> None:
        import pyopencl.array as cl_array

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

    def _launch(self, name: str, *arguments: Any, **named: Any) -> None:
        self.device.launch(self._kernels[name], int(np.prod(self.shape)), *arguments, **named)

    @device_errors("the prior")
    def value_and_gradient(self, extinction: Any, weight: float = 1.0, noise: float = 0.0) -> tuple[float, Any]:
        """The prior's value, and its gradient (km) on the device, for an extinction on the device.

        weight : N, factor of smoothness and monotonicity
        noise : n, factor of the sparsity
        """
        prior, shape = self.prior, self.shape
        self._launch("laplacian", extinction, shape, self._work)
        self._launch("laplacian", self._work, shape, self._smooth)
        self._launch(
            "monotonicity_terms",
            extinction, shape, prior.c1, prior.c2, prior.threshold, self._value, self._outer, self._inner,
        )  # fmt: skip
        gradient = self._cl_array.empty_like(extinction)
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
            sparsity_scale=prior.clear,
            gradient=gradient,
        )
        smooth = np.square(self._work.get(), dtype=np.float64).sum()
        monotone = self._value.get().sum(dtype=np.float64)
        value = weight * (prior.smoothness / 2 * smooth + prior.monotonicity * monotone)
        if noise * prior.sparsity > 0:
            b = extinction.get().astype(float)
            value += noise * prior.sparsity * float(np.sum(b / (b + prior.clear)))
        return float(value), gradient
