"""The prior on what clouds look like on a small scale: every patch comes from a mixture of Gaussians."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from cloudtomo_cl.inversion.noise_units import NoiseUnits
from cloudtomo_cl.inversion.patch_operator import PatchOperator
from cloudtomo_cl.inversion.patch_quadratic import PatchQuadratic
from cloudtomo_cl.inversion.vectors import Vectors
from cloudtomo_cl.opencl.arrays import DeviceArray
from cloudtomo_cl.parallel.ranks import Shares

# Noise of a stage's first step, in units of s, and factor by which it falls from step to step.
_FIRST_NOISE, _NOISE_SHARE = 0.2, 0.7
# Default share of the prior's pull on a cloud's mass that a step takes back (mass.py), and extinction, in units of s,
# at which a voxel has half of its full part in that (docs/decisions/patch-prior.md).
_MASS_SHARE, _HALF_PRESENT = 0.3, 0.1
# Number of voxels of a cloud at which its patches count half: the mixture was learnt from clouds of more voxels.
_FEW_VOXELS = 200.0
# Number of patches that are drawn at a time: 20 MB.
_AT_ONCE = 1 << 15


class StagePatches:
    """Minus the log likelihood of the patches of u = b / s, averaged over the patches that hold a voxel.

    R(u) = strength / values sum_i min_k [ 1/2 (P_i u - m_k)^T S_k (P_i u - m_k) - 1/2 log det S_k - log w_k ]
    with S_k = (C_k + noise^2)^-1, minus the value for a patch without cloud, so that a clear sky costs nothing. P_i u
    is patch i; m_k, C_k, w_k are mean, covariance and weight of component k. Source: the expected patch log likelihood
    (Zoran and Weiss 2011), each patch with its likeliest component. The auxiliary patches z of their half-quadratic
    splitting are eliminated: min_z (x - z)^2 / (2 noise^2) + 1/2 (z - m)^T C^-1 (z - m) is the form above.

    Parameters
    ----------
    operator : patch prior on the device
    strength : weight of the prior
    noise : standard deviation of the patches' noise, in units of s
    """

    chooses: ClassVar[bool] = True
    corrects_mass: ClassVar[bool] = True

    def __init__(self, operator: PatchOperator, strength: float, noise: float) -> None:
        self._operator = operator
        self._weight, self._noise = strength / operator.patches.values, noise

    def value_and_gradient(self, extinction: np.ndarray, units: NoiseUnits) -> tuple[float, np.ndarray]:
        step = FrozenPatches(self._operator, self._weight, self._noise, extinction)
        return step.value_and_gradient(extinction, units)

    def frozen(
        self, extinction: np.ndarray, iteration: int | None = None, mass_share: float | None = None
    ) -> FrozenPatches:
        """The prior with the components that are likeliest at this extinction, and with the noise of this iteration.

        Patches of a cloud of few voxels, as on the grids of the first stages, are rougher than most patches that were
        learnt from, so they count less. Patches without cloud do not differ, and count in full.

        The most likely cloud is thinner than typical likely ones, because every patch's Gaussian pulls towards its
        mean. A step takes a share of that pull on the cloud's mass back, by a constant slope where there is cloud.
        """
        noise = self._noise if iteration is None else max(_FIRST_NOISE * _NOISE_SHARE**iteration, self._noise)
        count = voxels_of_cloud(extinction)
        share = count / (count + _FEW_VOXELS) if count else 1.0
        taken_back = _MASS_SHARE if mass_share is None else mass_share
        return FrozenPatches(self._operator, self._weight, noise, extinction, share, taken_back)


def voxels_of_cloud(extinction: np.ndarray) -> float:
    """(sum b)^2 / sum b^2: the number of a cloud's voxels, were they all alike; 0 without cloud."""
    squares = float(np.sum(np.square(extinction)))
    return float(np.sum(extinction)) ** 2 / squares if squares > 0 else 0.0


