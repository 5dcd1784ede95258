"""Sums: many work items into one voxel, and many paths into one pixel."""

import numpy as np
import pytest

from cloudtomo_cl.errors import TransportError
from cloudtomo_cl.opencl.fixed_point import first_overflow, require_sums
from cloudtomo_cl.transport.path_sums import parts

ADDS, SUMS = 98_000, 7  # a multiple


@pytest.fixture(params=["wide", "narrow"])
def any_probe(request, probe, probe_with_narrow_atomics):
    """The device as it is, and as if it had no 64-bit atomics."""
    return {"wide": probe, "narrow": probe_with_narrow_atomics}[request.param]


def accumulated(probe, values):
    return probe("probe_accumulate", ADDS, np.uint32(SUMS), np.float32(values), results=[np.zeros(SUMS, np.int64)])


def test_sums_of_integers_are_exact(any_probe, random):
    # Beyond 2^24 a float holds every second integer or fewer; the sums exceed 2^53.
    values = np.rint(random.normal(size=ADDS) * 2.0**48).astype(np.float32)
    exact = [sum(int(v) for v in values[i::SUMS]) for i in range(SUMS)]
    assert accumulated(any_probe, values).tolist() == exact


def test_addends_are_rounded_to_nearest(any_probe, random):
    values = random.normal(size=ADDS).astype(np.float32) * 1000
    expected = np.bincount(np.arange(ADDS) % SUMS, np.rint(values).astype(float), SUMS)
    np.testing.assert_array_equal(accumulated(any_probe, values), expected)


def test_no_addition_is_lost_where_all_add_into_one(any_probe, random):
    # Long enough for all cores to take part; small numbers of both signs carry often.
    values = random.integers(-100, 100, 4_000_000)
    found = any_probe(
        "probe_accumulate", len(values), np.uint32(1), np.float32(values), results=[np.zeros(1, np.int64)]
    )
    assert found[0] == values.sum()


def test_sums_may_use_half_of_their_bits(any_probe):
    values = np.full(ADDS, 2.0**62 / ADDS * SUMS * 0.999, np.float32)
    exact = [sum(int(v) for v in values[i::SUMS]) for i in range(SUMS)]
    found = accumulated(any_probe, values)
    assert found.tolist() == exact and first_overflow(found) is None


@pytest.mark.parametrize(
    "value, at",
    [(2.0**62 / ADDS * SUMS * 1.001, ADDS), (2.0**60, 5 * SUMS), (2.0**60, ADDS), (-(2.0**60), ADDS), (2.0**61, 1),
     (np.inf, 1), (-np.inf, 1), (np.nan, 1)],
)  # fmt: skip
def test_sums_that_leave_their_range_are_known(any_probe, random, value, at):
    """`at` addends that are too much, all around them small ones of both signs: sums that came back by wrapping
    (2^60 added 16 times) are known as well."""
    values = random.normal(size=ADDS).astype(np.float32) * 1000
    values[random.permutation(ADDS // SUMS)[: max(at // SUMS, 1)] * SUMS + 3] = value
    found = accumulated(any_probe, values)
    assert first_overflow(found) == (3,)
    with pytest.raises(TransportError, match=r"the sum .* at place \(3,\)"):
        require_sums(found, "the sum", "place")


def compensated(probe, values, terms):
    sums = np.zeros((len(values), 2), np.float32)
    for begin, end in parts(terms, 1 << 15):  # some devices end longer loops
        sums = probe("probe_compensated", len(values), np.uint32(end - begin), np.float32(values), results=[sums])
    return sums.astype(float).sum(axis=1)


def test_compensated_sums_of_many_terms_do_not_drift(probe):
    values = np.float32([0.1, 3e-5, -0.7, 1 / 3])
    terms = 1_000_000
    np.testing.assert_allclose(compensated(probe, values, terms), terms * values.astype(float), rtol=1e-9)


def test_plain_sums_of_as_many_terms_would_drift():
    # The test above has a point only if this holds.
    plain = np.cumsum(np.full(1_000_000, 0.1, np.float32), dtype=np.float32)[-1]
    assert abs(plain / (1e6 * float(np.float32(0.1))) - 1) > 1e-3
