"""The figures and the page of a run folder, from what the folder holds."""

from __future__ import annotations

import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import TypeAdapter, ValidationError

from cloudtomo_cl.commands import stopping
from cloudtomo_cl.commands.modelled import write_modelled
from cloudtomo_cl.commands.progress import duration
from cloudtomo_cl.commands.provenance import digest, source
from cloudtomo_cl.commands.run_folder import RunFolder
from cloudtomo_cl.errors import DataError, DeviceError, SettingsError
from cloudtomo_cl.files.extinction import read_extinction
from cloudtomo_cl.files.measurements import read_measurements
from cloudtomo_cl.files.netcdf import AXES, load_dataset
from cloudtomo_cl.files.truth import read_truth
from cloudtomo_cl.files.vti import write_vti
from cloudtomo_cl.files.whole import written_whole
from cloudtomo_cl.inversion.records import MASK, STANDARD_ERROR, VARIABLES
from cloudtomo_cl.inversion.relative_prior import mean_extinction
from cloudtomo_cl.opencl.devices import choose_device
from cloudtomo_cl.report import plots
from cloudtomo_cl.report.page import report_page
from cloudtomo_cl.scene.grid import Grid
from cloudtomo_cl.scene.measurements import Measurements
from cloudtomo_cl.scene.metrics import delta, epsilon
from cloudtomo_cl.scene.scene import Sun
from cloudtomo_cl.settings.stored import kept_scene

# Extinction of voxels that hold cloud, over the cloud's mean extinction: less is haze, which recoveries leave.
_CLOUD = 0.02


@dataclass(eq=False)
class _Shown:
    """What a report is made of: all of it belongs to the result.

    Attributes
    ----------
    result : reconstruction.nc
    history : its columns, up to the result
    notes : sentences about what is left out
    """

    grid: Grid
    extinction: np.ndarray
    result: Any
    settings: dict[str, Any]
    history: dict[str, np.ndarray]
    measurements: Measurements | None = None
    truth: np.ndarray | None = None
    modelled: Measurements | None = None
    notes: list[str] = field(default_factory=list)

    @property
    def sun(self) -> Sun | None:
        """Of the scene that the settings keep, if they keep one."""
        scene = self.settings.get("scene")
        try:
            return TypeAdapter(Sun).validate_python(scene["sun"]) if isinstance(scene, dict) else None
        except (KeyError, ValidationError):
            return None


def make_report(run: RunFolder, quiet: bool) -> None:
    """Makes figures/*.png, figures/*.pdf and report.html.

    Raises
    ------
    DataError : no run was finished in the folder, or a file of it is damaged or cannot be written, or one is in the
        way that no run has written
    """
    shown = _read(run)
    for note in shown.notes:
        print(f"cloudtomo report: {note}", file=sys.stderr)
    if not quiet:
        print("drawing figures and report ...")
    stopping.check()
    figures = plots.run_figures(
        shown.grid, shown.extinction, shown.history, shown.truth, shown.measurements, shown.modelled, shown.sun
    )
    run.claim(run.files.report, *run.files.pictures(figures))
    paths: list[Path] = []
    for name, figure in figures.items():
        stopping.check()
        paths += plots.save_figures(run.files.figures, {name: figure})
    page = report_page(
        f"Reconstruction {run.path.resolve().name}",
        f"{shown.result.attrs.get('source', source())}, {shown.result.attrs.get('state', 'complete')}",
        _numbers(shown),
        shown.grid,
        shown.extinction,
        {path.stem: path.read_bytes() for path in paths if path.suffix == ".png"},
        shown.settings,
        shown.truth,
        shown.measurements,
        shown.modelled,
        [*shown.notes, *([str(shown.result.attrs["outliers"])] if "outliers" in shown.result.attrs else [])],
        shown.sun,
    )
    with written_whole(run.files.report) as partial:
        partial.write_text(page, encoding="utf-8")
    if not quiet:
        print(f"{run.files.figures}: {', '.join(figures)}, each as .png and .pdf")
        print(f"{run.files.report}: open it in a browser")


def export_vti(run: RunFolder, path: Path, quiet: bool) -> None:
    """Writes the recovered cloud for viewers: extinction, its standard error, the mask, and the truth if it is known.

    Raises
    ------
    DataError : a file of the folder is damaged, or the new one cannot be written
    """
    shown = _read(run)
    quantities = {"extinction": (shown.extinction, "km-1")}
    if shown.truth is not None:
        quantities["true_extinction"] = (shown.truth, "km-1")
    if STANDARD_ERROR in shown.result:
        error = shown.result[STANDARD_ERROR].transpose(*AXES).values
        quantities[STANDARD_ERROR] = (error, VARIABLES[STANDARD_ERROR][0])
    quantities[MASK] = (run.read_reconstruction()[2], VARIABLES[MASK][0])
    write_vti(path, shown.grid, quantities)
    if not quiet:
        print(f"{path}: open it in ParaView or another viewer of VTK's files")


def _read(run: RunFolder) -> _Shown:
    """All that there is, without what does not belong to the result."""
    grid, extinction, _ = run.read_reconstruction()
    settings, history = run.read_settings(), run.history.read()
    missing = {"stage", "seconds", "paths", "cost", "cost_standard_error", "epsilon"} - set(history)
    if missing or not len(history["stage"]):
        lacks = f"has no column {', '.join(sorted(missing))}" if missing else "has no iteration"
        raise DataError(f"{run.files.history}: {lacks}: it is no history of a run")
    shown = _Shown(grid, extinction, load_dataset(run.files.reconstruction), settings, history)
    files = settings.get("files", {})
    shown.measurements = _measured(run, shown, files)
    if "truth" in files:
        wavelength = None if shown.measurements is None else shown.measurements.wavelength
        shown.truth = _if_there(run.path / files["truth"], lambda path: read_truth(path, grid, wavelength))
    _leave_out_what_is_of_another(run, shown)
    return shown


