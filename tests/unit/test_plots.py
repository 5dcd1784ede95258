"""Figures: what lies where, looked up in the drawn pixels."""

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.image import imread

from cloudtomo_cl.report.plots import (
    new_figure,
    plot_history,
    plot_images,
    plot_optical_depth,
    plot_phase_function,
    plot_scatter,
    plot_slice,
    plot_slices,
    run_figures,
    save_figures,
    save_previews,
)
from cloudtomo_cl.scene.grid import Grid
from cloudtomo_cl.scene.measurements import Measurements
from cloudtomo_cl.scene.phase import HenyeyGreenstein, TabulatedPhaseFunction
from cloudtomo_cl.scene.sensors import OrthographicView

GRID = Grid((6, 5, 8), (0.1, 0.1, 0.1), (1.0, 2.0, 3.0))


@pytest.fixture
def extinction():
    """One bright voxel, at the eastern end, in the north, near the top."""
    values = np.zeros(GRID.shape, np.float32)
    values[5, 3, 6] = 10.0
    return values


@pytest.fixture
def measurements():
    """Two images of different sizes, bright in the upper right pixel."""
    images = []
    for shape in ((3, 4), (5, 5)):
        images.append(np.zeros(shape))
        images[-1][0, -1] = 1.0
    views = tuple(OrthographicView(width=1.0, pixels=image.shape[::-1], zenith=0.0) for image in images)
    return Measurements(views, tuple(images), tuple(np.zeros_like(image) for image in images))


@pytest.fixture
def history():
    """Two stages of three iterations; the cost falls below zero by its noise."""
    return {
        "stage": np.array([0, 0, 0, 1, 1, 1.0]),
        "seconds": np.arange(1, 7.0),
        "cost": np.array([1, 0.5, 0.2, 0.1, 0.01, -0.01]),
        "cost_standard_error": np.full(6, 0.02),
        "epsilon": np.linspace(0.9, 0.4, 6),
    }


def brightest(axes, figure):
    """Where the brightest drawn pixel within axes lies: data coordinates, and shares of the axes' width and height."""
    figure.canvas.draw()
    pixels = np.asarray(figure.canvas.buffer_rgba())[..., :3].astype(int)
    # Without the frame.
    box = axes.get_window_extent().shrunk(0.97, 0.97)
    height = pixels.shape[0]
    part = pixels[int(height - box.y1) : int(height - box.y0), int(box.x0) : int(box.x1)]
    rows, columns = np.nonzero(part[..., 0] == part[..., 0].max())
    display = (box.x0 + np.median(columns), box.y1 - np.median(rows))
    return axes.transData.inverted().transform(display), axes.transAxes.inverted().transform(display)


def test_vertical_slice_has_x_to_the_right_and_z_up(extinction):
    figure = new_figure(5, 5)
    axes = figure.subplots()
    plot_slice(axes, GRID, extinction, normal=1, index=3, largest=10.0)
    position, share = brightest(axes, figure)
    assert np.allclose(position, [1.55, 3.65], atol=0.05) and np.allclose(share, [5.5 / 6, 6.5 / 8], atol=0.05)


def test_horizontal_slice_has_x_to_the_right_and_y_up(extinction):
    figure = new_figure(5, 5)
    axes = figure.subplots()
    plot_slice(axes, GRID, extinction, normal=2, index=6, largest=10.0)
    position, share = brightest(axes, figure)
    assert np.allclose(position, [1.55, 2.35], atol=0.05) and np.allclose(share, [5.5 / 6, 3.5 / 5], atol=0.05)


def test_slices_of_truth_and_recovery_share_their_scale(extinction):
    figure = new_figure(6, 9)
    plot_slices(figure, GRID, 3 * extinction, extinction)
    images = [image for axes in figure.axes for image in axes.get_images() if axes.get_xlabel()]
    assert len(images) == 6 and {image.get_clim() for image in images} == {(0.0, 10.0)}


def test_slices_without_truth_show_the_recovery_alone(extinction):
    figure = new_figure(3, 9)
    plot_slices(figure, GRID, extinction)
    assert [axes.get_title().split(",")[0] for axes in figure.axes[:3]] == ["recovered"] * 3


def test_slices_go_through_the_cloud(extinction):
    figure = new_figure(3, 9)
    plot_slices(figure, GRID, extinction)
    assert all(axes.get_images()[0].get_array().max() == 10.0 for axes in figure.axes[:3])


