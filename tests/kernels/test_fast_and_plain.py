"""What makes the walk fast must not change what it computes: against the plain estimator, which skips nothing."""

import numpy as np
import pytest
from scipy import stats

from cloudtomo_cl import (
    Cloud,
    Grid,
    HenyeyGreenstein,
    OrthographicView,
    RadianceOperator,
    Scene,
    Sun,
    Surface,
    cumulus,
)

GRID = Grid(shape=(12, 12, 12), spacing=(0.08, 0.08, 0.08))
EXTINCTION = cumulus(GRID, seed=3).astype(np.float32)
SCENE = Scene(grid=GRID, sun=Sun(zenith=35, azimuth=20), surface=Surface(albedo=0.2))
VIEW = OrthographicView(zenith=30, azimuth=200, width=1.2, pixels=(8, 8))
# Seeds are fixed; a right code fails with this probability each time they are changed.
SIGNIFICANCE = 1e-4


def chi_square_probability(difference, error):
    """Of a difference as large, in all its elements together, by chance."""
    certain = error > 0
    return stats.chi2.sf(np.sum((difference[certain] / error[certain]) ** 2), certain.sum())


@pytest.fixture(scope="module")
def operators(device):
    """The fast walk, and the plain one: no side flights, no branches, and a mask that lets it skip nothing."""
    everywhere = np.ones(GRID.shape, bool)
    return (
        RadianceOperator(SCENE, (VIEW,), device, estimator="branches"),
        RadianceOperator(SCENE, (VIEW,), device, estimator="plain", mask=everywhere),
    )


def test_images_agree(operators):
    # Many small renders, whose means are all but normal although the plain estimator's paths are not.
    fast, plain = (
        np.array([operator.render(EXTINCTION, 1024, seed).mean for seed in range(first, first + 24)])
        for operator, first in zip(operators, (0, 100))
    )
    difference = (fast.mean(axis=0) - plain.mean(axis=0)).reshape(4, -1).mean(axis=0)
    spread = (fast.var(axis=0, ddof=1) + plain.var(axis=0, ddof=1)) / 24
    error = np.sqrt(spread.reshape(4, -1).mean(axis=0) / 4)
    assert chi_square_probability(difference, error) > SIGNIFICANCE
    assert error.mean() < 0.02 * plain.mean()


def test_gradients_agree(device):
    # A thin cloud of a mild forward peak, where the score function's noise is small enough for what half of the
    # side flights' deposits bring to be seen; along the extinction, by horizontal slices.
    cloud = Cloud(phase_function=HenyeyGreenstein(g=0.5))
    scene = Scene(grid=GRID, sun=SCENE.sun, surface=SCENE.surface, cloud=cloud)
    extinction, adjoint = 0.3 * EXTINCTION, np.full((64, 2), 1.0)
    operators = (
        RadianceOperator(scene, (VIEW,), device, estimator="side-flights"),
        RadianceOperator(scene, (VIEW,), device, estimator="plain", mask=np.ones(GRID.shape, bool)),
    )
    sums = []
    for operator, first in zip(operators, (0, 100)):
        rows = []
        for seed in range(first, first + 24):
            rendering = operator.render(extinction, 512, seed, store_paths=True)
            gradient = operator.gradient(rendering, adjoint).get()
            rows.append((gradient * extinction).sum(axis=(0, 1)).reshape(4, 3).sum(axis=1))
        sums.append(np.array(rows))
    fast, plain = sums
    difference = fast.mean(axis=0) - plain.mean(axis=0)
    error = np.sqrt((fast.var(axis=0, ddof=1) + plain.var(axis=0, ddof=1)) / 24)
    assert chi_square_probability(difference, error) > SIGNIFICANCE
    assert np.sqrt(np.sum(error**2)) < 0.1 * plain.mean(axis=0).sum()
