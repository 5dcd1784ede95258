"""Priors, what is known of clouds before any image: their patches; or smoothness, growth with height, clear air."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, Protocol, runtime_checkable

import numpy as np
from pydantic import ConfigDict, Field
from pydantic.dataclasses import dataclass

from cloudtomo_cl.errors import DataError
from cloudtomo_cl.inversion.mixture_file import SHIPPED, read_mixtures
from cloudtomo_cl.inversion.noise_units import NoiseUnits
from cloudtomo_cl.inversion.patch_operator import PatchOperator
from cloudtomo_cl.inversion.patch_prior import StagePatches
from cloudtomo_cl.inversion.patches import Patches
from cloudtomo_cl.inversion.relative_prior import RelativePrior
from cloudtomo_cl.inversion.stage_prior import FrozenPrior, StagePrior
from cloudtomo_cl.inversion.vectors import Vectors
from cloudtomo_cl.inversion.voxels import Voxels
from cloudtomo_cl.messages import answering
from cloudtomo_cl.opencl.arrays import DeviceArray
from cloudtomo_cl.opencl.device import Device
from cloudtomo_cl.opencl.driver import device_errors
from cloudtomo_cl.renamed import renamed_arguments
from cloudtomo_cl.scene.grid import Grid
from cloudtomo_cl.scene.scene import NotNegative, Positive

# Optical depth along a voxel's mean chord for the smallest mean extinction that scales a prior. No image shows less.
_LEAST_DEPTH = 1e-3
# Diagonal of A^T A away from the edges: 1 + 26 / 26^2.
SMOOTHNESS_CURVATURE = 27 / 26


def roughness(extinction: np.ndarray) -> np.ndarray:
    """A b: the mean of a voxel's 26 neighbours minus the voxel; beyond the edges the nearest voxel is repeated."""
    from scipy.ndimage import uniform_filter

    return (27 * uniform_filter(extinction, 3, mode="nearest") - extinction) / 26 - extinction


@answering
@dataclass(frozen=True, config=ConfigDict(extra="forbid"))
class PatchPrior:
    """Every patch of a cloud, 5 x 5 x 3 voxels, comes from a mixture of Gaussians that was learnt from clouds.

    Patches are divided by the mean extinction of the current estimate, s = sum b^2 / sum b, so that the prior does not
    depend on a cloud's brightness. There is a mixture for each of several shapes of voxels. Source: Zoran and Weiss
    2011 (docs/explanation/patches.md).

    Attributes
    ----------
    strength : weight of the patches' minus log likelihood, averaged over the patches that hold a voxel; for patches
        with cloud a step takes half of it if the cloud has 200 voxels, and less if it has fewer
    noise : standard deviation of the patches' noise, in units of s; a stage begins with 0.2
    file : file of mixtures that `cloudtomo prior learn` made; by default those that come with the package, learnt from
        generated clouds
    """

    type: Literal["patches"] = "patches"
    strength: NotNegative = 1.0
    noise: Positive = 0.03
    file: Path | None = None


@answering
@dataclass(frozen=True, config=ConfigDict(extra="forbid"))
class Prior:
    """R = N (smoothness / 2 ||A b||^2 + monotonicity R_mon) + n sparsity R_sparsity, b the extinction in km^-1.

    n is the data term's unit: the mean over pixels of weight times variance of the measured images' noise. N includes
    the modelled images' noise, and falls during a run. So the prior's weights describe clouds, and need not change with
    the images or their number: smoothness makes a Gaussian prior with an rms (A b) of smoothness^-1/2.

    A b is the mean of a voxel's 26 neighbours minus the voxel; R_mon = -sum tanh(c1 Dz b) tanh(c2 b)
    over voxels with b > threshold, Dz the central difference along z from voxel to voxel.
    Source: the supplement's Eqs. 20-23, with the gradient corrected (docs/explanation/derivatives.md), and
    the constants of the paper's released code.

    R_sparsity = sum b / (b + b0) is of this package, not of the paper: every voxel with cloud costs as
    much as one parameter reduces the data term by fitting noise (Akaike 1974's criterion, made smooth as
    by Geman and McClure 1985), so that what the images leave open stays clear.

    Attributes
    ----------
    smoothness : weight mu1, km^2; by default an rms (A b) of 7 km^-1
    monotonicity : weight mu2 of R_mon, without unit
    c1, c2 : scales in R_mon, km
    threshold : extinction above which a voxel counts in R_mon, km^-1
    sparsity : weight of R_sparsity: 1 for the criterion above, 0 for none
    sparsity_scale : b0, the extinction at which half of a voxel's cost is due, km^-1
    reference : mean extinction s = sum b^2 / sum b, km^-1, of the cloud for which the other numbers hold (scene C has
        46): for another cloud they are scaled by its mean extinction. 0: they hold for every cloud as they are
    """

    type: Literal["smoothness"] = "smoothness"

    smoothness: NotNegative = 0.02
    monotonicity: NotNegative = 0.0
    c1: Positive = 0.2
    c2: Positive = 0.05
    threshold: Annotated[float, Field(ge=0)] = 0.01
    sparsity: NotNegative = 1.0
    sparsity_scale: Positive = 3.0
    reference: NotNegative = 0.0


