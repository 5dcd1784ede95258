"""Unknown gains of the views and small motions of their cameras, which are found together with the cloud."""

from __future__ import annotations

import copy

import numpy as np

from cloudtomo_cl.scene.pointing import MOTIONS


class Calibration:
    """The part of residuals that unknown gains and motions of the views do not explain.

    A view measures its gain times the radiance that a slightly turned or shifted camera sees. A priori gains are 1 with
    the standard error s, motions are 0 with their standard errors, and all are independent. The gains and motions that
    are taken out minimise 1/2 sum w r^2 plus their penalty, n (g - 1)^2 / (2 s^2) for a gain g and alike for a motion.
    Here n is the data term's unit: the mean of w times the noise's variance. So 1/2 sum w r Calibration(r) is the cost
    with the best gains and motions, and w Calibration(r) its derivative with respect to r. (Marginalising them as
    Gaussian gives the same.) Gains multiply the modelled image: if they multiplied the noisy measured one, the fit
    would be biased to small values of both (D'Agostini 1994, "On the use of the covariance matrix to fit correlated
    data"). Motions change an image by its slope, to first order; solvers render with the motions that they find, so
    that in the end the first order is enough.
    The gains' mean, weighted by 1 / s^2, is taken to be 1: a brighter cloud looks like a larger common gain, and
    priors would choose the thinnest cloud that it allows (with errors of 8 %, on a small test: a fifth less mass).

    Parameters
    ----------
    weights : weights w of the squared residuals, shape (pixels,)
    view : number of each pixel's view, shape (pixels,)
    gain_errors : standard errors s of the views' gains; 0: the gain is exact
    unit : unit n of the data term
    motions : change of each pixel per unit of its view's three motions, shape (pixels, 3); None: no motion is possible
    motion_errors : standard errors of the motions, shape (views, 3); 0: the motion is exact
    """

    def __init__(
        self,
        weights: np.ndarray,
        view: np.ndarray,
        gain_errors: tuple[float, ...],
        unit: float,
        motions: np.ndarray | None = None,
        motion_errors: np.ndarray | None = None,
    ) -> None:
        gains = np.asarray(gain_errors, float)
        self._weights, self.view, self._unit = weights, view, unit
        self.motion_errors = np.zeros((len(gains), MOTIONS)) if motion_errors is None else motion_errors
        self._motions = np.zeros((len(weights), 0)) if motions is None else motions
        self._errors = np.column_stack([gains, self.motion_errors])[:, : 1 + self._motions.shape[1]]
        self._exact = self._errors <= 0
        self._held = np.divide(unit, self._errors**2, out=np.zeros_like(self._errors), where=~self._exact)
        # Gains need no fixed mean if one of them is exact.
        held = self._held[:, 0]
        self._share = held / held.max() if np.all(gains > 0) else None

    def in_unit(self, unit: float) -> Calibration:
        """The same with another unit n, for a step whose residuals are larger than noise explains."""
        other = copy.copy(self)
        other._held = self._held * (unit / self._unit)
        return other

    def __call__(self, residual: np.ndarray, modelled: np.ndarray) -> np.ndarray:
        """Residuals without what gains and motions explain.

        residual : modelled minus measured radiance without motions (their `change` taken out), shape (pixels,)
        modelled : image that gains multiply, shape (pixels,); it need not be the one in the residual
        """
        if self._exact.all():
            return residual
        basis = self._basis(modelled)
        return residual - np.sum(basis * self._fitted(basis, residual)[self.view], axis=1)

    def unexplained(self, residual: np.ndarray, modelled: np.ndarray) -> float:
        """The mean of w r Calibration(r), which is n if only noise is left; arguments as in a call."""
        return float(np.mean(self._weights * (residual * self(residual, modelled))))

    def motions(self, residual: np.ndarray, modelled: np.ndarray) -> np.ndarray:
        """The motions that explain residuals best, shape (views, 3); arguments as in a call."""
        if self._motions.shape[1] == 0:
            return np.zeros_like(self.motion_errors)
        return -self._fitted(self._basis(modelled), residual)[:, 1:]

    def change(self, motions: np.ndarray) -> np.ndarray:
        """Change of the pixels, shape (pixels,), by motions of their views, shape (views, 3)."""
        return np.sum(self._motions * motions[self.view, : self._motions.shape[1]], axis=1)

    def drawn(self, random: np.random.Generator, modelled: np.ndarray) -> np.ndarray:
        """Random errors of an image by draws of the gains and motions, shape (pixels,)."""
        draws = self._errors * random.standard_normal(self._errors.shape)
        return np.sum(self._basis(modelled) * draws[self.view], axis=1)

    def _basis(self, modelled: np.ndarray) -> np.ndarray:
        """Change of each pixel per unit of its view's gain and motions, shape (pixels, 1 or 4)."""
        return np.column_stack([modelled, self._motions])

    def explained(self, modelled: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The part B_v (M B^T W r)_v of the residuals r of view v that a call takes out, as matrices.

        modelled : as in a call

        Returns
        -------
        B, shape (pixels, k), and M, shape (views k, views k), with k = 1 or 4; k = 0 if all views are exact
        """
        if self._exact.all():
            return np.zeros((len(self._weights), 0)), np.zeros((0, 0))
        basis = self._basis(modelled)
        views, count = self._errors.shape
        right_hand_sides = np.eye(views * count).reshape(-1, views, count)
        normal_matrix = self._normal_matrix(basis)
        return basis, np.array(
            [self._factors(normal_matrix, right_hand_side).ravel() for right_hand_side in right_hand_sides]
        ).T

    def _fitted(self, basis: np.ndarray, residual: np.ndarray) -> np.ndarray:
        """Factors of the basis in the part that is taken out of each view, shape (views, 1 or 4)."""
        views, count = self._errors.shape
        weighted = self._weights[:, None] * basis
        right_hand_side = np.column_stack(
            [np.bincount(self.view, weighted[:, i] * residual, views) for i in range(count)]
        )
        return self._factors(self._normal_matrix(basis), right_hand_side)

    def _normal_matrix(self, basis: np.ndarray) -> np.ndarray:
        """B^T W B of each view, plus the penalties of its gain and motions, shape (views, k, k)."""
        views, count = self._errors.shape
        weighted = self._weights[:, None] * basis
        normal_matrix = np.zeros((views, count, count))
        for i in range(count):
            for j in range(count):
                normal_matrix[:, i, j] = np.bincount(self.view, weighted[:, i] * basis[:, j], views)
        return normal_matrix + np.eye(count) * self._held[:, None, :]

    def _factors(self, normal_matrix: np.ndarray, right_hand_side: np.ndarray) -> np.ndarray:
        """The factors of the basis for a right-hand side B^T W r, shape (views, 1 or 4)."""
        views, count = self._errors.shape
        free = ~self._exact
        # Exact gains and motions do not change: their rows and columns are those of the unit matrix.
        normal_matrix = np.where(free[:, :, None] & free[:, None, :], normal_matrix, np.eye(count))
        right_hand_side = np.where(free, right_hand_side, 0.0)
        factors = np.linalg.solve(normal_matrix, right_hand_side[..., None])[..., 0]
        if self._share is not None:
            unit = np.zeros((views, count))
            unit[:, 0] = self._share
            back = np.linalg.solve(normal_matrix, unit[..., None])[..., 0]
            factors -= back * (self._share @ factors[:, 0]) / (self._share @ back[:, 0])
        return factors
