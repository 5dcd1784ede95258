"""The figures and the page of a run folder, from what the folder holds."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np

from cloudtomo_cl.commands.progress import duration, with_error
from cloudtomo_cl.commands.provenance import source
from cloudtomo_cl.commands.run_folder import RunFolder
from cloudtomo_cl.errors import DataError
from cloudtomo_cl.files.measurements import read_measurements
from cloudtomo_cl.files.netcdf import load_dataset
from cloudtomo_cl.files.truth import read_truth
from cloudtomo_cl.files.whole import written_whole
from cloudtomo_cl.report import plots
from cloudtomo_cl.report.page import report_page
from cloudtomo_cl.scene.grid import Grid
from cloudtomo_cl.scene.metrics import delta, epsilon

# Extinction of voxels that hold cloud, km^-1.
_CLOUD = 1.0


def make_report(folder: Path, quiet: bool) -> None:
    """Makes figures/*.png, figures/*.pdf and report.html.

    Raises
    ------
    DataError : no run was finished in the folder, or a file of it is damaged or cannot be written
    """
    run = RunFolder(folder)
    grid, extinction, _ = run.read_reconstruction()
    settings, history = run.read_settings(), run.read_history()
    missing = {"stage", "seconds", "paths", "cost", "cost_standard_error", "epsilon"} - set(history)
    if missing or not len(history["stage"]):
        lacks = f"has no column {', '.join(sorted(missing))}" if missing else "has no iteration"
        raise DataError(f"{run.history_file}: {lacks}: it is no history of a run")
    files = settings.get("files", {})
    measurements = truth = modelled = None
    if "measurements" in files:
        measurements = _if_there(folder / files["measurements"], read_measurements)
    if "truth" in files:
        truth = _if_there(folder / files["truth"], lambda path: read_truth(path, grid))
    if run.modelled_file.is_file():
        modelled = read_measurements(run.modelled_file)
    if not quiet:
        print("drawing figures and report ...")
    figures = plots.run_figures(grid, extinction, history, truth, measurements, modelled)
    paths = plots.save_figures(run.figures, figures)
    result = load_dataset(run.reconstruction_file)
    attributes = result.attrs
    numbers = _numbers(grid, extinction, truth, history, settings)
    if "extinction_standard_error" in result and (extinction > _CLOUD).any():
        error = np.median(result["extinction_standard_error"].values[extinction > _CLOUD])
        numbers["typical standard error in cloud"] = f"{error:.3g} km⁻¹"
    page = report_page(
        f"Reconstruction {folder.resolve().name}",
        f"{attributes.get('source', source())}, {attributes.get('state', 'complete')}",
        numbers,
        grid,
        extinction,
        {path.stem: path.read_bytes() for path in paths if path.suffix == ".png"},
        settings,
        truth,
        measurements,
        modelled,
    )
    with written_whole(run.report_file) as partial:
        partial.write_text(page, encoding="utf-8")
    if not quiet:
        print(f"{run.figures}: {', '.join(figures)}, each as .png and .pdf")
        print(f"{run.report_file}: open it in a browser")


def _numbers(
    grid: Grid, extinction: np.ndarray, truth: np.ndarray | None, history: dict[str, np.ndarray], settings: Any
) -> dict[str, str]:
    numbers = {}
    if truth is not None:
        numbers["error eps"] = f"{epsilon(extinction, truth):.3f}"
        numbers["bias of the optical mass delta"] = f"{delta(extinction, truth):+.1%}"
    depth = extinction.sum(axis=2, dtype=float) * grid.spacing[2]
    numbers["optical mass"] = f"{extinction.sum(dtype=float) * grid.voxel_volume:.4g} km²"
    numbers["largest optical depth"] = f"{depth.max():.3g}"
    numbers["voxels"] = " × ".join(map(str, grid.shape))
    numbers["last cost"] = with_error(history["cost"][-1], history["cost_standard_error"][-1])
    numbers["iterations"] = str(len(history["cost"]))
    numbers["paths"] = f"{history['paths'][-1]:.3g}"
    numbers["time"] = duration(float(history["seconds"][-1]))
    device = settings.get("device")
    if isinstance(device, dict) and "name" in device:
        numbers["device"] = str(device["name"])
    return numbers


def _if_there(path: Path, read: Any) -> Any:
    """What a file holds; a run folder that was moved away from its inputs still gets its other figures."""
    if path.is_file():
        return read(path)
    print(f"cloudtomo report: {path} is not there any more: figures that need it are left out", file=sys.stderr)
    return None
