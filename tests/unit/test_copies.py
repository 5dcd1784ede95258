"""Objects that hold arrays are compared without an error; they are copied and pickled, or say why they are not."""

import copy
import dataclasses
import importlib
import inspect
import pickle
import pkgutil

import numpy as np
import pytest

import cloudtomo_cl as ct

GRID = ct.Grid((6, 6, 6), (0.1, 0.1, 0.1))
SCENE = ct.Scene(GRID, ct.Sun(30.0))
VIEWS = tuple(ct.OrthographicView(zenith=zenith, azimuth=0.0, width=1.0, pixels=(6, 6)) for zenith in (0.0, 40.0))
WAYS = {"deepcopy": copy.deepcopy, "copy": copy.copy, "pickle": lambda one: pickle.loads(pickle.dumps(one))}


def classes():
    """Every dataclass of the package."""
    for found in pkgutil.walk_packages(ct.__path__, "cloudtomo_cl."):
        if not found.name.endswith("__main__"):
            module = importlib.import_module(found.name)
            own = (one for one in vars(module).values() if getattr(one, "__module__", "") == found.name)
            yield from (one for one in own if inspect.isclass(one) and dataclasses.is_dataclass(one))


def test_what_holds_arrays_is_compared_as_an_object():
    """The fields' own == would make arrays of truth values, and end in NumPy's error."""
    holding = {
        kind
        for kind in classes()
        for field in dataclasses.fields(kind)
        if "ndarray" in str(field.type) and "Callable" not in str(field.type)
    }
    assert {ct.Measurements, ct.Reconstruction, ct.Rendering, ct.Fluxes, ct.CloudVolume} <= holding
    assert not [kind.__name__ for kind in holding if kind.__eq__ is not object.__eq__]


@pytest.fixture(scope="module")
def made(device):
    extinction = ct.cumulus(GRID, seed=1)
    operator = ct.RadianceOperator(SCENE, VIEWS, device)
    rendering = operator.render(extinction, 16, store_paths=True)
    measurements = ct.Measurements.rendered(operator, rendering)
    periodic = ct.FluxOperator(ct.Scene(GRID, ct.Sun(30.0), boundary=ct.Boundary("periodic")), device)
    kept = []
    stages = [ct.Stage(grid=(3, 3, 3), iterations=1, samples=4)]
    recovered = ct.reconstruct(
        SCENE, measurements, stages, device=device, mask=extinction > 0, checkpoint=kept.append, uncertainty=0
    )
    problem = ct.Problem.of(SCENE, measurements, mask=extinction > 0, device=device)
    model = problem.linearise(np.ones(len(problem.voxels)), samples=2)
    return {
        "Measurements": measurements,
        "Rendering": rendering,
        "Fluxes": periodic.compute(extinction, 100),
        "Estimate": periodic.compute(extinction, 100).reflected,
        "Reconstruction": recovered,
        "Checkpoint": kept[-1],
        "CloudVolume": ct.CloudVolume(GRID, extinction),
        "Voxels": problem.voxels,
        "Device": device,
        "RadianceOperator": operator,
        "FluxOperator": periodic,
        "Problem": problem,
        "LinearModel": model,
        "Jacobian": model.jacobian,
    }


NUMBERS = ["Measurements", "Rendering", "Fluxes", "Estimate", "Reconstruction", "Checkpoint", "CloudVolume", "Voxels"]
OF_A_DEVICE = ["Device", "RadianceOperator", "FluxOperator", "Problem", "LinearModel", "Jacobian"]


@pytest.mark.parametrize("way", WAYS.values(), ids=WAYS)
@pytest.mark.parametrize("name", NUMBERS)
def test_numbers_are_copied(made, name, way):
    again = way(made[name])
    assert (again == made[name]) is False and again == again and repr(again) == repr(made[name])


def test_a_copy_of_a_rendering_has_its_numbers_and_says_what_it_lacks(made):
    rendering, operator = made["Rendering"], made["RadianceOperator"]
    again = pickle.loads(pickle.dumps(rendering))
    assert np.array_equal(again.halves, rendering.halves) and again.audit == rendering.audit
    images = ct.Measurements.rendered(operator, again).images
    assert np.array_equal(images, ct.Measurements.rendered(operator, rendering).images)
    assert "mean radiance" in again._repr_html_()
    with pytest.raises(ct.DataError, match="a copy of one has none"):
        operator.gradient(again, np.zeros((len(operator.pixels), 2)))
    with pytest.raises(ct.DataError, match="is a copy, which has no views"):
        again.to_dataset()


@pytest.mark.parametrize("way", ["deepcopy", "pickle"])
@pytest.mark.parametrize("name", OF_A_DEVICE)
def test_what_lives_on_a_device_says_so(made, name, way):
    with pytest.raises(TypeError, match="can neither be pickled nor copied: .* choose_device"):
        WAYS[way](made[name])
