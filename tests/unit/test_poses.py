"""Cameras by pose: points of the scene appear where the textbook's projection has them."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import cloudtomo_cl as ct

PIXELS = (40, 30)
CENTRED = np.array([[80.0, 0, 19.5], [0, 70.0, 14.5], [0, 0, 1]])
OFF = np.array([[80.0, 0.3, 22.0], [0, 70.0, 11.0], [0, 0, 1]])
LENS = (-0.25, 0.08, 0.002, -0.001, -0.01)
GRID = ct.Grid((4, 4, 4), (0.1, 0.1, 0.1))


@pytest.fixture
def pose(random):
    """A camera south-west of the domain and above it, a little rolled."""
    position = np.array([-1.0, -1.5, 2.0])
    sight = np.array([0.2, 0.2, 0.2]) - position
    sight /= np.linalg.norm(sight)
    right = np.cross(sight, [0, 0, 1])
    right /= np.linalg.norm(right)
    level = np.array([right, np.cross(sight, right), sight])  # y is down
    rotation = Rotation.from_euler("z", 12, degrees=True).as_matrix() @ level
    return rotation, -rotation @ position


def appearing(points, rotation, translation, matrix, lens=()):
    """Columns and rows, by OpenCV's page on calibration."""
    k1, k2, p1, p2, k3 = (*lens, *(0.0,) * (5 - len(lens)))
    x, y, z = (points @ rotation.T + translation).T
    x, y = x / z, y / z
    r2 = x * x + y * y
    radial = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
    x, y = (
        x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x),
        y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y,
    )
    return (np.column_stack([x, y, np.ones_like(x)]) @ matrix.T)[:, :2]


def test_a_centred_camera_is_a_perspective_view(pose, random):
    view = ct.camera_from_pose(*pose, CENTRED, PIXELS)
    assert isinstance(view, ct.PerspectiveView) and view.pixels == PIXELS
    points = random.uniform(0, 0.4, (20, 3))
    u, v, depth = view.project(GRID, points)
    found = np.column_stack([u * PIXELS[0], v * PIXELS[1]]) - 0.5  # centres of pixels are whole numbers
    np.testing.assert_allclose(found, appearing(points, *pose, CENTRED), atol=1e-6)
    assert (depth > 0).all()


@pytest.mark.parametrize("lens", [(), LENS, (-0.1,)])
def test_every_ray_of_another_camera_goes_through_its_pixel(pose, lens, random):
    view = ct.camera_from_pose(*pose, OFF, PIXELS, lens)
    assert isinstance(view, ct.RayView) and view.pixels == PIXELS
    points = view.origins + random.uniform(0.5, 4.0, (len(view.origins), 1)) * view.directions
    rows, columns = np.divmod(np.arange(len(points)), PIXELS[0])
    np.testing.assert_allclose(appearing(points, *pose, OFF, lens), np.column_stack([columns, rows]), atol=1e-6)


def test_both_kinds_see_the_same(pose):
    """Rays of a camera with a lens that does almost nothing are those of the pinhole."""
    rays = ct.camera_from_pose(*pose, CENTRED, PIXELS, (1e-12,))
    origin, direction = ct.camera_from_pose(*pose, CENTRED, PIXELS).rays(GRID)
    u, v = (7 + 0.5) / PIXELS[0], (21 + 0.5) / PIXELS[1]
    sight = direction[0] + u * direction[1] + v * direction[2]
    np.testing.assert_allclose(rays.directions[21 * PIXELS[0] + 7], sight / np.linalg.norm(sight), atol=1e-9)
    np.testing.assert_allclose(rays.origins[0], origin[0], atol=1e-12)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"rotation": np.diag([1.0, 1.0, -1.0])}, "rotation is none .* determinant -1"),
        ({"rotation": 2 * np.eye(3)}, "rotation is none"),
        ({"rotation": np.eye(4)}, r"rotation has shape \(4, 4\)"),
        ({"matrix": np.eye(3)[::-1]}, r"matrix is .*: it must be \[\[fx"),
        ({"distortion": (1, 2, 3, 4, 5, 6)}, "at most 5 numbers"),
        ({"distortion": (-9.0,)}, "cannot be undone at column"),
        ({"translation": (0, 0)}, r"translation has shape \(2,\)"),
    ],
)
def test_what_is_no_camera_is_refused(pose, change, message):
    given = {"rotation": pose[0], "translation": pose[1], "matrix": OFF, "pixels": PIXELS, **change}
    with pytest.raises(ct.DataError, match=message):
        ct.camera_from_pose(**given)


def test_a_camera_below_the_ground_is_refused():
    with pytest.raises(ct.SettingsError, match="below the ground"):
        ct.camera_from_pose(np.diag([1.0, -1.0, -1.0]), (0, 0, -1), CENTRED, PIXELS)
