"""What `cloudtomo render` does: everything is read and checked, then the images are computed, then written."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from cloudtomo_cl.commands import progress, ranks, stopping
from cloudtomo_cl.commands.provenance import describe_device, source, versions
from cloudtomo_cl.errors import DataError
from cloudtomo_cl.files.measurements import read_measurements, write_measurements
from cloudtomo_cl.files.netcdf import ENDINGS, check_output, is_netcdf
from cloudtomo_cl.files.wavelengths import read_wavelengths
from cloudtomo_cl.opencl.devices import choose_device
from cloudtomo_cl.scene.measurements import Measurements
from cloudtomo_cl.scene.noise import Noise
from cloudtomo_cl.scene.scene import Scene
from cloudtomo_cl.scene.sensors import View
from cloudtomo_cl.scene.visibility import check_views
from cloudtomo_cl.settings.inputs import input_files
from cloudtomo_cl.settings.scenes import read_scene_file
from cloudtomo_cl.settings.stored import kept_scene, noise_of_table, stored_noise, stored_scene
from cloudtomo_cl.settings.tables import views
from cloudtomo_cl.transport.adaptive import relative_error, render_to_error
from cloudtomo_cl.transport.radiance import RadianceOperator
from cloudtomo_cl.transport.rendering import Rendering

_DEFAULT_SAMPLES = 256


@dataclass(frozen=True)
class Request:
    """What the command line says; see its help."""

    scene: Path
    samples: int | None
    target_error: float | None
    seed: int | None
    output: Path
    png: Path | None
    blind: bool
    overrides: Sequence[str]
    device: str | None
    quiet: bool
    overwrite: bool


@dataclass(frozen=True, eq=False)
class Job:
    """All that a rendering needs; nothing in it can be refused any more.

    Attributes
    ----------
    operators, extinctions : one, or one for each wavelength; km^-1, shape of the scenes' grid
    effective_radius : micrometres, of that shape
    samples, target_error : at least one of them; the target decides, and the samples are then the most
    stream : of the random numbers: images of a recovered cloud have some of their own
    cloud_file : the name of the file that the cloud is from
    """

    request: Request
    operators: tuple[RadianceOperator, ...]
    extinctions: tuple[np.ndarray, ...]
    effective_radius: np.ndarray | None
    samples: int | None
    target_error: float | None
    seed: int
    stream: int
    noise: Noise | None
    cloud_file: str

    @property
    def console(self) -> Console:
        return Console(markup=False, emoji=False, quiet=self.request.quiet)

    @property
    def how(self) -> dict[str, Any]:
        """The number of paths as the settings of the output have it."""
        if self.target_error is None:
            return {"samples": self.samples} | ({"stream": self.stream} if self.stream else {})
        return {"target_error": self.target_error} | ({} if self.samples is None else {"samples": self.samples})


@dataclass(frozen=True)
class Result:
    """Images of each wavelength, with the camera's noise if the scene has one, and the seconds that they took."""

    renderings: tuple[Rendering, ...]
    measurements: tuple[Measurements, ...]
    seconds: float


def prepare(request: Request) -> Job:
    """Reads and checks everything, and builds the kernels. Raises what can be refused."""
    scenes, seen, extinctions, radius, made = _to_render(request.scene, request.overrides)
    inputs = input_files(request.scene, request.overrides)
    check_output(request.output, request.overwrite, ENDINGS, inputs=inputs)
    _check_previews(request.png, request.overwrite)
    check_views(scenes[0], seen)
    stopping.check()
    samples, target_error = request.samples, request.target_error
    if samples is None and target_error is None:
        # Images that are rendered again tell how they were.
        samples, target_error = made.get("samples"), made.get("target_error")
    if samples is None and target_error is None:
        samples = _DEFAULT_SAMPLES
    noise = None if made.get("noise") is None else noise_of_table(request.scene, made["noise"])
    device = choose_device(request.device, ranks.current())
    return Job(
        request=request,
        operators=tuple(RadianceOperator(scene, seen, device, effective_radius=radius) for scene in scenes),
        extinctions=extinctions,
        effective_radius=radius,
        samples=samples,
        target_error=target_error,
        seed=made.get("seed", 0) if request.seed is None else request.seed,
        stream=made.get("stream", 0),
        noise=noise,
        cloud_file=made["cloud_file"],
    )


def execute(job: Job) -> Result:
    """Computes the images."""
    start = time.perf_counter()
    renderings = tuple(_rendered(job, *each) for each in zip(job.operators, job.extinctions))
    seconds = time.perf_counter() - start
    measurements = tuple(map(Measurements.rendered, job.operators, renderings))
    if job.noise is not None:
        # The paths of all wavelengths have the same random numbers; a camera's noise has its own at each.
        measurements = tuple(job.noise.added_to(one, job.seed, index) for index, one in enumerate(measurements))
    return Result(renderings, measurements, seconds)


def _rendered(job: Job, operator: RadianceOperator, extinction: np.ndarray) -> Rendering:
    """The images of one wavelength."""
    light = "" if operator.scene.wavelength is None else f" at {operator.scene.wavelength:g} nm"
    if job.target_error is None:
        assert job.samples is not None
        with progress.rendering(job.console, job.samples, f"samples{light}") as show:
            return operator.render(extinction, job.samples, job.seed, job.stream, progress=show)
    most = {} if job.samples is None else {"most_paths": float(job.samples) * len(operator.pixels)}
    with progress.rendering(job.console, 100, f"%{light}") as show:
        return render_to_error(
            operator,
            extinction,
            job.target_error,
            job.seed,
            **most,
            progress=lambda share: show(round(100 * share)),
        )


