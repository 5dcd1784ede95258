"""What `cloudtomo reconstruct` does: everything is read and checked, then the cloud is recovered, then delivered."""

from __future__ import annotations

import os
import shlex
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from cloudtomo_cl.commands import ranks, stopping
from cloudtomo_cl.commands.modelled import write_modelled
from cloudtomo_cl.commands.progress import ReconstructionProgress, duration, with_error
from cloudtomo_cl.commands.provenance import describe_device, digest, source, versions
from cloudtomo_cl.commands.reporting import make_report
from cloudtomo_cl.commands.run_folder import RunFolder
from cloudtomo_cl.commands.stopping import exit_status
from cloudtomo_cl.errors import DataError, DeviceError, Interrupted, RecoveryWarning, SettingsError
from cloudtomo_cl.files.measurements import read_measurements
from cloudtomo_cl.files.netcdf import is_netcdf
from cloudtomo_cl.files.stored_settings import read_settings
from cloudtomo_cl.files.truth import read_truth
from cloudtomo_cl.inversion.bound_priors import unlike_prior
from cloudtomo_cl.inversion.carving import carved_mask
from cloudtomo_cl.inversion.checkpoint import Checkpoint
from cloudtomo_cl.inversion.checks import check, check_memory, doubtful_texts
from cloudtomo_cl.inversion.outliers import outlier_text
from cloudtomo_cl.inversion.reconstruct import reconstruct
from cloudtomo_cl.inversion.records import COLUMNS, IterationRecord, Reconstruction
from cloudtomo_cl.inversion.run import records
from cloudtomo_cl.inversion.stages import stages_of
from cloudtomo_cl.opencl.device import Device
from cloudtomo_cl.opencl.devices import choose_device
from cloudtomo_cl.scene.measurements import Measurements
from cloudtomo_cl.scene.metrics import delta, epsilon
from cloudtomo_cl.scene.scene import Scene
from cloudtomo_cl.scene.visibility import check_views
from cloudtomo_cl.settings.inputs import input_files
from cloudtomo_cl.settings.stored import stored_scene
from cloudtomo_cl.settings.tables import (
    ReconstructSettings,
    read_reconstruct_settings,
    repeated_reconstruct_settings,
    views,
)


@dataclass(frozen=True)
class Request:
    """What the command line says; see its help."""

    run: Path
    seed: int | None
    output: Path
    resume: bool
    with_report: bool
    overrides: Sequence[str]
    device: str | None
    quiet: bool
    overwrite: bool

    @cached_property
    def folder(self) -> RunFolder:
        """Where it goes; to be held (`RunFolder.held`) from before `prepare` until after `deliver`."""
        return RunFolder(self.output, self.overwrite)

    @property
    def resume_command(self) -> str:
        """How to go on, as a line to copy."""
        words = ["cloudtomo", "reconstruct", str(self.run), "--output", str(self.output), "--resume"]
        for name, value in (("--seed", self.seed), ("--device", self.device)):
            if value is not None:
                words += [name, str(value)]
        for override in self.overrides:
            words += ["--set", override]
        return f"go on with\n  {shlex.join(words)}"


@dataclass(frozen=True, eq=False)
class Job:
    """All that a recovery needs.

    Attributes
    ----------
    truth : the known cloud on the scene's grid, km^-1, if there is one
    resumed : the checkpoint to go on from; none at the start
    """

    request: Request
    folder: RunFolder
    settings: ReconstructSettings
    measurements: Measurements
    scene: Scene
    truth: np.ndarray | None
    device: Device
    seed: int
    resumed: Checkpoint | None

    @property
    def console(self) -> Console:
        return Console(markup=False, emoji=False, quiet=self.request.quiet)

    @property
    def stored_settings(self) -> dict[str, Any]:
        """The settings as files keep them: without measurements and truth, and with the seed that was taken."""
        kept = self.settings.model_dump(mode="json", exclude={"measurements", "truth"})
        if kept["prior"].get("file") is not None:
            kept["prior"]["file"] = self.from_output(kept["prior"]["file"])
        return {**kept, "run": {**kept["run"], "seed": self.seed}}

    def from_output(self, file: str | Path) -> str:
        """A file's path as seen from the run folder, so that both may move together."""
        return os.path.relpath(file, self.request.output)

    def say(self, text: str) -> None:
        self.console.print(text, highlight=False, soft_wrap=True)


