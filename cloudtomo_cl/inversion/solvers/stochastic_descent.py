"""Iterations of stochastic gradient descent (ADAM, SGD) on the misfit of images and the prior."""

from __future__ import annotations

import numpy as np

from cloudtomo_cl.inversion.checkpoint import joined, part
from cloudtomo_cl.inversion.objective import LaggedResidual
from cloudtomo_cl.inversion.pixels import SeenPixels
from cloudtomo_cl.inversion.priors import Prior, PriorOperator
from cloudtomo_cl.inversion.solvers.method import Progress, check_gradient
from cloudtomo_cl.inversion.solvers.optimizer import Descent, Optimizer
from cloudtomo_cl.inversion.stages import Stage
from cloudtomo_cl.transport.derivatives import RadianceField
from cloudtomo_cl.transport.radiance import RadianceOperator

PATHS_PER_ITERATION = 60_000


class StochasticDescent:
    """Descends by the gradient of a few paths at a time.

    Parameters
    ----------
    optimizer, prior, stage : settings
    operator : of the stage's grid and pixels, with a mask
    seen : the pixels, as measured
    extinction : where to start, km^-1, shape of the grid
    mask : bool, where cloud may be, as the operator's
    seed : of the paths
    """

    def __init__(
        self,
        optimizer: Optimizer,
        prior: Prior,
        stage: Stage,
        operator: RadianceOperator,
        seen: SeenPixels,
        extinction: np.ndarray,
        mask: np.ndarray,
        seed: int,
    ) -> None:
        self._operator = operator
        self._seed = seed
        self._prior_weight = stage.prior_weight
        self._samples = stage.samples or max(2, 2 * round(PATHS_PER_ITERATION / len(seen.pixels) / 2))
        self._noise = seen.unit
        self._residual = LaggedResidual(seen.radiance, seen.weights, optimizer.image_memory, seen.gains)
        self._prior = PriorOperator(prior, operator.scene.grid.shape, operator.device)
        self._descent = Descent(optimizer, extinction, mask, operator.device)
        self._field = RadianceField(operator) if optimizer.gradient == "field" else None

    @property
    def extinction(self) -> np.ndarray:
        """Where the descent stands, km^-1, shape of the grid."""
        return self._descent.extinction.get()

    def estimate(self) -> np.ndarray:
        """The running mean of the extinction, km^-1, shape of the grid."""
        return self._descent.estimate()

    def standard_error(self, draws: int) -> None:
        """Not known: it takes the derivatives of all pixels."""
        return None

    def iterate(self, key: int, where: str) -> Progress:
        """One step; `key` numbers its paths, `where` is for errors.

        Raises
        ------
        TransportError : the gradient is not finite
        """
        extinction = self._descent.extinction
        rendering = self._operator.render(extinction, self._samples, self._seed, key, keep_paths=True)
        cost, error = self._residual.cost(rendering.halves)
        adjoint = self._residual.adjoint(rendering.halves)
        if self._field is None:
            gradient = self._operator.gradient(rendering, adjoint)
        else:
            gradient, tangent = self._field.gradient(rendering, adjoint, self._descent.change)
            self._residual.move(tangent)
        weight = self._prior_weight * (self._noise + 2 * self._residual.noise / len(adjoint))
        prior_value, prior_gradient = self._prior.value_and_gradient(extinction, weight, self._noise)
        gradient = gradient + prior_gradient
        check_gradient(gradient.get(), where)
        self._descent.step(gradient)
        return Progress(cost, error, prior_value, self._samples * len(self._operator.pixels))

    def state(self) -> dict[str, np.ndarray]:
        """All that an iteration changes, as arrays on the host."""
        parts = {"descent": self._descent.state(), "residual": self._residual.state()}
        if self._field is not None:
            parts["field"] = self._field.state()
        return joined(parts)

    def restore(self, state: dict[str, np.ndarray]) -> None:
        """Goes on from what `state` gave."""
        self._descent.restore(part(state, "descent"))
        self._residual.restore(part(state, "residual"))
        if self._field is not None:
            self._field.restore(part(state, "field"))
