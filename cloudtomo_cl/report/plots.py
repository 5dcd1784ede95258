"""Figures. Functions draw into axes or figures that they are given, without pyplot's state.

Lengths in km, x to the right, z up; images with row 0 at the top.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from cloudtomo_cl.files.whole import written_whole
from cloudtomo_cl.report.comparison import in_standard_errors, per_cent
from cloudtomo_cl.report.directions import angles, in_image, kilometre, round_length, towards_sensor
from cloudtomo_cl.report.volume import SUNLIGHT, plot_volume
from cloudtomo_cl.scene.grid import Grid
from cloudtomo_cl.scene.measurements import Measurements
from cloudtomo_cl.scene.phase import AnyPhaseFunction, TabulatedPhaseFunction
from cloudtomo_cl.scene.scene import Sun
from cloudtomo_cl.scene.sensors import RayView, View

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Endings of the files that figures are saved in.
PICTURES = (".png", ".pdf", ".svg")
_DOTS_PER_INCH = 130
# Names of the figures that a run may have.
FIGURES = ("volume", "slices", "maps", "history", "scatter", "images", "comparison")
EXTINCTION_LABEL = "extinction (km$^{-1}$)"
RADIANCE_LABEL = "radiance (W m$^{-2}$ sr$^{-1}$)"
_AXES = "xyz"
# More views side by side are too small to see anything.
_COMPARED_VIEWS = 6
# Directions closer to the vertical, degrees, have no azimuth worth telling.
_LEVEL = 0.5


def new_figure(width: float, height: float) -> Figure:
    """A figure that needs no display; inches."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def plot_slice(axes: Axes, grid: Grid, extinction: np.ndarray, normal: int, index: int, largest: float) -> Any:
    """One layer of voxels, seen along the axis `normal` (0, 1, 2): the next axis runs right, the last up.

    Returns the image, for a colour bar.
    """
    return _plot_plane(axes, grid, np.take(extinction, index, axis=normal), normal, largest)


def _plot_plane(
    axes: Axes, grid: Grid, values: np.ndarray, normal: int, largest: float | None, colours: str = "viridis"
) -> Any:
    """Values of voxels in a plane, shape of the grid without the axis `normal`, from 0 up; returns the image."""
    right, up = (axis for axis in range(3) if axis != normal)
    image = axes.imshow(
        values.T,
        origin="lower",
        extent=_extent(grid, right, up),
        vmin=0.0,
        vmax=largest,
        cmap=colours,
        interpolation="nearest",
    )
    axes.set_xlabel(f"{_AXES[right]} (km)")
    axes.set_ylabel(f"{_AXES[up]} (km)")
    return image


def _extent(grid: Grid, right: int, up: int) -> tuple[float, float, float, float]:
    left, bottom = grid.origin[right], grid.origin[up]
    return left, left + grid.extent[right], bottom, bottom + grid.extent[up]


def plot_optical_depth(axes: Axes, grid: Grid, extinction: np.ndarray, largest: float | None = None) -> Any:
    """Vertical optical depth of the columns, seen from above with north up. Returns the image."""
    depth = extinction.sum(axis=2, dtype=float) * grid.spacing[2]
    return _plot_plane(axes, grid, depth, 2, largest, "magma")


def plot_maximum(axes: Axes, grid: Grid, extinction: np.ndarray, normal: int, largest: float | None = None) -> Any:
    """The largest extinction along the axis `normal` (0, 1, 2): a maximum-intensity map. Returns the image."""
    return _plot_plane(axes, grid, extinction.max(axis=normal), normal, largest)


