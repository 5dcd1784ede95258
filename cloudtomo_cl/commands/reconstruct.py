"""What the commands of `cloudtomo` do."""

from __future__ import annotations

import os
import shlex
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.console import Console
from rich.table import Table

from cloudtomo_cl.commands.cloud import cloud as cloud
from cloudtomo_cl.commands.flux import flux as flux
from cloudtomo_cl.commands.init import init as init
from cloudtomo_cl.commands.mie import mie as mie
from cloudtomo_cl.commands.provenance import describe_device, source, versions
from cloudtomo_cl.commands.render import render as render
from cloudtomo_cl.commands.report import report as report
from cloudtomo_cl.commands.validate import validate as validate
from cloudtomo_cl.errors import DataError, DeviceError, Interrupted, SettingsError
from cloudtomo_cl.files.netcdf import is_netcdf
from cloudtomo_cl.files.truth import read_truth
from cloudtomo_cl.inversion.carving import carved_mask
from cloudtomo_cl.inversion.stages import stages_of
from cloudtomo_cl.opencl.device import Device, choose_device, list_devices
from cloudtomo_cl.scene.measurements import Measurements
from cloudtomo_cl.scene.scene import Scene
from cloudtomo_cl.scene.visibility import check_views
from cloudtomo_cl.transport.radiance import RadianceOperator

if TYPE_CHECKING:
    from cloudtomo_cl.commands.run_folder import RunFolder

_WIDE_TABLE = 160
# Paths of the images of the recovered cloud: some seconds on a CPU.
_MODELLED_PATHS, _FEWEST_MODELLED_SAMPLES = 3e6, 16


def devices() -> None:
    """Prints a table of the OpenCL devices."""
    console = Console()
    if not console.is_terminal:
        # Lines for another program to read are not folded.
        console = Console(width=_WIDE_TABLE)
    table = Table(box=None)
    for heading in ("index", "platform", "name", "type", "compute units", "memory", "OpenCL version", "accumulation"):
        table.add_column(heading)
    for device in list_devices():
        table.add_row(
            str(device.index),
            device.platform,
            device.name,
            device.kind,
            str(device.compute_units),
            f"{device.memory / 2**30:.1f} GiB",
            # "OpenCL 3.0", without what the vendor adds.
            " ".join(device.version.split()[:2]),
            device.accumulation,
        )
    console.print(table)


