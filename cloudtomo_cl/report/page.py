"""One HTML page about a reconstruction that needs nothing beside it: figures, numbers, and slices to slide through."""

from __future__ import annotations

import base64
import html
import json
from collections.abc import Mapping, Sequence
from importlib.resources import files
from string import Template
from typing import Any

import numpy as np

from cloudtomo_cl.report.comparison import in_standard_errors, per_cent
from cloudtomo_cl.report.volume import marks_of
from cloudtomo_cl.scene.grid import Grid, resample
from cloudtomo_cl.scene.measurements import Measurements
from cloudtomo_cl.scene.scene import Sun

# The page holds two bytes for every voxel shown, times 4/3: larger volumes are shown coarser.
_MOST_VOXELS = 500_000
_COLOURS = 256
# Standard errors beyond which a difference is one.
_SEEN = 2
_VIEW_COLUMNS = (
    "view",
    "measured mean (W m⁻² sr⁻¹)",
    "modelled mean",
    "mean difference",
    "root mean square",
    "mean square, standard errors",
    f"beyond {_SEEN} standard errors",
)
_CAPTIONS = {
    "volume": "The cloud from the south-south-west, lit by the sun; arrows show the directions of the sensors, "
    "numbered as the views, not their distances.",
    "maps": "Optical depth from above, and the largest extinction along y and along x.",
    "scatter": "Every voxel that holds cloud in one of the two; the line is perfect agreement.",
    "history": "The cost with its noise, what noise of the images alone would make of it, if that is known, and the "
    "error if the truth is known. Each stage has images of its own (other "
    "pixels, other noise), so the costs of two stages are not compared, and no line joins them.",
    "images": "The measured images, all on one grey scale, with the zenith angle and azimuth (from east towards north) "
    "of the direction from the cloud to the sensor; arrows show where north and the sun are.",
    "comparison": "Measured images, images of the recovered cloud, and their difference: in per cent of the view's "
    "measured mean, and in standard errors of both images together, the gain's among them. Of a perfect recovery one "
    "pixel in twenty would differ by more than two of them.",
}

# Beside the numbers, where the truth is known.
_EXPLAINED = (
    "eps is the sum of the absolute errors of the extinction over the sum of the true extinction: 0 is perfect, 1 is "
    "as bad as no cloud at all. delta is the recovered optical mass (the sum of the extinction times the volume) "
    "less the true one, over the true one: +10 % is a tenth too much cloud."
)


def report_page(
    title: str,
    source: str,
    numbers: Mapping[str, str],
    grid: Grid,
    recovered: np.ndarray,
    figures: Mapping[str, bytes],
    settings: Mapping[str, Any],
    truth: np.ndarray | None = None,
    measurements: Measurements | None = None,
    modelled: Measurements | None = None,
    notes: Sequence[str] = (),
    sun: Sun | None = None,
) -> str:
    """The page as HTML, with figures and volumes inside of it.

    Parameters
    ----------
    title, source : text at the top
    numbers : what counts, by name, with units
    grid, recovered, truth : extinction, km^-1
    figures : PNG files by name, shown in this order
    settings : types of JSON
    measurements, modelled : images, and those of the recovered cloud
    notes : sentences about what is left out, and what to know of the images
    sun : that the cloud is lit by, if it is known
    """
    shown, factor = _coarse_enough(grid)
    # Slices are there to slide through, and the volume to be turned.
    own = ("slices", "volume")
    drawn = "".join(_figure(name, picture) for name, picture in figures.items() if name not in own)
    return Template(_asset("page.html")).substitute(
        style=_asset("page.css"),
        explained="" if truth is None else f'<p class="note">{html.escape(_EXPLAINED)}</p>',
        volume=_picture("volume", figures["volume"]) if "volume" in figures else "",
        scene=json.dumps(marks_of(grid, sun, () if measurements is None else measurements.views)),
        title=html.escape(title),
        source=html.escape(source),
        notes="".join(f'<p class="note">{html.escape(note)}</p>' for note in notes),
        numbers="".join(
            f"<div><dt>{html.escape(name)}</dt><dd>{html.escape(value)}</dd></div>" for name, value in numbers.items()
        ),
        coarser="" if factor == 1 else f"Shown {factor} times coarser than recovered.",
        figures=drawn,
        views="" if measurements is None or modelled is None else _view_table(measurements, modelled),
        settings=html.escape(json.dumps(settings, indent=2)),
        volumes=json.dumps(_volumes(grid, shown, recovered, truth)),
        script=_asset("slices.js") + _asset("volume.js"),
    )