def plot_profile(axes: Axes, grid: Grid, extinction: np.ndarray, effective_radius: np.ndarray | None = None) -> None:
    """Height profiles of cloudy voxels: mean extinction, and mean effective radius (um) if known."""
    cloudy = extinction > 0
    count = cloudy.sum(axis=(0, 1))
    mean = np.divide(extinction.sum(axis=(0, 1)), count, out=np.full(count.shape, np.nan), where=count > 0)
    height = grid.centres(2)
    lines = axes.plot(mean, height, color="tab:blue", label="mean extinction of cloudy voxels")
    axes.set_xlim(0, None)
    axes.set_ylim(grid.origin[2], grid.origin[2] + grid.extent[2])
    axes.set_xlabel(EXTINCTION_LABEL)
    axes.set_ylabel("z (km)")
    if effective_radius is not None:
        above = axes.twiny()
        radius = np.where(cloudy, np.nan_to_num(effective_radius), 0.0).sum(axis=(0, 1))
        mean_radius = np.divide(radius, count, out=np.full(count.shape, np.nan), where=count > 0)
        lines += above.plot(mean_radius, height, color="tab:orange", label="mean effective radius")
        above.set_xlim(0, None)
        above.set_xlabel("effective radius (µm)")
    axes.legend(handles=lines, loc="lower right", fontsize="small")


def plot_cloud(figure: Figure, grid: Grid, extinction: np.ndarray, effective_radius: np.ndarray | None = None) -> None:
    """A cloud at a glance: optical depth from above, maxima from two sides, profiles."""
    (above, profile), (south, east) = figure.subplots(2, 2)
    figure.colorbar(plot_optical_depth(above, grid, extinction), ax=above, label="vertical optical depth")
    plot_profile(profile, grid, extinction, effective_radius)
    largest = float(extinction.max())
    plot_maximum(south, grid, extinction, 1, largest)
    image = plot_maximum(east, grid, extinction, 0, largest)
    south.set_title("largest extinction along y")
    east.set_title("largest extinction along x")
    figure.colorbar(image, ax=[south, east], label=EXTINCTION_LABEL)


def slice_indices(extinction: np.ndarray) -> list[tuple[int, int]]:
    """Normal and index of the layers to show: two vertical x-z ones and a horizontal one.

    The vertical ones have a third and two thirds of the optical mass on one side. The horizontal
    one goes through the largest extinction, smoothed over neighbours so that a single noisy
    voxel does not choose.
    """
    from scipy.ndimage import gaussian_filter

    mass = np.cumsum(extinction.sum(axis=(0, 2), dtype=float))
    south, north = (int(np.searchsorted(mass, share * mass[-1])) for share in (1 / 3, 2 / 3))
    smooth = gaussian_filter(np.asarray(extinction, float), 1.0)
    highest = np.unravel_index(np.argmax(smooth), smooth.shape)[2]
    return [(1, south), (1, north), (2, int(highest))]


def plot_slices(figure: Figure, grid: Grid, recovered: np.ndarray, truth: np.ndarray | None = None) -> None:
    """Recovered extinction in three layers, beside the true one if known, on the same colour scale.

    The layers and the scale are the truth's where it is known.
    """
    volumes = {"recovered": recovered} if truth is None else {"true": truth, "recovered": recovered}
    reference = recovered if truth is None else truth
    # A few recovered voxels of noise must not darken all others.
    largest = max(float(reference.max() if truth is not None else np.quantile(recovered, 0.9995)), 1e-9)
    slices = slice_indices(reference)
    axes = figure.subplots(len(slices), len(volumes), squeeze=False)
    for row, (normal, index) in zip(axes, slices):
        position = grid.centres(normal)[index]
        for panel, (name, volume) in zip(row, volumes.items()):
            image = plot_slice(panel, grid, volume, normal, index, largest)
            panel.set_title(f"{name}, {_AXES[normal]} = {position:.3g} km")
    figure.colorbar(image, ax=axes, label=EXTINCTION_LABEL, extend="max", shrink=0.6)


