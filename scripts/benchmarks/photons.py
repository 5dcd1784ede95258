"""The row against Monte Carlo eXtreme in OpenCL: photons through a homogeneous cube, on the same device."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np

import cloudtomo_cl as ct
from benchmarks.children import ChildFailed, child
from benchmarks.timing import Disagreement, Line, require_agreement, timed

_ROW, _GOAL = "pmcxcl", "2"
_WHAT = "scattering events per CPU second over pmcxcl's"
# A cube of optical depth 20, in voxels and in the droplets' optics.
_VOXELS, _DEPTH, _ALBEDO, _G = 40, 20.0, 0.99, 0.85


def _ours() -> tuple[ct.FluxOperator, np.ndarray]:
    grid = ct.Grid(shape=(_VOXELS,) * 3, spacing=(1.0 / _VOXELS,) * 3)
    cloud = ct.Cloud(single_scattering_albedo=_ALBEDO, phase_function=ct.HenyeyGreenstein(g=_G))
    return ct.FluxOperator(ct.Scene(grid=grid, sun=ct.Sun(zenith=0.0), cloud=cloud)), np.full(grid.shape, _DEPTH)


def followed(photons: int, seed: int) -> dict[str, float]:
    """CPU seconds of a photon of ours, and the share of them that is absorbed."""
    operator, extinction = _ours()
    operator.compute(extinction, 1, 100)
    fluxes, seconds = timed(lambda: operator.compute(extinction, photons, seed))
    absorbed = fluxes.domain_mean("absorbed").value / fluxes.incident
    return {"seconds": seconds / fluxes.photons, "absorbed": absorbed}


def followed_by_pmcxcl(photons: int, seed: int) -> dict[str, float]:
    """The same of pmcxcl, which has a loader of OpenCL of its own: it is told where pyopencl's PoCL is.

    Its kernel builds only where pyopencl has looked for platforms before (else PoCL takes its own headers
    for those of a host: `stdint.h` not found), and it crashes where pyopencl has built one.
    """
    import pyopencl

    library = sorted((Path(pyopencl.__file__).parent / ".libs").glob("libpocl*.so*"))
    with tempfile.TemporaryDirectory() as folder:
        if library and "OCL_ICD_VENDORS" not in os.environ:
            Path(folder, "pocl.icd").write_text(f"{library[0]}\n")
            os.environ["OCL_ICD_VENDORS"] = folder + "/"
        pyopencl.get_platforms()
        import pmcxcl

        depth = _DEPTH / _VOXELS  # per voxel, which is a mm to pmcxcl
        settings = {
            "vol": np.ones((_VOXELS,) * 3, np.uint8),
            "prop": [[0, 0, 1, 1], [depth * (1 - _ALBEDO), depth * _ALBEDO, _G, 1.0]],
            "srctype": "planar", "issrcfrom0": 1, "srcpos": [0, 0, 0], "srcdir": [0, 0, 1],
            "srcparam1": [_VOXELS, 0, 0, 0], "srcparam2": [0, _VOXELS, 0, 0],
            "tstart": 0, "tend": 1e-7, "tstep": 1e-7, "isreflect": 0, "autopilot": 1, "gpuid": 1,
        }  # fmt: skip
        pmcxcl.run({**settings, "nphoton": 1000, "seed": 99})
        result, seconds = timed(lambda: pmcxcl.run({**settings, "nphoton": photons, "seed": seed}))
    return {"seconds": seconds / photons, "absorbed": result["stat"]["energyabs"] / result["stat"]["energytot"]}


def scattering_events(quick: bool) -> Iterator[Line]:
    """Photons over the whole upper face, straight down, black sides: the same physics on both sides, hence
    as many scatterings per photon; so the ratio of photons is that of scatterings."""
    repeats, ours, theirs = (3, 300_000, 30_000) if quick else (5, 1_000_000, 100_000)
    times, absorbed = np.zeros((repeats, 2)), np.zeros((repeats, 2))
    for n in range(repeats):
        try:
            results = child("photons", "followed", ours, n), child("photons", "followed_by_pmcxcl", theirs, n + 1)
        except ChildFailed as reason:
            yield Line(_ROW, _WHAT, (), _GOAL, f"none: {reason}")
            return
        times[n] = [result["seconds"] for result in results]
        absorbed[n] = [result["absorbed"] for result in results]
    mean, error = absorbed.mean(axis=0), absorbed.std(axis=0, ddof=1) / np.sqrt(repeats)
    try:
        note = require_agreement("absorbed", mean[0], error[0], mean[1], error[1])
    except Disagreement as reason:
        yield Line(_ROW, _WHAT, (), _GOAL, f"none: {reason}")
        return
    ours_us, theirs_us = np.median(times, axis=0) * 1e6
    note += f"; {mean[0] / (1 - _ALBEDO):.1f} collisions a photon"
    note += f"; us a photon: {ours_us:.2f} ours, {theirs_us:.2f} pmcxcl's"
    yield Line(_ROW, _WHAT, times[:, 1] / times[:, 0], _GOAL, note)
