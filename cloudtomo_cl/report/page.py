"""One HTML page about a reconstruction that needs nothing beside it: figures, numbers, and slices to slide through."""

from __future__ import annotations

import base64
import html
import json
from collections.abc import Mapping, Sequence
from string import Template
from typing import Any

import numpy as np

from cloudtomo_cl.report.comparison import in_standard_errors, per_cent
from cloudtomo_cl.scene.grid import Grid, resample
from cloudtomo_cl.scene.measurements import Measurements

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
    "maps": "Optical depth from above, and the largest extinction along y and along x.",
    "scatter": "Every voxel that holds cloud in one of the two; the line is perfect agreement.",
    "history": "The cost with its noise, and the error if the truth is known; dotted lines are the ends of stages.",
    "images": "The measured images, all on one grey scale.",
    "comparison": "Measured images, images of the recovered cloud, and their difference: in per cent of the view's "
    "measured mean, and in standard errors of both images together, the gain's among them. Of a perfect recovery one "
    "pixel in twenty would differ by more than two of them.",
}

_PAGE = Template("""\
<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>$title</title>
<style>
body { font: 16px/1.5 system-ui, sans-serif; color: #222; max-width: 72rem; margin: 0 auto; padding: 1rem 2rem 4rem; }
h1 { font-size: 1.6rem; margin-bottom: 0; } h2 { font-size: 1.2rem; margin: 2.5rem 0 .5rem; }
p.source { color: #555; margin-top: .2rem; }
dl.numbers { display: flex; flex-wrap: wrap; gap: 1rem 2.5rem; margin: 1.5rem 0; }
dl.numbers dt { color: #555; font-size: .85rem; } dl.numbers dd { margin: 0; font-size: 1.3rem; }
figure { margin: 1rem 0; } figure img { max-width: 100%; } figcaption, .note { color: #555; font-size: .9rem; }
table { border-collapse: collapse; font-size: .9rem; } th, td { text-align: right; padding: .15rem .8rem; }
th { border-bottom: 1px solid #999; font-weight: 600; } td:first-child, th:first-child { text-align: left; }
.wide { overflow-x: auto; }
.panels { display: flex; flex-wrap: wrap; gap: 1.5rem; } .panels figure { margin: 0; }
canvas { image-rendering: pixelated; border: 1px solid #ccc; display: block; cursor: crosshair; }
.controls { display: flex; flex-wrap: wrap; gap: 1rem; align-items: center; margin: .8rem 0; }
input[type=range] { width: 22rem; max-width: 100%; }
.bar { height: 14px; width: 100%; margin-top: .3rem; } .ends { display: flex; justify-content: space-between;
  font-size: .8rem; color: #555; }
output { font-variant-numeric: tabular-nums; }
pre { background: #f5f5f5; padding: .8rem; overflow-x: auto; font-size: .8rem; }
summary { cursor: pointer; }
</style>
</head>
<body>
<h1>$title</h1>
<p class="source">$source</p>
$notes
<dl class="numbers">$numbers</dl>
<h2>Slices</h2>
<div id="viewer">
<div class="controls">
<label>across <select id="axis"><option value="2">z (from above)</option><option value="1">y (from the south)</option>
<option value="0">x (from the east)</option></select></label>
<label><input id="slice" type="range" min="0" step="1" aria-label="layer"></label>
<output id="where"></output>
</div>
<div class="panels" id="panels"></div>
<p class="note"><output id="value">Point at a voxel for its extinction.</output> $coarser</p>
</div>
<noscript><p>The slider needs JavaScript; figures/slices.png shows some layers without.</p></noscript>
$figures
$views
<h2>Settings and device</h2>
<details><summary>All settings, versions and the device</summary><pre>$settings</pre></details>
<script>
const cloud = $volumes;
$script
</script>
</body>
</html>
""")

