"""What `cloudtomo render` does."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from cloudtomo_cl.commands.provenance import describe_device, source, versions
from cloudtomo_cl.errors import DataError
from cloudtomo_cl.files.netcdf import check_output, is_netcdf
from cloudtomo_cl.opencl.device import choose_device
from cloudtomo_cl.scene.measurements import Measurements
from cloudtomo_cl.scene.scene import Scene
from cloudtomo_cl.scene.sensors import View
from cloudtomo_cl.scene.visibility import check_views

_DEFAULT_SAMPLES = 256


def render(
    scene: Path,
    samples: int | None,
    target_error: float | None,
    seed: int | None,
    output: Path,
    png: Path | None,
    device: str | None,
    quiet: bool,
    overwrite: bool,
    overrides: Sequence[str] = (),
) -> None:
    """Renders a scene file, or images again, into a file of measurements."""
    from cloudtomo_cl.commands import progress
    from cloudtomo_cl.files.measurements import write_measurements
    from cloudtomo_cl.settings.stored import noise_of_table, stored_noise, stored_scene
    from cloudtomo_cl.transport.adaptive import relative_error, render_to_error
    from cloudtomo_cl.transport.radiance import RadianceOperator

    check_output(output, overwrite)
    if png is not None and (png.is_file() or any(parent.is_file() for parent in png.parents)):
        raise DataError(f"{png}: is a file, or lies beneath one: choose another folder for --png")
    if png is not None and not overwrite and any(png.glob("view_*.png")):
        raise DataError(f"{png}: holds previews already: choose another folder, or add --overwrite")
    described, seen, extinction, radius, made = _to_render(scene, overrides)
    check_views(described, seen)
    if samples is None and target_error is None:
        # Images that are rendered again tell how they were.
        samples, target_error = made.get("samples"), made.get("target_error")
    seed = made.get("seed", 0) if seed is None else seed
    noise = None if made.get("noise") is None else noise_of_table(scene, made["noise"])
    # Images of a recovered cloud have random numbers of their own.
    iteration = made.get("iteration", 0)
    chosen = choose_device(device)
    operator = RadianceOperator(described, seen, chosen, effective_radius=radius)
    console = Console(quiet=quiet)
    start = time.perf_counter()
    if target_error is None:
        count = samples or _DEFAULT_SAMPLES
        with progress.rendering(console, count) as show:
            rendering = operator.render(extinction, count, seed, iteration, progress=show)
        how: dict[str, Any] = {"samples": count} | ({"iteration": iteration} if iteration else {})
    else:
        most = {} if samples is None else {"most_photons": float(samples) * len(operator.pixels)}
        with progress.rendering(console, 100, "%") as show:
            rendering = render_to_error(
                operator, extinction, target_error, seed, **most, progress=lambda share: show(round(100 * share))
            )
        how = {"target_error": target_error} | ({} if samples is None else {"samples": samples})
    seconds = time.perf_counter() - start
    measurements = Measurements.rendered(operator, rendering)
    if noise is not None:
        measurements = noise.added_to(measurements, seed)
        how["noise"] = stored_noise(noise)
    photons = rendering.audit.launched
    write_measurements(
        output,
        measurements,
        {
            "source": source(),
            "device": describe_device(chosen),
            "versions": versions(),
            "photons": float(photons),
            "seconds": seconds,
        },
        {"scene": stored_scene(described), "cloud_file": made["cloud_file"], **how, "seed": seed},
        (described.grid, extinction, radius),
    )
    relative = relative_error(operator, rendering)
    for index, (image, error) in enumerate(zip(measurements.images, measurements.standard_errors)):
        # Pixels have random numbers of their own: their variances add.
        valid = ~np.isnan(image)
        mean_error = np.sqrt((error[valid] ** 2).sum()) / valid.sum()
        line = f"view {index}: mean radiance {progress.with_error(image[valid].mean(), mean_error)} W m^-2 sr^-1"
        line += f", pixel noise {relative[index]:.2%}"
        if noise is not None:
            line += f", with the camera's {np.sqrt(np.mean(error[valid] ** 2)) / image[valid].mean():.2%}"
            line += f", {(~valid).sum()} saturated" if not valid.all() else ""
        console.print(line, highlight=False, soft_wrap=True)
    if target_error is not None and relative.max() > target_error:
        console.print(f"the target of {target_error:.2%} needs more photons than these", soft_wrap=True)
    console.print(f"{photons:.3g} photons in {progress.duration(seconds)} on {chosen.name}: {output}", soft_wrap=True)
    if png is not None:
        from cloudtomo_cl.report.plots import radiance_limit, save_previews

        save_previews(png, measurements)
        white = radiance_limit(measurements)
        console.print(f"previews from 0 (black) to {white:.4g} W m^-2 sr^-1 (white): {png}", soft_wrap=True)


def _to_render(
    path: Path, overrides: Sequence[str]
) -> tuple[Scene, tuple[View, ...], np.ndarray, np.ndarray | None, dict[str, Any]]:
    """Scene, views, extinction, effective radius and settings, of a scene file or of images rendered before."""
    from cloudtomo_cl.files.extinction import read_effective_radius, read_extinction
    from cloudtomo_cl.files.measurements import read_measurements
    from cloudtomo_cl.settings.stored import kept_scene
    from cloudtomo_cl.settings.tables import read_render_settings, views

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
    described, extinction, radius, stored = kept_scene(path, overrides)
    return described, read_measurements(path).views, extinction, radius, stored
