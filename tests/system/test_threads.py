"""The bits of a recovery do not follow from the numbers of threads, of BLAS and of the device, nor a resume's."""

import os
import subprocess
import sys

import pytest

RECOVERY = """
import hashlib, sys
import numpy as np
import cloudtomo_cl as ct
grid = ct.Grid(shape=(24, 24, 24), spacing=(0.03, 0.03, 0.03))
truth = ct.cumulus(grid, seed=3, peak=30.0)
scene = ct.Scene(grid=grid, sun=ct.Sun(zenith=30.0))
views = ct.RingOfViews(target=grid.centre, height=2.2, radius=1.2, count=4, field_of_view=30.0, pixels=(36, 36)).views()
operator = ct.RadianceOperator(scene, views)
measured = ct.Measurements.rendered(operator, operator.render(truth, 8, seed=1))
stages = (ct.Stage(grid=grid.shape, samples=4, iterations=2),)
stop = iter([True]) if sys.argv[1] == "begin" else iter(())
result = ct.reconstruct(
    scene, measured, stages, solver=ct.GaussNewton(image_samples=1, inner_iterations=5),
    mask=np.ones(grid.shape, bool), seed=2, uncertainty=1,
    checkpoint=sys.argv[2], resume=sys.argv[2] if sys.argv[1] == "resume" else None, stop=lambda: next(stop, False),
)
print(hashlib.sha256(result.extinction.data).hexdigest(), len(result.history))
"""


def recovered(checkpoint, what, blas, device):
    """The digest of a recovery in a process of its own; its 13,824 voxels are more than BLAS sums with one thread."""
    threads = {"OPENBLAS_NUM_THREADS": str(blas), "MKL_NUM_THREADS": str(blas), "POCL_MAX_PTHREAD_COUNT": str(device)}
    done = subprocess.run(
        [sys.executable, "-c", RECOVERY, what, str(checkpoint)], env={**os.environ, **threads}, capture_output=True,
        text=True, timeout=300,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return done.stdout.split()


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    return recovered(tmp_path_factory.mktemp("whole") / "checkpoint.npz", "whole", 1, 1)


def test_more_threads_change_no_bit(whole, tmp_path):
    assert recovered(tmp_path / "checkpoint.npz", "whole", 2, 2) == whole


def test_a_resume_with_more_threads_changes_no_bit(whole, tmp_path):
    assert recovered(tmp_path / "checkpoint.npz", "begin", 1, 2)[1] == "1"
    assert recovered(tmp_path / "checkpoint.npz", "resume", 2, 1) == whole
