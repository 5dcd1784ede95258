"""The minimum of a step, where the prior has many: from a weak prior to its full weight."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from cloudtomo_cl.inversion.conjugate_gradients import minimised
from cloudtomo_cl.inversion.noise_units import NoiseUnits
from cloudtomo_cl.inversion.prior_terms import term_of
from cloudtomo_cl.inversion.problem import Problem
from cloudtomo_cl.inversion.relative_prior import mean_extinction
from cloudtomo_cl.inversion.terms import Term

# Shares of the weight of a prior that chooses, one minimised with after the other (docs/decisions/patch-prior.md).
_SHARES = (0.03, 0.06, 0.12, 0.24, 0.48, 1.0, 1.0)
# Begun where nothing is less than this share of the cloud's mean extinction.
_FLOOR = 0.1
# Of the iterations of a minimisation, the share of one of these.
_EACH = 0.5
# How often a step is minimised again because the cloud's mean extinction has changed, by more than this share; not once
# it has fallen below that share of the step's start, where the linear model is no guide any more.
_RESCALINGS, _SETTLED_SCALE, _LEAST_SCALE = 4, 0.1, 0.5


@dataclass(frozen=True, eq=False)
class InnerProblem:
    """What a step minimises: a data term, which is quadratic, and the prior as it stands at some extinction.

    Attributes
    ----------
    problem : whose prior and device
    data : with the step's damping
    hessian_diagonal : about the diagonal of its second derivative, positive, shape (voxels,)
    units : what the prior is multiplied with
    upper : bound of the extinction, km^-1, shape (voxels,): as far as the linear model is trusted
    mass_share : of the prior's pull on the mass, which is taken back (`mass`)
    iterations : of conjugate gradients, at most
    iteration : of the stage, counted from 0
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
        """That of the prior as it stands there."""
        prior = self.problem.prior.frozen(extinction, self.iteration, self.mass_share)
        return prior.value_and_gradient(extinction, self.units)[0]

    def least(self, begin: np.ndarray, share: float = 1.0, of_iterations: float = 1.0) -> np.ndarray:
        """The minimum, begun where the prior is chosen, with a share of its weight and of the iterations."""
        begin = np.minimum(begin, self.upper)
        device = self.problem.operator.device
        prior = self.problem.prior.frozen(begin, self.iteration, self.mass_share)
        units = replace(self.units, weight=share * self.units.weight)
        hessian_diagonal = self.hessian_diagonal + prior.curvature(begin, units)
        iterations = max(1, round(of_iterations * self.iterations))
        terms = [self.data, term_of(prior, units, device)]
        return minimised(terms, begin, hessian_diagonal, iterations, device, upper=self.upper)


def annealed(inner: InnerProblem, start: np.ndarray) -> np.ndarray:
    """With a prior that chooses by the extinction what it is: from above.

    Begun at the last minimum, such a prior chooses what makes that likelier still, and every choice makes the cloud
    smoother. So each step begins with a weak prior, whose choice the images decide; and its weight rises to 1 while it
    chooses again and again (deterministic annealing: Rose 1998; a rising coupling does the same in Zoran and Weiss
    2011). It begins at the last cloud with no voxel clear: what the images do not say stays about what it was.

    start : km^-1, shape (voxels,)
    """
    extinction = np.maximum(start, _FLOOR * mean_extinction(start))
    for share in _SHARES:
        extinction = inner.least(extinction, share, _EACH)
    return extinction


def rescaled(inner: InnerProblem, start: np.ndarray) -> np.ndarray:
    """From the last minimum, and again whenever the cloud's mean extinction, by which the prior is scaled, has changed.

    A cloud that gets thinner makes the prior stronger, by which it gets thinner still: from a start that is too deep,
    where the linear model of images says that there is no cloud, this would go on until there is none.

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
