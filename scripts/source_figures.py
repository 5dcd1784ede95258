"""The figures of the source's supplement, from the runs that source_scenes.py has left in a folder.

Numbers follow the supplement: 2 stages' parameters; 3 and 4 cost and error against time; 5 the
monotonicity prior beside smoothness alone; 6 a view that was not used. And slices, recovered
against true extinction, and the error by depth inside the cloud.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from scipy.ndimage import distance_transform_edt

from cloudtomo_cl.commands.run_folder import RunFolder
from cloudtomo_cl.files.extinction import read_extinction
from cloudtomo_cl.files.measurements import read_measurements
from cloudtomo_cl.inversion.pixels import active_pixels
from cloudtomo_cl.inversion.stages import Stage, automatic_stages
from cloudtomo_cl.report.plots import (
    RADIANCE_LABEL,
    new_figure,
    plot_difference,
    plot_image,
    plot_scatter,
    plot_slices,
    radiance_limit,
    save_figures,
)
from cloudtomo_cl.scene.grid import Grid, coarsened
from cloudtomo_cl.scene.measurements import Measurements
from cloudtomo_cl.scene.metrics import delta, epsilon

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

PRIORS = {"": ("smoothness", "tab:orange"), "monotonicity-": ("and monotonicity", "tab:blue")}
STAGE_COLOURS = "tab20"
# The view that is not used, with other random numbers each.
UNSEEN_FILES = ("unseen.nc", "unseen-again.nc")


@dataclass(frozen=True)
class Run:
    """A finished reconstruction. `prior` is a key of PRIORS."""

    folder: Path
    prior: str
    seed: int
    grid: Grid
    extinction: np.ndarray
    mask: np.ndarray
    history: dict[str, np.ndarray]
    stages: tuple[Stage, ...]
    measurements: Measurements

    @property
    def cost(self) -> np.ndarray:
        """F + R (Eq. 24), at the start of each iteration."""
        return self.history["cost"] + self.history["prior"]

    @property
    def last_stage(self) -> np.ndarray:
        return self.history["stage"] == self.history["stage"].max()


def read_runs(output: Path) -> list[Run]:
    """All runs of a folder that have come to their end."""
    runs = []
    for prior in PRIORS:
        for folder in sorted(output.glob(f"{prior}seed-*")):
            run = RunFolder(folder)
            if not run.files.reconstruction.is_file():
                continue
            grid, extinction, mask = run.read_reconstruction()
            tables = run.read_settings()["settings"]
            given = tables.get("stage")
            stages = tuple(Stage(**table) for table in given) if given else automatic_stages(grid)
            measurements = read_measurements(run.files.reconstruction)
            seed = int(folder.name.rpartition("-")[2])
            runs.append(Run(folder, prior, seed, grid, extinction, mask, run.history.read(), stages, measurements))
    return runs


def mark_stages(axes: Axes, history: dict[str, np.ndarray]) -> None:
    """A coloured line at the end of every stage."""
    from matplotlib import colormaps

    colours = colormaps[STAGE_COLOURS].colors  # type: ignore[attr-defined]
    ends = np.flatnonzero(np.append(np.diff(history["stage"]) != 0, True))
    for end in ends:
        stage = int(history["stage"][end])
        axes.axvline(history["seconds"][end], color=colours[stage % len(colours)], label=f"end of stage {stage}")


def plot_stages(figure: Figure, run: Run) -> None:
    """Fig. 2: voxels, pixels, paths for each pixel, and all paths, by stage."""
    done = np.unique(run.history["stage"]).astype(int)
    voxels, sought, pixels, seen, each, paths = [], [], [], [], [], []
    for index in done:
        stage = run.stages[index - 1]
        mask = coarsened(run.mask, stage.grid)
        images = run.measurements.at_share(stage.pixels)
        voxels.append(mask.size)
        sought.append(mask.sum())
        pixels.append(sum(image.size for image in images.images))
        seen.append(len(active_pixels(images, run.grid.with_shape(stage.grid), mask)))
        of_stage = run.history["stage"] == index
        before = run.history["paths"][run.history["stage"] < index]
        paths.append(run.history["paths"][of_stage][-1] - (before[-1] if len(before) else 0))
        each.append(paths[-1] / of_stage.sum() / seen[-1])
    panels = (
        ("voxels", {"of the grid": voxels, "sought": sought}),
        ("pixels", {"of all images": pixels, "that see cloud": seen}),
        ("paths per pixel and iteration", {"": each}),
        ("paths", {"": paths}),
    )
    for axes, (title, lines) in zip(figure.subplots(2, 2).flat, panels):
        for name, values in lines.items():
            axes.plot(done, values, "o-", label=name)
        axes.set_yscale("log")
        axes.set_xticks(done)
        axes.set_xlabel("stage")
        axes.set_title(title)
        if len(lines) > 1:
            axes.legend()


def plot_course(figure: Figure, run: Run) -> None:
    """Figs. 3 and 4: cost and error against time, logarithmic, with the stages' ends."""
    left, right = figure.subplots(1, 2)
    seconds = run.history["seconds"]
    left.plot(seconds, run.cost, "k.-", linewidth=1, label="cost F + R")
    noise = run.history["cost_standard_error"]
    left.fill_between(seconds, run.cost - noise, run.cost + noise, color="0.7", linewidth=0)
    set_cost_scale(left, [run])
    left.set_ylabel("cost (± standard error of F)")
    right.plot(seconds, run.history["epsilon"], "k.-", linewidth=1)
    right.set_ylabel("eps")
    right.set_yscale("log")
    for axes in (left, right):
        axes.set_xscale("log")
        axes.set_xlabel("time (s)")
        mark_stages(axes, run.history)
    right.legend(fontsize="small")


