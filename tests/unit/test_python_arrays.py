"""Arrays with missing values, masked or NaN, in Python: refused or counted, never taken for what lies beneath."""

import numpy as np
import pytest

import cloudtomo_cl as ct
from cloudtomo_cl.errors import CloudtomoError, DataError

GRID = ct.Grid((3, 4, 5), (0.1, 0.1, 0.1))
VIEW = ct.OrthographicView(width=0.6, zenith=0.0, pixels=(4, 4))
VOXEL = (1, 2, 3)
MASKED = np.zeros(GRID.shape, bool)
MASKED[VOXEL] = True
CLOUD = np.where(np.arange(60).reshape(GRID.shape) % 4 == 0, 0.0, 5.0)
ANGLE = tuple(np.linspace(0.0, 180.0, 19))
TABLE = ct.TabulatedPhaseFunction(ANGLE, np.full((2, 19), 1 / (4 * np.pi)), (5.0, 15.0))
RADIUS = np.full(GRID.shape, 10.0)


def nan(values):
    return np.where(MASKED, np.nan, values)


def masked(values):
    return np.ma.masked_array(values, MASKED)


MISSING = pytest.mark.parametrize("missing", [nan, masked], ids=["NaN", "masked"])


def scene(phase_function=None):
    cloud = ct.Cloud() if phase_function is None else ct.Cloud(phase_function=phase_function)
    return ct.Scene(GRID, ct.Sun(30.0), cloud)


def measurements(operator):
    return ct.Measurements.rendered(operator, operator.render(CLOUD, 4))


@pytest.fixture(scope="module")
def operator():
    return ct.RadianceOperator(scene(), [VIEW])


@MISSING
def test_extinction_is_refused_by_what_renders(operator, missing):
    fluxes = ct.FluxOperator(scene())
    for render in (
        lambda: operator.render(missing(CLOUD), 4),
        lambda: operator.on_device(missing(CLOUD)),
        lambda: fluxes.compute(missing(CLOUD), 1000),
    ):
        with pytest.raises(DataError, match=r"extinction at voxel \(1, 2, 3\) is nan"):
            render()


@MISSING
def test_extinction_is_refused_by_what_keeps_it(tmp_path, missing):
    volume = lambda: ct.CloudVolume(GRID, missing(CLOUD))  # noqa: E731
    for keep in (
        volume,
        lambda: ct.extinction_dataset(GRID, missing(CLOUD)),
        lambda: ct.write_extinction(tmp_path / "cloud.nc", GRID, missing(CLOUD)),
        lambda: ct.epsilon(missing(CLOUD), CLOUD),
        lambda: ct.delta(CLOUD, missing(CLOUD)),
        lambda: ct.extinction_from_water(missing(CLOUD), 10.0),
    ):
        with pytest.raises(DataError, match="missing|finite"):
            keep()
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("bad", [-1.0, np.inf])
def test_an_extinction_that_cannot_be_is_neither_kept_nor_written(bad):
    values = np.where(MASKED, bad, CLOUD)
    for keep in (ct.CloudVolume, ct.extinction_dataset):
        with pytest.raises(DataError, match="finite"):
            keep(GRID, values)


@MISSING
def test_a_radius_must_be_known_where_there_is_cloud(tmp_path, missing):
    """It was once the table's smallest, and radiances 21 % too large."""
    operator = ct.RadianceOperator(scene(TABLE), [VIEW], effective_radius=missing(RADIUS))
    fluxes = ct.FluxOperator(scene(TABLE), effective_radius=missing(RADIUS))
    for use in (
        lambda extinction: operator.render(extinction, 4),
        lambda extinction: fluxes.compute(extinction, 1000),
        lambda extinction: ct.CloudVolume(GRID, extinction, missing(RADIUS)),
        lambda extinction: ct.extinction_dataset(GRID, extinction, effective_radius=missing(RADIUS)),
        lambda extinction: ct.extinction_from_water(extinction, missing(RADIUS)),
    ):
        use(np.where(MASKED, 0.0, CLOUD))
        with pytest.raises(DataError, match="effective.radius"):
            use(CLOUD)


def test_clear_air_needs_no_radius():
    """Radiances are those of the same cloud with a radius everywhere, to the bit."""
    clear = np.where(CLOUD > 0, RADIUS, np.nan)
    first, second = (
        ct.RadianceOperator(scene(TABLE), [VIEW], effective_radius=radius).render(CLOUD, 4).mean
        for radius in (clear, RADIUS)
    )
    np.testing.assert_array_equal(first, second)


