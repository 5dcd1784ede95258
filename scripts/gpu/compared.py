"""Integer sums and radiances beside those that a CPU has computed and reference.npz holds.

Sums in fixed point have the same bits on every device if every path takes the same turns; paths do if the device's
arithmetic is that of IEEE 754 and its functions (cube roots, arc tangents) round as the CPU's do.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from unittest import mock

import numpy as np

import cloudtomo_cl as ct
from cloudtomo_cl.opencl.layout import BUDGET_COPIES, TERMINATIONS
from gpu.audited import small_scenes
from gpu.rows import Row, failed

STORED = Path(__file__).with_name("reference.npz")
_PART = "bits"
_SCENES = ("forward peak", "absorbing", "air, ground, periodic", "double Henyey-Greenstein", "phase table")
_SAMPLES, _PHOTONS, _SEED = 100, 20_000, 7
_SAMPLES_RECOVERED, _ITERATIONS = 512, 3
# Paths of a device with other roundings part where a decision is close: so few that images do not show it.
_SHARE_OF_PATHS, _SHARE_OF_SUMS = 0.01, 0.01


@contextmanager
def integer_sums() -> Iterator[dict[str, np.ndarray]]:
    """Gathers the sums in fixed point that the host looks through for overflows, by their shapes; the last of each."""
    found: dict[str, np.ndarray] = {}

    def looking(sums: np.ndarray) -> None:
        # Which copy of the budget's sums is added to depends on the device.
        if sums.shape == (BUDGET_COPIES, len(TERMINATIONS)):
            found["budget"] = sums.sum(axis=0)
        else:
            found[f"{sums.ndim} axes"] = sums.copy()

    with mock.patch("cloudtomo_cl.opencl.fixed_point.first_overflow", looking):
        yield found


def computed(name: str) -> dict[str, np.ndarray]:
    """All that is compared of a scene, by kind."""
    scene, views, extinction = small_scenes()[name]
    operator = ct.RadianceOperator(scene, views, mask=np.ones(scene.grid.shape, bool))
    arrays: dict[str, np.ndarray] = {}
    with integer_sums() as sums:
        rendering = operator.render(extinction, _SAMPLES, _SEED, store_paths=True)
        arrays["radiances of paths"] = np.concatenate([paths.get()[0] for _, paths in rendering._launches])
        arrays["image"] = rendering.mean
        adjoint = np.linspace(0.5, 1.5, 2 * len(operator.pixels)).reshape(-1, 2)
        arrays["gradient"] = operator.gradient(rendering, adjoint, virtual_limit=0.5).get()
        arrays |= {"sums of the budget": sums["budget"], "sums of the gradient": sums["3 axes"]}
    if scene.boundary.horizontal == "periodic" or scene.surface.albedo == 0:
        with integer_sums() as sums:
            ct.FluxOperator(scene).compute(extinction, _PHOTONS, _SEED)
            arrays |= {"sums of the photons' budget": sums["budget"], "sums of fluxes": sums["4 axes"].sum(axis=0)}
    return arrays


def recovered() -> dict[str, np.ndarray]:
    """A small recovery, by kind: all that Gauss-Newton and its priors do on a device."""
    grid = ct.Grid(shape=(12, 12, 10), spacing=(0.1, 0.1, 0.1))
    truth = ct.cumulus(grid, seed=3)
    scene = ct.Scene(grid=grid, sun=ct.Sun(zenith=30.0, azimuth=40.0), surface=ct.Surface(albedo=0.05))
    ring = ct.RingOfViews(
        target=(0.6, 0.6, 0.5), height=4.0, radius=2.0, field_of_view=24.0, pixels=(16, 16), count=4
    )  # fmt: skip
    operator = ct.RadianceOperator(scene, ring.views())
    measurements = ct.Measurements.rendered(operator, operator.render(truth, _SAMPLES_RECOVERED, _SEED))
    solver = ct.GaussNewton(iterations=_ITERATIONS)
    found = ct.reconstruct(scene, measurements, solver=solver, device=operator.device, seed=_SEED, uncertainty=4)
    return {"recovered extinction": found.extinction, "its standard error": found.standard_error}


def everything() -> Iterator[tuple[str, Callable[[], dict[str, np.ndarray]]]]:
    """What is compared: names, and what computes it."""
    for name in _SCENES:
        yield name, partial(computed, name)
    yield "recovery", recovered


def store() -> None:
    """Writes reference.npz by the device that is chosen: a CPU's."""
    np.savez_compressed(
        STORED, **{f"{name}/{kind}": values for name, compute in everything() for kind, values in compute().items()}
    )


def differences(kind: str, found: list[np.ndarray], expected: list[np.ndarray]) -> Row:
    """A line on one kind of arrays, of all scenes."""
    one, other = (np.concatenate([np.ravel(part) for part in parts]) for parts in (found, expected))
    if one.shape != other.shape:
        return failed(_PART, f"{kind}: {one.size} numbers, stored are {other.size}")
    equal = float(np.mean(one == other))
    scale = np.maximum(np.abs(other.astype(float)), np.abs(one.astype(float)))
    relative = np.abs(one.astype(float) - other) / np.where(scale > 0, scale, 1.0)
    total = float(np.abs(one.astype(float) - other).sum() / max(np.abs(other.astype(float)).sum(), 1e-300))
    limit = _SHARE_OF_PATHS if kind == "radiances of paths" else _SHARE_OF_SUMS
    parted = float(np.mean(relative > 1e-3)) if kind == "radiances of paths" else total
    note = (
        f"{one.size} numbers ({one.dtype}); largest relative difference {relative.max():.2g}; sum of differences "
        f"{total:.2g} of the sum"
    )
    return Row(_PART, f"{kind}: share with the CPU's bits", equal, "", note, parted <= limit)


def rows(quick: bool) -> Iterator[Row]:
    if not STORED.exists():
        yield failed(_PART, f"{STORED.name} is not there: python scripts/gpu_check.py --store, on a CPU")
        return
    kinds: dict[str, tuple[list[np.ndarray], list[np.ndarray]]] = {}
    with np.load(STORED) as stored:
        for name, compute in everything():
            try:
                arrays = compute()
            except ct.CloudtomoError as error:
                yield failed(_PART, f"{name}: {error}")
                continue
            for kind, values in arrays.items():
                found, expected = kinds.setdefault(kind, ([], []))
                found.append(values)
                expected.append(stored[f"{name}/{kind}"])
    for kind, (found, expected) in kinds.items():
        yield differences(kind, found, expected)