class FrozenPatches:
    """`StagePatches` with the components that are likeliest at one extinction: a quadratic function.

    Parameters
    ----------
    operator : patch prior on the device
    weight : strength divided by the number of a patch's values
    noise : standard deviation of the patches' noise, in units of s
    extinction : extinction at which components are chosen, in units of s, shape (voxels,)
    share : factor of patches with cloud
    mass_share : share of the function's slope along `extinction` that an added constant slope takes away
    """

    def __init__(
        self, operator: PatchOperator, weight: float, noise: float, extinction: np.ndarray, share: float = 1.0,
        mass_share: float = 0.0,
    ) -> None:  # fmt: skip
        self._operator, self._weight, self._noise = operator, share * weight, noise
        self._quadratic = PatchQuadratic(operator, extinction, noise, 1 / share)
        self._mass_slope, self._start = self._slope_of_mass(extinction, mass_share), extinction

    def _slope_of_mass(self, extinction: np.ndarray, mass_share: float) -> np.ndarray:
        presence = extinction / (extinction + _HALF_PRESENT)
        along = float(presence @ extinction)
        if not (along > 0 and mass_share):
            return np.zeros(len(extinction))
        pull = float(self._quadratic.value_and_gradient(extinction)[1] @ extinction)
        return -mass_share * pull / along * presence

    def value_and_gradient(self, extinction: np.ndarray, units: NoiseUnits) -> tuple[float, np.ndarray]:
        value, gradient = self._quadratic.value_and_gradient(extinction)
        value += float(self._mass_slope @ (extinction - self._start))
        factor = units.weighted * self._weight
        return factor * value, factor * (gradient + self._mass_slope)

    def curvature(self, extinction: np.ndarray, units: NoiseUnits) -> np.ndarray:
        return units.weighted * self._weight * self._quadratic.diagonal

    def hessian_times(self, columns: np.ndarray, units: NoiseUnits) -> np.ndarray:
        products = [self._quadratic.times(column) for column in columns.T]
        return np.column_stack(products) * (units.weighted * self._weight)

    def perturbation(self, random: np.random.Generator, units: NoiseUnits) -> np.ndarray:
        patches, components, clear = self._operator.patches, self._quadratic.components, self._quadratic.clear
        sums, precisions = patches.zeros(), self._operator.mixture.precisions(self._noise)
        for component in np.unique(components[components > 0]):
            root = np.linalg.cholesky(precisions[component])
            of_component = np.flatnonzero(components == component)
            for first in range(0, len(of_component), _AT_ONCE):
                chosen = of_component[first : first + _AT_ONCE]
                patches.add(sums, chosen, random.standard_normal((len(chosen), patches.values)) @ root.T)
        of_clear = np.sqrt(clear) * random.standard_normal(len(clear))
        return np.sqrt(units.weighted * self._weight * units.both) * (of_clear + patches.on_voxels(sums))

    def term(self, units: NoiseUnits, scale: float = 1.0) -> PatchTerm:
        """See `DevicePrior`."""
        vectors = self._operator.vectors
        return PatchTerm(self._quadratic, vectors, vectors.of(self._mass_slope), units.weighted * self._weight, scale)


@dataclass(frozen=True, eq=False)
class PatchTerm:
    """`FrozenPatches` as a term on the device; see `Term`.

    Attributes
    ----------
    patches : quadratic function of the patches
    vectors : vectors with an element for each voxel
    slope : gradient of an added linear function, shape (voxels,)
    factor : factor of both functions
    scale : factor from the unknowns to the patches' values
    """

    patches: PatchQuadratic
    vectors: Vectors
    slope: DeviceArray
    factor: float
    scale: float
    quadratic: ClassVar[bool] = True
    repeatable: ClassVar[bool] = True

    @property
    def shares(self) -> Shares:
        """See `Term`."""
        return self.patches.shares

    def add_gradient(self, x: DeviceArray, result: DeviceArray) -> None:
        factor = self.factor * self.scale
        self.patches.add_product(x, result, factor, self.scale, means=1.0)
        self.vectors.add(factor, self.slope, result)

    def add_product(self, x: DeviceArray, result: DeviceArray) -> None:
        self.patches.add_product(x, result, self.factor * self.scale, self.scale)
