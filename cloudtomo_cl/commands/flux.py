"""What `cloudtomo flux` does."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.console import Console

from cloudtomo_cl.commands.provenance import describe_device, source, versions
from cloudtomo_cl.files.extinction import extinction_dataset
from cloudtomo_cl.files.netcdf import check_output, is_netcdf, save_dataset
from cloudtomo_cl.opencl.device import choose_device
from cloudtomo_cl.scene.scene import Scene

if TYPE_CHECKING:
    from cloudtomo_cl.transport.flux import Fluxes

_DEFAULT_PHOTONS = 1_000_000

_NAMES = {
    "reflected": "upward flux through the top",
    "direct": "downward flux through the bottom, not scattered",
    "diffuse": "downward flux through the bottom, scattered",
    "absorbed": "flux absorbed in the column by droplets and molecules",
}


def flux(
    scene: Path,
    photons: int | None,
    seed: int | None,
    output: Path | None,
    device: str | None,
    quiet: bool,
    overwrite: bool,
    overrides: Sequence[str] = (),
) -> None:
    """Computes the fluxes of a scene file, or of the scene of a file of fluxes or images, column by column."""
    from cloudtomo_cl.commands import progress
    from cloudtomo_cl.settings.stored import stored_scene
    from cloudtomo_cl.transport.flux import FluxOperator

    if output is not None:
        check_output(output, overwrite)
    described, extinction, radius, made = _to_compute(scene, overrides)
    photons = photons or made.get("photons", _DEFAULT_PHOTONS)
    seed = made.get("seed", 0) if seed is None else seed
    chosen = choose_device(device)
    operator = FluxOperator(described, chosen, effective_radius=radius)
    console = Console(quiet=quiet)
    start = time.perf_counter()
    with progress.rendering(console, photons, "photons") as show:
        fluxes = operator.compute(extinction, photons, seed, progress=lambda done: show(min(done, photons)))
    seconds = time.perf_counter() - start
    if output is not None:
        attributes = {
            "title": "fluxes of a cloud scene",
            "source": source(),
            "device": describe_device(chosen),
            "versions": versions(),
            "incident_flux": fluxes.incident,
            "incident_flux_units": "W m-2",
            "photons": float(fluxes.photons),
            "seconds": seconds,
            "seed": seed,
            "settings": {
                "scene": stored_scene(described),
                "cloud_file": made["cloud_file"],
                "photons": photons,
                "seed": seed,
            },
        }
        kept = extinction_dataset(described.grid, extinction, attributes, radius)
        save_dataset(output, kept.assign(_variables(fluxes)))
    for name in ("reflected", "transmitted", "direct", "diffuse", "absorbed"):
        mean = fluxes.domain_mean(name)
        share = mean.value / fluxes.incident
        line = f"{name:<12}{mean.value:10.5f} ± {mean.standard_error:.1g} W m^-2  {share:8.3%} of what comes in"
        console.print(line, highlight=False, soft_wrap=True)
    where = "" if output is None else f": {output}"
    took = progress.duration(seconds)
    console.print(f"{fluxes.photons:.3g} photons in {took} on {chosen.name}{where}", soft_wrap=True)


def _to_compute(
    path: Path, overrides: Sequence[str]
) -> tuple[Scene, np.ndarray, np.ndarray | None, dict[str, Any]]:
    """Scene, extinction, effective radius and settings, of a scene file or of a file that keeps them."""
    from cloudtomo_cl.files.extinction import read_effective_radius, read_extinction
    from cloudtomo_cl.settings.stored import kept_scene
    from cloudtomo_cl.settings.tables import read_flux_settings

    if is_netcdf(path):
        return kept_scene(path, overrides)
    settings = read_flux_settings(path, overrides)
    file = settings.cloud.file
    grid, extinction = read_extinction(file)
    return settings.scene(grid), extinction, read_effective_radius(file), {"cloud_file": file.name}


def _variables(fluxes: Fluxes) -> dict[str, Any]:
    """Fluxes and their standard errors by column, W m^-2."""
    variables = {}
    for name, text in _NAMES.items():
        estimate = getattr(fluxes, name)
        variables[name] = (("x", "y"), estimate.value, {"long_name": text, "units": "W m-2"})
        error = {"long_name": f"standard error of {name}", "units": "W m-2"}
        variables[f"{name}_standard_error"] = (("x", "y"), estimate.standard_error, error)
    return variables