def reconstruct(
    run: Path,
    seed: int | None,
    output: Path,
    resume: bool,
    device: str | None,
    quiet: bool,
    overwrite: bool,
    overrides: Sequence[str] = (),
    with_report: bool = True,
) -> None:
    """Reconstructs after a run file into a run folder."""
    from cloudtomo_cl.commands.progress import ReconstructionProgress, duration
    from cloudtomo_cl.commands.run_folder import RunFolder
    from cloudtomo_cl.commands.stopping import StopRequest, exit_status
    from cloudtomo_cl.inversion.reconstruct import check_memory
    from cloudtomo_cl.inversion.reconstruct import reconstruct as recover
    from cloudtomo_cl.inversion.records import IterationRecord
    from cloudtomo_cl.inversion.run import records
    from cloudtomo_cl.settings.stored import stored_scene
    from cloudtomo_cl.settings.tables import (
        ReconstructSettings,
        read_reconstruct_settings,
        repeated_reconstruct_settings,
        views,
    )

    if resume and overwrite:
        raise SettingsError("--resume goes on with a run and --overwrite discards it: give one of them")
    folder = RunFolder(output)
    resumed = folder.read_checkpoint() if resume else None
    if resumed is None:
        # Without a checkpoint there is nothing that a resume could lose.
        folder.check_new(overwrite or resume)
    if is_netcdf(run):
        measurements, stored = _read_measurements(run)
        settings: ReconstructSettings = repeated_reconstruct_settings(run, stored, overrides)
    else:
        settings = read_reconstruct_settings(run, overrides)
        measurements, stored = _read_measurements(settings.measurements.file)
    if settings.view is not None:
        try:
            measurements = replace(measurements, views=views(settings.view))
        except DataError as error:
            raise SettingsError(f"{run}: view: the views do not fit {settings.measurements.file}: {error}") from None
    scene = settings.scene(stored.get("scene", {}))
    truth = None if settings.truth is None else read_truth(settings.truth.file, scene.grid)
    check_views(scene, measurements.views)
    chosen = choose_device(device)
    stages = stages_of(scene.grid, settings.stage, settings.solver)
    check_memory(scene, measurements, stages, chosen)
    given_seed, seed = seed, settings.run.seed if seed is None else seed
    console = Console(quiet=quiet)
    if measurements.bad_pixels:
        share = measurements.bad_pixels / sum(image.size for image in measurements.images)
        console.print(f"{measurements.bad_pixels} bad pixels ({share:.2%}) are not used", highlight=False)
    before: list[IterationRecord] = []
    if resumed is None:
        if resume:
            console.print(f"{output} has no checkpoint: starting from the beginning", highlight=False, soft_wrap=True)
        console.print("building kernels, carving space ...", highlight=False)
        mask = carved_mask(scene, measurements, chosen)
        console.print(f"space carving keeps {mask.mean():.1%} of the voxels", highlight=False)
    else:
        mask, before = resumed.mask, records(resumed)
        where = f"stage {resumed.stage + 1}, iteration {resumed.iterations}"
        console.print(f"going on from {where}, {duration(resumed.seconds)}", highlight=False)
        if resumed.device != chosen.name:
            console.print(f"the run was on {resumed.device}: on {chosen.name} bits may differ", soft_wrap=True)
    folder.begin(
        {
            "settings": settings.model_dump(mode="json", exclude={"measurements", "truth"}),
            "files": {
                # As seen from the run folder, so that both may move together.
                name: os.path.relpath(table.file, output)
                for name, table in (("measurements", settings.measurements), ("truth", settings.truth))
                if table is not None
            },
            "scene": stored_scene(scene),
            "seed": seed,
            "device": describe_device(chosen),
            "versions": versions(),
        },
        before or None,
    )
    again = _resume_command(run, given_seed, output, device, overrides)
    try:
        with (
            ReconstructionProgress(console, settings.run.time_limit) as show,
            StopRequest().listening() as stop,
        ):
            show.go_on(before)

            def record(iteration: Any) -> None:
                folder.append(iteration)
                show(iteration)

            result = recover(
                scene,
                measurements,
                settings.stage,
                settings.prior,
                settings.solver,
                mask=mask,
                device=chosen,
                seed=seed,
                time_limit=settings.run.time_limit,
                truth=truth,
                callback=record,
                checkpoint=folder.checkpoint_file,
                checkpoint_interval=settings.run.checkpoint_interval,
                resume=resumed,
                stop=stop,
                uncertainty=settings.run.uncertainty,
            )
    except (DeviceError, DataError) as error:
        # Of the device, or of the disk: both may be in order tomorrow.
        if folder.checkpoint_file.is_file() and (folder.started or isinstance(error, DeviceError)):
            raise type(error)(f"{error}\nwhat was reached is kept in {folder.checkpoint_file}: {again}") from None
        raise
    finally:
        folder.close()
    last = result.history[-1]
    where = f"stage {last.stage + 1} of {last.stages}, iteration {last.iteration + 1}"
    if stop.signal_number is not None:
        state = f"interrupted in {where}"
    elif result.timed_out:
        state = f"stopped by its time limit in {where}"
    else:
        state = "complete"
    folder.write_reconstruction(
        result.grid,
        result.extinction,
        result.mask,
        {
            "source": source(),
            "seed": seed,
            "device": describe_device(chosen),
            "versions": versions(),
            "photons": float(last.paths),
            "seconds": last.seconds,
            "state": state,
        },
        measurements,
        {
            "scene": stored_scene(scene),
            "reconstruct": settings.model_dump(mode="json", exclude={"measurements", "truth"}),
            "seed": seed,
        },
        result.standard_error,
    )
    if stop.signal_number is not None:
        status = exit_status(stop.signal_number)
        raise Interrupted(f"interrupted in {where}; what was reached is in {output}: {again}", status)
    console.print(f"{last.paths:.3g} photons in {duration(last.seconds)} on {chosen.name}: {state}", soft_wrap=True)
    if not result.extinction.any():
        console.print("the images leave no cloud: take less noisy ones, or give the prior less weight ([prior])")
        return
    console.print("rendering the images of the recovered cloud ...", highlight=False)
    _write_modelled(folder, scene, measurements, result.extinction, chosen, seed, len(result.history) + 1)
    if with_report:
        console.print(f"drawing figures and {folder.report_file} ...", highlight=False, soft_wrap=True)
        report(output, quiet=True)
    if truth is None:
        mass = float(result.extinction.sum(dtype=float)) * result.grid.voxel_volume
        summary = f"optical mass {mass:.4g} km^2  {output}"
    else:
        from cloudtomo_cl.scene.metrics import delta, epsilon

        summary = (
            f"eps {epsilon(result.extinction, truth):.3f}  delta {delta(result.extinction, truth):+.1%}  {output}"
        )
    console.print(summary, highlight=False, soft_wrap=True)


def _resume_command(
    run: Path, seed: int | None, output: Path, device: str | None, overrides: Sequence[str]
) -> str:
    """How to go on, as a line to copy."""
    words = ["cloudtomo", "reconstruct", str(run), "--output", str(output), "--resume"]
    for name, value in (("--seed", seed), ("--device", device)):
        if value is not None:
            words += [name, str(value)]
    for override in overrides:
        words += ["--set", override]
    return f"go on with\n  {shlex.join(words)}"


def _write_modelled(
    folder: RunFolder,
    scene: Scene,
    measurements: Measurements,
    extinction: np.ndarray,
    device: Device,
    seed: int,
    iteration: int,
) -> None:
    """What the recovered cloud looks like from the measured views, for the report to compare with."""
    from cloudtomo_cl.files.measurements import write_measurements
    from cloudtomo_cl.settings.stored import stored_scene

    operator = RadianceOperator(scene, measurements.views, device)
    samples = max(_FEWEST_MODELLED_SAMPLES, 2 * round(_MODELLED_PATHS / len(operator.pixels) / 2))
    modelled = Measurements.rendered(operator, operator.render(extinction, samples, seed, iteration))
    write_measurements(
        folder.modelled_file,
        modelled,
        {"source": source(), "device": describe_device(device), "versions": versions()},
        {
            "scene": stored_scene(scene),
            "cloud_file": folder.reconstruction_file.name,
            "samples": samples,
            "seed": seed,
            "iteration": iteration,
        },
        (scene.grid, extinction, None),
    )


def _read_measurements(path: Path) -> tuple[Measurements, dict[str, Any]]:
    """Images, and the settings they were made with; images from elsewhere have none."""
    from cloudtomo_cl.files.measurements import read_measurements, read_settings

    measurements = read_measurements(path)
    try:
        return measurements, read_settings(path)
    except DataError:
        return measurements, {}
