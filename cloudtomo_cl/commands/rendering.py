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
from cloudtomo_cl.files.extinction import read_effective_radius, read_extinction
from cloudtomo_cl.files.measurements import read_measurements, write_measurements
from cloudtomo_cl.files.netcdf import ENDINGS, check_output, is_netcdf
from cloudtomo_cl.opencl.device import choose_device
from cloudtomo_cl.scene.measurements import Measurements
from cloudtomo_cl.scene.noise import Noise
from cloudtomo_cl.scene.scene import Scene
from cloudtomo_cl.scene.sensors import View
from cloudtomo_cl.scene.visibility import check_views
from cloudtomo_cl.settings.stored import kept_scene, noise_of_table, stored_noise, stored_scene
from cloudtomo_cl.settings.tables import read_render_settings, views
from cloudtomo_cl.transport.adaptive import relative_error, render_to_error
from cloudtomo_cl.transport.radiance import RadianceOperator, Rendering

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


@dataclass(frozen=True)
class Job:
    """All that a rendering needs; nothing in it can be refused any more.

    Attributes
    ----------
    extinction, effective_radius : km^-1 and micrometres, shape of the scene's grid
    samples, target_error : at least one of them; the target decides, and the samples are then the most
    iteration : of the random numbers: images of a recovered cloud have some of their own
    cloud_file : the name of the file that the cloud is from
    """

    request: Request
    operator: RadianceOperator
    extinction: np.ndarray
    effective_radius: np.ndarray | None
    samples: int | None
    target_error: float | None
    seed: int
    iteration: int
    noise: Noise | None
    cloud_file: str

    @property
    def console(self) -> Console:
        return Console(markup=False, emoji=False, quiet=self.request.quiet)

    @property
    def how(self) -> dict[str, Any]:
        """The number of paths as the settings of the output have it."""
        if self.target_error is None:
            return {"samples": self.samples} | ({"iteration": self.iteration} if self.iteration else {})
        return {"target_error": self.target_error} | ({} if self.samples is None else {"samples": self.samples})


@dataclass(frozen=True)
class Result:
    """Images, with the camera's noise if the scene has one, and the seconds that they took."""

    rendering: Rendering
    measurements: Measurements
    seconds: float


def prepare(request: Request) -> Job:
    """Reads and checks everything, and builds the kernels. Raises what can be refused."""
    scene, seen, extinction, radius, made = _to_render(request.scene, request.overrides)
    check_output(request.output, request.overwrite, ENDINGS)
    _check_previews(request.png, request.overwrite)
    check_views(scene, seen)
    stopping.check()
    samples, target_error = request.samples, request.target_error
    if samples is None and target_error is None:
        # Images that are rendered again tell how they were.
        samples, target_error = made.get("samples"), made.get("target_error")
    if target_error is None:
        samples = samples or _DEFAULT_SAMPLES
    noise = None if made.get("noise") is None else noise_of_table(request.scene, made["noise"])
    return Job(
        request=request,
        operator=RadianceOperator(scene, seen, choose_device(request.device, ranks.current()), effective_radius=radius),
        extinction=extinction,
        effective_radius=radius,
        samples=samples,
        target_error=target_error,
        seed=made.get("seed", 0) if request.seed is None else request.seed,
        iteration=made.get("iteration", 0),
        noise=noise,
        cloud_file=made["cloud_file"],
    )


def execute(job: Job) -> Result:
    """Computes the images."""
    start = time.perf_counter()
    if job.target_error is None:
        assert job.samples is not None
        with progress.rendering(job.console, job.samples) as show:
            rendering = job.operator.render(job.extinction, job.samples, job.seed, job.iteration, progress=show)
    else:
        most = {} if job.samples is None else {"most_paths": float(job.samples) * len(job.operator.pixels)}
        with progress.rendering(job.console, 100, "%") as show:
            rendering = render_to_error(
                job.operator,
                job.extinction,
                job.target_error,
                job.seed,
                **most,
                progress=lambda share: show(round(100 * share)),
            )
    seconds = time.perf_counter() - start
    measurements = Measurements.rendered(job.operator, rendering)
    if job.noise is not None:
        measurements = job.noise.added_to(measurements, job.seed)
    return Result(rendering, measurements, seconds)


def deliver(job: Job, result: Result) -> None:
    """Writes the images, tells about them, and makes previews."""
    operator, request = job.operator, job.request
    paths = result.rendering.audit.launched
    how = job.how if job.noise is None else {**job.how, "noise": stored_noise(job.noise)}
    settings = {"scene": stored_scene(operator.scene), "cloud_file": job.cloud_file, **how, "seed": job.seed}
    if request.blind:
        # The random numbers, too: with them a guessed cloud would be known by its noise.
        settings = {"scene": settings["scene"]}
    write_measurements(
        request.output,
        result.measurements,
        {
            "source": source(),
            "device": describe_device(operator.device),
            "versions": versions(),
            "paths": float(paths),
            "seconds": result.seconds,
        },
        settings,
        None if request.blind else (operator.scene.grid, job.extinction, job.effective_radius),
    )
    relative = relative_error(operator, result.rendering)
    for line in _lines(job, result, relative):
        job.console.print(line, highlight=False, soft_wrap=True)
    if job.target_error is not None and relative.max() > job.target_error:
        text = f"the target of {job.target_error:.2%} needs more paths than these"
        job.console.print(text, soft_wrap=True)
    took = progress.duration(result.seconds)
    job.console.print(f"{paths:.3g} paths in {took} on {operator.device.name}: {request.output}", soft_wrap=True)
    if request.png is not None:
        stopping.check()
        from cloudtomo_cl.report.plots import radiance_limit, save_previews

        save_previews(request.png, result.measurements)
        white = radiance_limit(result.measurements)
        text = f"previews from 0 (black) to {white:.4g} W m^-2 sr^-1 (white): {request.png}"
        job.console.print(text, soft_wrap=True)


def _lines(job: Job, result: Result, relative: np.ndarray) -> list[str]:
    """What is printed of each view: its mean radiance and its noise."""
    lines = []
    for index, (image, error) in enumerate(zip(result.measurements.images, result.measurements.standard_errors)):
        # Pixels have random numbers of their own: their variances add.
        valid = ~np.isnan(image)
        mean_error = np.sqrt((error[valid] ** 2).sum()) / valid.sum()
        line = f"view {index}: mean radiance {progress.with_error(image[valid].mean(), mean_error)} W m^-2 sr^-1"
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
    if png is not None and not overwrite and any(png.glob("view_*.png")):
        raise DataError(f"{png}: holds previews already: choose another folder, or add --overwrite")


def _to_render(
    path: Path, overrides: Sequence[str]
) -> tuple[Scene, tuple[View, ...], np.ndarray, np.ndarray | None, dict[str, Any]]:
    """Scene, views, extinction, effective radius and settings, of a scene file or of images rendered before."""
    if not is_netcdf(path):
        settings = read_render_settings(path, overrides)
        file = settings.cloud.file
        grid, extinction = read_extinction(file)
        return (
            settings.scene(grid),
            views(settings.view),
            extinction,
            read_effective_radius(file),
            {"cloud_file": file.name, "noise": settings.noise},
        )
    scene, extinction, radius, stored = kept_scene(path, overrides)
    return scene, read_measurements(path).views, extinction, radius, stored