def _asset(name: str) -> str:
    """A file beside this one."""
    return files("cloudtomo_cl.report").joinpath(name).read_text(encoding="utf-8")


def _figure(name: str, picture: bytes) -> str:
    return f"<h2>{html.escape(name.capitalize())}</h2>{_picture(name, picture)}\n"


def _picture(name: str, picture: bytes) -> str:
    text = base64.b64encode(picture).decode("ascii")
    caption = html.escape(_CAPTIONS.get(name, ""))
    image = f'<img alt="{caption}" src="data:image/png;base64,{text}">'
    return f'<figure><div class="wide">{image}</div><figcaption>{caption}</figcaption></figure>'


def _coarse_enough(grid: Grid) -> tuple[Grid, int]:
    factor = 1
    shape = grid.shape
    while np.prod(shape) > _MOST_VOXELS:
        factor += 1
        shape = tuple(-(-count // factor) for count in grid.shape)  # type: ignore[assignment]
    return grid.with_shape(shape), factor


def _volumes(grid: Grid, shown: Grid, recovered: np.ndarray, truth: np.ndarray | None) -> dict[str, Any]:
    """What the script needs: volumes in 16 bits, their scale, colours, and the layer to begin with on every axis."""
    from matplotlib import colormaps

    volumes = {"recovered": recovered} if truth is None else {"true": truth, "recovered": recovered}
    arrays = {name: resample(volume, shown.shape) for name, volume in volumes.items()}
    step = max(max(float(array.max()) for array in arrays.values()), 1e-9) / (2**16 - 1)
    first = next(iter(arrays.values()))
    # A few recovered voxels of noise must not darken all others.
    largest = float(first.max() if truth is not None else np.quantile(first, 0.9995))
    mass = [np.cumsum(first.sum(axis=tuple({0, 1, 2} - {axis}))) for axis in range(3)]
    colours = {
        key: (colormaps[name](np.linspace(0, 1, _COLOURS))[:, :3] * 255).round().astype(int).tolist()
        for key, name in (("sequential", "viridis"), ("diverging", "RdBu_r"))
    }
    return {
        "shape": shown.shape,
        "spacing": shown.spacing,
        "origin": shown.origin,
        "step": step,
        "largest": max(largest, 1e-9),
        # Half of the optical mass on either side: there is something to see.
        "start": [int(np.searchsorted(total, total[-1] / 2)) for total in mass],
        "volumes": [
            {"name": name, "data": base64.b64encode((array / step).round().astype("<u2").tobytes()).decode("ascii")}
            for name, array in arrays.items()
        ],
        **colours,
    }


def _view_table(measurements: Measurements, modelled: Measurements) -> str:
    """What is left of the images, view by view."""
    rows = []
    differences = zip(per_cent(measurements, modelled), in_standard_errors(measurements, modelled))
    for index, (relative, score) in enumerate(differences):
        image = measurements.images[index]
        valid, known = ~np.isnan(image), np.isfinite(score)
        relative, score = relative[valid], score[known]
        cells = [
            str(index),
            f"{image[valid].mean():#.4g}",
            f"{modelled.images[index][valid].mean():#.4g}",
            f"{relative.mean():+.2f} %",
            f"{np.sqrt(np.mean(relative**2)):.1f} %",
            f"{np.mean(score**2):.3g}" if known.any() else "unknown",
            f"{np.mean(np.abs(score) > _SEEN):.1%}" if known.any() else "unknown",
        ]
        rows.append("<tr>" + "".join(f"<td>{cell}</td>" for cell in cells) + "</tr>")
    heads = "".join(f"<th>{name}</th>" for name in _VIEW_COLUMNS)
    return f"<div class='wide'><table><tr>{heads}</tr>{''.join(rows)}</table></div>"
