"""Gauss-Newton: each iteration minimises a linear model of all pixels, with the prior."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass as plain_dataclass
from dataclasses import replace
from math import ceil
from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import ConfigDict, Field
from pydantic.dataclasses import dataclass

from cloudtomo_cl.arguments import a, require_kinds
from cloudtomo_cl.blas import with_one_blas_thread
from cloudtomo_cl.inversion.annealing import InnerProblem, annealed, rescaled
from cloudtomo_cl.inversion.data_term import DataTerm, ResidualWeights
from cloudtomo_cl.inversion.haze import without_haze
from cloudtomo_cl.inversion.mass import PAIRS, is_due, share_that_keeps_mass
from cloudtomo_cl.inversion.noisy_model import NoisyModel
from cloudtomo_cl.inversion.objective import cost_of_independent, error_beyond_noise, noise_of, variance_of_half
from cloudtomo_cl.inversion.outliers import Outlier
from cloudtomo_cl.inversion.prior_terms import hessian_of
from cloudtomo_cl.inversion.problem import Problem
from cloudtomo_cl.inversion.relative_prior import mean_extinction
from cloudtomo_cl.inversion.solvers.protocol import Progress, check_gradient, start_of
from cloudtomo_cl.inversion.solvers.state import not_saved, of_any_length
from cloudtomo_cl.inversion.stage_prior import FrozenPrior
from cloudtomo_cl.inversion.stencil import stencil_footprint
from cloudtomo_cl.inversion.terms import Around
from cloudtomo_cl.inversion.uncertainty import LEAST_CURVATURE, beyond_noise, standard_errors, widening
from cloudtomo_cl.messages import answering
from cloudtomo_cl.opencl.memory import Footprint
from cloudtomo_cl.scene.grid import Count, Grid
from cloudtomo_cl.scene.scene import NotNegative, Positive
from cloudtomo_cl.transport.jacobian import Jacobian, jacobian_footprint
from cloudtomo_cl.transport.jacobian_average import JacobianAverage
from cloudtomo_cl.transport.radiance import RadianceOperator
from cloudtomo_cl.transport.radiance_table import table_footprint, table_growth
from cloudtomo_cl.transport.rendering import Rendering, pooled

_LOGGER = logging.getLogger(__name__)
# Largest misfit, as a multiple of that by noise alone, at which the model fits the images: then steps may be annealed.
_FITTING = 2.5
# A step's largest increase of a voxel: by this optical depth along a mean chord, or by this factor.
_TRUSTED_DEPTH, _TRUSTED_GROWTH = 1 / 3, 1.3
# A rendering's noise of up to this share of the misfit, or this multiple of the measured images' noise, needs no
# further paths for the images.
_NOISE_OF_MISFIT, _NOISE_OF_MEASURED = 0.1, 2.0
# Variance of a path that does not branch over that of one that does (docs/decisions/forward-peak.md).
_WORTH_OF_BRANCHING = 2.5
# Largest number of paths of an iteration, as a multiple of the default.
_MOST_PATHS = 1000


@plain_dataclass(frozen=True, eq=False)
class GaussNewtonState:
    """The state of the iterations.

    The images of all iterations are kept as one mean: the derivatives carry it along with the extinction, and every
    iteration's new paths are averaged into it, so that its noise falls while the steps get smaller. Derivatives are
    averaged over the later half of the iterations (a tail average): those of one iteration are so noisy that they would
    fit noise of the images. So many iterations' paths determine the extinction, which is the estimate.

    Attributes
    ----------
    extinction : extinction of the mask's voxels, km^-1, shape (voxels,)
    image, variance : averaged modelled image, W m^-2 sr^-1, and its noise's variance, (W m^-2 sr^-1)^2, shape (pixels,)
    iterations : number of iterations done so far
    fitted : number of these that began where the model fitted the images
    misfit : mean square of the images' residuals at the start of the last iteration, over that of noise alone
    mass_share : share of the prior's pull on the mass that steps take back (mass.py)
    motions : motions of the views (`scene.pointing`) with which the next iteration renders, shape (views, 3)
    streams : streams of random numbers of the iterations so far, shape (iterations,)
    extinctions : extinctions that they rendered, km^-1, shape (iterations, voxels)
    view_motions : motions of the views with which they rendered, shape (iterations, views, 3)
    derivatives : average of their derivatives; computed again from the three arrays above after a resume
    """

    extinction: np.ndarray
    image: np.ndarray
    variance: np.ndarray
    iterations: int
    fitted: int
    misfit: float
    mass_share: float
    motions: np.ndarray
    streams: np.ndarray = of_any_length()
    extinctions: np.ndarray = of_any_length()
    view_motions: np.ndarray = of_any_length()
    derivatives: JacobianAverage | None = not_saved(default=None)

    @property
    def estimate(self) -> np.ndarray:
        """The recovered extinction, km^-1, shape (voxels,)."""
        return self.extinction

    def modelled_noise(self, problem: Problem) -> float:
        """The part of the data term that the modelled image's noise adds."""
        return noise_of(self.variance, problem.weights)


