"""Names of earlier versions are answered with the new ones."""

import numpy as np
import pytest

import cloudtomo_cl as ct
from cloudtomo_cl.errors import DataError

VIEW = ct.OrthographicView(zenith=0.0, width=1.0, pixels=(2, 2))
IMAGE = np.ones((2, 2))


@pytest.mark.parametrize("argument", ["keep_paths", "iteration"])
def test_old_arguments_of_render(device, argument):
    grid = ct.Grid(shape=(2, 2, 2), spacing=(0.1, 0.1, 0.1))
    operator = ct.RadianceOperator(ct.Scene(grid=grid, sun=ct.Sun(zenith=0.0)), [VIEW], device)
    new = {"keep_paths": "store_paths", "iteration": "stream"}[argument]
    with pytest.raises(DataError, match=f"RadianceOperator.render: the argument {argument} is now {new}"):
        operator.render(np.zeros(grid.shape), 2, **{argument: 1})


def test_old_argument_of_gradients(device):
    grid = ct.Grid(shape=(2, 2, 2), spacing=(0.1, 0.1, 0.1))
    operator = ct.RadianceOperator(ct.Scene(grid=grid, sun=ct.Sun(zenith=0.0)), [VIEW], device)
    with pytest.raises(DataError, match="gradient: the argument filling_limit is now virtual_limit"):
        operator.gradient(None, np.ones((4, 2)), filling_limit=0.0)


def test_old_arguments_of_priors_and_stages():
    with pytest.raises(DataError, match="the argument clear is now sparsity_scale"):
        ct.Prior(clear=3.0)
    grid = ct.Grid(shape=(8, 8, 8), spacing=(0.1, 0.1, 0.1))
    with pytest.raises(DataError, match="the argument method is now solver: a GaussNewton, Adam or SGD"):
        ct.automatic_stages(grid, method="adam")
    with pytest.raises(DataError, match="solver is 'adam', of type str: it must be a solver, for instance GaussNewton"):
        ct.automatic_stages(grid, "adam")


def test_old_attributes():
    measurements = ct.Measurements((VIEW,), (IMAGE,), (IMAGE,))
    with pytest.raises(AttributeError, match="has no attribute 'bad_pixels': it is now invalid_pixels"):
        _ = measurements.bad_pixels
    record = ct.IterationRecord(0, 1, 0, 1, 0.0, 10, 1.0, 0.1, 0.0)
    with pytest.raises(AttributeError, match="has no attribute 'photons': it is now paths"):
        _ = record.photons


def test_other_attributes_are_missing_as_ever():
    with pytest.raises(AttributeError, match="Measurements has no attribute 'nothing'$"):
        _ = ct.Measurements((VIEW,), (IMAGE,), (IMAGE,)).nothing
