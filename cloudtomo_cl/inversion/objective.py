"""The data term: how far modelled images are from measured ones."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cloudtomo_cl.inversion.calibration import Calibration

# Relative variance, in typical ones, beyond which a pixel's weight follows it. Below, the modelled image's noise
# counts as much; and standard errors come from the same samples as radiances: weights that follow them closely
# favour pixels that are dark by chance (docs/decisions/pixel-weights.md).
_NOISY = 4.0
# Standard error, in shares of m + m_rms, where none is known: that of a good camera.
_UNKNOWN_ERROR = 0.01


def relative_weights(measured: np.ndarray) -> np.ndarray:
    """Weights 1 / (m + m_rms)^2 of squared residuals: relative ones where it is bright.

    Bright pixels do not rule alone, and dark ones, in which the noise of the modelled image is
    large relative to them, do not rule either.

    measured : radiances, any unit, shape (pixels,); m_rms is their root mean square. Noise may
        make some of them negative: they weigh like zero
    """
    return 1.0 / (np.maximum(measured, 0.0) + np.sqrt(np.mean(measured**2))) ** 2


def variance_of(measured: np.ndarray, standard_error: np.ndarray) -> np.ndarray:
    """Variances of measured pixels.

    measured, standard_error : shape (pixels,), one unit; errors of 0 are unknown: taken for a typical one, relative
        to m + m_rms, of the others, or for 1 % if none is known
    """
    weights = relative_weights(measured)
    relative = weights * standard_error**2
    known = relative > 0
    relative[~known] = np.median(relative[known]) if known.any() else _UNKNOWN_ERROR**2
    return relative / weights


def pixel_weights(measured: np.ndarray, standard_error: np.ndarray) -> np.ndarray:
    """Relative weights r, but for noisy pixels: r min(1, 4 q / (r s^2)), q the median of the pixels' r s^2.

    So a pixel whose relative standard error is more than twice the typical one weighs by its inverse variance.

    measured, standard_error : radiance and s, shape (pixels,), one unit; as for `variance_of`
    """
    weights = relative_weights(measured)
    relative = weights * variance_of(measured, standard_error)
    return weights / np.maximum(1.0, relative / (_NOISY * np.median(relative)))


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


def variance_of_half(halves: np.ndarray) -> np.ndarray:
    """Of either of two independent halves of a rendering's paths, shape (pixels, 2): shape (pixels,)."""
    return (halves[:, 0] - halves[:, 1]) ** 2 / 2


def error_beyond_noise(image: np.ndarray, variance: np.ndarray, halves: np.ndarray, weights: np.ndarray) -> float:
    """What an image is off by beyond its noise, 1/2 sum_d w_d (error of d)^2, by paths that are not in it.

    Derivatives carry an averaged image along with the extinction, and miss what is not linear: in deep clouds much
    more than its noise. Of what is measured counts what exceeds its own standard error (a garrote: Breiman 1995), so
    that nothing is found where there is nothing.

    Parameters
    ----------
    image, variance : and that of its noise, shape (pixels,)
    halves : of other paths, independent of each other, shape (pixels, 2)
    weights : w, shape (pixels,)
    """
    of_half = variance_of_half(halves)
    first, second = (halves - image[:, None]).T
    square, standard_error = cost_of_independent(first, of_half, second, of_half, weights)
    off = square - noise_of(variance, weights)
    return off - standard_error**2 / off if off > standard_error else 0.0


@dataclass(frozen=True, eq=False)
class AveragedImage:
    """The modelled image, averaged over iterations: residuals that are independent of the paths that they multiply.

    Before the first iteration, and with a window of 1, half A's derivative meets half B's residual and the reverse
    ("crossed halves"). With a longer window there is less noise in cost and gradient, but the average lags while the
    extinction moves, unless it is `moved` along.

    Attributes
    ----------
    mean, variance : of the averaged radiances, W m^-2 sr^-1 and its square, shape (pixels,)
    iterations : averaged so far
    """

    mean: np.ndarray
    variance: np.ndarray
    iterations: int = 0

    @classmethod
    def empty(cls, pixels: int) -> AveragedImage:
        """Before the first iteration."""
        return cls(np.zeros(pixels), np.zeros(pixels))

    def cost(
        self,
        halves: np.ndarray,
        measured: np.ndarray,
        weights: np.ndarray,
        calibration: Calibration | None = None,
        window: int = 1,
    ) -> tuple[float, float]:
        """F and its standard error, from halves of shape (pixels, 2) of paths that are not averaged yet."""
        residuals = halves - measured[:, None]
        half_variance = variance_of_half(halves)
        if window == 1 or self.iterations == 0:
            first, second = residuals[:, 0], self._calibrated(residuals[:, 1], calibration)
            return cost_of_independent(first, half_variance, second, half_variance, weights)
        return cost_of_independent(
            self._calibrated(self.mean - measured, calibration),
            self.variance,
            residuals.mean(axis=1),
            half_variance / 2,
            weights,
        )

    def adjoint(
        self,
        halves: np.ndarray,
        measured: np.ndarray,
        weights: np.ndarray,
        calibration: Calibration | None = None,
        window: int = 1,
    ) -> np.ndarray:
        """d F / d halves, shape (pixels, 2): that of each half depends on the other's paths and the average only."""
        rate = self._rate(window)
        other = (1.0 - rate) * self.mean[:, None] + rate * halves[:, ::-1]
        corrected = np.column_stack([self._calibrated(half, calibration) for half in (other - measured[:, None]).T])
        return 0.5 * weights[:, None] * corrected

    def with_halves(self, halves: np.ndarray, window: int = 1) -> AveragedImage:
        """With one more iteration's halves in the average."""
        rate = self._rate(window)
        variance = variance_of_half(halves) / 2
        return AveragedImage(
            self.mean + rate * (halves.mean(axis=1) - self.mean),
            (1.0 - rate) ** 2 * self.variance + rate**2 * variance,
            self.iterations + 1,
        )

    def moved(self, change: np.ndarray, window: int = 1) -> AveragedImage:
        """Taken along: what the last step changed radiances by, to first order, shape (pixels,)."""
        share = 1.0 - 1.0 / min(self.iterations, window)
        return AveragedImage(self.mean + share * change, self.variance, self.iterations)

    def noise(self, weights: np.ndarray) -> float:
        """What noise of the average adds to the cost."""
        return noise_of(self.variance, weights)

    def _rate(self, window: int) -> float:
        return 1.0 / min(self.iterations + 1, window)

    def _calibrated(self, residual: np.ndarray, calibration: Calibration | None) -> np.ndarray:
        # The average multiplies gains: it has other paths than the residuals that it is taken from.
        return residual if calibration is None else calibration(residual, self.mean)
