"""A cloud in 3-D, lit by the sun: a flat picture for papers, and what the page's own view (volume.js) draws from.

It is a picture and no radiance: opacity is the optical depth along the line of sight, and a voxel is as light as what
is left of the sunlight after the optical depth towards the sun, most of which scatters forward.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from cloudtomo_cl.arguments import a, able, many, require_kinds
from cloudtomo_cl.errors import DataError
from cloudtomo_cl.report.directions import angles, round_length, towards_sensor
from cloudtomo_cl.scene.arrays import real_numbers
from cloudtomo_cl.scene.box import clip_to_box
from cloudtomo_cl.scene.grid import Grid, resample
from cloudtomo_cl.scene.scene import Sun, direction
from cloudtomo_cl.scene.sensors import View

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Where the picture is seen from, degrees: from the south-south-west, from above.
EYE = (62.0, 250.0)
# Without a sun: light from above.
_ABOVE = Sun(zenith=0.0)
# Share of scattered light that is lost to the direction of the sun, 1 - g of cloud droplets.
LOST = 0.15
AMBIENT = 0.4
SKY, LINES, SUNLIGHT, SENSORS = "#6f93b8", "#20364f", "#ffd24a", "#c0392b"
# Voxels of the volume that is drawn, along an edge, pixels for each of them; pixels of a picture, at least and at most.
_MOST_VOXELS, _PIXELS, _PIXELS_OF_PICTURE = 96, 4, (120, 360)
# Steps along a ray: at least, and at most.
_STEPS = (16, 160)
# The lowest sun that lights, as the cosine of its zenith angle: lower, shadows have no end.
_LOWEST_SUN = 0.1
# Distances of marks from the centre, in halves of the domain's diagonal.
SENSOR_AT, SUN_AT, NEARER = 1.15, 1.45, 0.82


def sunlight(grid: Grid, extinction: np.ndarray, sun: Sun) -> np.ndarray:
    """The share of sunlight that reaches voxels, shape of the grid: layer by layer from the top down."""
    from scipy.ndimage import shift

    towards = sun.direction
    up = max(float(towards[2]), _LOWEST_SUN)
    sideways = [float(towards[axis]) / up * grid.spacing[2] / grid.spacing[axis] for axis in (0, 1)]
    half = grid.spacing[2] / up / 2
    depth = np.zeros(grid.shape)
    for layer in range(grid.shape[2] - 1, -1, -1):
        if layer + 1 < grid.shape[2]:
            above = depth[:, :, layer + 1] + half * extinction[:, :, layer + 1]
            depth[:, :, layer] = shift(above, [-sideways[0], -sideways[1]], order=1)
        depth[:, :, layer] += half * extinction[:, :, layer]
    return np.exp(-LOST * depth)


def eye_axes(zenith: float, azimuth: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Unit vectors to the right, up, and towards one who looks from there at the cloud."""
    towards = direction(zenith, azimuth)
    phi = np.radians(azimuth)
    right = np.array([-np.sin(phi), np.cos(phi), 0.0])
    return right, np.cross(towards, right), towards


