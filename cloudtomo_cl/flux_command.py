"""What `cloudtomo flux` does."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rich.console import Console

from cloudtomo_cl.device import choose_device
from cloudtomo_cl.io import check_output, save_dataset
from cloudtomo_cl.provenance import source

_NAMES = {
    "reflected": "upward flux through the top",
    "direct": "downward flux through the bottom, not scattered",
    "diffuse": "downward flux through the bottom, scattered",
    "absorbed": "flux absorbed in the column by droplets and molecules",
}


def flux(
    scene: Path,
    photons: int,
    seed: int,
    output: Path | None,
    device: str | None,
    quiet: bool,
    overwrite: bool,
    overrides: Sequence[str] = (),
) -> None:
    """Computes the fluxes of a scene file, column by column."""
    from cloudtomo_cl import progress
    from cloudtomo_cl.config import read_flux_settings
    from cloudtomo_cl.flux import FluxOperator
    from cloudtomo_cl.io import read_effective_radius, read_extinction

    if output is not None:
        check_output(output, overwrite)
    settings = read_flux_settings(scene, overrides)
    grid, extinction = read_extinction(settings.cloud.file)
    described = settings.scene(grid)
    chosen = choose_device(device)
    operator = FluxOperator(described, chosen, effective_radius=read_effective_radius(settings.cloud.file))
    console = Console(quiet=quiet)
    start = time.perf_counter()
    with progress.rendering(console, photons, "photons") as show:
        fluxes = operator.compute(extinction, photons, seed, progress=lambda done: show(min(done, photons)))
    seconds = time.perf_counter() - start
    if output is not None:
        provenance = {"device": chosen.name, "seconds": seconds, "cloud_file": settings.cloud.file.name}
        _write(output, described, fluxes, provenance)
    for name in ("reflected", "transmitted", "direct", "diffuse", "absorbed"):
        mean = fluxes.domain_mean(name)
        share = mean.value / fluxes.incident
        line = f"{name:<12}{mean.value:10.5f} ± {mean.standard_error:.1g} W m^-2  {share:8.3%} of what comes in"
        console.print(line, highlight=False, soft_wrap=True)
    where = "" if output is None else f": {output}"
    took = progress.duration(seconds)
    console.print(f"{fluxes.photons:.3g} photons in {took} on {chosen.name}{where}", soft_wrap=True)


def _write(path: Path, scene: Any, fluxes: Any, provenance: dict[str, Any]) -> None:
    """Fluxes and their standard errors by column, W m^-2."""
    import json

    import xarray as xr

    from cloudtomo_cl.config import stored_scene

    grid = scene.grid
    variables = {}
    for name, text in _NAMES.items():
        estimate = getattr(fluxes, name)
        variables[name] = (("x", "y"), estimate.value, {"long_name": text, "units": "W m-2"})
        variables[f"{name}_standard_error"] = (
            ("x", "y"), estimate.standard_error, {"long_name": f"standard error of {name}", "units": "W m-2"},
        )  # fmt: skip
    coordinates = {
        axis: (axis, grid.centres(number), {"units": "km", "long_name": f"column centre along {axis}"})
        for number, axis in enumerate("xy")
    }
    attributes = {
        "Conventions": "CF-1.10",
        "title": "fluxes of a cloud scene",
        "source": source(),
        "incident_flux": fluxes.incident,
        "incident_flux_units": "W m-2",
        "photons": float(fluxes.photons),
        "seed": fluxes.seed,
        "settings": json.dumps({"scene": stored_scene(scene)}),
        **provenance,
    }
    save_dataset(path, xr.Dataset(variables, coordinates, attributes))
