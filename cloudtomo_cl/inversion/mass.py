"""The share of a prior's pull on a cloud's mass that a step takes back, so that recoveries keep the mass on average."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

# Number of draws of the images' noise that the share is found with; each is used with both signs.
PAIRS = 1


def is_due(iterations: int) -> bool:
    """Whether the share is found anew after this number of fitted iterations: 1, 2, 4, 8, ..., since it settles."""
    return iterations & (iterations - 1) == 0


def share_that_keeps_mass(
    recovered: Callable[[np.ndarray, float], np.ndarray], extinction: np.ndarray, noise: np.ndarray
) -> float:
    """The share of the prior's pull that is to be taken back at an extinction.

    Noisy images of the extinction are recovered as in a step, once with nothing of the pull taken back (share 0) and
    once with all of it (share 1). The share that keeps the mass on average is interpolated: a parametric bootstrap
    (Efron and Tibshirani 1993, section 6.5). So the prior's bias is corrected for one linear functional of the
    unknowns, the mass, not for each unknown, as in Javanmard and Montanari 2014 and Zhang and Zhang 2014, who use the
    data's slope. The effect of the bound at 0, by which noise makes thin voxels thicker on average, is included. Using
    each draw with both signs cancels what is linear in the noise.

    Parameters
    ----------
    recovered : function of the noise's part in the data term's slope and of a share; gives the recovered extinction
    extinction : extinction whose images are simulated, km^-1, shape (voxels,)
    noise : draws of the noise's part in the data term's slope, shape (voxels, draws)

    Returns
    -------
    the share, from 0 to 1: it is never negative, for mass that noise adds is no reason to make a cloud thinner
    """
    opposite = [sign * draw for draw in noise.T for sign in (1.0, -1.0)]
    with_nothing, with_all = (
        float(np.mean([np.sum(recovered(slope, share) - extinction) for slope in opposite])) for share in (0.0, 1.0)
    )
    if not with_all > with_nothing:
        return 0.0
    return float(np.clip(-with_nothing / (with_all - with_nothing), 0.0, 1.0))
