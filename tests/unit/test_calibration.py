"""What gains and motions of views explain of residuals, against general minimisers and finite differences."""

import numpy as np
import pytest
from scipy.optimize import minimize

from cloudtomo_cl.inversion.calibration import Calibration

PIXELS = 40
WEIGHTS = np.linspace(0.5, 2.0, PIXELS)
VIEW = np.arange(PIXELS) % 4
UNIT = 0.01


def with_gains(random, errors):
    residual, modelled = random.normal(size=PIXELS), random.random(PIXELS)
    return residual, modelled, Calibration(WEIGHTS, VIEW, errors, UNIT)


def test_gains_that_are_taken_out_cost_least(random):
    """Against a general minimiser, over gains whose weighted mean is 1."""
    errors = np.array([0.02, 0.05, 0.3, 0.05])
    residual, modelled, gains = with_gains(random, tuple(errors))

    def cost(change):
        left = residual + change[VIEW] * modelled
        return 0.5 * np.sum(WEIGHTS * left**2) + 0.5 * UNIT * np.sum((change / errors) ** 2)

    balanced = {"type": "eq", "fun": lambda change: np.sum(change / errors**2)}
    found = minimize(cost, np.zeros(4), method="SLSQP", constraints=balanced, options={"ftol": 1e-14})
    assert 0.5 * np.sum(WEIGHTS * residual * gains(residual, modelled)) == pytest.approx(found.fun, rel=1e-6)


def test_the_derivative_of_the_cost_with_the_best_gains(random):
    residual, modelled, gains = with_gains(random, (0.02, 0.0, 0.3, 0.05))
    step = 1e-3 * random.normal(size=PIXELS)
    costs = [0.5 * np.sum(WEIGHTS * r * gains(r, modelled)) for r in (residual + step, residual - step)]
    expected = 2 * np.sum(step * WEIGHTS * gains(residual, modelled))
    assert costs[0] - costs[1] == pytest.approx(expected, rel=1e-6)


def test_a_gain_that_all_views_share_stays(random):
    """Of views that see the same: nothing tells it from a brighter cloud."""
    modelled = np.repeat(random.random(PIXELS // 4), 4)
    gains = Calibration(np.ones(PIXELS), VIEW, (0.1,) * 4, UNIT)
    np.testing.assert_allclose(gains(0.2 * modelled, modelled), 0.2 * modelled)


def test_exact_views_keep_their_residuals(random):
    residual, modelled, gains = with_gains(random, (0.02, 0.0, 0.3, 0.05))
    left = gains(residual, modelled)
    np.testing.assert_array_equal(left[VIEW == 1], residual[VIEW == 1])
    assert (left[VIEW == 2] != residual[VIEW == 2]).all()


def with_motions(random):
    """Gains and motions of four views, of which one has exact gains and another does not move."""
    residual, modelled = random.normal(size=PIXELS), random.random(PIXELS)
    motions = random.normal(size=(PIXELS, 3))
    errors = np.full((4, 3), 0.3)
    errors[2] = 0.0
    calibration = Calibration(WEIGHTS, VIEW, (0.02, 0.0, 0.3, 0.05), UNIT, motions, errors)
    return residual, modelled, motions, errors, calibration


def test_gains_and_motions_that_are_taken_out_cost_least(random):
    """Against a general minimiser."""
    residual, modelled, motions, errors, calibration = with_motions(random)
    gain_errors = np.array([0.02, 1.0, 0.3, 0.05])

    def cost(unknown):
        gains = unknown[:4] * [1, 0, 1, 1]
        moves = unknown[4:].reshape(4, 3) * [[1], [1], [0], [1]]
        left = residual + gains[VIEW] * modelled + np.sum(motions * moves[VIEW], axis=1)
        held = np.sum((gains / gain_errors) ** 2) + np.sum((moves / 0.3) ** 2)
        return 0.5 * np.sum(WEIGHTS * left**2) + 0.5 * UNIT * held

    found = minimize(cost, np.zeros(16), method="BFGS", options={"gtol": 1e-8})
    assert 0.5 * np.sum(WEIGHTS * residual * calibration(residual, modelled)) == pytest.approx(found.fun, rel=1e-6)
    moves = found.x[4:].reshape(4, 3) * [[1], [1], [0], [1]]
    np.testing.assert_allclose(calibration.motions(residual, modelled), moves, atol=1e-5)


def test_the_derivative_of_the_cost_with_the_best_motions(random):
    residual, modelled, *_, calibration = with_motions(random)
    step = 1e-3 * random.normal(size=PIXELS)
    costs = [0.5 * np.sum(WEIGHTS * r * calibration(r, modelled)) for r in (residual + step, residual - step)]
    expected = 2 * np.sum(step * WEIGHTS * calibration(residual, modelled))
    assert costs[0] - costs[1] == pytest.approx(expected, rel=1e-6)


def test_an_image_of_moved_views_is_explained_by_its_motions(random):
    """Residuals that motions far below their standard errors make are taken out, and these found."""
    *_, modelled, motions, errors, _ = with_motions(random)
    calibration = Calibration(WEIGHTS, VIEW, (0.0,) * 4, 1e-9, motions, errors)
    moves = 0.01 * random.normal(size=(4, 3)) * (errors > 0)
    residual = -calibration.change(moves)
    np.testing.assert_allclose(calibration.motions(residual, modelled), moves, atol=1e-7)
    np.testing.assert_allclose(calibration(residual, modelled), 0.0, atol=1e-7)


def test_what_motions_explain_is_no_misfit(random):
    """However large it is without them: it costs no more than those that made it, in the unit n."""
    *_, modelled, motions, errors, _ = with_motions(random)
    calibration = Calibration(WEIGHTS, VIEW, (0.0,) * 4, UNIT, motions, errors)
    moves = errors * random.normal(size=(4, 3))
    residual = -calibration.change(moves)
    of_motions = np.sum(np.square(moves[:2] / errors[:2])) + np.sum(np.square(moves[3] / errors[3]))
    assert np.mean(WEIGHTS * residual**2) > 5 * UNIT * of_motions / PIXELS
    assert 0 < calibration.unexplained(residual, modelled) <= UNIT * of_motions / PIXELS


def test_in_a_larger_unit_motions_explain_less(random):
    """Their own cost then counts more: with one that nothing reaches, they stand still."""
    residual, modelled, *_, calibration = with_motions(random)
    still = calibration.in_unit(1e9)
    np.testing.assert_allclose(still.motions(residual, modelled), 0.0, atol=1e-6)
    np.testing.assert_allclose(still(residual, modelled), residual, atol=1e-5)
    assert np.abs(calibration.motions(residual, modelled)).max() > 0.01