@dataclass(frozen=True)
class Outcome:
    """A recovered cloud, and the signal that ended its recovery early, if one did."""

    result: Reconstruction
    signal_number: int | None

    @property
    def where(self) -> str:
        last = self.result.history[-1]
        return f"stage {last.stage + 1} of {last.stages}, iteration {last.iteration + 1}"

    @property
    def state(self) -> str:
        if self.signal_number is not None:
            return f"interrupted in {self.where}"
        return f"stopped by its time limit in {self.where}" if self.result.timed_out else "complete"


def prepare(request: Request) -> Job:
    """Reads and checks everything. Raises what can be refused before the first path."""
    if request.resume and request.overwrite:
        raise SettingsError("--resume goes on with a run and --overwrite discards it: give one of them")
    settings, measurements, stored = _read(request)
    folder = request.folder
    resumed = folder.read_checkpoint() if request.resume else None
    if ranks.current().is_first:
        inputs = (*input_files(request.run, request.overrides), getattr(settings.prior, "file", None))
        read = [file for file in inputs if file is not None]
        if request.resume:
            # What a run goes on from, a result with its images, stays whole: the new result has them, too. Without a
            # checkpoint there is nothing that a resume could lose.
            own = os.path.realpath(folder.files.reconstruction)
            folder.check_own(file for file in read if os.path.realpath(file) != own)
        else:
            folder.check_new(read)
    scene = settings.scene(stored.get("scene", {}))
    if scene.wavelength is None:
        scene = replace(scene, wavelength=measurements.wavelength)
    truth = None if settings.truth is None else read_truth(settings.truth.file, scene.grid, measurements.wavelength)
    check_views(scene, measurements.views)
    device = choose_device(request.device, ranks.current())
    seed = settings.run.seed if request.seed is None else request.seed
    what = scene, measurements, settings.stage, settings.prior, settings.solver
    check(*what, device=device, seed=seed, truth=truth, resume=resumed)
    stopping.check()
    return Job(
        request=request,
        folder=folder,
        settings=settings,
        measurements=measurements,
        scene=scene,
        truth=truth,
        device=device,
        seed=seed,
        resumed=resumed,
    )


def _read(request: Request) -> tuple[ReconstructSettings, Measurements, dict[str, Any]]:
    """Settings, images with the views that the settings give them, and the settings that the images were made with."""
    if is_netcdf(request.run):
        measurements, stored = _read_measurements(request.run)
        settings = repeated_reconstruct_settings(request.run, stored, request.overrides)
    else:
        settings = read_reconstruct_settings(request.run, request.overrides)
        measurements, stored = _read_measurements(settings.measurements.file, settings.measurements.wavelength)
    if settings.view is not None:
        try:
            measurements = replace(measurements, views=views(settings.view))
        except DataError as error:
            file = settings.measurements.file
            raise SettingsError(f"{request.run}: view: the views do not fit {file}: {error}") from None
    return settings, measurements, stored


def _read_measurements(path: Path, wavelength: float | None = None) -> tuple[Measurements, dict[str, Any]]:
    """Images of one wavelength, and the settings they were made with; images from elsewhere have none."""
    return read_measurements(path, wavelength), read_settings(path, required=False, wavelength=wavelength)


