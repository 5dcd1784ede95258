"""Voxels that may hold cloud and are in no image are told of."""

import numpy as np
import pytest

import cloudtomo_cl as ct
from cloudtomo_cl.inversion.checks import unseen_text
from cloudtomo_cl.scene.visibility import voxels_in_view

GRID = ct.Grid((8, 8, 8), (0.1, 0.1, 0.1))
EVERYWHERE = np.ones(GRID.shape, bool)


def above(width, target=(0.4, 0.4, 0.4)):
    return ct.OrthographicView(zenith=0, width=width, pixels=(8, 8), target=target)


def told(mask, *views, boundary="open"):
    scene = ct.Scene(grid=GRID, sun=ct.Sun(zenith=20.0), boundary=ct.Boundary(horizontal=boundary))
    images = [np.ones((view.pixels[1], view.pixels[0])) for view in views]
    return unseen_text(scene, ct.Measurements(views, tuple(images), tuple(images)), mask)


def test_a_narrow_view_sees_the_voxels_below_it():
    seen = voxels_in_view([above(0.4)], GRID)
    assert (seen == ((np.abs(np.arange(8) - 3.5) < 2)[:, None, None] & (np.abs(np.arange(8) - 3.5) < 2)[:, None])).all()


def test_a_camera_sees_nothing_behind_it():
    view = ct.PerspectiveView(position=(0.4, 0.4, 0.4), target=(0.4, 0.4, 1.0), field_of_view=120, pixels=(8, 8))
    seen = voxels_in_view([view], GRID)
    assert not seen[:, :, :4].any() and seen[3:5, 3:5, 4:].all()


def test_a_share_that_no_view_sees_is_told():
    assert told(EVERYWHERE, above(0.4)).startswith("75% of the voxels that may hold cloud are in no view's image")


@pytest.mark.parametrize("boundary, width", [("open", 0.8), ("periodic", 0.4)])
def test_nothing_is_told_where_all_is_seen(boundary, width):
    assert told(EVERYWHERE, above(width), boundary=boundary) == ""


def test_what_no_cloud_may_fill_does_not_count():
    inside = EVERYWHERE.copy()
    inside[:2] = inside[6:] = inside[:, :2] = inside[:, 6:] = False
    assert told(inside, above(0.4)) == ""


def test_lists_of_rays_may_see_any_voxel():
    down = ct.RayView(origins=np.array([[0.4, 0.4, 2.0]]), directions=np.array([[0.0, 0.0, -1.0]]))
    assert voxels_in_view([down, above(0.1)], GRID).all()
