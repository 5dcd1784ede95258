"""Launches that are made again with the same arguments."""

import gc
import threading

import numpy as np
import pytest

from cloudtomo_cl.inversion.conjugate_gradients import minimised
from cloudtomo_cl.inversion.vectors import Vectors

COUNT = 100


@pytest.fixture
def vectors(device):
    return Vectors(device, COUNT)


def test_what_is_repeated_is_launched_as_often_as_it_is_called(device, vectors, random):
    x, result, calls = random.random(COUNT).astype(np.float32), vectors.zeros(), []
    given = vectors.of(x)

    def add() -> None:
        calls.append(1)
        vectors.add(2.0, given, result)
        vectors.add(-1.0, given, result)

    with device.repeated(add) as again:
        for times in range(1, 4):
            again()
            np.testing.assert_allclose(result.get(), times * x, rtol=1e-6)
    assert len(calls) == 1


def test_it_keeps_its_arrays(device, vectors):
    """Drivers do not: memory of arrays that nobody else has would be another's by then."""
    result = vectors.zeros()
    with device.repeated(lambda: vectors.add(1.0, vectors.of(np.ones(COUNT)), result)) as again:
        again()
        gc.collect()
        others = [vectors.of(np.full(COUNT, 7.0)) for _ in range(20)]
        again()
        np.testing.assert_array_equal(result.get(), 2)
    del others


def test_what_is_launched_besides_stays_alone(device, vectors):
    """By another thread meanwhile, between two calls, and afterwards."""
    one, result, other = vectors.of(np.ones(COUNT)), vectors.zeros(), vectors.zeros()

    def add() -> None:
        vectors.add(1.0, one, result)
        thread = threading.Thread(target=vectors.add, args=(1.0, one, other))
        thread.start()
        thread.join()

    with device.repeated(add) as again:
        again()
        vectors.add(5.0, one, other)
        again()
    vectors.add(10.0, one, other)
    np.testing.assert_array_equal(result.get(), 2)
    np.testing.assert_array_equal(other.get(), 16)


def test_two_may_be_repeated_in_turn(device, vectors):
    """Each has its own arguments of the same kernel."""
    one, first, second = vectors.of(np.ones(COUNT)), vectors.zeros(), vectors.zeros()
    with (
        device.repeated(lambda: vectors.add(1.0, one, first)) as add,
        device.repeated(lambda: vectors.add(3.0, one, second)) as add_three,
    ):
        for _ in range(3):
            add()
            add_three()
    np.testing.assert_array_equal(first.get(), 3)
    np.testing.assert_array_equal(second.get(), 9)


def test_steps_between_launches_are_taken_again_in_their_place(device, vectors, random):
    x, result, seen = random.random(COUNT).astype(np.float32), vectors.zeros(), []
    given = vectors.of(x)

    def work():
        vectors.add(1.0, given, result)
        device.step(lambda: seen.append(result.get()))
        vectors.add(1.0, given, result)

    with device.repeated(work) as again:
        for _ in range(3):
            again()
    np.testing.assert_allclose(seen, [x, 3 * x, 5 * x], rtol=1e-6)
    device.step(lambda: seen.append(None))
    assert len(seen) == 4


def test_what_fails_is_recorded_no_further(device, vectors):
    result = vectors.zeros()
    with device.repeated(lambda: vectors.add(1.0, None, result)) as again, pytest.raises(TypeError):
        again()
    vectors.add(1.0, vectors.of(np.ones(COUNT)), result)
    np.testing.assert_array_equal(result.get(), 1)


def test_what_has_failed_in_part_is_done_whole_the_next_time(device, vectors):
    """Not the part that was recorded."""
    one, result, fails = vectors.of(np.ones(COUNT)), vectors.zeros(), [True]

    def work():
        vectors.add(1.0, one, result)
        if fails.pop():
            raise ValueError("the first time")
        vectors.add(10.0, one, result)

    with device.repeated(work) as again:
        with pytest.raises(ValueError, match="the first time"):
            again()
        fails.append(False)
        again()
        again()
    np.testing.assert_array_equal(result.get(), 1 + 11 + 11)


class Diagonal:
    """1/2 x^T D x - b^T x by launches alone."""

    quadratic = True

    def __init__(self, vectors, diagonal, slope, repeatable):
        self.vectors, self.repeatable = vectors, repeatable
        self.diagonal, self.slope, self.zeros = vectors.of(diagonal), vectors.of(slope), vectors.zeros()

    def add_gradient(self, x, result):
        self.add_product(x, result)
        self.vectors.add(-1.0, self.slope, result)

    def add_product(self, x, result):
        self.vectors.launch("add_damped", transposed=self.zeros, damping=self.diagonal, change=x, result=result)


@pytest.mark.parametrize("iterations", [1, 2, 30])
def test_minima_are_the_same_with_and_without(device, vectors, random, iterations):
    """To the bit."""
    diagonal, slope = np.exp(0.5 * random.normal(size=COUNT)), random.normal(size=COUNT)
    found = [
        minimised([Diagonal(vectors, diagonal, slope, repeatable)], np.ones(COUNT), np.ones(COUNT), iterations, device)
        for repeatable in (False, True)
    ]
    np.testing.assert_array_equal(*found)
    if iterations == 30:
        np.testing.assert_allclose(found[1], np.maximum(slope / diagonal, 0), atol=1e-3)