def execute(job: Job) -> Outcome:
    """Recovers the cloud; the folder has a history and checkpoints from the first iteration on."""
    stop = stopping.current()
    _say_what_begins(job)
    mask = _carve(job) if job.resumed is None else job.resumed.mask
    before = [] if job.resumed is None else records(job.resumed)
    _say_what_is_doubtful(job, mask)
    job.folder.begin(_description(job), before or None)
    stop.answer = "finishing the iteration"
    try:
        with warnings.catch_warnings(), ReconstructionProgress(job.console, job.settings.run.time_limit) as show:
            warnings.simplefilter("ignore", RecoveryWarning)  # what they say is told already
            show.go_on(before)

            def record(iteration: IterationRecord) -> None:
                job.folder.append(iteration)
                show(iteration)

            result = reconstruct(
                job.scene,
                job.measurements,
                job.settings.stage,
                job.settings.prior,
                job.settings.solver,
                mask=mask,
                device=job.device,
                seed=job.seed,
                time_limit=job.settings.run.time_limit,
                truth=job.truth,
                callback=record,
                checkpoint=job.folder.files.checkpoint,
                checkpoint_interval=job.settings.run.checkpoint_interval,
                resume=job.resumed,
                stop=stop,
                uncertainty=job.settings.run.uncertainty,
            )
    except (DeviceError, DataError) as error:
        # Of the device, or of the disk: both may be in order tomorrow.
        kept = job.folder.files.checkpoint
        if kept.is_file() and (job.folder.started or isinstance(error, DeviceError)):
            again = type(error)(f"{error}\nwhat was reached is kept in {kept}: {job.request.resume_command}")
            vars(again).update(vars(error))
            raise again from None
        raise
    finally:
        job.folder.close()
        stop.answer = "stopping"
    return Outcome(result, max(ranks.current().all(stop.signal_number or 0)) or None)


def _say_what_begins(job: Job) -> None:
    measurements, resumed = job.measurements, job.resumed
    if measurements.invalid_pixels:
        share = measurements.invalid_pixels / sum(image.size for image in measurements.images)
        which = (
            "1 invalid pixel" if measurements.invalid_pixels == 1 else f"{measurements.invalid_pixels} invalid pixels"
        )
        job.say(f"not used: {which} ({share:.2%})")
    if unlike := unlike_prior(job.settings.prior, job.scene.grid):
        job.say(unlike)
    if resumed is None:
        if job.request.resume:
            job.say(f"{job.request.output} has no checkpoint: starting from the beginning")
        return
    where = f"stage {resumed.stage + 1}, iteration {resumed.iterations}"
    job.say(f"going on from {where}, {duration(resumed.seconds)}")
    if resumed.device != job.device.name:
        job.say(f"the run was on {resumed.device}: on {job.device.name} bits may differ")


def _say_what_is_doubtful(job: Job, mask: np.ndarray) -> None:
    if not mask.any():
        return  # which is refused
    given = job.scene, job.measurements, stages_of(job.scene.grid, job.settings.stage, job.settings.solver)
    if tight := ranks.current().together(lambda: check_memory(*given, job.device, job.settings.solver, mask)):
        job.say(tight)
    for text in filter(None, doubtful_texts(job.scene, job.measurements, mask)):
        job.say(text)


def _carve(job: Job) -> np.ndarray:
    """The voxels that the images leave room for."""
    job.say("building kernels, carving space ...")
    mask = carved_mask(job.scene, job.measurements, job.device, stopping.check)
    ranks.check_together()
    job.say(f"space carving keeps {mask.mean():.1%} of the voxels")
    return mask


def _description(job: Job) -> dict[str, Any]:
    """What settings.json says of the run."""
    tables = (("measurements", job.settings.measurements), ("truth", job.settings.truth))
    return {
        "settings": job.stored_settings,
        "files": {name: job.from_output(table.file) for name, table in tables if table is not None},
        "scene": stored_scene(job.scene),
        # The table itself begins with its columns' names, as every reader of such tables expects.
        "history": {name: {"units": units, "long_name": text} for name, (units, text) in COLUMNS.items()},
        "digests": {} if job.truth is None else {"truth": digest(job.truth)},
        "device": describe_device(job.device),
        "versions": versions(),
    }