def plot_history(axes: Axes, history: Mapping[str, np.ndarray]) -> None:
    """Cost with its noise and what the images' noise explains of it, and the error if known, against time.

    Costs of different stages are costs of different images: a line for each stage, none between them.

    Parameters
    ----------
    history : columns as `HistoryFile.read` gives them
    """
    from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

    seconds, cost, noise = (history[name] for name in ("seconds", "cost", "cost_standard_error"))
    axes.set_xscale("log")
    axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.xaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
    axes.xaxis.set_minor_formatter(NullFormatter())
    # The unbiased cost may fall below zero by its noise: then linear within the noise.
    if (cost > 0).all():
        axes.set_yscale("log")
    elif (noise > 0).any():
        axes.set_yscale("symlog", linthresh=float(np.median(noise[noise > 0])))
    stages = np.split(np.arange(len(seconds)), np.flatnonzero(np.diff(history["stage"])) + 1)
    lines, expected = [], history.get("expected_cost", np.full_like(cost, np.nan))  # which older runs do not have
    for stage in stages:
        # A stage of one iteration is a point.
        lines = axes.plot(seconds[stage], cost[stage], ".-", color="tab:blue", linewidth=1, markersize=3,
                          label="cost of a stage's images ± its error")  # fmt: skip
        if np.isfinite(expected[stage]).all():
            lines += axes.plot(seconds[stage], expected[stage], color="tab:green", linewidth=1, linestyle="--",
                               label="expected, by their noise alone")  # fmt: skip
    limits = axes.get_ylim()
    for number, stage in enumerate(stages):
        time, middle, error = seconds[stage], cost[stage], noise[stage]
        axes.fill_between(time, middle - error, middle + error, color="tab:blue", alpha=0.2, linewidth=0)
        if len(stages) > 1:
            place = (float(np.sqrt(max(time[0], 1e-9) * max(time[-1], 1e-9))), 1.0)
            axes.text(*place, str(number + 1), transform=axes.get_xaxis_transform(), ha="center", va="bottom",
                      fontsize="small", color="0.4")  # fmt: skip
        if number + 1 < len(stages):
            axes.axvline(time[-1], color="0.75", linewidth=0.8, linestyle=":")
    axes.set_ylim(limits)  # of the costs, however large the first and noisiest ones' errors
    axes.set_xlabel("time (s)" + ("; above: the stages" if len(stages) > 1 else ""))
    axes.set_ylabel("cost")
    if np.isfinite(history["epsilon"]).any():
        errors = axes.twinx()
        lines += errors.plot(seconds, history["epsilon"], color="tab:red", linewidth=1.2, label="error eps")
        errors.set_ylabel("eps", color="tab:red")
        errors.set_ylim(0, None)
    # Above: wherever it lay inside, it could hide the end of a line.
    axes.legend(handles=lines, loc="lower center", bbox_to_anchor=(0.5, 1.04), ncols=len(lines), frameon=False)


def plot_scatter(axes: Axes, recovered: np.ndarray, truth: np.ndarray) -> None:
    """Recovered against true extinction of every voxel that holds cloud in one of them."""
    cloudy = (truth > 0) | (recovered > 0)
    largest = max(float(truth.max()), float(np.quantile(recovered, 0.9995)), 1e-9)
    axes.plot([0, largest], [0, largest], color="0.5", linewidth=1)
    axes.plot(truth[cloudy], recovered[cloudy], ".", markersize=2, alpha=0.3, rasterized=True)
    axes.set_xlim(0, largest)
    axes.set_ylim(0, largest)
    axes.set_aspect("equal")
    axes.set_xlabel(f"true {EXTINCTION_LABEL}")
    axes.set_ylabel(f"recovered {EXTINCTION_LABEL}")


