"""The data term: how far modelled images are from measured ones."""

from __future__ import annotations

import numpy as np


def relative_weights(measured: np.ndarray) -> np.ndarray:
    """Weights 1 / (m + m_rms)^2 of squared residuals: relative ones where it is bright.

    Bright pixels do not rule alone, and dark ones, in which the noise of the modelled image is
    large relative to them, do not rule either.

    measured : radiances, any unit, shape (pixels,); m_rms is their root mean square. Noise may
        make some of them negative: they weigh like zero
    """
    return 1.0 / (np.maximum(measured, 0.0) + np.sqrt(np.mean(measured**2))) ** 2


def noise_of(variance: np.ndarray, weights: np.ndarray) -> float:
    """What noise of the images alone adds to the data term on average: 1/2 sum_d w_d Var(m_d)."""
    return 0.5 * float(np.sum(weights * variance))


def cost_of_independent(
    first: np.ndarray,
    first_variance: np.ndarray,
    second: np.ndarray,
    second_variance: np.ndarray,
    weights: np.ndarray,
) -> tuple[float, float]:
    """F = 1/2 sum_d w_d (i_d - m_d)^2 from two independent estimates of the residuals.

    Their product has the mean (i - m)^2, where a square of one of them would be too large by
    its variance. Returns F and its standard error. All arrays have shape (pixels,).
    """
    product = first * second
    # Var(product) = (i - m)^2 (v1 + v2) + v1 v2. No pixel's square is rectified, for the sum is to
    # be unbiased; rare bright paths may make it negative. Least is what noise alone would give: a
    # third of the second term, whose mean is three times too large if v1 and v2 are one estimate.
    noise = np.sum(weights**2 * first_variance * second_variance)
    variance = np.sum(weights**2 * product * (first_variance + second_variance)) + noise
    return 0.5 * float(np.sum(weights * product)), 0.5 * float(np.sqrt(max(variance, noise / 3)))


class LaggedResidual:
    """Residuals that are independent of the paths whose derivative they multiply.

    With memory 1, half A's derivative meets half B's residual and the reverse ("crossed
    halves"). With a longer memory the modelled image is averaged over about that many
    iterations: less noise in cost and gradient, but the residual lags while the extinction
    moves. Usage in an iteration: `cost`, then `adjoint`, which remembers the image.

    Parameters
    ----------
    measured, weights : shape (pixels,)
    memory : iterations, at least 1
    """

    def __init__(self, measured: np.ndarray, weights: np.ndarray, memory: int = 1) -> None:
        self.measured = measured
        self.weights = weights
        self.memory = memory
        self._mean = np.zeros_like(measured)
        self._variance = np.zeros_like(measured)
        self._iterations = 0

    def state(self) -> dict[str, np.ndarray]:
        """What is remembered of the iterations so far."""
        return {"mean": self._mean.copy(), "variance": self._variance.copy(), "iterations": np.array(self._iterations)}

    def restore(self, state: dict[str, np.ndarray]) -> None:
        """Goes on from what `state` gave."""
        self._mean, self._variance = state["mean"].copy(), state["variance"].copy()
        self._iterations = int(state["iterations"])

    def cost(self, halves: np.ndarray) -> tuple[float, float]:
        """F and its standard error, from halves of shape (pixels, 2)."""
        residuals = halves - self.measured[:, None]
        half_variance = (halves[:, 0] - halves[:, 1]) ** 2 / 2
        if self.memory == 1 or self._iterations == 0:
            first, second = residuals.T
            return cost_of_independent(first, half_variance, second, half_variance, self.weights)
        return cost_of_independent(
            self._mean - self.measured, self._variance, residuals.mean(axis=1), half_variance / 2, self.weights
        )

    def move(self, change: np.ndarray) -> None:
        """Takes the remembered image along: what the last step changed, by the tangent, shape (pixels,)."""
        rate = 1.0 / min(self._iterations, self.memory)
        self._mean += (1.0 - rate) * change

    def adjoint(self, halves: np.ndarray) -> np.ndarray:
        """d F / d halves, shape (pixels, 2); then remembers these halves."""
        self._iterations += 1
        rate = 1.0 / min(self._iterations, self.memory)
        other = (1.0 - rate) * self._mean[:, None] + rate * halves[:, ::-1]
        self._mean += rate * (halves.mean(axis=1) - self._mean)
        variance = (halves[:, 0] - halves[:, 1]) ** 2 / 4
        self._variance = (1.0 - rate) ** 2 * self._variance + rate**2 * variance
        return 0.5 * self.weights[:, None] * (other - self.measured[:, None])
