"""How much of a prior's pull on a cloud's mass a step takes back: as much as recoveries of simulated images lose."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from cloudtomo_cl.inversion.bound_prior import FrozenPrior
from cloudtomo_cl.inversion.noisy_model import NoisyModel
from cloudtomo_cl.inversion.patch_prior import FrozenPatches
from cloudtomo_cl.inversion.relative_prior import ScaledPrior

# Draws of the images' noise, each with its opposite. Both are minimised with nothing and with all taken back.
_PAIRS = 2


def is_due(iterations: int) -> bool:
    """Whether the share is found anew in a stage's iteration, counted from 1: it changes ever more slowly."""
    return iterations & (iterations - 1) == 0


def give_back(prior: FrozenPrior, extinction: np.ndarray, share: float) -> bool:
    """Lets a prior take this share of its pull on the mass back, see `FrozenPatches.give_back`; False if it cannot."""
    if isinstance(prior, ScaledPrior):
        return give_back(prior.inner, extinction / prior.factor, share)
    if isinstance(prior, FrozenPatches):
        prior.give_back(extinction, share)
        return True
    return False


def returned_share(model: NoisyModel, random: np.random.Generator) -> float:
    """The share of the prior's pull that is to be taken back at an extinction; 0 of priors that take nothing back.

    Images of the extinction by the linear model, with noise, are recovered by the same model and prior: with nothing
    and with all taken back. Between the two lies the share with which the mass is kept on average.

    Parameters
    ----------
    model : at the extinction; its prior takes nothing back afterwards
    random : of the draws

    Returns
    -------
    from 0 to 1
    """
    if not give_back(model.prior, model.extinction, 1.0):
        return 0.0
    everything = model.prior_slope
    give_back(model.prior, model.extinction, 0.0)
    slope = model.prior_slope
    noise = np.column_stack([model.slope_of_noise(random) for _ in range(_PAIRS)])

    def changes(slopes: np.ndarray) -> np.ndarray:
        return np.column_stack([model.minimum(column) - model.extinction for column in slopes.T])

    return share_that_keeps_mass(changes, noise, slope, everything - slope)


def share_that_keeps_mass(
    changes: Callable[[np.ndarray], np.ndarray], noise: np.ndarray, slope: np.ndarray, back: np.ndarray
) -> float:
    """The share t for which minima of a model with slopes +-noise + slope + t back have the mass of where it stands.

    The bias that the prior's slope gives a linear functional of the unknowns is taken off the functional, not off each
    unknown: so do Javanmard and Montanari 2014 and Zhang and Zhang 2014 by the data's slope. What bounds add, by which
    noise makes thin voxels thicker on average, is in it by simulation, a parametric bootstrap (Efron and Tibshirani
    1993, section 6.5). Each draw's opposite takes off what is linear in the noise.

    Parameters
    ----------
    changes : of the extinction to the minimum with additional slopes, both of shape (voxels, columns)
    noise : shape (voxels, draws)
    slope : of the prior, shape (voxels,)
    back : what taking all of its pull back adds to that, shape (voxels,)

    Returns
    -------
    from 0, for what noise adds to the mass is no reason to make a cloud thinner, to 1
    """
    opposite = np.hstack([noise, -noise]) + slope[:, None]
    masses = changes(np.hstack([opposite, opposite + back[:, None]])).sum(axis=0)
    with_nothing, with_all = masses.reshape(2, -1).mean(axis=1)
    if not with_all > with_nothing:
        return 0.0
    return float(np.clip(-with_nothing / (with_all - with_nothing), 0.0, 1.0))
