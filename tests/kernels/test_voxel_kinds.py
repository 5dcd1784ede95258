"""The gradient against finite differences in voxels of every kind: deep, thin, empty, in a hole, at the boundary.

Both sides have the same random numbers, batch by batch; over 16 batches their mean difference is zero by Student's t
at a significance of 1e-4 per kind and scene (14 in all). And the test can see something: the standard error of the
difference is below 0.3 of the cloud's derivative, in thin and empty voxels mostly below 0.03.
scripts/derivatives_check.py does the same for larger clouds, with more paths.
"""

import numpy as np
import pytest
from scenes import PERIODIC, optics
from scipy import stats

from cloudtomo_cl.scene.grid import Grid
from cloudtomo_cl.scene.scene import Air, Scene, Sun, Surface
from cloudtomo_cl.scene.sensors import OrthographicView
from cloudtomo_cl.transport.radiance import RadianceOperator

EDGE = 0.1  # km
GRID = Grid(shape=(4, 4, 4), spacing=(EDGE, EDGE, EDGE), origin=(0.0, 0.0, 0.2))
VIEWS = [OrthographicView(width=0.35, pixels=(2, 2), zenith=zenith, azimuth=30) for zenith in (0, 40)]
SCENES = {
    "open": Scene(GRID, Sun(zenith=30, azimuth=20), optics(0.7)),
    "periodic, ground, air, absorption": Scene(
        GRID, Sun(zenith=40, azimuth=100), optics(0.6, 0.95), Air(0.5, 0.9), Surface(0.6), PERIODIC
    ),
}
BATCHES, SAMPLES = 16, 3000
STEP = 0.15  # optical depth of a voxel: curvature shows less than 1 %


def cloud():
    """Extinction, km^-1, and kinds of voxels."""
    values = np.full(GRID.shape, 6.0)
    values[3] = 0.0  # one side of the domain
    values[1, 1, 1] = 0.0
    values[0, 0:2, 0] = 20.0 / EDGE
    values[2] = 0.4
    values[1, 3, 3] = 0.0

    def only(*where):
        chosen = np.zeros(GRID.shape)
        chosen[where] = 1.0
        return chosen

    rest = slice(None)
    return values, {
        "all cloud but the deep": values * (values < 100),
        "deep": values * (values > 100),
        "thin": values * (values == 0.4),
        "hole": only(1, 1, 1),
        "boundary, empty": only(3),
        "corner of the cloud, empty": only(1, 3, 3),
        "boundary, cloudy": values * only(0, rest, slice(1, None)),
    }


def difference(operator, values, change, batch, here):
    """Along a change of the extinction: central, where it is 0 of second order to one side of `here`."""
    empty = not (values * change).any()
    step = STEP / (change * EDGE).max() if empty else min(STEP / (change * EDGE).max(), 0.5)
    times, weights = ((1, 2), (2, -0.5)) if empty else ((1, -1), (0.5, -0.5))
    means = [operator.render(values + n * step * change, SAMPLES, 21, batch).mean.mean() for n in times]
    return (np.dot(weights, means) - sum(weights) * here) / step


@pytest.mark.parametrize("scene", SCENES.values(), ids=SCENES)
def test_gradients_in_all_kinds_of_voxels(device, scene):
    values, kinds = cloud()
    operator = RadianceOperator(scene, VIEWS, device)
    adjoint = np.full((len(operator.pixels), 2), 0.5 / len(operator.pixels))
    gradients, means = [], []
    for batch in range(BATCHES):
        rendering = operator.render(values, SAMPLES, 21, batch, store_paths=True)
        gradients.append(operator.gradient(rendering, adjoint).get())
        means.append(rendering.mean.mean())
    largest = 0.0
    for name, change in kinds.items():
        found = np.array([np.sum(gradient * change) for gradient in gradients])
        expected = np.array([difference(operator, values, change, *at) for at in enumerate(means)])
        error = stats.sem(found - expected)
        print(f"{name}: {found.mean():.3g}, differences {expected.mean():.3g}, standard error {error:.2g}")
        largest = largest or abs(expected.mean())
        assert error < 0.3 * largest, name
        assert stats.ttest_1samp(found - expected, 0.0).pvalue > 1e-4, name
