"""Priors, as users give them, bound to the voxels of a stage."""

from __future__ import annotations

import numpy as np

from cloudtomo_cl.errors import DataError
from cloudtomo_cl.inversion.mixture_file import SHIPPED, read_mixtures
from cloudtomo_cl.inversion.noise_units import NoiseUnits
from cloudtomo_cl.inversion.patch_operator import PatchOperator
from cloudtomo_cl.inversion.patch_prior import StagePatches
from cloudtomo_cl.inversion.patches import Patches
from cloudtomo_cl.inversion.priors import AnyPrior, PatchPrior, Prior, Regulariser
from cloudtomo_cl.inversion.relative_prior import RelativePrior
from cloudtomo_cl.inversion.smoothness import StageSmoothness
from cloudtomo_cl.inversion.stage_prior import FrozenPrior, StagePrior
from cloudtomo_cl.inversion.voxels import Voxels
from cloudtomo_cl.opencl.device import Device
from cloudtomo_cl.scene.grid import Grid

# Optical depth along a voxel's mean chord for the smallest mean extinction that scales a prior. No image shows less.
_LEAST_DEPTH = 1e-3


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