def deliver(job: Job, result: Result) -> None:
    """Writes the images, tells about them, and makes previews."""
    operators, request = job.operators, job.request
    _write(job, result)
    worst = 0.0
    for operator, rendering, measurements in zip(operators, result.renderings, result.measurements):
        relative = relative_error(operator, rendering)
        worst = max(worst, float(relative.max()))
        for line in _lines(job, measurements, relative):
            job.console.print(line, highlight=False, soft_wrap=True)
    if job.target_error is not None and worst > job.target_error:
        text = f"the target of {job.target_error:.2%} needs more paths than these"
        job.console.print(text, soft_wrap=True)
    took, paths = progress.duration(result.seconds), sum(one.audit.launched for one in result.renderings)
    job.console.print(f"{paths:.3g} paths in {took} on {operators[0].device.name}: {request.output}", soft_wrap=True)
    if request.png is not None:
        stopping.check()
        _show(job, request.png, result.measurements)


def _write(job: Job, result: Result) -> None:
    """The images, with what renders them again."""
    request, operators = job.request, job.operators
    scenes = [stored_scene(operator.scene) for operator in operators]
    several = len(scenes) > 1
    described: dict[str, Any] = {"scenes": scenes} if several else {"scene": scenes[0]}
    how = job.how if job.noise is None else {**job.how, "noise": stored_noise(job.noise)}
    # Of a blind test not even the random numbers: with them a guessed cloud would be known by its noise.
    settings = described if request.blind else {**described, "cloud_file": job.cloud_file, **how, "seed": job.seed}
    extinction = job.extinctions if several else job.extinctions[0]
    write_measurements(
        request.output,
        result.measurements if several else result.measurements[0],
        {
            "source": source(),
            "device": describe_device(operators[0].device),
            "versions": versions(),
            "paths": float(sum(rendering.audit.launched for rendering in result.renderings)),
            "seconds": result.seconds,
        },
        settings,
        None if request.blind else (operators[0].scene.grid, extinction, job.effective_radius),
    )


def _show(job: Job, folder: Path, measurements: Sequence[Measurements]) -> None:
    """Previews, on one grey scale for each wavelength."""
    from cloudtomo_cl.report.plots import radiance_limit, save_previews

    for one in measurements:
        light = "" if len(measurements) == 1 else f"{one.wavelength:g}nm_"
        save_previews(folder, one, light)
        scale = f"from 0 (black) to {radiance_limit(one):.4g} W m^-2 sr^-1 (white)"
        job.console.print(f"previews{f' at {one.wavelength:g} nm' if light else ''} {scale}: {folder}", soft_wrap=True)


def _lines(job: Job, measurements: Measurements, relative: np.ndarray) -> list[str]:
    """What is printed of each view: its mean radiance and its noise."""
    lines = []
    light = "" if measurements.wavelength is None else f"{measurements.wavelength:g} nm, "
    for index, (image, error) in enumerate(zip(measurements.images, measurements.standard_errors)):
        # Pixels have random numbers of their own: their variances add.
        valid = ~np.isnan(image)
        mean_error = np.sqrt((error[valid] ** 2).sum()) / valid.sum()
        line = f"{light}view {index}: mean radiance {progress.with_error(image[valid].mean(), mean_error)} W m^-2 sr^-1"
        line += f", pixel noise {relative[index]:.2%}"
        if job.noise is not None:
            line += f", with the camera's {np.sqrt(np.mean(error[valid] ** 2)) / image[valid].mean():.2%}"
            line += f", {(~valid).sum()} saturated" if not valid.all() else ""
        lines.append(line)
    return lines


def _check_previews(png: Path | None, overwrite: bool) -> None:
    """DataError if previews cannot go to a folder."""
    if png is not None and (png.is_file() or any(parent.is_file() for parent in png.parents)):
        raise DataError(f"{png}: is a file, or lies beneath one: choose another folder for --png")
    if png is not None and not overwrite and any(png.glob("*view_*.png")):
        raise DataError(f"{png}: holds previews already: choose another folder, or add --overwrite")


def _to_render(
    path: Path, overrides: Sequence[str]
) -> tuple[tuple[Scene, ...], tuple[View, ...], tuple[np.ndarray, ...], np.ndarray | None, dict[str, Any]]:
    """Scenes, views, extinctions, effective radius and settings, of a scene file or of images rendered before."""
    if not is_netcdf(path):
        read = read_scene_file(path, overrides)
        settings = read.settings
        made: dict[str, Any] = {"cloud_file": settings.cloud.file.name, "noise": settings.noise}
        return read.scenes, views(settings.view), read.extinctions, read.effective_radius, made
    wavelengths = read_wavelengths(path) or (None,)
    scenes, extinctions, radii, stored = zip(*(kept_scene(path, overrides, one) for one in wavelengths))
    return scenes, read_measurements(path, wavelengths[0]).views, extinctions, radii[0], stored[0]