def set_cost_scale(axes: Axes, runs: list[Run]) -> None:
    """Logarithmic, but for unbiased costs that noise, or the monotonicity prior, takes below zero."""
    costs = np.concatenate([run.cost for run in runs])
    if (costs > 0).all():
        axes.set_yscale("log")
        axes.set_ylim(0.8 * costs.min(), 1.2 * costs.max())
    else:
        axes.set_yscale("symlog", linthresh=float(np.median(np.abs(costs))))


def plot_priors(figure: Figure, runs: list[Run]) -> None:
    """Fig. 5: the cost over the whole run, and eps in the last stage, by the priors; a line for each seed."""
    whole, last = figure.subplots(1, 2)
    labelled = set()
    for run in runs:
        name, colour = PRIORS[run.prior]
        label = None if name in labelled else name
        labelled.add(name)
        seconds = run.history["seconds"]
        whole.plot(seconds, run.cost, ".-", color=colour, linewidth=1, label=label)
        chosen = run.last_stage
        last.plot(seconds[chosen], run.history["epsilon"][chosen], ".-", color=colour, linewidth=1)
    whole.set_xscale("log")
    set_cost_scale(whole, runs)
    whole.set_ylabel("cost F + R")
    last.set_ylabel("eps in the last stage")
    for axes in (whole, last):
        axes.set_xlabel("time (s)")
    whole.legend(title="prior")


def plot_unseen(figure: Figure, true: Measurements, recovered: Measurements) -> None:
    """Fig. 6: a view that was not used, of the true and the recovered cloud, and their difference."""
    panels = figure.subplots(1, 3)
    white = radiance_limit(true)
    image = plot_image(panels[0], true.images[0], white)
    plot_image(panels[1], recovered.images[0], white)
    difference = plot_difference(panels[2], true.differences(recovered)[0])
    for axes, title in zip(panels, ("true", "recovered", "recovered - true")):
        axes.set_title(title)
    figure.colorbar(image, ax=panels[:2], label=RADIANCE_LABEL, extend="max", location="bottom", shrink=0.6)
    label = "standard errors of the two"
    figure.colorbar(difference, ax=panels[2], label=label, extend="both", location="bottom")


def relative_difference(true: Sequence[np.ndarray], recovered: Sequence[np.ndarray]) -> tuple[float, float]:
    """Root mean square of the difference over that of the true image, without the noise of either; of the means.

    true, recovered : two independent images of each. Products of differences of two pairs have no noise on average,
        whatever is known of it: stated errors are pooled, and too large
    """
    (first, again), (second, once_more) = true, recovered
    square = np.sum((first - second) * (again - once_more))
    rms = np.sqrt(max(square, 0.0) / np.sum(first * again))
    return float(rms), float((second + once_more).mean() / (first + again).mean() - 1)


def unseen_images(folder: Path) -> list[np.ndarray]:
    """The images of a folder's `UNSEEN_FILES`."""
    return [read_measurements(folder / name).images[0] for name in UNSEEN_FILES]