def rendered(grid: Grid, extinction: np.ndarray, sun: Sun) -> np.ndarray:
    """The cloud as seen from EYE, by parallel rays: RGBA, row 0 at the bottom, of a square around the domain."""
    from scipy.ndimage import map_coordinates

    shape = tuple(min(count, _MOST_VOXELS) for count in grid.shape)
    volume, coarse = resample(np.asarray(extinction, float), shape), grid.with_shape(shape)
    light = AMBIENT + (1 - AMBIENT) * sunlight(coarse, volume, sun)
    right, up, towards = eye_axes(*EYE)
    reach = float(np.linalg.norm(grid.extent)) / 2
    pixels = int(np.clip(_PIXELS * 2 * reach / min(coarse.spacing), *_PIXELS_OF_PICTURE))
    across = ((np.arange(pixels) + 0.5) / pixels * 2 - 1) * reach
    start = np.asarray(grid.centre) + across[:, None, None] * up + across[None, :, None] * right + reach * towards
    upper = np.add(grid.origin, grid.extent)
    near, far = clip_to_box(start, np.broadcast_to(-towards, start.shape), np.array(grid.origin), upper)
    hit = near < far
    start, near, through = start[hit], near[hit], (far - near)[hit]
    steps = int(np.clip(np.ceil(through.max() / min(coarse.spacing)), *_STEPS))
    clear, brightness = np.ones(len(start)), np.zeros(len(start))
    for step in range(steps):  # from the eye on
        along = near + (step + 0.5) / steps * through
        places = ((start - along[:, None] * towards - coarse.origin) / coarse.spacing - 0.5).T
        met = map_coordinates(volume, places, order=1, mode="nearest")
        passed = np.exp(-met * through / steps)
        brightness += clear * (1 - passed) * map_coordinates(light, places, order=1, mode="nearest")
        clear *= passed
    picture = np.zeros((pixels, pixels, 4))
    opacity = 1 - clear
    grey = np.divide(brightness, opacity, out=np.ones_like(clear), where=opacity > 0)
    picture[hit] = np.column_stack([grey, grey, grey, opacity]).clip(0, 1)
    return picture


def edges(grid: Grid) -> list[tuple[np.ndarray, np.ndarray]]:
    """The twelve edges of the domain, km."""
    lower, extent = np.array(grid.origin), np.array(grid.extent)
    corners = [np.array([i, j, k]) for i in (0, 1) for j in (0, 1) for k in (0, 1)]
    return [
        (lower + one * extent, lower + (one + step) * extent)
        for one in corners
        for step in np.eye(3, dtype=int)
        if not (one * step).any()
    ]


def plot_volume(
    figure: Figure,
    grid: Grid,
    recovered: np.ndarray,
    truth: np.ndarray | None = None,
    sun: Sun | None = None,
    views: Sequence[View] = (),
) -> None:
    """The recovered cloud in 3-D, beside the true one if known, with the directions of sun, sensors and north.

    Parameters
    ----------
    sun : that lights the cloud; by default it is lit from above, and no sun is drawn
    views : whose directions are drawn, all at one distance

    Raises
    ------
    DataError : an extinction of another shape; an argument is of another kind (InvalidArgumentError)
    """
    require_kinds(
        "plot_volume",
        figure=(figure, able("a Figure of Matplotlib", "subplots")),
        grid=(grid, a(Grid)),
        sun=(sun, a(Sun).or_none()),
        views=(views, many(View)),
    )
    given = {"recovered": recovered} if truth is None else {"true": truth, "recovered": recovered}
    volumes = {name: real_numbers(volume, name) for name, volume in given.items()}
    for name, volume in volumes.items():
        if volume.shape != grid.shape:
            raise DataError(f"plot_volume: the {name} extinction has shape {volume.shape}, the grid {grid.shape}")
    half = float(np.linalg.norm(grid.extent)) / 2
    for panel, (name, volume) in zip(np.ravel(figure.subplots(1, len(volumes))), volumes.items()):
        panel.set_title(name)
        picture = rendered(grid, volume, sun or _ABOVE)
        panel.imshow(picture, extent=(-half, half, -half, half), origin="lower", zorder=3)
        points = np.array(_draw_marks(panel, grid, half, sun, views))
        room = 0.08 * half
        (left, bottom), (right, top) = points.min(axis=0) - room, points.max(axis=0) + room
        panel.set(xlim=(left, right), ylim=(bottom - room, top), xticks=[], yticks=[], facecolor=SKY)


