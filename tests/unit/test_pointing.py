"""Views that are turned and shifted, and what that does to images: against images of a known brightness."""

import numpy as np
import pytest

from cloudtomo_cl.errors import DataError
from cloudtomo_cl.scene.grid import Grid
from cloudtomo_cl.scene.pointing import error_in_pixels, image_motions, motion_errors, moved, pixel_motions
from cloudtomo_cl.scene.poses import camera_from_pose
from cloudtomo_cl.scene.sensors import OrthographicView, PerspectiveView, PushBroomView, RayView, image_axes

GRID = Grid((4, 4, 4), (0.25, 0.25, 0.25))
CAMERA = PerspectiveView(position=(2.0, 0.3, 1.5), target=(0.5, 0.5, 0.4), field_of_view=50.0, pixels=(40, 30))
FROM_AFAR = OrthographicView(width=1.6, pixels=(40, 30), zenith=30.0, azimuth=70.0)
PLACED = OrthographicView(width=1.6, pixels=(40, 30), position=(0.5, 0.5, 3.0), target=(0.5, 0.5, 0.4))
LENS = camera_from_pose(
    np.diag([1.0, -1.0, -1.0]), np.array([-0.5, 0.5, 2.0]), np.array([[40.0, 0, 21], [0, 40, 14], [0, 0, 1]]), (40, 30),
    [0.1],
)  # fmt: skip
VIEWS = [CAMERA, FROM_AFAR, PLACED, LENS]
NAMES = ["camera", "orthographic", "orthographic at a place", "lens"]


def seen(view):
    """A smooth brightness of the plane z = 0.4, as the view sees it: at the centres of its pixels."""
    width, height = view.pixels
    if isinstance(view, RayView):
        start, along = view.origins.reshape(height, width, 3), view.directions.reshape(height, width, 3)
    else:
        u, v = np.meshgrid((np.arange(width) + 0.5) / width, (np.arange(height) + 0.5) / height)
        image = np.stack([np.ones_like(u), u, v], axis=-1)
        start, along = (image @ part for part in view.rays(GRID))
    x, y, _ = np.moveaxis(start + ((0.4 - start[..., 2]) / along[..., 2])[..., None] * along, -1, 0)
    return 2 + np.sin(1.2 * x) * np.cos(y)


@pytest.mark.parametrize("view", VIEWS, ids=NAMES)
@pytest.mark.parametrize("motion", range(3), ids=["right", "up", "roll"])
def test_images_change_by_their_slopes(view, motion):
    """Away from the frame, against the image of the moved view; blurred slopes cost some per cent."""
    step = np.zeros(3)
    step[motion] = 1e-3
    change = (seen(moved(view, step, GRID)) - seen(view))[6:-6, 6:-6]
    predicted = image_motions(view, seen(view), GRID)[6:-6, 6:-6, motion] * 1e-3
    assert np.abs(change).max() > 1e-4
    assert np.abs(predicted - change).max() < 0.05 * np.abs(change).max()


@pytest.mark.parametrize("view", VIEWS, ids=NAMES)
def test_the_centre_comes_to_look_to_the_right_and_up(view):
    """To the right and, since rows run down, up: by less of a row."""
    right, up = pixel_motions(view, GRID)[15, 20, :, 0], pixel_motions(view, GRID)[15, 20, :, 1]
    assert right[0] > 0 and abs(right[1]) < 0.1 * right[0]
    assert up[1] < 0 and abs(up[0]) < 0.1 * -up[1]


def test_a_camera_rolls_clockwise():
    """Its right edge then looks farther down."""
    assert pixel_motions(CAMERA, GRID)[15, 39, 1, 2] > 0


def test_a_view_that_does_not_move_is_the_same():
    assert moved(CAMERA, np.zeros(3), GRID) is CAMERA


def test_a_camera_turns_by_the_angle_it_is_told_to():
    before = np.subtract(CAMERA.target, CAMERA.position)
    after = np.subtract(moved(CAMERA, np.array([0.0, 0.02, 0.0]), GRID).target, CAMERA.position)
    angle = np.arccos(before @ after / (before @ before))
    assert angle == pytest.approx(0.02, rel=1e-6)
    right, up = image_axes(before / np.linalg.norm(before), None)
    assert after @ up > 0 and abs(after @ right) < 1e-9


def test_a_camera_elsewhere_counts_as_turned():
    """By the angle under which the error of its place is seen from the domain's centre."""
    away = np.linalg.norm(np.subtract(CAMERA.position, GRID.centre))
    errors = motion_errors(CAMERA, GRID, 0.5, 0.02)
    np.testing.assert_allclose(errors[:2], np.hypot(np.radians(0.5), 0.02 / away))
    assert errors[2] == pytest.approx(np.radians(0.5))


def test_the_error_in_pixels_of_an_orthographic_view_is_its_shift():
    """0.04 km across and up, where a pixel is 0.04 km wide."""
    assert error_in_pixels(FROM_AFAR, GRID, 0.0, 0.04) == pytest.approx(np.sqrt(2), rel=1e-6)


def test_invalid_pixels_do_not_spoil_the_slopes_of_others():
    image = seen(CAMERA)
    image[3, 4] = np.nan
    assert np.isfinite(image_motions(CAMERA, image, GRID)).all()


LINES = [
    PushBroomView(start=(0.0, 0.5, 2.0), end=(1.0, 0.5, 2.0), field_of_view=40.0, pixels=(8, 8)),
    RayView(np.array([[0.5, 0.5, 2.0], [0.6, 0.5, 2.0]]), np.array([[0.0, 0.0, -1.0]] * 2)),
]


@pytest.mark.parametrize("view", LINES, ids=["push-broom", "rays"])
def test_views_that_are_no_cameras_are_refused(view):
    with pytest.raises(DataError, match="set them to 0"):
        motion_errors(view, GRID, 0.5, 0.0)
    assert not motion_errors(view, GRID, 0.0, 0.0).any()
