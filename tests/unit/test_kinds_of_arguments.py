"""What is no images, no scene, no device ... is answered with its name and what is wanted."""

import re

import numpy as np
import pytest
import xarray as xr
from matplotlib.figure import Figure

import cloudtomo_cl as ct
from cloudtomo_cl.arguments import NUMBER, Kind, a, able, many, require_kinds

GRID = ct.Grid((4, 4, 4), (0.1, 0.1, 0.1))
SCENE = ct.Scene(GRID, ct.Sun(30.0))
CLOUD = np.zeros(GRID.shape, np.float32)
CLOUD[1:3, 1:3, 1:3] = 5.0
VIEWS = (ct.OrthographicView(zenith=0.0, width=0.6, pixels=(4, 4)),)
IMAGES = ct.Measurements(VIEWS, (np.ones((4, 4)),), (np.full((4, 4), 0.1),))
ANGLES = (0.0, 90.0, 180.0)
TABLE = ct.TabulatedPhaseFunction(ANGLES, (((1 / (4 * np.pi),) * 3),), (10.0,), (1.0,))


def recover(*arguments, **others):
    return ct.reconstruct(*arguments, **{"mask": CLOUD > 0, **others})


WRONG = {
    "no scene": (lambda: recover(None, IMAGES), "reconstruct: scene is None: it must be a Scene"),
    "no images": (lambda: recover(SCENE, "images.nc"), "measurements is 'images.nc', of type str: it must be a"),
    "arrays": (lambda: recover(SCENE, IMAGES.images), "measurements is a tuple of ndarray: .*read_measurements reads"),
    "a stage": (lambda: recover(SCENE, IMAGES, ct.Stage(grid=(2, 2, 2))), "stages is of type Stage: .* each entry"),
    "a number": (lambda: recover(SCENE, IMAGES, prior=5), "prior is 5, of type int: it must be a PatchPr"),
    "a class": (lambda: recover(SCENE, IMAGES, solver=ct.Adam), "solver is the class Adam, not an object of it"),
    "a name": (lambda: recover(SCENE, IMAGES, device="cpu"), "device is 'cpu', .*choose_device gives one"),
    "no function": (lambda: recover(SCENE, IMAGES, callback=3), "callback is 3, of type int: .* function, or None"),
    "no file": (lambda: recover(SCENE, IMAGES, checkpoint=3), "checkpoint is 3, .* file, .* or a function, or None"),
    "Problem": (lambda: ct.Problem.of(SCENE, None), "Problem.of: measurements is None"),
    "stages": (lambda: ct.automatic_stages((4, 4, 4)), "automatic_stages: grid is a tuple of int: it must be a Grid"),
    "operator": (lambda: ct.RadianceOperator("scene", VIEWS), "RadianceOperator: scene is 'scene'"),
    "one view": (lambda: ct.RadianceOperator(SCENE, VIEWS[0]), "views is of type OrthographicView: .* tuple or list"),
    "fluxes": (lambda: ct.FluxOperator(GRID), "FluxOperator: scene is of type Grid"),
    "carve": (lambda: ct.carve(SCENE, IMAGES, IMAGES), "carve: grid is of type Scene"),
    "error": (lambda: ct.render_to_error(SCENE, CLOUD, 0.1), "render_to_error: operator is of type Scene"),
    "views": (lambda: ct.Measurements(("a",), IMAGES.images, IMAGES.images), "views is a tuple of str: .*PerspectiveV"),
    "image": (lambda: ct.Measurements(VIEWS, 3, IMAGES.images), "images is 3, .* an array for each view"),
    "gains": (lambda: ct.Measurements(VIEWS, IMAGES.images, IMAGES.images, 0.02), "calibration_errors is 0.02"),
    "rendered": (lambda: ct.Measurements.rendered(SCENE, None), "operator is of type Scene: .* a RadianceOperator"),
    "dataset": (lambda: ct.measurements_dataset(SCENE), "measurements is of type Scene"),
    "cloud file": (lambda: ct.write_extinction("new.nc", SCENE, CLOUD), "new.nc: grid is of type Scene"),
    "target": (lambda: ct.write_extinction(3, GRID, CLOUD), "writing: path is 3, of type int: .* a str or a Path"),
    "source": (lambda: ct.read_measurements(IMAGES), "reading: path is of type Measurements: .* name of a file"),
    "rays": (lambda: ct.write_rays("new.nc", VIEWS[0]), "write_rays: view is of type OrthographicView: .* a RayView"),
    "phases": (lambda: ct.write_phase_function("new.nc", ct.HenyeyGreenstein(0.5)), "table is of type HenyeyG"),
    "vti": (lambda: ct.write_vti("new.vti", GRID, {"extinction": CLOUD}), "quantities .* pairs: values and their unit"),
    "volume": (lambda: ct.CloudVolume(CLOUD, GRID), "CloudVolume: grid is of type ndarray: it must be a Grid"),
    "voxels": (lambda: ct.Voxels(CLOUD, CLOUD > 0), "Voxels: grid is of type ndarray"),
    "generator": (lambda: ct.cumulus((4, 4, 4)), "cumulus: grid is a tuple of int"),
    "picture": (lambda: ct.plot_volume(Figure(), CLOUD, CLOUD), "plot_volume: grid is of type ndarray"),
    "droplets": (lambda: ct.extinction_at(CLOUD, 10.0, TABLE), "table is of type TabulatedPhaseFunction: .* DropletT"),
    "text": (lambda: ct.epsilon("estimate", CLOUD), "estimate is of type str and holds no numbers"),
}  # fmt: skip


@pytest.mark.parametrize(("call", "said"), WRONG.values(), ids=WRONG)
def test_an_argument_of_another_kind_is_named(tmp_path, monkeypatch, call, said):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ct.InvalidArgumentError) as error:
        call()
    assert re.search(said, str(error.value)), str(error.value)
    assert isinstance(error.value, TypeError) and isinstance(error.value, ct.DataError)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("kind", "good", "bad"),
    [
        (a(ct.Grid), [GRID], [None, ct.Grid, (4, 4, 4)]),
        (a(ct.Grid).or_none(), [GRID, None], [0, ""]),
        (a(ct.Grid, ct.Sun).or_(NUMBER), [GRID, ct.Sun(3.0), 3, np.float32(3)], [True, "3", 3j]),
        (many(ct.Grid), [(), [GRID], (GRID, GRID)], [GRID, "grid", {}, {0: GRID}, [GRID, None], iter([GRID])]),
        (able("a list", "append"), [[]], [list, (), None]),
    ],
)
def test_kinds(kind, good, bad):
    assert all(kind.fits(value) for value in good)
    assert not any(kind.fits(value) for value in bad)


def test_a_long_value_is_cut():
    with pytest.raises(ct.InvalidArgumentError, match=r"^f: x is '1{56}\.\.\., of type str: it must be odd$"):
        require_kinds("f", x=("1" * 1000, Kind("odd", lambda value: False)))


@pytest.mark.parametrize("number", [np.float32(672), np.array(672.0), xr.DataArray(672.0)])
def test_numbers_of_numpy_and_xarray_are_numbers(number):
    ones = [np.ones((4, 4))]
    images = ct.Measurements(VIEWS, ones, ones, wavelength=number, calibration_errors=[number / 1e4])
    assert images.wavelength == 672.0 and images.calibration_errors == (pytest.approx(0.0672),)
    assert type(images.wavelength) is type(images.calibration_errors[0]) is float
