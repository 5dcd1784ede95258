"""What the views' calibration leaves open, and is found with the cloud: gains, and where cameras point."""

from __future__ import annotations

import copy

import numpy as np

from cloudtomo_cl.scene.pointing import MOTIONS


class Calibration:
    """The part of residuals that unknown gains and motions of the views do not explain.

    What a view measures is its gain times the radiance that a camera sees which is a little turned or shifted. The
    gain is 1 with the standard error s, motions are 0 with theirs, all independent. Those that make 1/2 sum w r^2 and
    their own cost, n (g - 1)^2 / (2 s^2) and the like, least are taken out, n the mean of w times the noise's
    variance, which is the data term's unit. So 1/2 sum w r Calibration(r) is the cost with the best of them, and
    w Calibration(r) its derivative with respect to r. (Marginalising them as Gaussian gives the same.) It is the
    modelled image that gains multiply: with the measured one, noise and all, a fit would gain by shrinking both
    (D'Agostini 1994, "On the use of the covariance matrix to fit correlated data"). Motions change an image by its
    slope, to first order; solvers render with the motions that they find, so that the order does not matter in the end.
    The gains' mean, weighted by 1 / s^2, is taken to be 1: a brighter cloud looks like a larger common gain, and
    priors would choose the thinnest cloud that it allows (with errors of 8 %, on a small test: a fifth less mass).

    Parameters
    ----------
    weights : w, shape (pixels,)
    view : of each pixel, shape (pixels,)
    gain_errors : s, one for each view; 0 for a gain that is exact
    unit : n
    motions : what the motions of a pixel's view change it by, shape (pixels, 3), or none
    motion_errors : of them, shape (views, 3); 0 for what is exact
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
        # Exact views fix the scale by themselves.
        held = self._held[:, 0]
        self._share = held / held.max() if np.all(gains > 0) else None

    def in_unit(self, unit: float) -> Calibration:
        """The same with another unit: n of a step whose residuals are larger than noise explains."""
        other = copy.copy(self)
        other._held = self._held * (unit / self._unit)
        return other

    def __call__(self, residual: np.ndarray, modelled: np.ndarray) -> np.ndarray:
        """Residuals without what gains and motions explain.

        residual, modelled : shape (pixels,); the image that gains multiply, which need not be the residual's. The
            residual is that of views without motions: take out their `change` where they have some
        """
        if self._exact.all():
            return residual
        basis = self._basis(modelled)
        return residual - np.sum(basis * self._fitted(basis, residual)[self.view], axis=1)

    def unexplained(self, residual: np.ndarray, modelled: np.ndarray) -> float:
        """The mean of w r Calibration(r), which is n where noise is all that is left; arguments as of a call."""
        return float(np.mean(self._weights * (residual * self(residual, modelled))))

    def motions(self, residual: np.ndarray, modelled: np.ndarray) -> np.ndarray:
        """Those that explain residuals best, shape (views, 3); arguments as of a call."""
        if self._motions.shape[1] == 0:
            return np.zeros_like(self.motion_errors)
        return -self._fitted(self._basis(modelled), residual)[:, 1:]

    def change(self, motions: np.ndarray) -> np.ndarray:
        """What motions of the views, shape (views, 3), change their pixels by, shape (pixels,)."""
        return np.sum(self._motions * motions[self.view, : self._motions.shape[1]], axis=1)

    def drawn(self, random: np.random.Generator, modelled: np.ndarray) -> np.ndarray:
        """Errors of an image that gains and motions might bring, shape (pixels,)."""
        draws = self._errors * random.standard_normal(self._errors.shape)
        return np.sum(self._basis(modelled) * draws[self.view], axis=1)

    def _basis(self, modelled: np.ndarray) -> np.ndarray:
        """What gains and motions change pixels by, shape (pixels, 1 or 4)."""
        return np.column_stack([modelled, self._motions])

    def explained(self, modelled: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """What a call takes out of residuals r, as matrices: B_v (M B^T W r)_v of the view v.

        modelled : as of a call

        Returns
        -------
        B, shape (pixels, 1 or 4), and M, shape (views times that, views times that); with nothing in them if all views
        are exact
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
        """Factors of the basis that are taken out of each view, shape (views, 1 or 4)."""
        views, count = self._errors.shape
        weighted = self._weights[:, None] * basis
        right_hand_side = np.column_stack(
            [np.bincount(self.view, weighted[:, i] * residual, views) for i in range(count)]
        )
        return self._factors(self._normal_matrix(basis), right_hand_side)

    def _normal_matrix(self, basis: np.ndarray) -> np.ndarray:
        """B^T W B and what holds gains and motions, of each view."""
        views, count = self._errors.shape
        weighted = self._weights[:, None] * basis
        normal_matrix = np.zeros((views, count, count))
        for i in range(count):
            for j in range(count):
                normal_matrix[:, i, j] = np.bincount(self.view, weighted[:, i] * basis[:, j], views)
        return normal_matrix + np.eye(count) * self._held[:, None, :]

    def _factors(self, normal_matrix: np.ndarray, right_hand_side: np.ndarray) -> np.ndarray:
        """Those that a right-hand side, B^T W r, has, shape (views, 1 or 4)."""
        views, count = self._errors.shape
        free = ~self._exact
        # What is exact has no part: its row and column are those of the unit matrix.
        normal_matrix = np.where(free[:, :, None] & free[:, None, :], normal_matrix, np.eye(count))
        right_hand_side = np.where(free, right_hand_side, 0.0)
        factors = np.linalg.solve(normal_matrix, right_hand_side[..., None])[..., 0]
        if self._share is not None:
            unit = np.zeros((views, count))
            unit[:, 0] = self._share
            back = np.linalg.solve(normal_matrix, unit[..., None])[..., 0]
            factors -= back * (self._share @ factors[:, 0]) / (self._share @ back[:, 0])
        return factors