def deliver(job: Job, outcome: Outcome) -> None:
    """Writes the result, then images of it and a report.

    Raises
    ------
    Interrupted : somebody asked to stop: the result is on the disk, and nothing else was begun
    """
    output = job.request.output
    ranks.first_alone(lambda: _write_result(job, outcome))
    if outcome.signal_number is not None:
        text = f"interrupted in {outcome.where}; what was reached is in {output}: {job.request.resume_command}"
        raise ranks.interrupted(text, exit_status(outcome.signal_number))
    try:
        _show_result(job, outcome)
    except Interrupted as interrupted:
        interrupted.args = (
            f"interrupted; the result is in {output}, and the rest is made by\n  cloudtomo report {output}",
        )
        raise


def _show_result(job: Job, outcome: Outcome) -> None:
    """Images of the result, and a report."""
    result, output = outcome.result, job.request.output
    last = result.history[-1]
    took = duration(last.seconds)
    job.console.print(f"{last.paths:.3g} paths in {took} on {job.device.name}: {outcome.state}", soft_wrap=True)
    job.say(fit_text(last))
    if result.outliers:
        job.say(outlier_text(result.outliers))
    if result.no_standard_error and job.settings.run.uncertainty:
        job.say(f"no standard error of the extinction: {result.no_standard_error}")
    if not result.extinction.any():
        job.say("the images leave no cloud: take less noisy ones, or give the prior less weight ([prior])")
        return
    ranks.check_together()
    job.say("rendering the images of the recovered cloud ...")
    stream = len(result.history) + 1
    measurements = replace(job.measurements, views=result.views)
    write_modelled(job.folder, job.scene, measurements, result.extinction, job.device, job.seed, stream)
    if job.request.with_report:
        ranks.check_together()
        job.say(f"drawing figures and {job.folder.files.report} ...")
        ranks.first_alone(lambda: make_report(job.folder, quiet=True))
    job.say(f"{_summary(result, job.truth)}  {output}")


def _write_result(job: Job, outcome: Outcome) -> None:
    """reconstruction.nc, with what repeats the run."""
    result = outcome.result
    last = result.history[-1]
    attributes = {
        "title": "extinction of a cloud, recovered from its images",
        "source": source(),
        "seed": job.seed,
        "device": describe_device(job.device),
        "versions": versions(),
        "paths": float(last.paths),
        "seconds": last.seconds,
        "state": outcome.state,
        "iterations": len(result.history),
    }
    if result.no_standard_error:
        attributes["no_standard_error"] = result.no_standard_error
    if result.outliers:
        attributes["outliers"] = outlier_text(result.outliers)
    settings = {"scene": stored_scene(job.scene), "reconstruct": job.stored_settings, "seed": job.seed}
    job.folder.write_reconstruction(
        result.grid,
        result.extinction,
        result.mask,
        attributes,
        replace(job.measurements, views=result.views),
        settings,
        result.standard_error,
    )


def fit_text(last: IterationRecord) -> str:
    """How well the images are fitted, and what may be wrong if they are not."""
    cost = f"cost {with_error(last.cost, last.cost_standard_error)}"
    if last.expected_cost is None:
        return cost
    text = f"{cost}, {last.expected_cost:.3g} expected by the images' noise alone"
    if last.is_fitted:
        return text
    return (
        f"{text}: the images are not fitted yet, or something is not as told. If more iterations (--resume) do not "
        "help, look at the views' differences in the report: the radiances' unit, sun, surface, cameras "
        "(pointing_error, calibration_error) or standard errors may be wrong"
    )


def _summary(result: Reconstruction, truth: np.ndarray | None) -> str:
    """The errors if the truth is known, otherwise the optical mass."""
    if truth is None:
        return f"optical mass {float(result.extinction.sum(dtype=float)) * result.grid.voxel_volume:.4g} km^2"
    return f"eps {epsilon(result.extinction, truth):.3f}  delta {delta(result.extinction, truth):+.1%}"
