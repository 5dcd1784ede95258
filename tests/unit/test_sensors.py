"""Views that cannot be: each is refused when it is made."""

import numpy as np
import pytest

from cloudtomo_cl.errors import SettingsError
from cloudtomo_cl.scene.grid import Grid
from cloudtomo_cl.scene.scene import Air, Boundary, Scene, Sun
from cloudtomo_cl.scene.sensors import OrthographicView, PerspectiveView, PushBroomView, RadiometerView, RayView

PERSPECTIVE = {"position": (0.0, 0.0, 2.0), "target": (0.5, 0.5, 0.0), "field_of_view": 30.0, "pixels": (4, 4)}


@pytest.mark.parametrize("number", [np.nan, np.inf])
@pytest.mark.parametrize("name", ["position", "target", "up"])
def test_coordinates_are_finite(name, number):
    with pytest.raises(SettingsError, match="finite"):
        PerspectiveView(**{**PERSPECTIVE, name: (0.0, number, 1.0)})


def test_an_azimuth_is_finite():
    with pytest.raises(SettingsError, match="finite"):
        OrthographicView(zenith=10.0, azimuth=np.nan, width=1.0, pixels=(4, 4))


@pytest.mark.parametrize("up", [(0.0, 0.0, 1.0), (0.0, 0.0, 0.0)])
def test_up_is_not_along_the_line_of_sight(up):
    with pytest.raises(SettingsError, match="up is parallel"):
        OrthographicView(zenith=0.0, width=1.0, pixels=(4, 4), up=up)


def test_a_line_of_sight_close_to_vertical_has_north_up():
    view = OrthographicView(zenith=1e-9, width=1.0, pixels=(4, 4))
    origin, _ = view.rays(Grid(shape=(1, 1, 1), spacing=(1, 1, 1)))
    np.testing.assert_allclose(origin[2], (0, -1, 0), atol=1e-6)


def test_no_ray_starts_below_the_ground():
    with pytest.raises(SettingsError, match="below the ground"):
        OrthographicView(position=(-1, 0.4, 0.1), target=(0.4, 0.4, 0.6), width=1.2, pixels=(4, 4))


def test_an_aspect_of_ones_own_stretches_the_pixels():
    grid = Grid(shape=(1, 1, 1), spacing=(1, 1, 1))
    square, stretched = (PerspectiveView(**PERSPECTIVE, aspect=aspect).rays(grid)[1] for aspect in (None, 2.0))
    np.testing.assert_allclose(stretched[1:], square[1:] * [[1], [2]])


def test_a_vertical_line_of_sight_needs_no_up():
    down, up = (PerspectiveView((1, 1, 1), (1, 1, z), 30.0, (4, 4)) for z in (0.0, 2.0))
    for view in (down, up):
        assert view.rays(Grid(shape=(1, 1, 1), spacing=(1, 1, 1)))[1][2][1] < 0  # v runs to the south


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"end": (0.0, 1.0, 2.1)}, "must be level"),
        ({"end": (0.0, 0.0, 2.0)}, "same point"),
        ({"start": (0.0, 0.0, -1.0), "end": (0.0, 1.0, -1.0)}, "below the ground"),
        ({"along_track_angle": 90.0}, "less than 90"),
        ({"field_of_view": 180.0}, "less than 180"),
        ({"pixels": (0, 4)}, "greater than or equal to 1"),
    ],
)
def test_an_impossible_push_broom_view_is_refused(change, message):
    fields = {"start": (0.0, 0.0, 2.0), "end": (0.0, 1.0, 2.0), "field_of_view": 30.0, "pixels": (4, 4)}
    with pytest.raises(SettingsError, match=message):
        PushBroomView(**{**fields, **change})


@pytest.mark.parametrize(("zenith", "message"), [(90.0, "horizontal ray"), (180.5, "less than or equal to 180")])
def test_an_impossible_radiometer_is_refused(zenith, message):
    with pytest.raises(SettingsError, match=message):
        RadiometerView(zenith=zenith, pixels=(4, 4))


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"origins": [(0, 0, 1)]}, "1 origins and 2 directions"),
        ({"origins": [(0, 0, 1), (0, 0, np.nan)]}, "row 1 is not finite"),
        ({"origins": [(0, 0, 1), (0, 0, -1)]}, "row 1 lies below the ground"),
        ({"directions": [(0, 0, 1), (0, 0, 0)]}, "row 1 is zero"),
        ({"directions": [(0, 0), (0, 0)]}, r"shape \(2, 2\)"),
        ({"directions": "up"}, "array of numbers"),
        ({"origins": np.zeros((0, 3))}, "at least one ray"),
        ({"pixels": (3, 1)}, "3 x 1 for 2 rays"),
    ],
)
def test_impossible_rays_are_refused(fields, message):
    with pytest.raises(SettingsError, match=message):
        RayView(**{"origins": [(0, 0, 1), (1, 1, 1)], "directions": [(0, 0, 1), (0, 1, 0)], **fields})


