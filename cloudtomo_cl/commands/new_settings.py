"""The texts of commented settings files of scenes and runs. Imports what is slow when it is called."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from cloudtomo_cl.clouds.volume import CloudVolume

# Views of the example: how far off the vertical the ring is seen, and how many radii of the cloud away.
_RING_ZENITH, _DISTANCE = 40.0, 4.0
_FEWEST_PIXELS, _MOST_PIXELS = 32, 128
# Meanings of keys are wrapped: no line is longer than 120 characters.
_COMMENT_WIDTH = 84
# Values for keys that have no default, in tables that are there as comments.
_EXAMPLES = {
    # Molecules at 550 nm near the ground (Bodhaine et al. 1999, J. Atmos. Oceanic Technol. 16, 1854).
    ("air", "extinction"): 0.011,
    ("stage", "grid"): [32, 32, 32],
    ("run", "time_limit"): 600.0,
}

_SCENE = """\
# What `cloudtomo render` renders. Lengths in km, extinction in km^-1, angles in degrees, radiance in W m^-2 sr^-1;
# x runs east, y north, z up, the ground is z = 0; azimuth runs from +x (east) towards +y (north).
# Lines that begin with # are comments: what is optional is there with its default.

[cloud]
file = {cloud}                    # beside this file; `cloudtomo cloud` makes it
single_scattering_albedo = 1.0    # of the droplets; 1 absorbs nothing
phase_function = {{ type = "henyey-greenstein", g = 0.85 }}

[sun]
zenith = 30.0                     # where the sun stands, as seen from the scene
azimuth = 0.0
irradiance = 1.0                  # W m^-2, on a plane normal to the beam

[surface]
albedo = 0.05                     # Lambertian; the open sea is about this dark

# The images' own noise is that of the paths. This adds a camera's: photons, reading, digits, calibration.
# [noise]
# full_well = 20000               # electrons of a full pixel; or signal_to_noise
# read_noise = 10.0               # electrons
# bits = 12
# calibration_error = 0.02        # of each view's gain

# Several wavelengths go into one file: docs/how-to/wavelengths.md says what follows from what.
# [spectrum]
# wavelengths = [672.0]           # nm; several, as [672.0, 2130.0], need a table of phase functions that has them
# irradiance = [1.5]              # W m^-2, at each, in place of that of the sun
# surface_albedo = [0.05]         # at each, in place of that of the surface

# One table [[view]] for each image, or for each group of images. This one is a camera above the cloud and eight
# around it, which look at it {zenith:g} degrees off the vertical.
[[view]]
type = "ring"
target = {target}                 # km; what all cameras look at
height = {height}                 # km above the ground
radius = {radius}                 # km around the vertical through the target
field_of_view = {field_of_view}   # degrees, across an image's width
pixels = [{pixels}, {pixels}]     # width, height

# Another kind of view: from far away.
# [[view]]
# type = "orthographic"
# zenith = 40.0                   # direction from the scene to the sensor
# azimuth = 90.0
# width = {width}                 # km across the image, measured across the rays
# pixels = [{pixels}, {pixels}]
"""

_RUN = """\
# What `cloudtomo reconstruct` recovers the cloud from. What is not said here the images tell: their views, the sun,
# the droplets' optics, the surface and the voxels. A table of the scene ([sun], [cloud], [[view]] ...) takes its place.
# Lines that begin with # are comments: what is optional is there with its default.

[measurements]
file = {measurements}             # beside this file; by `cloudtomo render`; format: docs/how-to/measurements.md

{truth}
"""


def scene_file(cloud: Path | None, folder: Path) -> str:
    """The text of a scene file in a folder, with views that see the whole cloud."""
    from cloudtomo_cl.scene.scene import Air, Boundary

    volume = None
    if cloud is None:
        cloud, views = folder / "cloud.nc", _views((0.4, 0.4, 0.45), 0.5, 0.025)
    else:
        from cloudtomo_cl.clouds.readers import read_cloud

        volume = read_cloud(cloud)
        views = _views_of(volume)
    text = _SCENE.format(cloud=_relative(cloud, folder), **views)
    if volume is not None and volume.effective_radius is not None:
        text = text.replace("\n[sun]", f"{_radii_text(volume)}\n[sun]", 1)
    return "\n".join([_aligned(text), *_commented("boundary", Boundary), *_commented("air", Air), ""])


def _radii_text(volume: CloudVolume) -> str:
    """A comment: the file knows its droplets' radii, and a phase function without radii takes no notice of them."""
    import numpy as np

    assert volume.effective_radius is not None
    known = volume.effective_radius[(volume.extinction > 0) & np.isfinite(volume.effective_radius)]
    if not known.size:
        return ""
    first, last = np.floor(known.min()), np.ceil(known.max())
    radii = f"{first:g} {last:g} --count {max(2, round(last - first) + 1)}" if last > first else f"{first:g}"
    return (
        f"# The file has its droplets' effective radii, {known.min():.3g} to {known.max():.3g} um, of which this\n"
        "# phase function takes no notice. A table by Mie's theory does, voxel by voxel:\n"
        f"#   cloudtomo mie --wavelength 672 --effective-radius {radii} --output mie.nc\n"
        '# phase_function = { type = "table", file = "mie.nc" }\n'
    )