def test_images_have_row_0_at_the_top(measurements):
    figure = new_figure(6, 4)
    plot_images(figure, measurements)
    _, share = brightest(figure.axes[0], figure)
    assert np.allclose(share, [3.5 / 4, 2.5 / 3], atol=0.05)


def test_history_has_a_logarithmic_time_axis(history):
    axes = new_figure(5, 4).subplots()
    plot_history(axes, history)
    assert axes.get_xscale() == "log"


def test_history_marks_the_end_of_a_stage(history):
    axes = new_figure(5, 4).subplots()
    plot_history(axes, history)
    marks = [line.get_xdata()[0] for line in axes.get_lines() if line.get_linestyle() == ":"]
    assert marks == [3.0]


def test_history_without_truth_has_no_error_axis(history):
    figure = new_figure(5, 4)
    plot_history(figure.subplots(), {**history, "epsilon": np.full(6, np.nan)})
    assert len(figure.axes) == 1


def test_history_shows_costs_below_zero(history):
    figure = new_figure(5, 4)
    axes = figure.subplots()
    plot_history(axes, history)
    figure.canvas.draw()
    assert axes.get_ylim()[0] < -0.01


def test_scatter_has_the_truth_to_the_right(extinction):
    axes = new_figure(4, 4).subplots()
    plot_scatter(axes, extinction / 2, extinction)
    assert axes.get_lines()[1].get_xydata().tolist() == [[10.0, 5.0]]


def test_previews_are_the_images_pixel_by_pixel(tmp_path, measurements):
    paths = save_previews(tmp_path / "png", measurements)
    assert np.array_equal(imread(paths[0])[..., 0], measurements.images[0])


def test_figures_of_a_run_are_not_empty(tmp_path, extinction, history, measurements):
    figures = run_figures(GRID, extinction, history, extinction, measurements, measurements)
    assert list(figures) == ["volume", "slices", "maps", "history", "scatter", "images", "comparison"]
    for path in save_figures(tmp_path, figures):
        if path.suffix == ".png":
            assert np.unique((255 * imread(path)[..., :3]).round() @ [1, 256, 65536]).size > 20
        else:
            assert path.read_bytes().startswith(b"%PDF")


def test_optical_depth_has_north_up(extinction):
    axes = new_figure(4, 4).subplots()
    shown = plot_optical_depth(axes, GRID, extinction).get_array()
    assert np.allclose(shown, extinction.sum(axis=2).T * GRID.spacing[2]) and axes.get_ylim()[0] < axes.get_ylim()[1]


def test_a_difference_is_in_standard_errors_of_both(measurements):
    errors = tuple(np.full(image.shape, 0.3) for image in measurements.images)
    one = replace(measurements, standard_errors=errors)
    images = tuple(image + 1.0 for image in measurements.images)
    other = replace(one, images=images, standard_errors=tuple(error / 0.3 * 0.4 for error in errors))
    assert all(np.allclose(difference, 2.0) for difference in one.differences(other))


def test_phase_function_has_a_line_for_each_radius():
    radii = tuple(range(5, 13))
    table = TabulatedPhaseFunction((0, 90, 180), np.full((8, 3), 1 / (4 * np.pi)), radii)
    axes = new_figure(4, 3).subplots()
    plot_phase_function(axes, table)
    assert len(axes.get_lines()) == 8
    assert [text.get_text() for text in axes.get_legend().get_texts()][::5] == ["5 µm", "12 µm"]


def test_phase_function_is_drawn_over_its_angle():
    axes = new_figure(4, 3).subplots()
    plot_phase_function(axes, HenyeyGreenstein(0.5), label="g 0.5")
    angle, density = axes.get_lines()[0].get_data()
    # Of Henyey and Greenstein at 180 degrees: (1 - g) / (4 pi (1 + g)^2).
    assert (angle[-1], density[-1]) == pytest.approx((180.0, 0.5 / (4 * np.pi * 1.5**2)))
    assert axes.get_yscale() == "log"


@pytest.mark.parametrize("known", [True, False])
def test_the_cost_that_noise_makes_is_drawn_where_it_is_known(history, known):
    """A level for each stage; runs of older versions have none."""
    if known:
        history["expected_cost"] = np.array([0.3, 0.3, 0.3, 0.02, 0.02, 0.02])
    axes = new_figure(4, 3).subplots()
    plot_history(axes, history)
    levels = [line.get_ydata() for line in axes.get_lines() if line.get_linestyle() == "--"]
    assert [list(level) for level in levels] == ([[0.3] * 3, [0.02] * 3] if known else [])
    named = [text.get_text() for text in axes.get_legend().get_texts()]
    assert ("expected, by their noise alone" in named) == known