def plot_phase_function(axes: Axes, phase_function: AnyPhaseFunction, label: str | None = None) -> None:
    """Density over the scattering angle, logarithmic; a line for each row of a table, dark for small droplets.

    Parameters
    ----------
    label : of a phase function without radii, for a legend
    """
    radii = getattr(phase_function, "effective_radius", ())
    if isinstance(phase_function, TabulatedPhaseFunction):
        angle = np.array(phase_function.angle)
        rows = np.array(phase_function.values)
    else:
        angle = np.linspace(0.0, 180.0, 721)
        rows = phase_function.density(np.cos(np.radians(angle)))[None, :]
    if radii:
        from matplotlib import colormaps

        colours = colormaps["viridis"](np.linspace(0.0, 0.9, len(radii)))
        # A legend of many lines hides them: the ends and a few between.
        named = set(np.linspace(0, len(radii) - 1, min(len(radii), 6)).round().astype(int))
        for index, (radius, row) in enumerate(zip(radii, rows)):
            name = f"{radius:g} µm" if index in named else None
            axes.plot(angle, row, color=colours[index], linewidth=1, label=name)
        axes.legend(title="effective radius", fontsize="small")
    else:
        axes.plot(angle, rows[0], linewidth=1, label=label)
        if label is not None:
            axes.legend(fontsize="small")
    axes.set_yscale("log")
    axes.set_xlim(0, 180)
    axes.set_xticks(range(0, 181, 30))
    axes.set_xlabel("scattering angle (degrees)")
    axes.set_ylabel("phase function (sr$^{-1}$)")
    axes.grid(color="0.9", linewidth=0.5)


def radiance_limit(measurements: Measurements) -> float:
    """White of the grey scale that all views share; the brightest 0.1 % of the pixels are cut."""
    pixels = np.concatenate([image.ravel() for image in measurements.images])
    return max(float(np.nanquantile(pixels, 0.999)), 1e-12)


def _grey() -> Any:
    """Black to white, and invalid pixels in a colour of their own."""
    from matplotlib import colormaps

    return colormaps["gray"].with_extremes(bad="tab:blue")


def _image_columns(measurements: Measurements) -> int:
    return int(np.ceil(np.sqrt(len(measurements.views))))


