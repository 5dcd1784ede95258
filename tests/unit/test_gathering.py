"""Vectors that ranks make by parts, and who makes which voxels; ranks are threads with a device each."""

import numpy as np
import pytest

from cloudtomo_cl.inversion.conjugate_gradients import minimised
from cloudtomo_cl.inversion.terms import shares_of
from cloudtomo_cl.inversion.vectors import Vectors
from cloudtomo_cl.opencl.gathering import Gathering
from cloudtomo_cl.opencl.several import on_devices
from cloudtomo_cl.parallel.ranks import Ranks
from cloudtomo_cl.transport.blocks import voxel_blocks
from cloudtomo_cl.transport.voxel_shares import ROW, voxel_shares

COUNT = 50
SIZES = [1, 2, 3]


def of_size(size):
    """One of so many ranks, as far as it deals out."""
    ranks = Ranks()
    ranks.size = size
    return ranks


def shares_on(device):
    return device.ranks.dealt(np.arange(COUNT) // 4)


def own_numbers(shares, values):
    """The values of a rank's own numbers, and nothing where others' are."""
    result = np.full(COUNT, np.nan, np.float32)
    result[shares.own] = values[shares.own]
    return result


@pytest.mark.parametrize("size", SIZES)
def test_a_vector_is_completed_by_the_others_numbers(size, random):
    values = random.normal(size=COUNT).astype(np.float32)

    def work(device):
        shares = shares_on(device)
        vector = device.array(own_numbers(shares, values))
        Gathering(device, shares).complete(vector)
        return device.ranks.all(vector.get())

    np.testing.assert_array_equal(on_devices([0] * size, work), [values] * size)


@pytest.mark.parametrize("size", [2, 3])
def test_parts_are_joined_in_their_places(size, random):
    values = random.normal(size=COUNT).astype(np.float32)

    def work(device):
        shares = shares_on(device)
        part, vector = device.array(np.resize(shares.taken(values), COUNT)), device.zeros(COUNT, np.float32)
        Gathering(device, shares).join(part, vector)
        return device.ranks.all(vector.get())

    np.testing.assert_array_equal(on_devices([0] * size, work), [values] * size)


def test_a_rank_without_any_takes_part():
    def work(device):
        shares = device.ranks.dealt(np.zeros(COUNT, int))
        vector = device.array(np.full(COUNT, device.ranks.rank, np.float32))
        Gathering(device, shares).complete(vector)
        return device.ranks.all(vector.get())

    np.testing.assert_array_equal(on_devices([0, 0], work), np.zeros((2, COUNT)))


class Shared:
    """1/2 x^T D x - b^T x, of which ranks make their own numbers, and others nonsense."""

    quadratic = repeatable = True

    def __init__(self, device, diagonal, slope):
        self.vectors, self.shares = Vectors(device, COUNT), shares_on(device)
        self.diagonal = self.vectors.of(own_numbers(self.shares, diagonal))
        self.slope, self.zeros = self.vectors.of(slope), self.vectors.zeros()

    def add_gradient(self, x, result):
        self.add_product(x, result)
        self.vectors.add(-1.0, self.slope, result)

    def add_product(self, x, result):
        self.vectors.launch("add_damped", transposed=self.zeros, damping=self.diagonal, change=x, result=result)


def minimum_and_messages(diagonal, slope, iterations, terms=2):
    """Of so many terms that share, and how many messages that took."""

    def work(device):
        told, joined = [], device.ranks.joined

        def counted(*arguments):
            told.append(1)
            return joined(*arguments)

        device.ranks.joined = counted
        made = [Shared(device, diagonal, slope) for _ in range(terms)]
        return minimised(made, np.ones(COUNT), np.ones(COUNT), iterations, device), len(told)

    return work


def test_ranks_find_the_minimum_of_terms_that_they_share(random):
    """To the bit, and by launches that are made again."""
    diagonal, slope = np.exp(0.5 * random.normal(size=COUNT)), random.normal(size=COUNT)
    found = [on_devices([0] * size, minimum_and_messages(diagonal, slope, 30))[0] for size in SIZES]
    np.testing.assert_array_equal(found[1:], [found[0]] * 2)
    np.testing.assert_allclose(found[0], np.maximum(slope / diagonal, 0), atol=1e-3)


def test_terms_share_a_message(random):
    """One for the gradient at the start, and one for every product of all terms."""
    diagonal, slope = np.exp(random.normal(size=COUNT)), random.normal(size=COUNT)
    _, messages = on_devices([0, 0], minimum_and_messages(diagonal, slope, 4, terms=3))
    assert messages == 1 + 4


def test_terms_whose_numbers_have_other_owners_are_no_sum(device):
    class Term:
        def __init__(self, owner):
            self.shares = of_size(2).dealt(np.array(owner))

    assert shares_of([Term([0, 1, 0]), Term([0, 1, 0]), object()]).count == 3
    with pytest.raises(AssertionError):
        shares_of([Term([0, 1, 0]), Term([1, 0, 1])])


@pytest.fixture
def mask():
    """An ellipsoid: boxes at its edge hold less than others."""
    place = np.indices((40, 36, 30)) - np.reshape([20, 18, 15], (3, 1, 1, 1))
    return np.sum((place / np.reshape([18, 15, 13], (3, 1, 1, 1))) ** 2, axis=0) < 1


@pytest.mark.parametrize("size", [2, 3, 8])
def test_voxels_in_a_row_have_one_owner(mask, size):
    """Tiles of the stencil are made by it."""
    owner = voxel_shares(mask, of_size(size)).owner
    x, y, z = np.argwhere(mask).T
    rows = np.unique(np.column_stack([x, y, z // ROW]), axis=0)
    assert len(np.unique(np.column_stack([x, y, z // ROW, owner]), axis=0)) == len(rows)


@pytest.mark.parametrize("size", [2, 3, 8])
def test_ranks_have_about_as_many_voxels(mask, size):
    counts = np.bincount(voxel_shares(mask, of_size(size)).owner, minlength=size)
    assert counts.max() < 1.1 * counts.mean()


def test_blocks_of_the_far_field_have_one_owner(mask):
    owner = voxel_shares(mask, of_size(2)).owner
    of = voxel_blocks(mask, 10).of
    assert len(np.unique(np.column_stack([of, owner]), axis=0)) == of.max() + 1


def test_small_masks_are_shared_by_all_who_can():
    assert set(voxel_shares(np.ones((6, 6, 5), bool), of_size(3)).owner) == {0, 1, 2}
