"""Clouds and images go into xarray and come back as they were."""

import numpy as np
import pytest
import xarray as xr

import cloudtomo_cl as ct

GRID = ct.Grid(shape=(3, 4, 5), spacing=(0.1, 0.2, 0.05), origin=(1.0, 2.0, 0.5))


def cloud(random):
    return random.uniform(0.1, 50, GRID.shape).astype(np.float32)


def test_extinction_comes_back(random):
    extinction = cloud(random)
    grid, back = ct.read_extinction(ct.extinction_dataset(GRID, extinction))
    assert grid == GRID and np.array_equal(back, extinction)


def test_an_array_in_other_units_and_order_is_extinction(random):
    extinction = cloud(random)
    array = ct.extinction_dataset(GRID, extinction).extinction.transpose("z", "y", "x") / 1000
    grid, back = ct.read_extinction(array.assign_attrs(units="m-1"))
    assert grid == GRID and np.allclose(back, extinction)


def test_water_in_a_dataset_becomes_extinction():
    dataset = xr.Dataset(
        {
            "lwc": (("x", "y", "z"), np.full((2, 2, 2), 0.5), {"units": "g m-3"}),
            "reff": (("x", "y", "z"), np.full((2, 2, 2), 10.0), {"units": "um"}),
        },
        {name: (name, [50.0, 150.0], {"units": "m"}) for name in "xyz"},
    )
    volume = ct.read_cloud(dataset)
    # 3 LWC / (2 rho r_e) = 3 x 0.5 g m^-3 / (2 x 1e6 g m^-3 x 1e-5 m) = 0.075 m^-1
    assert np.allclose(volume.extinction, 75.0) and volume.grid.spacing == (0.1, 0.1, 0.1)


def test_measurements_come_back(random):
    views = tuple(ct.OrthographicView(zenith=20.0, width=1.0, pixels=pixels) for pixels in ((3, 2), (4, 4)))
    images, errors = (tuple(random.uniform(0, 1, view.pixels[::-1]) for view in views) for _ in range(2))
    back = ct.read_measurements(ct.measurements_dataset(ct.Measurements(views, images, errors)))
    assert back.views == views
    assert all(map(np.array_equal, back.images, images)) and all(map(np.array_equal, back.standard_errors, errors))


def test_an_error_says_what_is_wrong_with_a_dataset():
    with pytest.raises(ct.CloudtomoError, match="the Dataset: no variable extinction"):
        ct.read_extinction(xr.Dataset())


def test_objects_are_told_by_their_sizes_and_units(random):
    view = ct.OrthographicView(zenith=20.0, width=1.0, pixels=(3, 2))
    image = np.array([[0.1, 0.2, 0.3], [0.4, 0.5, 0.25]])
    measurements = ct.Measurements((view,), (image,), (image,))
    assert repr(measurements) == "Measurements(1 views of 3 x 2 pixels, radiance 0.1 to 0.5 W m^-2 sr^-1)"
    volume = ct.CloudVolume(GRID, np.full(GRID.shape, 4.0))
    assert repr(volume) == (
        "CloudVolume(3 x 4 x 5 voxels of 0.1 x 0.2 x 0.05 km, extinction up to 4 km^-1, vertical optical depth up to 1)"
    )
