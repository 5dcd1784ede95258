"""Sums: many work items into one voxel, and many paths into one pixel."""

import numpy as np
import pytest

ADDS, SUMS = 98_000, 7  # a multiple


def accumulated(probe, values):
    dtype = np.int64 if probe.device.fixed_point else np.float32
    return probe("probe_accumulate", ADDS, np.uint32(SUMS), np.float32(values), results=[np.zeros(SUMS, dtype)])


def expected(values):
    return np.bincount(np.arange(ADDS) % SUMS, np.float32(values).astype(float), SUMS)


def test_fixed_point_sums_of_integers_are_exact(probe, random):
    if not probe.device.fixed_point:
        pytest.skip("this device has no 64-bit integer atomics")
    # Beyond 2^24 a float holds every second integer or fewer; the sums exceed 2^53.
    values = np.rint(random.normal(size=ADDS) * 2.0**50).astype(np.float32)
    found = accumulated(probe, values)
    exact = [sum(int(v) for v in values[i::SUMS]) for i in range(SUMS)]
    assert found.tolist() == exact


def test_fixed_point_rounds_to_nearest(probe, random):
    if not probe.device.fixed_point:
        pytest.skip("this device has no 64-bit integer atomics")
    values = random.normal(size=ADDS).astype(np.float32) * 1000
    np.testing.assert_array_equal(accumulated(probe, values), expected(np.rint(values)))


def test_fixed_point_sums_have_the_same_bits_in_any_order(probe, random):
    if not probe.device.fixed_point:
        pytest.skip("this device has no 64-bit integer atomics")
    values = random.normal(size=ADDS).astype(np.float32) * 2.0**40
    # Turned round by a multiple of SUMS, every value keeps its sum and changes its place.
    np.testing.assert_array_equal(accumulated(probe, values), accumulated(probe, np.roll(values, 5000 * SUMS)))


def test_compare_and_swap_loses_no_addition(probe_compare_and_swap, random):
    # Integers below 2^24 add exactly in single precision, in any order. Every work item adds
    # into the same sum, long enough for all cores to take part.
    values = random.integers(-100, 100, 4_000_000)
    found = probe_compare_and_swap(
        "probe_accumulate", len(values), np.uint32(1), np.float32(values), results=[np.zeros(1, np.float32)]
    )
    assert found[0] == values.sum()


def compensated(probe, values, terms):
    result = np.zeros((len(values), 2), np.float32)
    found = probe("probe_compensated", len(values), np.uint32(terms), np.float32(values), results=[result])
    return found.astype(float).sum(axis=1)


def test_compensated_sums_of_many_terms_do_not_drift(probe):
    values = np.float32([0.1, 3e-5, -0.7, 1 / 3])
    terms = 1_000_000
    np.testing.assert_allclose(compensated(probe, values, terms), terms * values.astype(float), rtol=1e-9)


def test_plain_sums_of_as_many_terms_would_drift():
    # The test above has a point only if this holds.
    plain = np.cumsum(np.full(1_000_000, 0.1, np.float32), dtype=np.float32)[-1]
    assert abs(plain / (1e6 * float(np.float32(0.1))) - 1) > 1e-3
