"""The two errors, on arrays whose errors are known."""

import numpy as np
import pytest

from cloudtomo_cl.errors import DataError
from cloudtomo_cl.scene.metrics import delta, epsilon

TRUTH = np.array([[[1.0, 3.0], [0.0, 4.0]]])


def test_epsilon_counts_errors_of_both_signs():
    assert epsilon(TRUTH + [[[1.0, -1.0], [2.0, 0.0]]], TRUTH) == pytest.approx(4 / 8)


def test_delta_lets_errors_of_opposite_sign_cancel():
    assert delta(TRUTH + [[[1.0, -1.0], [0.0, 0.0]]], TRUTH) == pytest.approx(0.0)


def test_delta_is_negative_for_too_little_cloud():
    assert delta(0.25 * TRUTH, TRUTH) == pytest.approx(-0.75)


def test_an_empty_estimate_scores_one():
    assert epsilon(np.zeros_like(TRUTH), TRUTH) == pytest.approx(1.0)


def test_sums_of_many_small_voxels_keep_their_digits():
    truth = np.full((200, 200, 200), 1 / 3, np.float32)
    assert epsilon(truth * np.float32(1.5), truth) == pytest.approx(0.5, rel=1e-7)


@pytest.mark.parametrize("error", [epsilon, delta])
@pytest.mark.parametrize(
    ("estimate", "truth", "text"),
    [
        (TRUTH, np.zeros_like(TRUTH), "truth is zero"),
        (TRUTH[..., :1], TRUTH, "same grid"),
        (TRUTH * np.nan, TRUTH, "estimate at voxel"),
        (TRUTH, np.full_like(TRUTH, np.inf), "truth at voxel"),
    ],
)
def test_unfit_arrays_are_named(error, estimate, truth, text):
    with pytest.raises(DataError, match=text):
        error(estimate, truth)


def test_the_first_voxel_that_is_not_finite_is_named():
    estimate = TRUTH.copy()
    estimate[0, 1] = np.nan
    with pytest.raises(DataError, match=r"estimate at voxel \(0, 1, 0\)"):
        epsilon(estimate, TRUTH)