# Volumes come as unsigned 16-bit numbers, x slowest; a layer is drawn one pixel for each voxel and scaled up.
_SCRIPT = """\
const decode = text => new Uint16Array(Uint8Array.from(atob(text), c => c.charCodeAt(0)).buffer);
const volumes = cloud.volumes.map(v => ({name: v.name, data: decode(v.data)}));
const [nx, ny, nz] = cloud.shape, names = ['x', 'y', 'z'];
const at = (data, i, j, k) => data[(i * ny + j) * nz + k] * cloud.step;
const panels = volumes.map(v => ({title: v.name, colours: cloud.sequential, low: 0, high: cloud.largest,
  value: (i, j, k) => at(v.data, i, j, k)}));
if (volumes.length === 2) panels.push({title: 'recovered - true', colours: cloud.diverging,
  low: -cloud.largest, high: cloud.largest,
  value: (i, j, k) => at(volumes[1].data, i, j, k) - at(volumes[0].data, i, j, k)});
const holder = document.getElementById('panels');
for (const panel of panels) {
  const figure = document.createElement('figure'), caption = document.createElement('figcaption');
  panel.canvas = document.createElement('canvas');
  caption.textContent = panel.title;
  const bar = document.createElement('div'), ends = document.createElement('div');
  bar.className = 'bar'; ends.className = 'ends';
  bar.style.background = 'linear-gradient(to right,' + panel.colours.filter((c, n) => n % 16 === 0 || n === 255)
    .map(c => 'rgb(' + c.join(',') + ')').join(',') + ')';
  for (const text of [panel.low.toPrecision(3), 'extinction, km⁻¹', panel.high.toPrecision(3)]) {
    const span = document.createElement('span'); span.textContent = text; ends.append(span);
  }
  figure.append(caption, panel.canvas, bar, ends); holder.append(figure);
}
const axis = document.getElementById('axis'), slice = document.getElementById('slice');
const where = document.getElementById('where'), value = document.getElementById('value');
const plane = normal => [0, 1, 2].filter(other => other !== normal);
function voxel(normal, index, column, row) {
  const [right, up] = plane(normal), place = [0, 0, 0];
  place[normal] = index; place[right] = column; place[up] = row;
  return place;
}
function draw() {
  const normal = +axis.value, index = +slice.value, [right, up] = plane(normal);
  const width = cloud.shape[right], height = cloud.shape[up];
  const scale = 320 / Math.max(width * cloud.spacing[right], height * cloud.spacing[up]);
  for (const panel of panels) {
    const canvas = panel.canvas, context = canvas.getContext('2d');
    canvas.width = width; canvas.height = height;
    canvas.style.width = width * cloud.spacing[right] * scale + 'px';
    canvas.style.height = height * cloud.spacing[up] * scale + 'px';
    const image = context.createImageData(width, height);
    for (let row = 0; row < height; row++) for (let column = 0; column < width; column++) {
      const share = (panel.value(...voxel(normal, index, column, row)) - panel.low) / (panel.high - panel.low);
      const colour = panel.colours[Math.max(0, Math.min(255, Math.round(share * 255)))];
      image.data.set([...colour, 255], 4 * ((height - 1 - row) * width + column));
    }
    context.putImageData(image, 0, 0);
    canvas.onmousemove = event => {
      const column = Math.min(width - 1, Math.floor(event.offsetX / canvas.clientWidth * width));
      const row = height - 1 - Math.min(height - 1, Math.floor(event.offsetY / canvas.clientHeight * height));
      const place = voxel(normal, index, column, row);
      const position = place.map((n, a) => (cloud.origin[a] + (n + .5) * cloud.spacing[a]).toFixed(3));
      value.textContent = `x ${position[0]}, y ${position[1]}, z ${position[2]} km: ` +
        panels.map(p => `${p.title} ${p.value(...place).toFixed(1)}`).join(', ') + ' km⁻¹';
    };
  }
  const position = cloud.origin[normal] + (index + .5) * cloud.spacing[normal];
  where.textContent = `${names[normal]} = ${position.toFixed(3)} km (layer ${index + 1} of ${cloud.shape[normal]}); ` +
    `${names[right]} to the right, ${names[up]} up`;
}
function choose() {
  slice.max = cloud.shape[+axis.value] - 1;
  slice.value = cloud.start[+axis.value];
  draw();
}
axis.oninput = choose; slice.oninput = draw; choose();"""


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
    notes : sentences about what is left out
    """
    shown, factor = _coarse_enough(grid)
    # Slices are there to slide through.
    drawn = "".join(_figure(name, picture) for name, picture in figures.items() if name != "slices")
    return _PAGE.substitute(
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
        script=_SCRIPT,
    )


def _figure(name: str, picture: bytes) -> str:
    text = base64.b64encode(picture).decode("ascii")
    caption = html.escape(_CAPTIONS.get(name, ""))
    return (
        f'<h2>{html.escape(name.capitalize())}</h2><figure><img alt="{caption}" '
        f'src="data:image/png;base64,{text}"><figcaption>{caption}</figcaption></figure>\n'
    )


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
