"""The data term: how far modelled images are from measured ones."""

from __future__ import annotations

import numpy as np


def relative_weights(measured: np.ndarray, share: float = 0.1) -> np.ndarray:
    """Weights 1 / (m + share <m>)^2 of squared residuals, so that bright pixels do not rule alone.

    measured : radiances, any unit, shape (pixels,); <m> is their mean
    """
    return 1.0 / (measured + share * measured.mean()) ** 2


def crossed_cost(halves: np.ndarray, measured: np.ndarray, weights: np.ndarray) -> tuple[float, float]:
    """F = 1/2 sum_d w_d (i_d - m_d)^2 without the bias of the paths' noise, and its standard error.

    The residuals of two independent halves of the paths are multiplied: the mean of
    (A - m)(B - m) is (i - m)^2. The standard error takes the halves' difference as their noise.

    Parameters
    ----------
    halves : means over even and over odd samples, shape (pixels, 2)
    measured, weights : shape (pixels,)
    """
    residuals = halves - measured[:, None]
    products = weights * residuals.prod(axis=1)
    noise = (halves[:, 0] - halves[:, 1]) ** 2 / 2  # variance of one half
    signal = np.maximum(residuals.prod(axis=1), 0.0)
    variance = np.sum(weights**2 * (2 * signal * noise + noise**2))
    return 0.5 * float(products.sum()), 0.5 * float(np.sqrt(variance))


class LaggedResidual:
    """Residuals that are independent of the paths whose derivative they multiply.

    With memory 1, half A's derivative meets half B's residual and the reverse ("crossed
    halves"). With a longer memory the modelled image is averaged over about that many
    iterations: less noise in the gradient, but the residual lags while the extinction moves.

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
        self._iterations = 0

    def adjoint(self, halves: np.ndarray) -> np.ndarray:
        """d F / d halves, shape (pixels, 2); then remembers these halves."""
        self._iterations += 1
        rate = 1.0 / min(self._iterations, self.memory)
        other = (1.0 - rate) * self._mean[:, None] + rate * halves[:, ::-1]
        self._mean += rate * (halves.mean(axis=1) - self._mean)
        return 0.5 * self.weights[:, None] * (other - self.measured[:, None])