def run_file(measurements: Path, truth: Path | None, folder: Path) -> str:
    """The text of a run file in a folder."""
    from cloudtomo_cl.inversion.priors import PatchPrior
    from cloudtomo_cl.inversion.solvers.gauss_newton import GaussNewton
    from cloudtomo_cl.inversion.stages import Stage
    from cloudtomo_cl.settings.tables import Run

    known = "[truth]                           # for the errors eps and delta, never for the recovery\nfile = "
    if truth is None:
        shown = "# " + known.replace("\n", "\n# ") + '"cloud.nc"'
    else:
        shown = known + _relative(truth, folder)
    text = _aligned(_RUN.format(measurements=_relative(measurements, folder), truth=shown))
    tables = (("run", Run), ("prior", PatchPrior), ("solver", GaussNewton))
    lines = [line for name, kind in tables for line in _commented(name, kind)]
    stages = ["\n# Stages, from coarse to fine, as many tables as there are; without any they are chosen by the grid."]
    return "\n".join([text, *lines, *stages, *_commented("stage", Stage, "[[stage]]"), ""])


def _relative(file: Path, folder: Path) -> str:
    """As the settings file in the folder must call it."""
    import json

    path = file if file.is_absolute() else Path(os.path.relpath(file, folder))
    return json.dumps(path.as_posix())


def _views_of(cloud: CloudVolume) -> dict[str, Any]:
    """Cameras far enough away that the box around the cloudy voxels is in all their images."""
    import numpy as np

    corners = []
    for axis in range(3):
        others = tuple(other for other in range(3) if other != axis)
        cloudy = np.flatnonzero(cloud.extinction.any(axis=others))
        start, edge = cloud.grid.origin[axis], cloud.grid.spacing[axis]
        corners.append((start + cloudy[0] * edge, start + (cloudy[-1] + 1) * edge))
    box = np.array(corners)
    radius = float(np.linalg.norm(box[:, 1] - box[:, 0])) / 2
    return _views(tuple(float(middle) for middle in box.mean(axis=1)), radius, cloud.grid.spacing[0])


def _views(target: tuple[float, ...], radius: float, spacing: float) -> dict[str, Any]:
    """The numbers of a ring of cameras around a ball, with about one pixel for each voxel across it."""
    import numpy as np

    above = _DISTANCE * radius * np.cos(np.radians(_RING_ZENITH))
    # The camera above stands nearest: what it sees whole, all do.
    field_of_view = float(np.ceil(2 * np.degrees(np.arcsin(radius / above))))
    width = 2 * _DISTANCE * radius * np.tan(np.radians(field_of_view / 2))
    return {
        "target": [round(value, 4) for value in target],
        "height": round(target[2] + above, 3),
        "radius": round(above * np.tan(np.radians(_RING_ZENITH)), 3),
        "field_of_view": field_of_view,
        "pixels": int(np.clip(np.ceil(width / spacing), _FEWEST_PIXELS, _MOST_PIXELS)),
        "width": round(2.1 * radius, 3),
        "zenith": _RING_ZENITH,
    }


def _aligned(text: str) -> str:
    """Comments behind values in one column, whatever the values' lengths."""
    lines = []
    for line in text.splitlines():
        code, mark, comment = line.partition("  #")
        lines.append(f"{code.rstrip():<33} #{comment}" if mark and code.strip() else line)
    return "\n".join(lines)


def _commented(name: str, kind: type, heading: str | None = None) -> Iterator[str]:
    """A table with its defaults, as comments."""
    import dataclasses
    import textwrap

    from cloudtomo_cl.settings.reference_page import attribute_meanings, default_value, toml

    yield f"\n# {heading or f'[{name}]'}"
    meanings = attribute_meanings(kind)
    for field in dataclasses.fields(kind):
        has_default, value = default_value(field)
        if not has_default or value is None:
            value = _EXAMPLES.get((name, field.name))
        code = field.name if value is None else f"{field.name} = {toml(value)}"
        first, *more = textwrap.wrap(meanings.get(field.name, ""), _COMMENT_WIDTH) or [""]
        yield f"# {code:<31} # {first}".rstrip(" #")
        for line in more:
            yield f"# {'':<31} # {line}"
