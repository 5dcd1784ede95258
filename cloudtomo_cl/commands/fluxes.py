"""What `cloudtomo flux` does: everything is read and checked, then the fluxes are computed, then written."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from cloudtomo_cl.commands import progress, ranks, stopping
from cloudtomo_cl.commands.provenance import describe_device, source, versions
from cloudtomo_cl.errors import SettingsError
from cloudtomo_cl.files.extinction import extinction_dataset
from cloudtomo_cl.files.netcdf import ENDINGS, check_output, is_netcdf, save_dataset
from cloudtomo_cl.opencl.devices import choose_device
from cloudtomo_cl.scene.scene import Boundary, Scene
from cloudtomo_cl.settings.inputs import input_files
from cloudtomo_cl.settings.scenes import read_scene_file
from cloudtomo_cl.settings.stored import kept_scene, stored_scene
from cloudtomo_cl.transport.flux import Fluxes, FluxOperator, can_be_open

_DEFAULT_PHOTONS = 1_000_000

_NAMES = {
    "reflected": "upward flux through the top",
    "direct": "downward flux through the bottom, not scattered",
    "diffuse": "downward flux through the bottom, scattered",
    "absorbed": "flux absorbed in the column by droplets and molecules",
}


@dataclass(frozen=True)
class Request:
    """What the command line says; see its help."""

    scene: Path
    photons: int | None
    seed: int | None
    output: Path | None
    overrides: Sequence[str]
    device: str | None
    quiet: bool
    overwrite: bool


@dataclass(frozen=True, eq=False)
class Job:
    """All that the fluxes need.

    Attributes
    ----------
    extinction, effective_radius : km^-1 and micrometres, shape of the scene's grid
    cloud_file : the name of the file that the cloud is from
    """

    request: Request
    operator: FluxOperator
    extinction: np.ndarray
    effective_radius: np.ndarray | None
    photons: int
    seed: int
    cloud_file: str

    @property
    def console(self) -> Console:
        return Console(markup=False, emoji=False, quiet=self.request.quiet)


@dataclass(frozen=True)
class Result:
    """Fluxes, and the seconds that they took."""

    fluxes: Fluxes
    seconds: float


def prepare(request: Request) -> Job:
    """Reads and checks everything, and builds the kernels. Raises what can be refused."""
    scene, extinction, radius, made = _to_compute(request.scene, request.overrides)
    if request.output is not None:
        inputs = input_files(request.scene, request.overrides)
        check_output(request.output, request.overwrite, ENDINGS, inputs=inputs)
    stopping.check()
    return Job(
        request=request,
        operator=FluxOperator(scene, choose_device(request.device, ranks.current()), effective_radius=radius),
        extinction=extinction,
        effective_radius=radius,
        photons=request.photons or made.get("photons", _DEFAULT_PHOTONS),
        seed=made.get("seed", 0) if request.seed is None else request.seed,
        cloud_file=made["cloud_file"],
    )


def execute(job: Job) -> Result:
    """Follows the photons."""
    start = time.perf_counter()
    most = job.photons
    with progress.rendering(job.console, most, "photons") as show:
        fluxes = job.operator.compute(job.extinction, most, job.seed, progress=lambda done: show(min(done, most)))
    return Result(fluxes, time.perf_counter() - start)


def deliver(job: Job, result: Result) -> None:
    """Writes the fluxes, if a file is wanted, and prints their means."""
    fluxes, output = result.fluxes, job.request.output
    if output is not None:
        scene = job.operator.scene
        kept = extinction_dataset(
            scene.grid, job.extinction, _attributes(job, result), job.effective_radius, wavelength=scene.wavelength
        )
        save_dataset(output, kept.assign(_variables(fluxes)))
    for line in _lines(job.operator.scene, fluxes):
        job.console.print(line, highlight=False, soft_wrap=True)
    where = "" if output is None else f": {output}"
    took = progress.duration(result.seconds)
    job.console.print(f"{fluxes.photons:.3g} photons in {took} on {job.operator.device.name}{where}", soft_wrap=True)


def _lines(scene: Scene, fluxes: Fluxes) -> Iterator[str]:
    """What is printed: the budget, whose lines add up, and of what arrives at the surface its parts."""
    means = {name: fluxes.domain_mean(name) for name in ("reflected", "absorbed", "transmitted", "direct", "diffuse")}
    kept = 1 - scene.surface.albedo
    down = means["transmitted"]
    numbers = {name: (mean.value, mean.standard_error) for name, mean in means.items()}
    budget = {name: numbers[name] for name in ("reflected", "absorbed")}
    budget["surface"] = (kept * down.value, kept * down.standard_error)
    closed = scene.boundary.horizontal == "periodic"
    if not closed:
        # What enters by the sides leaves by them, too: the difference of the others.
        yield "the sides are open: light enters and leaves by them, too, so these lines do not add up to 100 %"
    for name, (value, error) in budget.items():
        yield _line(name, value, error, fluxes.incident)
    if closed:
        total = sum(value for value, _ in budget.values())
        yield f"{'sum':<12}{total:10.5f} of {fluxes.incident:.5f} W m^-2 that come in by the top"
    again = ", what the surface and the cloud send to and fro counted every time" if kept < 1 else ""
    yield f"down at the surface{again}:"
    for name in ("transmitted", "direct", "diffuse"):
        yield _line(name, *numbers[name], fluxes.incident)


def _line(name: str, value: float, error: float, incident: float) -> str:
    return f"{name:<12}{value:10.5f} ± {error:.1g} W m^-2  {value / incident:8.3%} of what comes in"


def _attributes(job: Job, result: Result) -> dict[str, Any]:
    """Of the file, with the settings that repeat it."""
    return {
        "title": "fluxes of a cloud, and its extinction",
        "source": source(),
        "device": describe_device(job.operator.device),
        "versions": versions(),
        "incident_flux": result.fluxes.incident,
        "incident_flux_units": "W m-2",
        "photons": float(result.fluxes.photons),
        "seconds": result.seconds,
        "seed": job.seed,
        "settings": {
            "scene": stored_scene(job.operator.scene),
            "cloud_file": job.cloud_file,
            "photons": job.photons,
            "seed": job.seed,
        },
    }


def _to_compute(path: Path, overrides: Sequence[str]) -> tuple[Scene, np.ndarray, np.ndarray | None, dict[str, Any]]:
    """Scene, extinction, effective radius and settings, of a scene file or of a file that keeps them."""
    if is_netcdf(path):
        return kept_scene(path, overrides)
    read = read_scene_file(path, overrides, with_views=False)
    if len(read.scenes) > 1:
        first = read.scenes[0].wavelength
        raise SettingsError(
            f"{path}: spectrum.wavelengths: fluxes are of one wavelength, for instance with --set "
            f"'spectrum.wavelengths=[{first:g}]'"
        )
    settings, scene, extinction = read.settings, read.scenes[0], read.extinctions[0]
    if "boundary" not in settings.model_fields_set and not can_be_open(scene):
        # As a scene of `init render`: fluxes have no other choice, and nobody has made one.
        _warn(
            f'cloudtomo flux: {path} has no [boundary]: horizontal = "periodic" is taken, for open sides over a '
            "surface that reflects, or beside air, would need endlessly many photons"
        )
        scene = replace(scene, boundary=Boundary("periodic"))
    return scene, extinction, read.effective_radius, {"cloud_file": settings.cloud.file.name}


def _warn(text: str) -> None:
    if ranks.current().is_first:
        print(text, file=sys.stderr)


def _variables(fluxes: Fluxes) -> dict[str, Any]:
    """Fluxes and their standard errors by column, W m^-2."""
    variables = {}
    for name, text in _NAMES.items():
        estimate = getattr(fluxes, name)
        variables[name] = (("y", "x"), estimate.value.T, {"long_name": text, "units": "W m-2"})
        error = {"long_name": f"standard error of {name}", "units": "W m-2"}
        variables[f"{name}_standard_error"] = (("y", "x"), estimate.standard_error.T, error)
    return variables
