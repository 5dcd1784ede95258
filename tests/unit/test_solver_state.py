"""A solver's state survives as arrays, or is refused by the name of what is wrong."""

from dataclasses import dataclass, field

import numpy as np
import pytest

from cloudtomo_cl.errors import DataError
from cloudtomo_cl.inversion.solvers.state import arrays_of, not_saved, of_any_length, restored


@dataclass(frozen=True)
class Inner:
    mean: np.ndarray
    steps: int = 0


@dataclass(frozen=True)
class Outer:
    inner: Inner
    rate: float
    extinction: np.ndarray
    walked: np.ndarray = of_any_length()
    cache: object = not_saved(default=None)
    names: tuple = field(default=(), metadata={"saved": False})


def state(walked=0, rate=0.5):
    return Outer(Inner(np.arange(3.0), 4), rate, np.arange(5, dtype=np.float32), np.ones((walked, 5), np.float32))


def test_a_state_comes_back_field_by_field():
    arrays = arrays_of(state(walked=2, rate=0.25))
    assert set(arrays) == {"inner.mean", "inner.steps", "rate", "extinction", "walked"}
    back = restored(state(), arrays)
    assert back.rate == 0.25 and back.inner.steps == 4 and back.walked.shape == (2, 5)
    np.testing.assert_array_equal(back.extinction, np.arange(5))


def test_a_state_without_one_of_its_parts_can_be_kept_and_comes_back():
    """As that of a descent by replayed paths, which has no radiance table."""
    arrays = arrays_of(state(rate=None))
    assert set(arrays) == {"inner.mean", "inner.steps", "extinction", "walked"}
    assert all(array.dtype != object for array in arrays.values())
    assert restored(state(rate=None), arrays).rate is None


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"rate": None}, "the state lacks rate"),
        ({"more": np.zeros(1)}, "the state has an unknown more"),
        ({"inner.mean": np.zeros(4)}, r"inner.mean of the state is float64 \(4,\): it must be float64 \(3,\)"),
        ({"extinction": np.zeros(5)}, r"extinction of the state is float64 \(5,\): it must be float32 \(5,\)"),
        ({"walked": np.zeros((1, 4), np.float32)}, r"walked of the state .* it must be float32 \('any', 5\)"),
        ({"rate": np.array(np.inf)}, "rate of the state is not finite"),
        ({"extinction": np.full(5, np.nan, np.float32)}, "extinction of the state is not finite"),
    ],
)
def test_what_does_not_fit_is_refused(change, message):
    arrays = {name: array for name, array in (arrays_of(state()) | change).items() if array is not None}
    with pytest.raises(DataError, match=message):
        restored(state(), arrays)
