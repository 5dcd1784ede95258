"""Gauss-Newton iterations: the misfit with the derivatives of all pixels, and the prior, minimised."""

from __future__ import annotations

import numpy as np
from scipy.optimize import minimize

from cloudtomo_cl.inversion.checkpoint import joined, part
from cloudtomo_cl.inversion.objective import cost_of_independent, curvature_of, noise_of
from cloudtomo_cl.inversion.pixels import SeenPixels
from cloudtomo_cl.inversion.priors import SMOOTHNESS_CURVATURE, Prior, PriorOperator
from cloudtomo_cl.inversion.solvers.method import Progress, check_gradient
from cloudtomo_cl.inversion.solvers.optimizer import Optimizer
from cloudtomo_cl.inversion.stages import Stage
from cloudtomo_cl.inversion.uncertainty import LEAST_CURVATURE, standard_errors
from cloudtomo_cl.transport.derivatives import RadianceField
from cloudtomo_cl.transport.radiance import RadianceOperator, Rendering, pooled

# Paths of an iteration that derivatives are made of, for each voxel of the mask, and the least of all.
_PATHS_PER_VOXEL = 45
_LEAST_PATHS = 50_000
# Share of a predicted change of a pixel that is taken for the prediction's error.
_TANGENT_ERROR = 0.1
# Of L-BFGS-B's memory.
_CORRECTIONS = 20


def samples_of(pixels: int, voxels: int) -> int:
    """Paths per pixel that the derivatives of so many voxels are made of, if the stage does not say."""
    return max(2, 2 * round(max(_PATHS_PER_VOXEL * voxels, _LEAST_PATHS) / pixels / 2))