def error_by_depth(grid: Grid, recovered: np.ndarray, truth: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Middles (km from the true cloud's edge, inside positive), eps and share of the true mass, by depth."""
    inside = distance_transform_edt(truth > 0, sampling=grid.spacing)
    # Voxels' centres are half a voxel from the edge.
    depth = np.where(truth > 0, inside - min(grid.spacing) / 2, 0.0)
    edges = np.arange(0.0, depth.max() + min(grid.spacing), min(grid.spacing))
    place = np.digitize(depth[truth > 0], edges) - 1
    error, mass = (
        np.bincount(place, np.asarray(values, float), len(edges))
        for values in (np.abs(recovered - truth)[truth > 0], truth[truth > 0])
    )
    kept = mass > 0
    return (edges + min(grid.spacing) / 2)[kept], (error[kept] / mass[kept]), mass[kept] / mass.sum()


def plot_depth(axes: Axes, grid: Grid, recovered: np.ndarray, truth: np.ndarray) -> None:
    """eps of the voxels at a depth below the true cloud's surface, with their share of the cloud."""
    middle, error, share = error_by_depth(grid, recovered, truth)
    axes.plot(middle, error, "o-", color="tab:red")
    axes.set_ylim(0, None)
    axes.set_xlabel("distance from the nearest clear voxel's edge (km)")
    axes.set_ylabel("eps of the voxels there", color="tab:red")
    other = axes.twinx()
    other.bar(middle, share, width=0.8 * min(grid.spacing), color="0.85", zorder=0)
    other.set_ylabel("share of the true optical mass", color="0.4")
    axes.set_zorder(other.get_zorder() + 1)
    axes.patch.set_visible(False)
    clear = float(recovered[truth == 0].sum(dtype=float) / truth.sum(dtype=float))
    axes.set_title(f"in clear air: {clear:.3f} of the true mass", fontsize="medium")


def draw(output: Path) -> None:
    """All figures into OUTPUT/figures, the numbers into OUTPUT/numbers.json, and a table to the terminal."""
    runs = read_runs(output)
    if not runs:
        print(f"{output}: no run has come to its end: there is nothing to draw")
        return
    grid, truth = read_extinction(output / "cloud.nc")
    first = runs[0]
    figures = {"figure2-stages": new_figure(8, 6), "figure3-course": new_figure(10, 4)}
    plot_stages(figures["figure2-stages"], first)
    plot_course(figures["figure3-course"], first)
    if len({run.prior for run in runs}) > 1:
        figures["figure5-priors"] = new_figure(10, 4)
        plot_priors(figures["figure5-priors"], runs)
    if (first.folder / UNSEEN_FILES[0]).is_file():
        figures["figure6-unseen"] = new_figure(10, 4.4)
        views = (read_measurements(folder / UNSEEN_FILES[0]) for folder in (output, first.folder))
        plot_unseen(figures["figure6-unseen"], *views)
    figures["slices"] = new_figure(8, 10)
    plot_slices(figures["slices"], grid, first.extinction, truth)
    figures["scatter"] = new_figure(5, 5)
    plot_scatter(figures["scatter"].add_subplot(), first.extinction, truth)
    figures["depth"] = new_figure(6, 4)
    plot_depth(figures["depth"].add_subplot(), grid, first.extinction, truth)
    save_figures(output / "figures", figures)
    numbers = []
    for run in runs:
        row = {
            "run": run.folder.name,
            "eps": epsilon(run.extinction, truth),
            "delta": delta(run.extinction, truth),
            "seconds": float(run.history["seconds"][-1]),
            "paths": float(run.history["paths"][-1]),
        }
        if all((folder / name).is_file() for folder in (output, run.folder) for name in UNSEEN_FILES):
            images = map(unseen_images, (output, run.folder))
            row["unseen_rms"], row["unseen_mean"] = relative_difference(*images)
        numbers.append(row)
        print("  ".join(f"{key} {value:.4g}" if key != "run" else str(value) for key, value in row.items()))
    for prior, (name, _) in PRIORS.items():
        of_prior = [row["eps"] for row, run in zip(numbers, runs) if run.prior == prior]
        if len(of_prior) > 1:
            spread = np.std(of_prior, ddof=1)
            print(f"{name}: eps {np.mean(of_prior):.4f}, spread {spread:.4f} over {len(of_prior)} seeds")
    (output / "numbers.json").write_text(json.dumps(numbers, indent=1) + "\n")
    print(f"{output / 'figures'}: {', '.join(figures)}")