def _draw_marks(
    panel: Axes, grid: Grid, half: float, sun: Sun | None, views: Sequence[View]
) -> list[tuple[float, float]]:
    """Edges, scale, north, sun and sensors; what is nearer than the cloud lies over it. Returns what must be seen."""
    right, up, towards = eye_axes(*EYE)
    centre = np.asarray(grid.centre)

    def seen(point: np.ndarray) -> tuple[float, float]:
        return float((point - centre) @ right), float((point - centre) @ up)

    points = [seen(end) for ends in edges(grid) for end in ends]
    nearest = np.where(towards > 0, np.add(grid.origin, grid.extent), grid.origin)
    for ends in edges(grid):
        front = any(np.allclose(end, nearest) for end in ends)
        style: dict[str, Any] = {"linewidth": 0.8, "alpha": 0.5 if front else 0.9, "zorder": 4 if front else 2}
        panel.plot(*zip(*map(seen, ends)), color=LINES, **style)
    marks = [(str(index), towards_sensor(view, grid), SENSOR_AT, SENSORS) for index, view in enumerate(views)]
    if sun is not None:
        marks.append(("sun", sun.direction, SUN_AT, SUNLIGHT))
    for text, place, distance, colour in marks:
        start, end = (seen(centre + share * distance * half * place) for share in (1.0, NEARER))
        points.append(start)
        order = 5 if place @ towards > 0 else 1
        arrow = {"arrowstyle": "-|>", "color": colour, "linewidth": 1.2, "shrinkA": 0, "shrinkB": 0}
        panel.annotate("", end, start, arrowprops=arrow, zorder=order)
        box = {"boxstyle": "circle,pad=0.15", "facecolor": colour, "edgecolor": "none"}
        light = "black" if text == "sun" else "white"
        panel.text(*start, text, fontsize=7, color=light, ha="center", va="center", bbox=box, zorder=order)
    _draw_scale(panel, grid, seen)
    return points


def _draw_scale(panel: Axes, grid: Grid, seen: Any) -> None:
    """North, and a length, on the ground of the domain's southern edge."""
    corner = np.array(grid.origin)
    length = round_length(grid.extent[0] / 2)
    lifted = np.array([0.0, -0.06 * grid.extent[1], 0.0])
    start, end = corner + lifted, corner + lifted + [length, 0, 0]
    panel.plot(*zip(seen(start), seen(end)), color="white", linewidth=2.5, solid_capstyle="butt", zorder=5)
    middle = seen((start + end) / 2)
    panel.annotate(f"{length:g} km", middle, (0, -10), textcoords="offset points", color="white", fontsize=8,
                   ha="center", va="center", zorder=5)  # fmt: skip
    tail = corner + [1.06 * grid.extent[0], 0.25 * grid.extent[1], 0]
    tip = tail + [0, 0.5 * grid.extent[1], 0]
    arrow = {"arrowstyle": "-|>", "color": "white", "linewidth": 1.5, "shrinkA": 0, "shrinkB": 0}
    panel.annotate("", seen(tip), seen(tail), arrowprops=arrow, zorder=5)
    panel.annotate("N", seen(tip), (0, 7), textcoords="offset points", color="white", fontsize=9, ha="center",
                   va="center", zorder=5)  # fmt: skip


def marks_of(grid: Grid, sun: Sun | None, views: Sequence[View]) -> dict[str, Any]:
    """Directions for the page's view: of sun and sensors, unit vectors and what they are called."""
    sensors = []
    for index, view in enumerate(views):
        towards = towards_sensor(view, grid)
        zenith, azimuth = angles(towards)
        text = f"view {index}, {view.type}: zenith {zenith:.0f}°, azimuth {azimuth:.0f}°"
        sensors.append({"name": str(index), "text": text, "towards": [round(float(part), 5) for part in towards]})
    light = (sun or _ABOVE).direction
    return {
        "light": [round(float(part), 5) for part in light],
        "sun": None if sun is None else f"sun: zenith {sun.zenith:g}°, azimuth {sun.azimuth:g}°",
        "sensors": sensors,
        "eye": EYE,
        "lost": LOST,
        "ambient": AMBIENT,
        "distances": {"sensor": SENSOR_AT, "sun": SUN_AT, "nearer": NEARER},
        "colours": {"sky": SKY, "lines": LINES, "sun": SUNLIGHT, "sensors": SENSORS},
    }