Prior.__init__ = renamed_arguments(clear="sparsity_scale")(Prior.__init__)  # type: ignore[method-assign]


AnyPrior = PatchPrior | Prior


@runtime_checkable
class Regulariser(Protocol):
    """A prior that a user writes: minus the logarithm of a probability density of extinctions, up to a constant.

    It is multiplied by the data term's unit, so that it does not depend on the images and their noise. An optional
    method `curvature(extinction, voxels)`, the diagonal of its Hessian, km^2, shape (voxels,), scales Gauss-Newton's
    inner minimisation.
    """

    def value_and_gradient(self, extinction: np.ndarray, voxels: Voxels) -> tuple[float, np.ndarray]:
        """Value, and gradient in km, for an extinction in km^-1; both arrays have shape (voxels,)."""
        ...


def unlike_prior(prior: AnyPrior | Regulariser, grid: Grid) -> str:
    """A text that says how a grid's voxels differ from those that a prior was learnt from; empty if they do not.

    Raises
    ------
    DataError : the prior's file holds no mixtures
    """
    return read_mixtures(prior.file or SHIPPED).unlike(grid.spacing) if isinstance(prior, PatchPrior) else ""


def stage_prior(prior: AnyPrior | Regulariser, voxels: Voxels, device: Device) -> StagePrior:
    """A prior for the voxels of one stage.

    Raises
    ------
    DataError : it is neither a `PatchPrior` nor a `Prior`, nor has `value_and_gradient`; or its file is not there
    """
    least = _LEAST_DEPTH / voxels.grid.mean_chord
    if isinstance(prior, PatchPrior):
        mixture = read_mixtures(prior.file or SHIPPED).of_spacing(voxels.grid.spacing)
        operator = PatchOperator(Patches(voxels, mixture.size), mixture, device)
        return RelativePrior(StagePatches(operator, prior.strength, prior.noise), 1.0, least)
    if isinstance(prior, Prior):
        absolute = StageSmoothness(prior, voxels, device)
        return RelativePrior(absolute, prior.reference, least) if prior.reference else absolute
    if not isinstance(prior, Regulariser):
        raise DataError(
            f"prior is a {type(prior).__name__}: give a PatchPrior, a Prior, or an object with "
            "value_and_gradient(extinction, voxels) -> (value, gradient)"
        )
    return _UserPrior(prior, voxels)


class _UserPrior:
    """A user's regulariser, whose results are checked."""

    def __init__(self, regulariser: Regulariser, voxels: Voxels) -> None:
        self._regulariser = regulariser
        self._voxels = voxels

    def value_and_gradient(self, extinction: np.ndarray, units: NoiseUnits) -> tuple[float, np.ndarray]:
        value, gradient = self._regulariser.value_and_gradient(extinction.copy(), self._voxels)
        gradient = np.asarray(gradient, float)
        name = type(self._regulariser).__name__
        if gradient.shape != extinction.shape:
            raise DataError(f"the gradient of the prior {name} has shape {gradient.shape}, not {extinction.shape}")
        if not (np.isfinite(value) and np.isfinite(gradient).all()):
            raise DataError(f"the prior {name} has a value or a gradient that is not finite")
        return units.weighted * float(value), units.weighted * gradient

    def curvature(self, extinction: np.ndarray, units: NoiseUnits) -> np.ndarray | float:
        diagonal = getattr(self._regulariser, "curvature", None)
        if diagonal is None:
            return 0.0
        curvature = np.asarray(diagonal(extinction.copy(), self._voxels), float)
        return units.weighted * np.maximum(np.broadcast_to(curvature, len(self._voxels)), 0.0)

    def frozen(
        self, extinction: np.ndarray, iteration: int | None = None, mass_share: float | None = None
    ) -> FrozenPrior:
        return self

    def hessian_times(self, columns: np.ndarray, units: NoiseUnits) -> np.ndarray:
        return np.zeros_like(columns)

    def perturbation(self, random: np.random.Generator, units: NoiseUnits) -> np.ndarray:
        return np.zeros(len(self._voxels))


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