def plot_images(figure: Figure, measurements: Measurements, grid: Grid | None = None, sun: Sun | None = None) -> None:
    """The views in a grid, on one grey scale, row 0 at the top.

    grid, sun : with them, angles, scale bars, and arrows to where north and the sun are
    """
    count, columns = len(measurements.views), _image_columns(measurements)
    axes = figure.subplots(-(-count // columns), columns, squeeze=False)
    white = radiance_limit(measurements)
    for index, panel in enumerate(axes.flat):
        panel.set_axis_off()
        if index < count:
            # A list of rays is often one row.
            aspect: Literal["auto", "equal"] = "auto" if isinstance(measurements.views[index], RayView) else "equal"
            image = panel.imshow(
                measurements.images[index], cmap=_grey(), vmin=0, vmax=white, interpolation="nearest", aspect=aspect
            )
            title = f"view {index}"
            if grid is not None:
                zenith, azimuth = angles(towards_sensor(measurements.views[index], grid))
                title += f": zenith {zenith:.0f}°" + (f", azimuth {azimuth:.0f}°" if zenith >= _LEVEL else "")
                _draw_directions(panel, measurements.views[index], grid, sun)
            panel.set_title(title, fontsize="small")
    figure.colorbar(image, ax=axes, label=RADIANCE_LABEL, extend="max", shrink=0.6)


def _draw_directions(panel: Axes, view: View, grid: Grid, sun: Sun | None) -> None:
    """A scale bar at the lower left, and at the lower right arrows to where north and the sun are."""
    from matplotlib.patheffects import withStroke

    outlined: dict[str, Any] = {"path_effects": [withStroke(linewidth=2, foreground="black")]}
    width, height = view.pixels
    size = min(width, height)
    per_km = kilometre(view, grid)
    if per_km:
        length = round_length(0.35 * width / per_km)
        left, level = 0.06 * width, 0.93 * height
        bar: dict[str, Any] = {"color": "white", "linewidth": 2, "solid_capstyle": "butt"}
        panel.plot([left, left + length * per_km], [level, level], **bar)
        panel.text(left, level - 0.03 * size, f"{length:g} km", color="white", fontsize=6, va="bottom", **outlined)
    start = np.array([width - 0.22 * size, height - 0.2 * size])
    towards = [("N", np.array([0.0, 1.0, 0.0]), "white")]
    if sun is not None and sun.zenith > _LEVEL:
        level_part = sun.direction * [1, 1, 0]
        towards.append(("sun", level_part / np.linalg.norm(level_part), SUNLIGHT))
    for text, horizontal, colour in towards:
        moved = in_image(view, grid, horizontal)
        if moved is None or not moved.any():
            continue
        # What points into the image is short there.
        step = 0.12 * size * moved / max(float(np.linalg.norm(moved)), per_km or 0.0)
        tip, place = (start + share * step for share in (1.0, 1.0 + 0.04 * size / np.linalg.norm(step)))
        arrow = {"arrowstyle": "-|>", "color": colour, "linewidth": 1, "shrinkA": 0, "shrinkB": 0}
        panel.annotate("", (tip[0], tip[1]), (start[0], start[1]), arrowprops=arrow)
        panel.text(place[0], place[1], text, color=colour, fontsize=6, ha="center", va="center", **outlined)
    panel.set(xlim=(-0.5, width - 0.5), ylim=(height - 0.5, -0.5))


def plot_image(axes: Axes, image: np.ndarray, white: float) -> Any:
    """A radiance image, row 0 at the top, from 0 (black) to `white`. Returns it, for a colour bar."""
    axes.set_axis_off()
    return axes.imshow(image, cmap=_grey(), vmin=0, vmax=white, interpolation="nearest")


def plot_difference(axes: Axes, difference: np.ndarray, largest: float = 5.0) -> Any:
    """A difference of images (standard errors, per cent), red where positive, up to `largest`. Returns it."""
    axes.set_axis_off()
    return axes.imshow(difference, cmap="RdBu_r", vmin=-largest, vmax=largest, interpolation="nearest")


def plot_comparison(figure: Figure, measured: Measurements, modelled: Measurements, views: Sequence[int]) -> None:
    """Measured images, those of the recovered cloud, and their difference in per cent and in standard errors."""
    axes = figure.subplots(4, len(views), squeeze=False)
    white = radiance_limit(measured)
    scores, relative = in_standard_errors(measured, modelled), per_cent(measured, modelled)
    shown = np.concatenate([np.abs(relative[view]).ravel() for view in views])
    largest = max(float(np.nanquantile(shown, 0.99)), 1e-3)
    for column, view in zip(axes.T, views):
        image = plot_image(column[0], measured.images[view], white)
        plot_image(column[1], modelled.images[view], white)
        share = plot_difference(column[2], relative[view], largest)
        score = plot_difference(column[3], scores[view])
        column[0].set_title(f"view {view}", fontsize="medium")
    for panel, name in zip(axes[:, 0], ("measured", "modelled", "difference", "difference")):
        # The axes are off: a text stands in for the label of y.
        panel.text(-0.08, 0.5, name, rotation=90, va="center", ha="right", transform=panel.transAxes)
    figure.colorbar(image, ax=axes[:2], label=RADIANCE_LABEL, extend="max")
    figure.colorbar(share, ax=axes[2], label="% of the mean", extend="both")
    figure.colorbar(score, ax=axes[3], label="standard errors", extend="both")


def plot_maps(figure: Figure, grid: Grid, recovered: np.ndarray, truth: np.ndarray | None = None) -> None:
    """Optical depth from above, and the largest extinction along y and along x; recovered, and true if known."""
    volumes = {"recovered": recovered} if truth is None else {"true": truth, "recovered": recovered}
    reference = recovered if truth is None else truth
    largest = max(float(reference.max() if truth is not None else np.quantile(recovered, 0.9995)), 1e-9)
    deepest = max(float(reference.sum(axis=2, dtype=float).max()) * grid.spacing[2], 1e-9)
    # A kilometre is as long in every panel.
    widths = [grid.extent[0], grid.extent[0], grid.extent[1]]
    axes = figure.subplots(len(volumes), 3, squeeze=False, width_ratios=widths)
    for row, (name, volume) in zip(axes, volumes.items()):
        depth = plot_optical_depth(row[0], grid, volume, deepest)
        plot_maximum(row[1], grid, volume, 1, largest)
        image = plot_maximum(row[2], grid, volume, 0, largest)
        for panel, what in zip(row, ("optical depth", "largest along y", "largest along x")):
            panel.set_title(f"{name}: {what}", fontsize="medium")
        row[2].set_ylabel("")  # that of its neighbour
    bars: dict[str, Any] = {"extend": "max", "shrink": 0.5, "aspect": 25}
    figure.colorbar(depth, ax=axes[:, 0], label="vertical optical depth", location="left", **bars)
    figure.colorbar(image, ax=axes[:, 2], label=EXTINCTION_LABEL, **bars)


def save_previews(folder: Path, measurements: Measurements, start: str = "") -> list[Path]:
    """One PNG for each view, pixel by pixel, on one grey scale from 0 to `radiance_limit`; `start` of their names."""
    from matplotlib.image import imsave

    folder.mkdir(parents=True, exist_ok=True)
    white = radiance_limit(measurements)
    paths = []
    for index, image in enumerate(measurements.images):
        paths.append(folder / f"{start}view_{index}.png")
        with written_whole(paths[-1]) as partial:
            imsave(partial, image, vmin=0.0, vmax=white, cmap=_grey(), origin="upper", format="png")
    return paths


def run_figures(
    grid: Grid,
    recovered: np.ndarray,
    history: Mapping[str, np.ndarray],
    truth: np.ndarray | None = None,
    measurements: Measurements | None = None,
    modelled: Measurements | None = None,
    sun: Sun | None = None,
) -> dict[str, Figure]:
    """The figures of a run by name: volume, slices, maps, history, and scatter, images, comparison where known."""
    figures: dict[str, Figure] = {}
    panels = 1 if truth is None else 2
    figures["volume"] = new_figure(3.6 * panels + 0.4, 5.4)
    plot_volume(figures["volume"], grid, recovered, truth, sun, () if measurements is None else measurements.views)
    rows = sum(grid.extent[2 if normal == 1 else 1] / grid.extent[0] for normal in (1, 1, 2))
    figures["slices"] = new_figure(1.5 + 3.2 * panels, min(max(1.5 + 3.0 * rows, 5), 14))
    plot_slices(figures["slices"], grid, recovered, truth)
    tall = max(1.0, grid.extent[2] / grid.extent[0], grid.extent[1] / grid.extent[0])
    figures["maps"] = new_figure(11, min(panels * (2.4 * tall + 0.8), 10))
    plot_maps(figures["maps"], grid, recovered, truth)
    figures["history"] = new_figure(7, 4.5)
    plot_history(figures["history"].subplots(), history)
    if truth is not None:
        figures["scatter"] = new_figure(5, 5)
        plot_scatter(figures["scatter"].subplots(), recovered, truth)
    if measurements is not None:
        columns = _image_columns(measurements)
        rows = -(-len(measurements.views) // columns)
        figures["images"] = new_figure(2.5 * columns + 1.5, 2.7 * rows + 0.3)
        plot_images(figures["images"], measurements, grid, sun)
    if measurements is not None and modelled is not None:
        count = len(measurements.views)
        views = np.unique(np.linspace(0, count - 1, min(count, _COMPARED_VIEWS)).round().astype(int))
        figures["comparison"] = new_figure(1.8 * len(views) + 1.6, 7.8)
        plot_comparison(figures["comparison"], measurements, modelled, [int(view) for view in views])
    return figures


def save_figures(folder: Path, figures: Mapping[str, Figure]) -> list[Path]:
    """Every figure as NAME.png and NAME.pdf in a folder, which is made."""
    folder.mkdir(parents=True, exist_ok=True)
    paths = []
    for name, figure in figures.items():
        for suffix in ("png", "pdf"):
            paths.append(folder / f"{name}.{suffix}")
            save_figure(paths[-1], figure)
            # The layout, which takes most of the time, stays as it was drawn first.
            figure.set_layout_engine("none")
    return paths


def save_figure(path: Path, figure: Figure) -> None:
    """A figure in the format that the file's name ends in (PICTURES), whole or not at all.

    Raises
    ------
    DataError : the file cannot be written
    """
    with written_whole(path) as partial:
        figure.savefig(partial, dpi=_DOTS_PER_INCH, format=path.suffix.lower().removeprefix("."))
