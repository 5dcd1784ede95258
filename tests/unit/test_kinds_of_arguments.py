"""What is no images, no scene, no device ... is answered with its name and what is wanted."""

import re

import numpy as np
import pytest
import xarray as xr
from matplotlib.figure import Figure

import cloudtomo_cl as ct
from cloudtomo_cl.arguments import NUMBER, NUMBERS, TRUTH, WHOLE, Kind, a, able, many, place, require_kinds, several

GRID = ct.Grid((4, 4, 4), (0.1, 0.1, 0.1))
SCENE = ct.Scene(GRID, ct.Sun(30.0))
CLOUD = np.zeros(GRID.shape, np.float32)
CLOUD[1:3, 1:3, 1:3] = 5.0
VIEWS = (ct.OrthographicView(zenith=0.0, width=0.6, pixels=(4, 4)),)
IMAGES = ct.Measurements(VIEWS, (np.ones((4, 4)),), (np.full((4, 4), 0.1),))
ANGLES = (0.0, 90.0, 180.0)
TABLE = ct.TabulatedPhaseFunction(ANGLES, (((1 / (4 * np.pi),) * 3),), (10.0,), (1.0,))


POSE = (np.diag([1.0, -1.0, -1.0]), (0.0, 0.0, 5.0), ((100.0, 0.0, 1.5), (0.0, 100.0, 1.5), (0.0, 0.0, 1.0)), (4, 4))
VOLUME = ct.CloudVolume(GRID, CLOUD)
RAYS = ct.RayView(np.ones((2, 3)), np.ones((2, 3)))


def operator():
    return ct.RadianceOperator(SCENE, VIEWS)


