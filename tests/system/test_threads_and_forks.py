"""Operators that share a device, in threads and in forked processes."""

import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

import cloudtomo_cl as ct

GRID = ct.Grid(shape=(4, 4, 4), spacing=(0.2, 0.2, 0.2))
VIEWS = (ct.OrthographicView(zenith=0.0, width=0.9, pixels=(8, 8)),)
SCENES = [ct.Scene(grid=GRID, sun=ct.Sun(zenith=zenith)) for zenith in (0.0, 20.0, 40.0, 60.0)]
EXTINCTION = np.full(GRID.shape, 5.0, np.float32)


@pytest.fixture
def quick_switches():
    before = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    yield
    sys.setswitchinterval(before)


def results(operator, seed):
    """An image and a gradient."""
    rendering = operator.render(EXTINCTION, 8, seed, store_paths=True)
    return rendering.mean, operator.gradient(rendering, np.ones((len(operator.pixels), 2))).get()


def test_threads_that_share_a_device_have_their_own_results(device, quick_switches):
    operators = [ct.RadianceOperator(scene, VIEWS, device) for scene in SCENES]
    tasks = [(operator, seed) for seed in range(15) for operator in operators]
    alone = [results(*task) for task in tasks]
    with ThreadPoolExecutor(len(operators)) as pool:
        together = list(pool.map(lambda task: results(*task), tasks))
    for one, other in zip(alone, together):
        np.testing.assert_array_equal(one[0], other[0])
        np.testing.assert_array_equal(one[1], other[1])


FORKED = """
import os, sys
import numpy as np
import cloudtomo_cl as ct
from cloudtomo_cl.errors import DeviceError
grid = ct.Grid(shape=(2, 2, 2), spacing=(0.2, 0.2, 0.2))
views = (ct.OrthographicView(zenith=0.0, width=0.6, pixels=(3, 3)),)
operator = ct.RadianceOperator(ct.Scene(grid=grid, sun=ct.Sun(zenith=30.0)), views, ct.choose_device())
operator.render(np.ones(grid.shape, np.float32), 2)
child = os.fork()
if child == 0:
    said = 0
    for attempt in (lambda: operator.render(np.ones(grid.shape, np.float32), 2), ct.choose_device):
        try:
            attempt()
        except DeviceError as error:
            said += "spawn" in str(error)
    os._exit(said)
sys.exit(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork here")
def test_a_forked_process_is_told_to_spawn():
    assert subprocess.run([sys.executable, "-c", FORKED], timeout=60).returncode == 2
