"""The minimum of a step: by annealing from a weak prior to its full weight, or with the prior's scale renewed."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from cloudtomo_cl.inversion.conjugate_gradients import minimised
from cloudtomo_cl.inversion.noise_units import NoiseUnits
from cloudtomo_cl.inversion.prior_terms import term_of
from cloudtomo_cl.inversion.problem import Problem
from cloudtomo_cl.inversion.relative_prior import mean_extinction
from cloudtomo_cl.inversion.terms import Term

# Shares of the prior's weight, with which annealing minimises one after the other (docs/decisions/patch-prior.md).
_SHARES = (0.03, 0.06, 0.12, 0.24, 0.48, 1.0, 1.0)
# Annealing begins with at least this share of the cloud's mean extinction in every voxel.
_FLOOR = 0.1
# Iterations of each of these minimisations, as a share of `InnerProblem.iterations`.
_EACH = 0.5
# A step is minimised again, at most _RESCALINGS times, while the cloud's mean extinction changes by more than the share
# _SETTLED_SCALE; but not below the share _LEAST_SCALE of its value at the start, where the linear model misleads.
_RESCALINGS, _SETTLED_SCALE, _LEAST_SCALE = 4, 0.1, 0.5


@dataclass(frozen=True, eq=False)
class InnerProblem:
    """What a step minimises: the quadratic data term and the prior, whose form is chosen at some extinction.

    Attributes
    ----------
    problem : the problem, for its prior and device
    data : data term with the step's damping
    hessian_diagonal : approximate diagonal of the data term's Hessian, positive, shape (voxels,)
    units : factors of the prior
    upper : upper bound of the extinction, km^-1, shape (voxels,): as far as the linear model is trusted
    mass_share : share of the prior's pull on the cloud's mass that is taken back (mass.py)
    iterations : largest number of iterations of conjugate gradients
    iteration : number of the stage's iteration, counted from 0, if the prior is gentler in the first ones; else None
    """

    problem: Problem
    data: Term
    hessian_diagonal: np.ndarray
    units: NoiseUnits
    upper: np.ndarray
    mass_share: float
    iterations: int
    iteration: int | None = None

    def prior_value(self, extinction: np.ndarray) -> float:
        """The prior's value at an extinction, with the form that the prior has there."""
        prior = self.problem.prior.frozen(extinction, self.iteration, self.mass_share)
        return prior.value_and_gradient(extinction, self.units)[0]

    def least(self, begin: np.ndarray, share: float = 1.0, of_iterations: float = 1.0) -> np.ndarray:
        """The minimum with a share of the prior's weight and of the iterations; the prior's form is that at `begin`."""
        begin = np.minimum(begin, self.upper)
        device = self.problem.operator.device
        prior = self.problem.prior.frozen(begin, self.iteration, self.mass_share)
        units = replace(self.units, weight=share * self.units.weight)
        hessian_diagonal = self.hessian_diagonal + prior.curvature(begin, units)
        iterations = max(1, round(of_iterations * self.iterations))
        terms = [self.data, term_of(prior, units, device)]
        return minimised(terms, begin, hessian_diagonal, iterations, device, upper=self.upper)


def annealed(inner: InnerProblem, start: np.ndarray) -> np.ndarray:
    """The minimum, by annealing, with a prior whose form depends on the extinction, as the patch prior's does.

    If a step chose the prior's form at the last minimum, the choice would make that minimum likelier still, and every
    choice would make the cloud smoother. So each step begins with a weak prior, where the images decide on the form,
    and the form is chosen again while the weight rises to 1 (deterministic annealing: Rose 1998; a rising coupling
    does the same in Zoran and Weiss 2011). The step begins at the last cloud, with no voxel clear: what the images
    leave open stays about as it was.

    start : km^-1, shape (voxels,)
    """
    extinction = np.maximum(start, _FLOOR * mean_extinction(start))
    for share in _SHARES:
        extinction = inner.least(extinction, share, _EACH)
    return extinction


def rescaled(inner: InnerProblem, start: np.ndarray) -> np.ndarray:
    """The minimum from the last one, found again while the cloud's mean extinction, the prior's scale, changes.

    A thinner cloud makes the prior stronger, which makes the cloud thinner still. From a start that is too deep, where
    the linear model of the images says that there is no cloud, this would go on until no cloud is left.

    start : km^-1, shape (voxels,)
    """
    first, extinction = mean_extinction(start), inner.least(start)
    scale = first
    for _ in range(_RESCALINGS):
        before, scale = scale, mean_extinction(extinction)
        if abs(scale - before) <= _SETTLED_SCALE * before or scale < _LEAST_SCALE * first:
            break
        extinction = inner.least(extinction)
    return extinction
