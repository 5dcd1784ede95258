"""Priors, what is known of clouds before any image: their patches; or smoothness, growth with height, clear air."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal, Protocol, runtime_checkable

import numpy as np
from pydantic import ConfigDict, Field
from pydantic.dataclasses import dataclass

from cloudtomo_cl.arguments import a, able
from cloudtomo_cl.inversion.voxels import Voxels
from cloudtomo_cl.messages import answering
from cloudtomo_cl.renamed import renamed_arguments
from cloudtomo_cl.scene.scene import NotNegative, Positive


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


# What `prior` may be in functions' arguments.
PRIOR = a(PatchPrior, Prior).or_(able("an object with value_and_gradient", "value_and_gradient"))
