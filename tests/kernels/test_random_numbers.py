"""Random numbers of the kernels: docs/reference/random-numbers.md."""

import numpy as np
import pytest
from scipy import stats

import cloudtomo_cl as ct
from cloudtomo_cl.errors import DataError
from cloudtomo_cl.reference import random as reference_random


@pytest.mark.parametrize(
    "counter, key, expected",
    [
        ([0, 0, 0, 0], [0, 0], [0x6627E8D5, 0xE169C58D, 0xBC57AC4C, 0x9B00DBD8]),
        ([0xFFFFFFFF] * 4, [0xFFFFFFFF] * 2, [0x408F276D, 0x41C83B0E, 0xA20BC7C6, 0x6D5451FD]),
        (
            [0x243F6A88, 0x85A308D3, 0x13198A2E, 0x03707344],
            [0xA4093822, 0x299F31D0],
            [0xD16CFE09, 0x94FDCCEB, 0x5001E420, 0x24126EA1],
        ),
    ],
)
def test_the_reference_gives_the_known_answers_of_random123(counter, key, expected):
    assert reference_random.philox(np.array(counter), np.array(key)).tolist() == expected


def keys(random, count):
    """seed, iteration, pixel, view, sample, block: with the largest and the smallest values."""
    chosen = random.integers(0, 2**32, (count, 6), dtype=np.uint32)
    chosen[0], chosen[1] = 0, 2**32 - 1
    return chosen


def test_uniforms_have_the_bits_of_the_reference(probe, random):
    chosen = keys(random, 1000)
    found = probe("probe_uniforms", 1000, chosen, results=[np.zeros((1000, 4), np.float32)])
    expected = reference_random.open_uniform(reference_random.philox(chosen[:, [2, 3, 4, 5]], chosen[:, [0, 1]]))
    np.testing.assert_array_equal(found.view(np.uint32), expected.view(np.uint32))


def test_the_words_of_a_key_take_their_places(probe):
    # One word is set at a time: a swap of two words would give another block.
    chosen = np.eye(6, dtype=np.uint32) * 7
    found = probe("probe_uniforms", 6, chosen, results=[np.zeros((6, 4), np.float32)])
    for numbers, (seed, iteration, pixel, view, sample, block) in zip(found, chosen, strict=True):
        expected = reference_random.uniforms(seed, iteration, view, pixel, sample, block)
        np.testing.assert_array_equal(numbers, expected.astype(np.float32))


def test_uniforms_stay_inside_the_open_interval(probe):
    bits = np.array([0, 1, 2**31, 2**32 - 2**8, 2**32 - 129, 2**32 - 2, 2**32 - 1], np.uint32)
    found = probe("probe_open_uniform", len(bits), bits, results=[np.zeros(len(bits), np.float32)])
    assert found.min() > 0
    assert found.max() < 1
    assert found[-1] == np.float32(1 - 2.0**-24)


def test_free_paths_of_all_bits_are_positive_and_finite(probe):
    bits = np.array([0, 2**32 - 1], np.uint32)
    found = probe("probe_open_uniform", 2, bits, results=[np.zeros(2, np.float32)])
    depths = -np.log(found)
    assert np.all(depths > 0)
    assert np.all(np.isfinite(depths))


def test_uniforms_of_consecutive_samples_are_uniform(probe):
    # Kolmogorov-Smirnov at a significance of 1e-3 for each of the four numbers, fixed keys.
    count = 20000
    chosen = np.zeros((count, 6), np.uint32)
    chosen[:, 4] = np.arange(count)
    found = probe("probe_uniforms", count, chosen, results=[np.zeros((count, 4), np.float32)])
    for numbers in found.T:
        assert stats.kstest(numbers, "uniform").pvalue > 1e-3


@pytest.mark.parametrize("seed", [2**32, -1, 1.5, "2"])
def test_a_seed_that_kernels_do_not_take_is_named(device, seed):
    scene, extinction = ct.Scene(grid=ct.Grid((2, 2, 2), (0.2, 0.2, 0.2)), sun=ct.Sun(zenith=0.0)), np.ones((2, 2, 2))
    operator = ct.RadianceOperator(scene, [ct.OrthographicView(zenith=0.0, width=0.5, pixels=(2, 2))], device)
    flux = ct.FluxOperator(scene, device)
    for compute in (lambda: operator.render(extinction, 2, seed), lambda: flux.compute(extinction, 10, seed)):
        with pytest.raises(DataError, match=r"seed is .*: it must be a whole number from 0 to 4294967295"):
            compute()