@answering
@dataclass(frozen=True, config=ConfigDict(extra="forbid"))
class GaussNewton:
    """Renders an extinction, takes the derivatives of all pixels there, and minimises the linear model that they give.

    Source: Gauss-Newton with bounds (Nocedal and Wright 2006, section 10.3); the inner minimisation is by conjugate
    gradients whose steps are projected onto the bounds (`conjugate_gradients.minimised`).

    Attributes
    ----------
    iterations : largest number of iterations on the finest of the automatic stages; by default 30. A run that has done
        them goes on with more by `--resume`, unless its cost has settled
    start : extinction inside the mask before the first stage, km^-1; by default an optical depth of 1 along a mean
        chord of the box around the mask, halved as long as images of a uniform cloud then fit better
    paths : number of paths of an iteration, as a multiple of the default (for the derivatives 90 for each voxel that
        may hold cloud, but no more than 180 for each pixel): with more paths noise is less, and the minimum that is
        found better. It holds for stages that do not set `samples`
    image_samples : largest number of further paths for the images, as a multiple of those for the derivatives: fewer
        are taken where their noise is small beside the misfit or the measured images' noise
    damping : damping of a stage's first step, as a share of the data term's curvature; it halves from step to step,
        down to a tenth
    inner_iterations : largest number of iterations of the minimisation of the quadratic model
    """

    stores_branches: ClassVar[bool] = False
    type: Literal["gauss-newton"] = "gauss-newton"
    iterations: Count | None = None
    start: Positive | None = None
    paths: Annotated[float, Field(gt=0, le=_MOST_PATHS)] = 1.0
    image_samples: Annotated[int, Field(ge=0)] = 5
    damping: NotNegative = 0.1
    inner_iterations: Count = 40

    def stage_limits(self, last: bool) -> tuple[int, int]:
        """Largest number of iterations, and window, of an automatic stage."""
        return (self.iterations or 30, 30) if last else (4, 20)

    def footprint(self, pixels: int, voxels: int, longest: int, entries: int) -> Footprint:
        """Memory of the derivatives, the radiance table and the prior.

        pixels, voxels : numbers of active pixels and of voxels in the mask
        longest : voxels along the grid's longest axis
        entries : number of entries of the Jacobian's near field
        """
        derivatives = jacobian_footprint(pixels, voxels, longest, entries)
        return table_footprint(voxels) + derivatives + stencil_footprint(voxels)

    def deep_growth(self, voxels: int) -> Footprint:
        """Memory beyond the footprint, at most, if the voxels are optically deep."""
        return table_growth(voxels)

    def init(self, problem: Problem, extinction: np.ndarray) -> GaussNewtonState:
        """The state before the first iteration; see `Solver`."""
        start = np.array(start_of(self, problem, extinction))
        pixels, voxels = len(problem.active), len(start)
        nothing, none = np.zeros(pixels), np.zeros((0, voxels), np.float32)
        motions = np.zeros_like(problem.active.calibration.motion_errors)
        if problem.motions is not None:
            motions = problem.motions
        streams, no_motions = np.zeros(0, np.int64), np.zeros((0, *motions.shape))
        return GaussNewtonState(start, nothing, nothing, 0, 0, 0.0, 0.0, motions, streams, none, no_motions)

    @with_one_blas_thread
    def step(
        self, problem: Problem, state: GaussNewtonState, *, seed: int, stream: int
    ) -> tuple[GaussNewtonState, Progress]:
        """One iteration; see `Solver`.

        Raises
        ------
        TransportError : a derivative is not finite
        """
        require_kinds("step", problem=(problem, a(Problem)), state=(state, a(GaussNewtonState)))
        problem = self._sampled(problem)
        derivatives = _derivatives_of(problem, state, seed)
        seen = problem.with_motions(state.motions)
        first = _averaged_in(derivatives, len(state.streams), seen, state.extinction, seed, stream)
        problem = _without_outliers(problem, state if state.iterations else _with_image(problem, state, first))
        rendering = self._with_more_paths(problem, seen.operator, state, first, (seed, stream))
        cost, error = _cost(problem, rendering.halves, state)
        state = _with_image(problem, state, rendering)
        state = replace(
            state,
            streams=np.append(state.streams, stream),
            extinctions=np.concatenate([state.extinctions, state.extinction[None].astype(np.float32)]),
            view_motions=np.concatenate([state.view_motions, state.motions[None]]),
            derivatives=derivatives,
        )
        prior, state = self._minimised(problem, state, seed, stream)
        return state, Progress(cost, error, prior, rendering.samples * len(problem.active))

    def _sampled(self, problem: Problem) -> Problem:
        """The problem with the number of paths per pixel for derivatives filled in."""
        if problem.samples is not None:
            return problem
        return replace(problem, samples=max(2, 2 * round(self.paths * problem.default_samples / 2)))

    def _with_more_paths(
        self, problem: Problem, operator: RadianceOperator, state: GaussNewtonState, first: Rendering,
        drawn: tuple[int, int],
    ) -> Rendering:  # fmt: skip
        """The rendering for the derivatives, pooled with further paths for the images, which may branch.

        There are no more than it takes for their noise to be small beside the misfit or beside the measured images'
        noise.

        operator : which renders them, and the same but for branches has made the first
        drawn : seed and stream
        """
        cost, error = _cost(problem, first.halves, state)
        measured = noise_of(problem.active.variance, problem.weights)
        bearable = max(_NOISE_OF_MISFIT * (cost - 2 * error), _NOISE_OF_MEASURED * measured)
        noise = noise_of(first.standard_error**2, problem.weights)
        # Not by the noise that these paths show: those that miss rare bright ones would count for more.
        worth = _WORTH_OF_BRANCHING if operator.estimator == "branches" else 1.0
        times = self.image_samples
        if noise < (1 + times * worth) * bearable:
            times = max(ceil((noise / bearable - 1) / worth), 0)
        if not times:
            return first
        values, samples = problem.on_grid(state.extinction), times * first.samples
        further = operator.render(values, samples, *drawn, first_sample=first.samples)
        return pooled(first, further, 1 / (1 + times * worth))

    def _minimised(
        self, problem: Problem, state: GaussNewtonState, seed: int, stream: int
    ) -> tuple[float, GaussNewtonState]:
        """The prior's value at the start, and the state at the minimum of the model.

        The model has the residuals and their derivatives, the prior, and a damping of the step.
        """
        assert state.derivatives is not None
        jacobian, weights = state.derivatives.jacobian, problem.weights
        curvature = jacobian.curvature(weights)
        check_gradient(curvature, problem, stream)
        misfit = _misfit(problem, state)
        unexplained = problem.active.calibration.unexplained(misfit, state.image)
        # While the cloud is still wrong, gains and motions of the views must not explain its residuals.
        calibration = problem.active.calibration.in_unit(max(problem.active.unit, unexplained))
        damping = self.damping * max(0.5 ** (state.iterations - 1), 0.1)
        device = problem.operator.device
        residual_weights = ResidualWeights(weights, calibration, state.image, device)
        data = DataTerm(jacobian, residual_weights, misfit, state.extinction, damping * curvature)
        units = problem.units(state.modelled_noise(problem))

        fits = unexplained <= _FITTING * units.both
        state = replace(state, fitted=state.fitted + fits, misfit=unexplained / units.both)
        if fits:
            # For deep clouds the model's errors exceed the noise, so that the prior gets a larger weight.
            depth = mean_extinction(state.extinction) * problem.grid.mean_chord
            units = replace(units, weight=units.weight * float(beyond_noise(depth)))
        anneals = fits and getattr(problem.prior, "chooses", False)
        minimum, iteration = (annealed, None) if anneals else (rescaled, state.iterations - 1)
        hessian_diagonal = curvature * (1 + damping) + LEAST_CURVATURE * curvature.mean()
        upper = trusted(state.extinction, problem.grid)
        inner = InnerProblem(
            problem, data, hessian_diagonal, units, upper, state.mass_share, self.inner_iterations, iteration
        )
        if fits and is_due(state.fitted):
            share = _share_by(minimum, inner, state, jacobian, np.random.default_rng([seed, stream]))
            inner, state = replace(inner, mass_share=share), replace(state, mass_share=share)
        value = inner.prior_value(state.extinction)
        extinction = minimum(inner, state.extinction)
        if anneals:
            undamped = DataTerm(jacobian, residual_weights, misfit, state.extinction, np.zeros_like(extinction))
            extinction = without_haze(extinction, problem.voxels, undamped, units.both)
        predicted = jacobian @ (extinction - state.extinction)
        motions = calibration.motions(misfit + predicted, state.image)
        predicted = predicted + calibration.change(motions - state.motions)
        image = state.image + predicted
        return value, replace(state, extinction=extinction, image=image, motions=motions)

    @with_one_blas_thread
    def standard_error(self, problem: Problem, state: GaussNewtonState, draws: int, seed: int) -> np.ndarray | None:
        """Standard error of the estimate, km^-1, shape (voxels,): by draws from the last linear model, widened.

        None if the images' noise is not known, or before the first iteration.
        """
        if not state.iterations or not problem.active.standard_error.any():
            return None
        problem = _without_outliers(self._sampled(problem), state)
        jacobian = _derivatives_of(problem, state, seed).jacobian
        prior = problem.prior.frozen(state.extinction, mass_share=state.mass_share)
        wider = widening(state.misfit, state.extinction * problem.grid.mean_chord)
        return wider * standard_errors(_noisy_model(problem, state, jacobian, prior), draws, seed)

    def outliers(self, problem: Problem, state: GaussNewtonState) -> tuple[Outlier, ...]:
        """The pixels that no cloud explains, the farthest first; they hardly counted."""
        return problem.active.outliers(_misfit(problem, state), state.variance) if state.iterations else ()


