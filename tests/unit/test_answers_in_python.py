"""Settings in Python are answered as those in a file: one of the package's errors, what is wrong, what was meant."""

import pickle

import pytest

import cloudtomo_cl as ct

RING = {"target": (0, 0, 1), "height": 3.0, "radius": 2.0, "field_of_view": 30.0, "pixels": (8, 8)}


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: ct.Sun(zenit=3.0), "Sun: zenith is missing\nSun: zenit is no known key: did you mean zenith?"),
        (lambda: ct.Sun(100.0), "Sun: zenith must be less than 90, is 100.0"),
        (lambda: ct.Sun(zenith="high"), "Sun: zenith must be a number, unable to parse string as a number, is"),
        (lambda: ct.Sun(1.0, 2.0, 3.0, 4.0), "Sun: takes 3 arguments (zenith, azimuth, irradiance), 4 are given"),
        (lambda: ct.Grid((3, 0, 3), (1, 1, 1)), "Grid: shape[1] must be greater than or equal to 1, is 0"),
        (
            lambda: ct.Grid((3, 3, 3), (1, 1, 1), (0, 0, -1)),
            "Grid: origin[2] must be greater than or equal to 0, is -1",
        ),
        (lambda: ct.GaussNewton(samples=3), "GaussNewton: samples is no known key: did you mean image_samples?"),
        (lambda: ct.Stage(grid=(2, 2, 2), sample=8), "Stage: sample is no known key: did you mean samples?"),
        (lambda: ct.Prior(smoothness=-1), "Prior: smoothness must be greater than or equal to 0, is -1"),
        (lambda: ct.RingOfViews(**RING, azimut=3), "RingOfViews: azimut is no known key: did you mean azimuth?"),
        (
            lambda: ct.RingOfViews(**{**RING, "height": 0.5}),
            "RingOfViews: is wrong: height is 0.5 km: it must be above",
        ),
        (lambda: ct.RayView([[0, 0, 1]], [[0, 0, 0]]), "RayView: is wrong: directions: row 0 is zero"),
        (lambda: ct.RayView([[0, 0]], [[0, 0, 1]]), "RayView: origins is wrong: has shape (1, 2)"),
        (lambda: ct.Scene(grid=3, sun=ct.Sun(3.0)), "Scene: grid must be a table"),
    ],
)
def test_a_wrong_argument_is_named(make, message):
    with pytest.raises(ct.CloudtomoError) as error:
        make()
    assert str(error.value).startswith(message), str(error.value)


def test_the_error_is_a_value_error_and_keeps_the_details():
    with pytest.raises(ValueError) as error:
        ct.Sun(zenith=95.0)
    assert isinstance(error.value, ct.InvalidSettingError) and error.value.details[0]["loc"] == ("zenith",)
    assert isinstance(error.value, ct.SettingsError)


def test_settings_are_copied_compared_and_pickled_as_before():
    view = ct.PerspectiveView((0, 0, 3), (0, 0, 0), field_of_view=30, pixels=(4, 4))
    assert pickle.loads(pickle.dumps(view)) == view and view.with_pixels((8, 8)).pixels == (8, 8)


def test_every_error_of_the_package_is_public():
    from cloudtomo_cl import errors

    kinds = [name for name, kind in vars(errors).items() if isinstance(kind, type) and issubclass(kind, Exception)]
    assert set(kinds) <= set(ct.__all__)