def problem(**others):
    return ct.Problem.of(SCENE, IMAGES, **{"mask": CLOUD > 0, **others})


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
    "text in an array": (lambda: ct.epsilon(CLOUD, np.full(GRID.shape, "1")), "truth is .* holds no numbers"),
    "complex": (lambda: ct.delta(CLOUD + 1j, CLOUD), "estimate is complex: it must be real"),
    "ragged": (lambda: ct.delta([[1, 2], [3]], CLOUD), "estimate makes no array .* give all rows as many"),
    "too large": (lambda: ct.extinction_from_water([10**400], 10.0), "content .* beyond 1e308"),
    "ragged mask": (lambda: ct.Voxels(GRID, [[1, 0], [1]]), "mask makes no array"),
    "ragged images": (lambda: ct.Measurements(VIEWS, ([[1, 2], [3]],), IMAGES.images), "images makes no array"),
    "complex cloud": (lambda: ct.CloudVolume(GRID, CLOUD + 1j), "extinction is complex"),
    "text cloud": (lambda: operator().render(np.full(GRID.shape, "a"), 4), "extinction is .* holds no numbers"),
    "text file": (lambda: ct.extinction_dataset(GRID, np.full(GRID.shape, "a")), "the dataset: extinction is .* no n"),
    "values": (lambda: ct.Voxels(GRID, CLOUD > 0).on_grid("a"), "values is .* holds no numbers"),
    "rows": (lambda: operator().of_pixels([[0, 1], [0]]), "pixels makes no array"),
    "huge number": (lambda: ct.Measurements(VIEWS, *2 * (IMAGES.images,), wavelength=10**400), "beyond 1e308"),
    "rotation": (lambda: ct.camera_from_pose("a", *POSE[1:]), "rotation is .* holds no numbers"),
    "pixels": (lambda: ct.camera_from_pose(*POSE[:3], 8), "pixels is 8, .* a tuple or list of 2, each a whole number"),
    "distortion": (lambda: ct.camera_from_pose(*POSE, 1j), "distortion is complex"),
    "all-sky": (lambda: ct.fisheye_rays((0, 0, 0), "8"), "fisheye_rays: pixels is '8', .* a number"),
    "place": (lambda: ct.fisheye_rays(0, 8), "position is 0, .* a tuple or list of 3, each a number"),
    "factors": (lambda: VOLUME.coarsened(2), "coarsened: factors is 2, .* of 3, each a whole number"),
    "crop": (lambda: VOLUME.cropped([(0, 1), (0, 1), (0, "a")]), "cropped: ranges is a list of tuple"),
    "pad": (lambda: VOLUME.padded([(0, 1), (0, 1), (0, 0.5)]), "padded: voxels is a list of tuple"),
    "turn": (lambda: VOLUME.rotated("90"), "rotated: degrees is '90', .* a number"),
    "tiles": (lambda: VOLUME.tiled(1, 2.5), "tiled: along_y is 2.5, .* a whole number"),
    "nm": (lambda: ct.CloudVolume(GRID, CLOUD, wavelength="672"), "wavelength is '672', .* a number, or None"),
    "readings": (lambda: ct.CloudVolume(GRID, CLOUD, readings=3), "readings is 3, .* a tuple of pairs of texts"),
    "clouds": (lambda: ct.cumulus(GRID, clouds=1.5), "cumulus: clouds is 1.5, .* a whole number"),
    "peak": (lambda: ct.cumulus(GRID, peak="100"), "cumulus: peak is '100', .* a number"),
    "axis": (lambda: GRID.centres(3), "centres: axis is 3, of type int: it must be 0 to 2"),
    "shape": (lambda: GRID.with_shape((4, 4)), "with_shape: shape is a tuple of int: .* of 3, each a whole number"),
    "cosine": (lambda: ct.HenyeyGreenstein(0.5).density("a"), "cosine is .* holds no numbers"),
    "row": (lambda: TABLE.density(0.5, row=1), "density: row is 1, .* 0 to 0, or None"),
    "table": (lambda: ct.TabulatedPhaseFunction.normalised("a", 1.0), "angle is .* holds no numbers"),
    "no optics": (lambda: ct.DropletTable(None, (2.0,), 672.0, 0.1, 1.33, 0.0), "phase_function is None: .* a Tabul"),
    "layers": (lambda: ct.Air(0.1).layers(None), "Air: grid is None"),
    "rays of": (lambda: VIEWS[0].rays((4, 4, 4)), "rays: grid is a tuple of int"),
    "top": (lambda: VIEWS[0].rays(GRID, "1"), "rays: top is '1', .* a number, or None"),
    "points": (lambda: VIEWS[0].project(GRID, "a"), "points is .* holds no numbers"),
    "columns": (lambda: ct.RadiometerView.of_columns(CLOUD, 0.0), "of_columns: grid is of type ndarray"),
    "starts": (lambda: RAYS.starts(GRID), "starts: scene is of type Grid"),
    "attributes": (lambda: ct.extinction_dataset(GRID, CLOUD, "note"), "attributes is 'note', .* a dict, or another"),
    "attribute": (lambda: ct.write_extinction("new.nc", GRID, CLOUD, {"a": None}), "'a' is None: .* text, a number"),
    "its name": (lambda: ct.extinction_dataset(GRID, CLOUD, {1: "a"}), "attributes: name is 1"),
    "no JSON": (lambda: ct.extinction_dataset(GRID, CLOUD, {"a": {"b": GRID}}), "'a' cannot be JSON"),
    "settings": (lambda: ct.write_measurements("new.nc", IMAGES, settings=3), "new.nc: settings is 3"),
    "beside": (lambda: ct.measurements_dataset(IMAGES, cloud=GRID), "cloud is of type Grid: .* a tuple of grid"),
    "at": (lambda: ct.extinction_dataset(GRID, CLOUD, wavelength="672"), "wavelength is '672', .* a number, or None"),
    "which": (lambda: ct.read_extinction(ct.extinction_dataset(GRID, CLOUD), "672"), "wavelength is '672'"),
    "of a table": (lambda: ct.read_phase_function("no.nc", "672"), "no.nc: wavelength is '672'"),
    "unit": (lambda: ct.write_vti("new.vti", GRID, {"a": (CLOUD, 1)}), "quantities .* pairs: values and their unit"),
    "ranks": (lambda: ct.choose_device(communicator=2), "choose_device: communicator is 2, .* mpi4py"),
    "devices": (lambda: ct.on_devices(0, print), "on_devices: names is 0, .* a tuple or list of names"),
    "work": (lambda: ct.on_devices([0], None), "on_devices: work is None: it must be a function"),
    "droplet sizes": (lambda: ct.droplet_table(672.0, "10"), "effective_radius is .* holds no numbers"),
    "in air": (lambda: ct.droplet_table("672", 10.0), "droplet_table: wavelength_nm is '672'"),
    "several": (lambda: ct.droplet_tables(672.0, 10.0), "wavelengths_nm is 672.0, .* a tuple or list of numbers"),
    "index": (lambda: ct.droplet_table(672.0, 10.0, 0.1, "1.3"), "refractive_indices is a list of str"),
    "motions": (lambda: IMAGES.moved("a", GRID), "motions is .* holds no numbers"),
    "sizes": (lambda: IMAGES.resampled((2, 2)), "resampled: pixels is a tuple of int: .* a tuple or list of 1"),
    "share": (lambda: IMAGES.at_share("a"), "at_share: share is 'a', .* a number"),
    "noise": (lambda: ct.Noise(full_well=1e4).added_to(CLOUD), "added_to: measurements is of type ndarray"),
    "other views": (lambda: operator().of_views("a"), "of_views: views is 'a'"),
    "pixel values": (lambda: operator().images("a"), "values is .* holds no numbers"),
    "keep": (lambda: operator().render(CLOUD, 4, store_paths="no"), "store_paths is 'no', .* True or False"),
    "launches": (lambda: list(operator().stored_launches(None)), "stored_launches: rendering is None"),
    "paths": (lambda: ct.render_to_error(operator(), CLOUD, 0.5, most_paths="a"), "most_paths is 'a', .* a number"),
    "told": (lambda: ct.FluxOperator(SCENE).compute(CLOUD, progress=3), "progress is 3, .* a function, or None"),
    "truth": (lambda: recover(SCENE, IMAGES, truth=[[1, 2], [3]]), "truth makes no array"),
    "problem's grid": (lambda: problem(grid=()), "Problem.of: grid is an empty tuple: .* of 3, each a whole number"),
    "weight": (lambda: problem(prior_weight="a"), "prior_weight is 'a', .* a number"),
    "moving": (lambda: problem().with_motions("a"), "motions is .* holds no numbers"),
    "start": (lambda: ct.GaussNewton().init(problem(), "a"), "extinction is .* holds no numbers"),
    "no problem": (lambda: ct.Adam().init(SCENE, CLOUD), "Adam.init: problem is of type Scene"),
    "state": (lambda: ct.Adam().step(problem(), None, seed=0, stream=0), "step: state is None"),
    "record": (lambda: ct.ProgressDisplay()(3), "ProgressDisplay: record is 3, .* an IterationRecord"),
    "drawn": (lambda: ct.plot_volume(Figure(), GRID, "a"), "recovered is .* holds no numbers"),
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
        (NUMBER, [2**70, np.nan], [10**400]),
        (NUMBERS, [(), [1, 2.5], np.ones(2)], [np.array(1.0), "1", [None]]),
        (WHOLE, [0, -3, 2**70, np.int64(3), np.array(3)], [1.0, True, np.True_, "1", np.ones(1, int)]),
        (several(2, WHOLE), [(1, 2), np.array([1, 2])], [(1,), (1, 2, 3), (1, 2.0)]),
        (place(2), [0, 1, -2, np.int8(1)], [2, -3, 0.0, "0"]),
        (TRUTH, [True, False, np.True_, 0, 1], ["no", None, 2, np.ones(2, bool)]),
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


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda: recover(SCENE, IMAGES, ()), "stages is empty: give at least one Stage, or None for automatic ones"),
        (lambda: recover(SCENE, IMAGES, []), "stages is empty"),
        (lambda: recover(SCENE, IMAGES, uncertainty=10**400), "uncertainty is 1.* at most 10000"),
        (lambda: recover(SCENE, IMAGES, time_limit=10**400), "time_limit is 1.* a number of seconds"),
        (lambda: IMAGES.at_share(-1), "share is -1: it must be above 0"),
        (lambda: IMAGES.moved(np.ones((2, 3)), GRID), r"motions have shape \(2, 3\)"),
        (lambda: GRID.with_shape((4, 4, 0)), "at least 1 voxel along each axis"),
        (lambda: ct.fisheye_rays((0, 0, 0), 2**70), "all-sky camera .* of memory"),
        (lambda: ct.fisheye_rays((0, 0, 0), 8.5), "pixels is 8.5: it must be a whole number"),
        (lambda: ct.camera_from_pose(*POSE[:3], (10**400, 4)), "a camera of .* of memory"),
        (lambda: VOLUME.tiled(10**400, 1), "tile: a cloud of .* of memory"),
        (lambda: VOLUME.padded([(0, 2**70), (0, 0), (0, 0)]), "pad: a cloud of .* of memory"),
        (lambda: ct.cumulus(GRID, clouds=2**70), "clouds is .* at most 10000"),
        (lambda: ct.carve(GRID, IMAGES, IMAGES, significance=np.inf), "both must be finite"),
        (lambda: ct.FluxOperator(SCENE).compute(CLOUD, 10**400), "photons is 1e.300: this scene has at most"),
        (lambda: VIEWS[0].project(GRID, np.ones(2)), r"points have shape \(2,\): it must be \(..., 3\)"),
        (lambda: ct.Voxels(GRID, CLOUD > 0).on_grid(np.ones(3)), r"values have shape \(3,\): it must be \(8,\)"),
        (lambda: ct.RadianceOperator(SCENE, VIEWS, estimator=np.array(["a", "b"])), "estimator is array"),
        (lambda: ct.RadianceOperator(SCENE, np.zeros(0)), "no view"),
        (lambda: ct.measurements_dataset(np.zeros(0)), "there are no images"),
        (lambda: ct.write_phase_function("new.nc", np.zeros(0)), "there is no table to write"),
        (lambda: ct.Air(np.zeros(0)), "extinction"),
        (lambda: problem().linearise(np.ones(8)).jacobian.curvature(np.ones(3)), r"weights have shape \(3,\)"),
        (lambda: operator().gradient(operator().render(CLOUD, 4, store_paths=True), np.ones((16, 2)), 2**70), "limit"),
        (lambda: ct.plot_volume(Figure(), GRID, np.ones(3)), "recovered extinction has shape"),
    ],
)  # fmt: skip
def test_what_no_function_can_work_with_is_refused_in_words(call, said):
    with pytest.raises((ct.DataError, ct.SettingsError), match=said):
        call()