def trusted(extinction: np.ndarray, grid: Grid) -> np.ndarray:
    """The upper bound of a step, km^-1, shape (voxels,).

    Images hardly change with a voxel that is deep: if a linear model that does not fit yet makes it so, no later step
    takes that back. Steps down have no such bound, since images change much with thin voxels.
    """
    return np.maximum(_TRUSTED_GROWTH * extinction, extinction + _TRUSTED_DEPTH / grid.mean_chord)


def tail_rate(iteration: int) -> float:
    """The share of an iteration, counted from 0, in a running mean over about the later half of all iterations."""
    return 1 / (1 + iteration // 2)


def _derivatives_of(problem: Problem, state: GaussNewtonState, seed: int) -> JacobianAverage:
    """The average of derivatives of a state; after a resume that of all iterations before, computed again."""
    if state.derivatives is not None:
        return state.derivatives
    # The near field of a line of sight is chosen once in a stage, by the views at its start.
    begun = state.view_motions[0] if len(state.view_motions) else state.motions
    derivatives = JacobianAverage(problem.with_motions(begun).operator.without_branches())
    for number, (stream, extinction, motions) in enumerate(zip(state.streams, state.extinctions, state.view_motions)):
        _LOGGER.info("replaying the paths of iteration %d of %d", number + 1, len(state.streams))
        _averaged_in(derivatives, number, problem.with_motions(motions), extinction, seed, int(stream))
    return derivatives


def _averaged_in(
    derivatives: JacobianAverage, iteration: int, problem: Problem, extinction: np.ndarray, seed: int, stream: int
) -> Rendering:
    """Renders an extinction, km^-1, shape (voxels,), and adds its derivatives to the average; returns the rendering.

    iteration : number of the iteration, counted from 0
    """
    # Derivatives by the table take the mean of all light along a flight: branches find light that is rare, at a cost.
    operator, samples = problem.operator.without_branches(), problem.paths_per_pixel()
    rendering = operator.render(problem.on_grid(extinction), samples, seed, stream, store_paths=True)
    derivatives.add(rendering, tail_rate(iteration))
    return rendering


def _share_by(
    minimum: Callable[[InnerProblem, np.ndarray], np.ndarray], inner: InnerProblem, state: GaussNewtonState,
    jacobian: Jacobian, random: np.random.Generator,
) -> float:  # fmt: skip
    """The share of the prior's pull on the mass that steps take back (mass.py), by this step's way of minimisation.

    There is no upper bound here: a single step's bound limits gains of mass but not losses, while later steps gain on.
    """
    problem, extinction = inner.problem, state.extinction
    if not getattr(problem.prior, "corrects_mass", False):
        return 0.0
    data, slope_of_noise = _simulated_images(problem, state, jacobian)
    noise = np.column_stack([slope_of_noise(random) for _ in range(PAIRS)])

    def recovered(slope: np.ndarray, share: float) -> np.ndarray:
        images = Around([data], extinction, slope, problem.operator.device)
        unbounded = np.full_like(extinction, np.inf)
        return minimum(replace(inner, data=images, upper=unbounded, mass_share=share), extinction)

    return share_that_keeps_mass(recovered, extinction, noise)


def _simulated_images(
    problem: Problem, state: GaussNewtonState, jacobian: Jacobian
) -> tuple[DataTerm, Callable[[np.random.Generator], np.ndarray]]:
    """The linear model's data term at a state's extinction, and a function that draws its gradient's noise."""
    active, image, extinction = problem.active, state.image, state.extinction
    calibration, weights = active.calibration, problem.weights
    residual_weights = ResidualWeights(weights, calibration, image, problem.operator.device)
    data = DataTerm(jacobian, residual_weights, _misfit(problem, state), extinction, np.zeros_like(extinction))
    deviation = np.sqrt(active.variance + state.variance)

    def slope_of_noise(random: np.random.Generator) -> np.ndarray:
        noise = calibration.drawn(random, image) + deviation * random.standard_normal(len(image))
        return jacobian.rmatvec(weights * calibration(noise, image)).astype(float)

    return data, slope_of_noise


def _noisy_model(problem: Problem, state: GaussNewtonState, jacobian: Jacobian, prior: FrozenPrior) -> NoisyModel:
    """The linear model at a state's extinction, with the given form of the prior."""
    device, extinction, units = problem.operator.device, state.extinction, problem.units(state.modelled_noise(problem))
    data, slope_of_noise = _simulated_images(problem, state, jacobian)
    curvature = jacobian.curvature(problem.weights)
    hessian_diagonal = curvature + prior.curvature(extinction, units) + LEAST_CURVATURE * curvature.mean()
    terms = [data, hessian_of(prior, units, device)]
    return NoisyModel(
        terms, hessian_diagonal, data.gradient(extinction), slope_of_noise, prior, units, extinction, device
    )


def _without_outliers(problem: Problem, state: GaussNewtonState) -> Problem:
    """The problem with next to no weight on the pixels that a state's image is far from."""
    return replace(problem, active=problem.active.without_outliers(_misfit(problem, state), state.variance))


def _misfit(problem: Problem, state: GaussNewtonState) -> np.ndarray:
    """Averaged minus measured image, without the motions' part, W m^-2 sr^-1, shape (pixels,)."""
    return state.image - problem.active.calibration.change(state.motions) - problem.radiance


def _cost(problem: Problem, halves: np.ndarray, state: GaussNewtonState) -> tuple[float, float]:
    calibration = problem.active.calibration
    variance = variance_of_half(halves)
    first, second = (halves - (problem.radiance + calibration.change(state.motions))[:, None]).T
    return cost_of_independent(first, variance, calibration(second, state.image), variance, problem.weights)


def _with_image(problem: Problem, state: GaussNewtonState, rendering: Rendering) -> GaussNewtonState:
    """The state with a rendering averaged into its image, by the noise and error of both."""
    variance = rendering.standard_error**2
    rate = 1.0
    if state.iterations:
        off = error_beyond_noise(state.image, state.variance, rendering.halves, problem.weights)
        old, new = state.modelled_noise(problem) + off, noise_of(variance, problem.weights)
        rate = old / (old + new) if old + new > 0 else 1 / (1 + state.iterations)
    return replace(
        state,
        image=state.image + rate * (rendering.mean - state.image),
        variance=(1 - rate) ** 2 * state.variance + rate**2 * variance,
        iterations=state.iterations + 1,
    )
