"""How much of a prior's pull on a cloud's mass a step takes back: as much as recoveries of simulated images lose."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

# Draws of the images' noise that the share is found by, each with its opposite.
PAIRS = 1


def is_due(iterations: int) -> bool:
    """Whether the share is found anew after so many fitted iterations: at 1, 2, 4, 8, ..., for it settles."""
    return iterations & (iterations - 1) == 0


def share_that_keeps_mass(
    recovered: Callable[[np.ndarray, float], np.ndarray], extinction: np.ndarray, noise: np.ndarray
) -> float:
    """The share of the prior's pull that is to be taken back at an extinction.

    Images of the extinction with noise are recovered as a step does it: with nothing and with all taken back. Between
    the two lies the share with which the mass is kept on average: a parametric bootstrap (Efron and Tibshirani 1993,
    section 6.5). The bias that a prior gives a linear functional of the unknowns is taken off the functional, not off
    each unknown: so do Javanmard and Montanari 2014 and Zhang and Zhang 2014 by the data's slope. What bounds add, by
    which noise makes thin voxels thicker on average, is in it. Each draw's opposite takes off what is linear in it.

    Parameters
    ----------
    recovered : makes the extinction of what noise adds to the data term's slope, and a share
    extinction : km^-1, shape (voxels,)
    noise : such slopes, shape (voxels, draws)

    Returns
    -------
    from 0, for what noise adds to the mass is no reason to make a cloud thinner, to 1
    """
    opposite = [sign * draw for draw in noise.T for sign in (1.0, -1.0)]
    with_nothing, with_all = (
        float(np.mean([np.sum(recovered(slope, share) - extinction) for slope in opposite])) for share in (0.0, 1.0)
    )
    if not with_all > with_nothing:
        return 0.0
    return float(np.clip(-with_nothing / (with_all - with_nothing), 0.0, 1.0))