def _rate(iteration: int) -> float:
    """Share of an iteration, counted from 0, in a mean over about the later half of them."""
    return 1 / (1 + iteration // 2)


class GaussNewton:
    """Renders at an extinction, takes the derivatives there, and minimises the model of the cost they give.

    The images of all iterations are kept as one: their mean is carried along with the extinction by
    the derivatives, and every iteration's own paths are averaged into it, so that noise falls while
    the steps get smaller. Derivatives and estimate are means over the later half of the iterations:
    noise of the derivatives alone would let them fit noise of the images (docs/results.md).
    Parameters as of `StochasticDescent`.

    Source: Gauss-Newton with bounds; derivatives by `RadianceField.jacobian`.
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
        import pyopencl.array as cl_array

        self._array = cl_array
        self._optimizer = optimizer
        self._operator = operator
        self._mask = mask
        self._seed = seed
        self._samples = stage.samples or samples_of(len(seen.pixels), int(mask.sum()))
        self._seen = seen
        self._measured = seen.radiance
        self._weights = seen.weights
        self._unit = seen.unit
        self._gains = seen.gains
        self._smoothness = prior.smoothness
        self._curvature_of_sparsity = prior.sparsity / prior.clear**2
        self._prior = PriorOperator(prior, operator.scene.grid.shape, operator.device)
        self._field = RadianceField(operator)
        self._extinction = extinction[self._mask].astype(float)  # of the mask's voxels
        self._mean = self._extinction.copy()
        self._image = np.zeros(len(seen.pixels))
        self._variance = np.zeros(len(seen.pixels))
        self._jacobian: np.ndarray | None = None
        self._walked: list[tuple[int, np.ndarray]] = []  # keys and extinctions that the derivatives are of
        self._lag = 0.0  # noise_of the errors of the last step's prediction
        self._stage_weight = stage.prior_weight
        self._iterations = 0

    @property
    def extinction(self) -> np.ndarray:
        """Where the iterations stand, km^-1, shape of the grid."""
        return self._on_grid(self._extinction)

    def estimate(self) -> np.ndarray:
        """The mean of the last iterations' extinctions, km^-1, shape of the grid."""
        return self._on_grid(self._mean)

    def _on_grid(self, values: np.ndarray) -> np.ndarray:
        extinction = np.zeros(self._mask.shape, np.float32)
        extinction[self._mask] = values
        return extinction

    def iterate(self, key: int, where: str) -> Progress:
        """One step; `key` numbers its paths, `where` is for errors.

        Raises
        ------
        TransportError : a derivative is not finite
        """
        operator, samples = self._operator, self._samples
        extinction = self.extinction
        self._recall()
        walked = self._differentiate(key, self._extinction)
        rendering = walked
        if self._optimizer.image_samples:
            more = samples * self._optimizer.image_samples
            rendering = pooled(walked, operator.render(extinction, more, self._seed, key, first_sample=samples))
        cost, error = self._cost(rendering.halves)
        self._remember(rendering.mean, rendering.standard_error**2)
        prior_value, _ = self._prior_at(self._extinction)
        self._step(where)
        self._mean += (self._extinction - self._mean) * _rate(self._iterations - 1)
        return Progress(cost, error, prior_value, rendering.samples * len(operator.pixels))

    def _recall(self) -> None:
        """After a resume: derivatives of the iterations before."""
        if self._jacobian is None:
            before, self._walked = self._walked, []
            for earlier, values in before:
                self._differentiate(earlier, values)

    def standard_error(self, draws: int) -> np.ndarray | None:
        """Of the estimate, by so many draws from the last linear model, km^-1, shape of the grid.

        None if the images' noise is not known, or before the first iteration.
        """
        self._recall()
        if self._jacobian is None or not self._seen.standard_error.any():
            return None
        image, seen = self._image, self._seen
        misfit = image - self._measured + self._jacobian @ (self._mean - self._extinction).astype(np.float32)
        force = self._weights * self._gains(misfit, image)
        gradient = force.astype(np.float32) @ self._jacobian + self._prior_at(self._mean)[1]
        deviation = np.sqrt(seen.variance + self._variance)
        gains = np.array(seen.calibration_errors)

        def noise(random: np.random.Generator) -> np.ndarray:
            common = gains * random.standard_normal(len(gains))
            return deviation * random.standard_normal(len(image)) + common[seen.pixels[:, 0]] * image

        found = standard_errors(
            self._jacobian,
            self._weights,
            noise,
            lambda residual: self._gains(residual, image),
            self._prior_weight * self._smoothness,
            self._noise,
            self._mask,
            self._mean,
            gradient,
            draws,
            self._seed,
        )
        return self._on_grid(found)

    def _differentiate(self, key: int, values: np.ndarray) -> Rendering:
        """Walks paths at an extinction, and averages their derivatives into those of iterations before."""
        walked = self._operator.render(self._on_grid(values), self._samples, self._seed, key, keep_paths=True)
        self._jacobian = self._field.jacobian(walked, self._jacobian, _rate(len(self._walked)))
        self._walked.append((key, values.astype(np.float32)))
        return walked

    def _cost(self, halves: np.ndarray) -> tuple[float, float]:
        variance = (halves[:, 0] - halves[:, 1]) ** 2 / 2
        first, second = (halves - self._measured[:, None]).T
        return cost_of_independent(first, variance, self._gains(second, self._image), variance, self._weights)

    def _remember(self, image: np.ndarray, variance: np.ndarray) -> None:
        """Averages an image into that remembered, by how much noise and error each has."""
        rate = 1.0
        if self._iterations:
            old = noise_of(self._variance, self._weights) + self._lag
            new = noise_of(variance, self._weights)
            rate = old / (old + new) if old + new > 0 else 1 / (1 + self._iterations)
        self._image += rate * (image - self._image)
        self._variance = (1 - rate) ** 2 * self._variance + rate**2 * variance
        self._lag *= (1 - rate) ** 2
        self._iterations += 1

    @property
    def _noise(self) -> float:
        """N of the prior: the mean weighted variance of a pixel's noise, measured and modelled."""
        return self._unit + 2 * (noise_of(self._variance, self._weights) + self._lag) / len(self._measured)

    @property
    def _prior_weight(self) -> float:
        return self._stage_weight * self._noise

    def _prior_at(self, values: np.ndarray) -> tuple[float, np.ndarray]:
        extinction = self._array.to_device(self._operator.device.queue, self._on_grid(values))
        value, gradient = self._prior.value_and_gradient(extinction, self._prior_weight, self._unit)
        return value, gradient.get()[self._mask].astype(float)

    def _step(self, where: str) -> None:
        """Minimises the model: residuals and their derivatives, the prior, and a damping of the step."""
        jacobian = self._jacobian
        assert jacobian is not None
        start, residual, image = self._extinction, self._image - self._measured, self._image.copy()
        curvature = curvature_of(jacobian, self._weights)
        check_gradient(self._on_grid(curvature), where)
        damping = self._optimizer.damping * max(0.5 ** (self._iterations - 1), 0.1)
        stiff = curvature * (1 + damping) + self._prior_weight * self._smoothness * SMOOTHNESS_CURVATURE
        stiff += self._unit * self._curvature_of_sparsity + LEAST_CURVATURE * curvature.mean()
        scale = 1 / np.sqrt(stiff)

        def model(scaled: np.ndarray) -> tuple[float, np.ndarray]:
            values = scaled * scale
            change = values - start
            misfit = residual + jacobian @ change.astype(np.float32)
            force = self._weights * self._gains(misfit, image)
            prior, prior_gradient = self._prior_at(values)
            held = damping * curvature * change
            gradient = force.astype(np.float32) @ jacobian + held + prior_gradient
            return 0.5 * float(misfit @ force + held @ change) + prior, gradient * scale

        options = {"maxiter": self._optimizer.inner_iterations, "maxcor": _CORRECTIONS}
        bounds = [(0.0, None)] * len(start)
        found = minimize(model, start / scale, jac=True, method="L-BFGS-B", bounds=bounds, options=options)
        self._extinction = np.maximum(found.x * scale, 0.0)
        predicted = jacobian @ (self._extinction - start).astype(np.float32)
        self._image += predicted
        self._lag += noise_of((_TANGENT_ERROR * predicted) ** 2, self._weights)

    def state(self) -> dict[str, np.ndarray]:
        """All that an iteration changes, as arrays on the host."""
        names = ("extinction", "mean", "image", "variance", "lag", "iterations")
        own = {name: np.array(getattr(self, f"_{name}")) for name in names}
        keys, extinctions = zip(*self._walked) if self._walked else ((), ())
        walked: dict[str, np.ndarray] = {"keys": np.array(keys, np.int64)}
        walked["extinctions"] = np.array(extinctions, np.float32)
        return joined({"gauss_newton": own, "walked": walked})

    def restore(self, state: dict[str, np.ndarray]) -> None:
        """Goes on from what `state` gave. The derivatives are too many to be kept: their paths are walked again."""
        for name, array in part(state, "gauss_newton").items():
            setattr(self, f"_{name}", array.item() if array.ndim == 0 else array.copy())
        walked = part(state, "walked")
        self._walked = [(int(key), values) for key, values in zip(walked["keys"], walked["extinctions"])]
