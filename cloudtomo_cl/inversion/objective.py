"""The data term: how far modelled images are from measured ones."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cloudtomo_cl.inversion.calibration import Calibration

# Relative variance, in units of the pixels' median, above which a pixel's weight falls with it. Below, the noise of the
# modelled image counts as much; and standard errors come from the same samples as radiances, so that weights which
# follow them closely favour pixels that are dark by chance (docs/decisions/pixel-weights.md).
_NOISY = 4.0
# Standard error as a share of m + m_rms where none is known: that of a good camera.
_UNKNOWN_ERROR = 0.01


def relative_weights(measured: np.ndarray) -> np.ndarray:
    """Weights 1 / (m + m_rms)^2 of squared residuals: in bright pixels relative errors count.

    So neither bright pixels dominate, nor dark ones, in which the modelled image's noise is
    large in relation to the radiance.

    measured : radiances m in any unit, shape (pixels,); m_rms is their root mean square. Radiances
        that noise has made negative weigh like zero
    """
    return 1.0 / (np.maximum(measured, 0.0) + np.sqrt(np.mean(measured**2))) ** 2


def variance_of(measured: np.ndarray, standard_error: np.ndarray) -> np.ndarray:
    """Variances of measured pixels.

    measured, standard_error : radiances and their standard errors in one unit, shape (pixels,). An error of 0 is
        unknown: it is taken to be the median of the others relative to m + m_rms, or 1 % if none is known
    """
    weights = relative_weights(measured)
    relative = weights * standard_error**2
    known = relative > 0
    relative[~known] = np.median(relative[known]) if known.any() else _UNKNOWN_ERROR**2
    return relative / weights


def pixel_weights(measured: np.ndarray, standard_error: np.ndarray) -> np.ndarray:
    """Relative weights r, smaller in noisy pixels: r min(1, 4 q / (r s^2)), with q the median of the pixels' r s^2.

    So a pixel whose relative standard error is more than twice the median is weighted by its inverse variance.

    measured, standard_error : radiances and their standard errors s, as for `variance_of`
    """
    weights = relative_weights(measured)
    relative = weights * variance_of(measured, standard_error)
    return weights / np.maximum(1.0, relative / (_NOISY * np.median(relative)))


def noise_of(variance: np.ndarray, weights: np.ndarray) -> float:
    """The part of the data term that the images' noise adds on average: 1/2 sum_d w_d Var(m_d)."""
    return 0.5 * float(np.sum(weights * variance))


def cost_of_independent(
    first: np.ndarray,
    first_variance: np.ndarray,
    second: np.ndarray,
    second_variance: np.ndarray,
    weights: np.ndarray,
) -> tuple[float, float]:
    """F = 1/2 sum_d w_d (i_d - m_d)^2 and its standard error, from two independent estimates of the residuals.

    The mean of their product is (i - m)^2; the square of one of them would be too large by its
    variance. All arrays have shape (pixels,).
    """
    product = first * second
    # Var(product) = (i - m)^2 (v1 + v2) + v1 v2. Negative products stay, so that the sum is unbiased;
    # rare bright paths may make it negative. The lower bound is what noise alone would give: a third
    # of the second term, whose mean is three times too large if v1 and v2 are the same estimate.
    noise = np.sum(weights**2 * first_variance * second_variance)
    variance = np.sum(weights**2 * product * (first_variance + second_variance)) + noise
    return 0.5 * float(np.sum(weights * product)), 0.5 * float(np.sqrt(max(variance, noise / 3)))


def variance_of_half(halves: np.ndarray) -> np.ndarray:
    """The variance of each of two independent halves of a rendering's paths, (pixels, 2); shape (pixels,)."""
    return (halves[:, 0] - halves[:, 1]) ** 2 / 2


def error_beyond_noise(image: np.ndarray, variance: np.ndarray, halves: np.ndarray, weights: np.ndarray) -> float:
    """The error of an image beyond its noise, 1/2 sum_d w_d (error of d)^2, found by paths that are not in it.

    An averaged image is carried along with the extinction by the derivatives, which miss what is not linear: in deep
    clouds much more than the noise. The estimate counts as far as it exceeds its standard error (a garrote: Breiman
    1995), so that it is 0 where there is no such error.

    Parameters
    ----------
    image, variance : radiances and variances of their noise, shape (pixels,)
    halves : radiances by two halves of other paths, shape (pixels, 2)
    weights : weights w of the squared residuals, shape (pixels,)
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
    mean, variance : averaged radiances, W m^-2 sr^-1, and their variances, (W m^-2 sr^-1)^2, shape (pixels,)
    iterations : number of iterations averaged so far
    """

    mean: np.ndarray
    variance: np.ndarray
    iterations: int = 0

    @classmethod
    def empty(cls, pixels: int) -> AveragedImage:
        """The average before the first iteration."""
        return cls(np.zeros(pixels), np.zeros(pixels))

    def cost(
        self,
        halves: np.ndarray,
        measured: np.ndarray,
        weights: np.ndarray,
        calibration: Calibration | None = None,
        window: int = 1,
    ) -> tuple[float, float]:
        """F and its standard error, from two halves of paths that are not yet averaged, shape (pixels, 2)."""
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
        """d F / d halves, shape (pixels, 2): for each half from the other half's paths and the average only."""
        rate = self._rate(window)
        other = (1.0 - rate) * self.mean[:, None] + rate * halves[:, ::-1]
        corrected = np.column_stack([self._calibrated(half, calibration) for half in (other - measured[:, None]).T])
        return 0.5 * weights[:, None] * corrected

    def with_halves(self, halves: np.ndarray, window: int = 1) -> AveragedImage:
        """The average with one more iteration's halves."""
        rate = self._rate(window)
        variance = variance_of_half(halves) / 2
        return AveragedImage(
            self.mean + rate * (halves.mean(axis=1) - self.mean),
            (1.0 - rate) ** 2 * self.variance + rate**2 * variance,
            self.iterations + 1,
        )

    def moved(self, change: np.ndarray, window: int = 1) -> AveragedImage:
        """The average carried along with the last step, which changed radiances by `change`, to first order."""
        share = 1.0 - 1.0 / min(self.iterations, window)
        return AveragedImage(self.mean + share * change, self.variance, self.iterations)

    def noise(self, weights: np.ndarray) -> float:
        """The part of the cost that the average's noise adds."""
        return noise_of(self.variance, weights)

    def _rate(self, window: int) -> float:
        return 1.0 / min(self.iterations + 1, window)

    def _calibrated(self, residual: np.ndarray, calibration: Calibration | None) -> np.ndarray:
        # Gains multiply the average, whose paths are not those of the residuals.
        return residual if calibration is None else calibration(residual, self.mean)
