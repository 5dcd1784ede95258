"""What `cloudtomo render` does."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from rich.console import Console

from cloudtomo_cl.carving import check_views
from cloudtomo_cl.device import choose_device
from cloudtomo_cl.errors import DataError
from cloudtomo_cl.io import check_output
from cloudtomo_cl.measurements import Measurements
from cloudtomo_cl.provenance import source

_DEFAULT_SAMPLES = 256


def render(
    scene: Path,
    samples: int | None,
    target_error: float | None,
    seed: int,
    output: Path,
    png: Path | None,
    device: str | None,
    quiet: bool,
    overwrite: bool,
    overrides: Sequence[str] = (),
) -> None:
    """Renders a scene file into a file of measurements."""
    from cloudtomo_cl import progress
    from cloudtomo_cl.adaptive import relative_error, render_to_error
    from cloudtomo_cl.config import read_render_settings, stored_scene, views
    from cloudtomo_cl.io import read_effective_radius, read_extinction, write_measurements
    from cloudtomo_cl.transport import RadianceOperator

    check_output(output, overwrite)
    if png is not None and (png.is_file() or any(parent.is_file() for parent in png.parents)):
        raise DataError(f"{png}: is a file, or lies beneath one: choose another folder for --png")
    if png is not None and not overwrite and any(png.glob("view_*.png")):
        raise DataError(f"{png}: holds previews already: choose another folder, or add --overwrite")
    settings = read_render_settings(scene, overrides)
    grid, extinction = read_extinction(settings.cloud.file)
    described = settings.scene(grid)
    check_views(described, views(settings.view))
    chosen = choose_device(device)
    operator = RadianceOperator(
        described, views(settings.view), chosen, effective_radius=read_effective_radius(settings.cloud.file)
    )
    console = Console(quiet=quiet)
    start = time.perf_counter()
    if target_error is None:
        count = samples or _DEFAULT_SAMPLES
        with progress.rendering(console, count) as show:
            rendering = operator.render(extinction, count, seed, progress=show)
        how = {"samples": count}
    else:
        most = {} if samples is None else {"most_photons": float(samples) * len(operator.pixels)}
        with progress.rendering(console, 100, "%") as show:
            rendering = render_to_error(
                operator, extinction, target_error, seed, **most, progress=lambda share: show(round(100 * share))
            )
        how = {"target_error": target_error}
    seconds = time.perf_counter() - start
    measurements = Measurements.rendered(operator, rendering)
    photons = rendering.audit.launched
    write_measurements(
        output,
        measurements,
        {"source": source(), "device": chosen.name, "photons": float(photons), "seconds": seconds},
        {"scene": stored_scene(described), "cloud_file": settings.cloud.file.name, **how, "seed": seed},
    )
    noise = relative_error(operator, rendering)
    for index, (image, error) in enumerate(zip(measurements.images, measurements.standard_errors)):
        # Pixels have random numbers of their own: their variances add.
        mean_error = np.sqrt((error**2).sum()) / image.size
        line = f"view {index}: mean radiance {image.mean():.5g} ± {mean_error:.1g} W m^-2 sr^-1"
        console.print(f"{line}, pixel noise {noise[index]:.2%}", highlight=False, soft_wrap=True)
    if target_error is not None and noise.max() > target_error:
        console.print(f"the target of {target_error:.2%} needs more than {samples} photons per pixel", soft_wrap=True)
    console.print(f"{photons:.3g} photons in {progress.duration(seconds)} on {chosen.name}: {output}", soft_wrap=True)
    if png is not None:
        from cloudtomo_cl.plots import radiance_limit, save_previews

        save_previews(png, measurements)
        white = radiance_limit(measurements)
        console.print(f"previews from 0 (black) to {white:.4g} W m^-2 sr^-1 (white): {png}", soft_wrap=True)
