"""The prior and its gradient as sparse matrices, to check the kernels by.

Equation numbers are those of the supplement on the monotonicity prior.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse


def smoothness_matrix(shape: tuple[int, int, int]) -> scipy.sparse.csr_matrix:
    """A: the mean over the 26 neighbours, less the voxel itself; beyond an edge its nearest voxel."""
    ones = []
    for count in shape:
        here = np.arange(count)
        neighbours = np.concatenate([np.maximum(here - 1, 0), here, np.minimum(here + 1, count - 1)])
        ones.append(scipy.sparse.coo_matrix((np.ones(3 * count), (np.tile(here, 3), neighbours)), (count, count)))
    block = scipy.sparse.kron(scipy.sparse.kron(ones[0], ones[1]), ones[2])  # all 27 voxels
    identity = scipy.sparse.identity(int(np.prod(shape)))
    return ((block - identity) / 26 - identity).tocsr()


def vertical_matrix(shape: tuple[int, int, int]) -> scipy.sparse.csr_matrix:
    """Dz: central differences along z in grid units, one-sided at the ends; 0 if there is one layer."""
    count = shape[2]
    derivative = np.zeros((count, count))
    for k in range(count):
        below, above = max(k - 1, 0), min(k + 1, count - 1)
        if above > below:
            derivative[k, above] += 1 / (above - below)
            derivative[k, below] -= 1 / (above - below)
    return scipy.sparse.kron(scipy.sparse.identity(shape[0] * shape[1]), scipy.sparse.csr_matrix(derivative)).tocsr()


def prior_value_and_gradient(
    extinction: np.ndarray,
    mu1: float,
    mu2: float,
    c1: float = 1 / 5,
    c2: float = 1 / 20,
    threshold: float = 0.01,
    mu3: float = 0.0,
    clear: float = 3.0,
) -> tuple[float, np.ndarray]:
    """The prior on smoothness, on growth with height and on clear air, and its gradient.

    Parameters
    ----------
    extinction : km^-1, shape of the grid
    mu1, mu2 : weights of smoothness (km^2) and of monotonicity
    c1, c2 : km, the scales of the derivative and of the extinction
    threshold : km^-1; voxels at or below it do not count as cloud
    mu3, clear : weight of sum b / (b + clear), and its scale, km^-1

    Returns the value, and the gradient (km, shape of the grid).

    Source: Eqs. 20-23; the gradient has the transpose of Dz, which Eq. 23 leaves out. The last term is
    this project's own (prior.py).
    """
    smoothness, vertical = smoothness_matrix(extinction.shape), vertical_matrix(extinction.shape)
    b = np.asarray(extinction, float).ravel()
    cloud = b > threshold
    growth, amount = np.tanh(c1 * (vertical @ b)), np.tanh(c2 * b)
    rough = smoothness @ b
    value = mu1 / 2 * rough @ rough - mu2 * np.sum(growth * amount * cloud)
    gradient = mu1 * (smoothness.T @ rough) - mu2 * (
        c1 * (vertical.T @ ((1 - growth**2) * amount * cloud)) + c2 * growth * (1 - amount**2) * cloud
    )
    value += mu3 * np.sum(b / (b + clear))
    gradient += mu3 * clear / (b + clear) ** 2
    return float(value), gradient.reshape(extinction.shape)