@MISSING
def test_a_pixel_is_counted_as_bad(missing):
    image, hole = np.full((4, 5), 0.1), np.zeros((4, 5), bool)
    hole[1, 2] = True
    image = np.where(hole, np.nan, image) if missing is nan else np.ma.masked_array(image, hole)
    view = ct.OrthographicView(width=0.6, zenith=0.0, pixels=(5, 4))
    read = ct.Measurements((view,), (image,), (np.zeros((4, 5)),))
    assert read.invalid_pixels == 1 and not read.valid[0][1, 2] and "1 bad" in repr(read)
    with pytest.raises(DataError, match="standard_errors of view 0 are not finite at row 1, column 2"):
        ct.Measurements((view,), (np.full((4, 5), 0.1),), (image,))
    with pytest.raises(DataError, match="calibration_errors of view 0 is nan"):
        ct.Measurements((view,), (image,), (np.zeros((4, 5)),), (np.nan,))


@MISSING
def test_what_a_recovery_starts_from_is_refused(operator, missing):
    images = measurements(operator)
    with pytest.raises(DataError, match=r"the mask: cloud is missing in 1 of 60 voxels, first at \(1, 2, 3\)"):
        ct.Problem.of(scene(), images, mask=missing(np.ones(GRID.shape)))
    with pytest.raises(DataError, match="the mask: cloud is missing"):
        ct.reconstruct(scene(), images, mask=missing(np.ones(GRID.shape)))
    with pytest.raises(DataError, match=r"truth at voxel \(1, 2, 3\) is nan"):
        ct.reconstruct(scene(), images, mask=CLOUD > 0, truth=missing(CLOUD))
    problem = ct.Problem.of(scene(), images, mask=np.ones(GRID.shape, bool))
    for use in (problem.linearise, problem.value_and_gradient):
        with pytest.raises(DataError, match="is nan: it must be finite"):
            use(missing(CLOUD).ravel(), samples=4)


def test_numbers_of_a_recovery_are_refused():
    for wrong in (lambda: ct.GaussNewton(start=np.nan), lambda: ct.Prior(smoothness=np.nan), lambda: ct.Sun(np.nan)):
        with pytest.raises((CloudtomoError, ValueError), match="nan|finite|greater|less"):
            wrong()


def test_rays_and_tables_are_refused():
    rays = np.ma.masked_array(np.ones((3, 3)), np.eye(3, dtype=bool))
    values = np.ma.masked_array(np.ones(19), np.arange(19) == 4)
    for wrong in (
        lambda: ct.RayView(rays, np.ones((3, 3))),
        lambda: ct.RayView(np.ones((3, 3)), rays),
        lambda: ct.TabulatedPhaseFunction(ANGLE, values),
        lambda: ct.TabulatedPhaseFunction.normalised(ANGLE, values),
        lambda: ct.TabulatedPhaseFunction.normalised(ANGLE, np.where(values.mask, np.nan, 1.0)),
        lambda: ct.Air(extinction=tuple(np.ma.masked_array([0.1, 0.2], [True, False]))),
        lambda: ct.Air(extinction=(np.nan, 0.2)),
    ):
        with pytest.raises(ValueError, match="finite|number|nan|greater|less"):
            wrong()


def labelled(values, order):
    xarray = pytest.importorskip("xarray")
    return xarray.DataArray(values, dims=("x", "y", "z")).transpose(*order)


@pytest.mark.parametrize("order", [("x", "y", "z"), ("z", "y", "x"), ("y", "z", "x")])
def test_named_dimensions_come_in_their_order(operator, tmp_path, order):
    """As of a dataset that was read from our own files, whose dimensions are (z, y, x)."""
    given = labelled(CLOUD, order)
    np.testing.assert_array_equal(operator.render(given, 4).mean, operator.render(CLOUD, 4).mean)
    np.testing.assert_array_equal(ct.CloudVolume(GRID, given).extinction, ct.CloudVolume(GRID, CLOUD).extinction)
    ct.write_extinction(tmp_path / "cloud.nc", GRID, given)
    np.testing.assert_array_equal(ct.read_extinction(tmp_path / "cloud.nc")[1], CLOUD.astype(np.float32))
    assert ct.epsilon(given, CLOUD) == 0


def test_images_of_named_dimensions_have_rows_first():
    xarray = pytest.importorskip("xarray")
    image = xarray.DataArray(np.arange(16.0).reshape(4, 4), dims=("row", "column"))
    read = ct.Measurements((VIEW,), (image.T,), (np.ones((4, 4)),))
    np.testing.assert_array_equal(read.images[0], image.values)