def test_directions_of_rays_become_unit_vectors():
    np.testing.assert_array_equal(RayView([(0, 0, 1)], [(0, 3, -4)]).directions, [[0, 0.6, -0.8]])


def test_rays_cannot_be_changed_afterwards():
    origins = np.ones((2, 3))
    view = RayView(origins, np.ones((2, 3)))
    origins[:] = 7
    assert np.all(view.origins == 1)
    for array in (view.origins, view.directions):
        with pytest.raises(ValueError, match="read-only"):
            array[0, 0] = 3


def test_rays_are_compared_by_value():
    first, same = (RayView(np.ones((2, 3)), np.ones((2, 3))) for _ in range(2))
    assert first == same and hash(first) == hash(same)
    assert first != RayView(np.ones((2, 3)), np.ones((2, 3)), (1, 2))
    assert first != RayView(np.ones((2, 3)), [(1, 1, 1), (1, 1, 2)])


# Of rays that start beside, above, far above, within and below a domain on stilts.
STILTS = Grid(shape=(2, 2, 2), spacing=(0.5, 0.5, 0.5), origin=(0.0, 0.0, 1.0))
STARTS = {
    "from above, at the top": ((0.5, 0.5, 9), (0, 0, -1), False, (0.5, 0.5, 2)),
    "from beside, at the side": ((-700, 0.5, 1.5), (1, 0, 0), False, (0, 0.5, 1.5)),
    "from within, where it is": ((0.1, 0.2, 1.3), (0, 0, -1), False, (0.1, 0.2, 1.3)),
    "from the ground, at the bottom": ((0.5, 0.5, 0), (0, 0, 1), False, (0.5, 0.5, 1)),
    "past the domain, at the ground": ((4, 3, 700), (0, 0, -1), False, (4, 3, 0)),
    "past the domain to the sky, where it is": ((4, 3, 7), (0, 0, 1), False, (4, 3, 7)),
    "periodic, from above": ((4.25, -3.25, 7), (0, 0, -1), True, (0.25, 0.75, 2)),
    "periodic, from beside": ((-8.75, 0.5, 1.5), (1, 0, 0), True, (0.25, 0.5, 1.5)),
    "periodic, below the domain": ((3.5, 0.5, 0.5), (0, 0, -1), True, (0.5, 0.5, 0)),
}


@pytest.mark.parametrize(("origin", "direction", "periodic", "start"), STARTS.values(), ids=STARTS)
def test_rays_start_close_to_the_domain(origin, direction, periodic, start):
    scene = Scene(STILTS, Sun(0.0), boundary=Boundary("periodic" if periodic else "open"))
    np.testing.assert_allclose(RayView([origin], [direction]).starts(scene), [start], atol=1e-12)


@pytest.mark.parametrize("boundary", ["open", "periodic"])
@pytest.mark.parametrize(
    ("origin", "direction", "start"),
    [
        ((0.5, 0.5, 700), (0, 0, -1), (0.5, 0.5, 40)),
        ((0.5, 0.5, 9), (0, 0, -1), (0.5, 0.5, 9)),
        ((0.5, 0.5, 0), (0, 0, 1), (0.5, 0.5, 0)),
    ],
    ids=["from space, at the atmosphere's top", "from within the air, where it is", "from the ground, where it is"],
)
def test_rays_skip_no_air(origin, direction, start, boundary):
    scene = Scene(STILTS, Sun(0.0), air=Air(extinction=0.1, levels=(0, 40)), boundary=Boundary(boundary))
    np.testing.assert_allclose(RayView([origin], [direction]).starts(scene), [start], atol=1e-12)


@pytest.mark.parametrize(
    "direction", [{"zenith": 50.0, "azimuth": 20.0}, {"position": (900.0, 0.4, 800.0), "target": (0.5, 0.5, 1.0)}]
)
def test_an_orthographic_view_from_afar_starts_above_the_atmosphere(direction):
    origin, _ = OrthographicView(0.7, (4, 4), **direction).rays(STILTS, top=40.0)
    corners = [origin[0] + u * origin[1] + v * origin[2] for u in (0, 1) for v in (0, 1)]
    assert np.min(corners, axis=0)[2] >= 40 - 1e-9
    assert np.max(np.abs(corners)) < 120