def _measured(run: RunFolder, shown: _Shown, files: dict[str, str]) -> Measurements | None:
    """The images that the cloud was recovered from: the result keeps them."""
    if "radiance" in shown.result:
        return read_measurements(run.files.reconstruction)
    if "measurements" in files:
        measurements: Measurements | None = _if_there(run.path / files["measurements"], read_measurements)
        return measurements
    return None


def _leave_out_what_is_of_another(run: RunFolder, shown: _Shown) -> None:
    done = int(shown.result.attrs.get("iterations", len(shown.history["stage"])))
    lines = len(shown.history["stage"])
    if lines != done:
        text = f"the result is that of iteration {done}, the history has {lines}: "
        shown.notes.append(text + ("the later ones are left out" if lines > done else "some are missing"))
        shown.history = {name: column[:done] for name, column in shown.history.items()}
    known = shown.settings.get("digests")
    expected = known.get("truth") if isinstance(known, dict) else None
    if shown.truth is not None and expected is not None and digest(shown.truth) != expected:
        text = f"{run.path / shown.settings['files']['truth']} is not the truth that the run knew: it is left out"
        shown.notes.append(text)
        shown.truth = None
    if run.files.modelled.is_file() and shown.measurements is not None:
        if is_of(run, shown.extinction, shown.measurements):
            shown.modelled = read_measurements(run.files.modelled)
        else:
            shown.notes.append(
                f"{run.files.modelled.name} has images of another cloud than the result: they are left out; "
                f"`cloudtomo report {run.path}` makes them again"
            )


def is_of(run: RunFolder, extinction: np.ndarray, measurements: Measurements) -> bool:
    """Whether modelled.nc has images of this cloud, from these views: it keeps both."""
    _, rendered = read_extinction(run.files.modelled)
    return np.array_equal(rendered, extinction) and read_measurements(run.files.modelled).views == measurements.views


def renew_modelled(run: RunFolder, device: str | None, quiet: bool) -> None:
    """Renders modelled.nc again if it is not of the result; where that cannot be, it is left as it is, and it is said.

    Raises
    ------
    DataError : the result is damaged, or the file cannot be written
    """
    grid, extinction, _ = run.read_reconstruction()
    result = load_dataset(run.files.reconstruction)
    if "radiance" not in result:
        return
    measurements = read_measurements(run.files.reconstruction)
    if run.files.modelled.is_file() and is_of(run, extinction, measurements):
        return
    try:
        scene, _, _, made = kept_scene(run.files.reconstruction, ())
        if not quiet:
            print("rendering the images of the recovered cloud ...")
        stream = int(result.attrs.get("iterations", len(run.history.read()["stage"]))) + 1
        write_modelled(run, scene, measurements, extinction, choose_device(device), made.get("seed", 0), stream)
    except (DeviceError, SettingsError) as error:
        print(f"cloudtomo report: the images of the recovered cloud could not be rendered: {error}", file=sys.stderr)


def _numbers(shown: _Shown) -> dict[str, str]:
    grid, extinction, truth, history = shown.grid, shown.extinction, shown.truth, shown.history
    numbers = {}
    if truth is not None:
        numbers["error, eps"] = f"{epsilon(extinction, truth):.3f}"
        numbers["bias of the mass, delta"] = f"{delta(extinction, truth):+.1%}"
    depth = extinction.sum(axis=2, dtype=float) * grid.spacing[2]
    if shown.measurements is not None and shown.measurements.wavelength is not None:
        numbers["wavelength"] = f"{shown.measurements.wavelength:g} nm"
    numbers["optical mass"] = f"{extinction.sum(dtype=float) * grid.voxel_volume:.4g} km²"
    numbers["largest optical depth"] = f"{depth.max():.3g}"
    numbers["voxels"] = " × ".join(map(str, grid.shape))
    numbers["iterations"] = str(len(history["cost"]))
    numbers["paths"] = f"{history['paths'][-1]:.3g}"
    numbers["time"] = duration(float(history["seconds"][-1]))
    device = shown.settings.get("device")
    if isinstance(device, dict) and "name" in device:
        numbers["device"] = str(device["name"])
    if STANDARD_ERROR in shown.result and extinction.any():
        error = _in_cloud(shown.result[STANDARD_ERROR].transpose(*AXES).values, extinction)
        numbers["typical standard error in cloud"] = f"{error:.3g} km⁻¹"
    elif "no_standard_error" in shown.result.attrs:
        numbers["standard error"] = f"not known: {shown.result.attrs['no_standard_error']}"
    return numbers


def _in_cloud(error: np.ndarray, extinction: np.ndarray) -> float:
    """The median of standard errors in voxels that hold cloud, however thin the cloud is; both of one shape."""
    return float(np.median(error[extinction > _CLOUD * mean_extinction(extinction)]))


def _if_there(path: Path, read: Any) -> Any:
    """What a file holds; a run folder that was moved away from its inputs still gets its other figures."""
    if path.is_file():
        return read(path)
    print(f"cloudtomo report: {path} is not there any more: figures that need it are left out", file=sys.stderr)
    return None
