"""The cases of `cloudtomo validate`, with few photons.

Rationale: the reference shares this project's reading of the equations; others' codes do not.
Expected: means within 4 standard errors (a probability of 6e-5 each) plus 0.3 %, the spread among the
published codes; columns with an r.m.s. difference below 1.5 % plus 4 of its standard errors.
"""

from pathlib import Path

import numpy as np
import pytest

from cloudtomo_cl import validation
from cloudtomo_cl.files import i3rc

SIGMAS = 4.0
# What the noise may be, relative to the value: a test that any value passes is none.
LARGEST_NOISE = 0.04
BESIDE = Path(__file__).resolve().parents[3] / "shared" / "data"
FILES = i3rc.folder(None) or i3rc.folder(BESIDE if (BESIDE / "i3rc").is_dir() else None)
needs_files = pytest.mark.skipif(FILES is None, reason="CLOUDTOMO_DATA does not name a folder with I3RC's files")


def check(row):
    if row.columns:
        assert row.standard_error < 0.03, row
        assert row.value <= validation.COLUMNS_SHARE + SIGMAS * row.standard_error, row
    else:
        assert row.standard_error <= LARGEST_NOISE * max(row.published, 0.01), row
        tolerance = SIGMAS * row.standard_error + validation.SHARE * row.published
        assert abs(row.value - row.published) <= tolerance, row


@pytest.mark.parametrize("case", list(validation.cases()), ids=lambda case: case.name)
def test_values_are_the_published_ones(device, case):
    """Columns too, where I3RC's files are."""
    for row in validation.run(case, device, photons=60_000, seed=5, files=FILES):
        check(row)


@needs_files
@pytest.mark.parametrize("case", list(validation.step_cloud()), ids=lambda case: case.name)
def test_tables_means_are_those_of_the_columns(case):
    for quantity in case.quantities:
        if quantity.consensus is not None:
            columns = i3rc.read_consensus(FILES, *case.i3rc, quantity.consensus)
            assert columns.mean() == pytest.approx(quantity.published, abs=6e-6)


@needs_files
def test_landsat_cloud_keeps_the_optical_depth_of_every_column():
    experiment = validation.landsat(FILES)
    depth = np.loadtxt(FILES / "scene43.tau.128x128").T
    np.testing.assert_allclose(experiment.extinction.sum(axis=2) * experiment.scene.grid.spacing[2], depth, rtol=1e-5)


@needs_files
def test_map_of_the_landsat_cloud_lies_as_the_published_one(device):
    experiment = validation.landsat(FILES)
    (nadir,) = (quantity for quantity in experiment.quantities if quantity.view is not None)
    found, _ = validation.radiance(experiment, nadir.view, device, 2 * 128 * 128, seed=7)
    published = i3rc.read_consensus(FILES, 3, 1, nadir.consensus)
    mirrored = [published[::-1], published[:, ::-1], published.T, published[::-1, ::-1]]
    correlation, *others = (np.corrcoef(found.ravel(), image.ravel())[0, 1] for image in [published, *mirrored])
    # Two photons a pixel are noise enough to keep the correlation away from 1.
    assert correlation > 1.1 * max(others) and correlation > 0.1
