"""The kernels' own logarithm, exponential, cube root, cosine, sine and their turn, against double precision."""

import numpy as np
import pytest

COUNT = 20_000


@pytest.fixture(scope="module")
def found(probe):
    """Arguments and results by name, float32."""
    random = np.random.default_rng(5)
    # Free paths take logarithms of numbers from 2^-33 to 1 - 2^-24, roulettes those of numbers above 1.
    near_one = 1 - 2.0**-24 * np.arange(1, 1001)
    positive = np.concatenate([near_one, 2.0 ** random.uniform(-60, 60, COUNT - 1000)]).astype(np.float32)
    negative = -np.concatenate([[0.0, 1e-30, 86.9, 200.0, np.inf], random.exponential(10.0, COUNT - 5)])
    turn = np.concatenate([[0.0, 0.125, 0.25, 0.5, 0.75, 1 - 2.0**-24], random.random(COUNT - 6)]).astype(np.float32)
    arguments = {"positive": positive, "negative": negative.astype(np.float32), "turn": turn}
    names = ("logarithm", "root", "cube root", "exponential", "cosine", "sine", "turn back")
    results = probe(
        "probe_arithmetic", COUNT, *arguments.values(), results=[np.zeros(COUNT, np.float32) for _ in names]
    )
    return arguments | dict(zip(names, results))


def test_logarithms_are_good_to_two_units_in_the_last_place(found):
    expected = np.log(found["positive"].astype(float))
    unit = np.spacing(np.abs(expected).astype(np.float32))
    assert np.max(np.abs(found["logarithm"] - expected) / unit) < 2


def test_square_roots_are_rounded(found):
    np.testing.assert_allclose(found["root"], np.sqrt(found["positive"].astype(float)), rtol=2e-7)


def test_cube_roots_are_good_to_two_units_in_the_last_place(found):
    expected = np.cbrt(found["positive"].astype(float))
    unit = np.spacing(expected.astype(np.float32))
    assert np.max(np.abs(found["cube root"] - expected) / unit) < 2


def test_exponentials_are_good_to_single_precision_or_0(found):
    expected = np.exp(found["negative"].astype(float))
    expected[found["negative"] <= -87] = 0
    np.testing.assert_allclose(found["exponential"], expected, rtol=2e-7)


@pytest.mark.parametrize("name, function", [("cosine", np.cos), ("sine", np.sin)])
def test_turns_are_good_to_single_precision(found, name, function):
    np.testing.assert_allclose(found[name], function(2 * np.pi * found["turn"].astype(float)), atol=1.5e-7)


def test_turns_are_found_again(found):
    expected = np.arctan2(found["sine"].astype(float), found["cosine"].astype(float)) / (2 * np.pi) % 1
    away = np.abs(found["turn back"] - expected)
    assert np.max(np.minimum(away, 1 - away)) < 1.5e-7
    assert found["turn back"].min() >= 0 and found["turn back"].max() < 1
