"""Whether two revisions compute the same bits: digests of one to a file, and the comparison of two files.

    PYTHONPATH=CHECKOUT python scripts/bits.py digests before.json    # of the package that Python finds there
    python scripts/bits.py compare before.json after.json             # exit status 1 if a digest differs

For the scenes of the revision's tests/kernels/scenes.py under all estimators, a sparse cloud (open and periodic)
whose empty blocks are skipped, and scene C where its file is (CLOUDTOMO_DATA, or ../shared/data): renders (plain,
masked, truncated), audits, fluxes, replay gradients, the radiance table's gradient and Jacobian, a prior and
solver steps. Classes are found by their names wherever they are in the package, so moves between modules do not
matter. Half a minute; PoCL's threads are chosen by POCL_MAX_PTHREAD_COUNT.
"""

from __future__ import annotations

import argparse
import dataclasses
import hashlib
import importlib
import json
import os
import pkgutil
import sys
from collections.abc import Callable, Iterator
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

import cloudtomo_cl as ct

ROOT = Path(ct.__file__).resolve().parents[1]
SAMPLES, SEED, STREAM = 16, 5, 3
PHOTONS = 4096
TRUNCATION = 0.05  # sr^-1: cuts some of the local estimates in every scene
STEPS = 3


@lru_cache
def found(*names: str) -> Any:
    """The class of the first of these names that there is, in whatever module of the package it is defined.

    LookupError if there is none.
    """
    there: dict[str, Any] = {}
    for info in pkgutil.walk_packages(ct.__path__, "cloudtomo_cl."):
        if info.name.endswith(("__main__", ".kernels")):
            continue
        try:
            module = importlib.import_module(info.name)
        except ModuleNotFoundError:  # what is not installed (MPI) holds no class that is looked for
            continue
        for name in names:
            candidate = vars(module).get(name)
            if candidate is not None and getattr(candidate, "__module__", "") == info.name:
                there.setdefault(name, candidate)
    for name in names:
        if name in there:
            return there[name]
    raise LookupError(f"no {' or '.join(names)} in the package")


def digest(values: Any) -> str:
    """Of an array on host or device, or of the numbers of a dataclass."""
    if dataclasses.is_dataclass(values):
        return digest(np.array([float(getattr(values, field.name)) for field in dataclasses.fields(values)]))
    array = np.ascontiguousarray(values.get() if hasattr(values, "get") else values)
    return hashlib.sha256(f"{array.dtype} {array.shape}".encode() + array.tobytes()).hexdigest()[:24]


def of_rendering(rendering: Any) -> Iterator[tuple[str, str]]:
    for name in ("mean", "halves", "standard_error", "audit"):
        yield name, digest(getattr(rendering, name))


def of_radiances(
    scene: Any, views: tuple[Any, ...], extinction: np.ndarray, estimator: str, device: Any, radius: Any
) -> Iterator[tuple[str, str]]:
    """Renders and their derivatives."""
    options = {"effective_radius": radius} if radius is not None else {}
    operator = ct.RadianceOperator(scene, views, device, estimator=estimator, **options)
    rendering = operator.render(extinction, SAMPLES, SEED, STREAM, True)
    for name, value in of_rendering(rendering):
        yield f"render: {name}", value
    random = np.random.default_rng(1)
    adjoint = random.normal(size=(len(operator.pixels), 2))
    yield "replay gradient", digest(operator.gradient(rendering, adjoint, 0.0))
    for name, value in of_rendering(operator.render(extinction, SAMPLES, SEED, STREAM)):
        yield f"render, skips: {name}", value
    cut = ct.RadianceOperator(scene, views, device, estimator=estimator, truncation=TRUNCATION, **options)
    rendering = cut.render(extinction, SAMPLES, SEED, STREAM, True)
    for name, value in of_rendering(rendering):
        yield f"truncated: {name}", value
    yield "truncated: replay gradient", digest(cut.gradient(rendering, adjoint, 0.0))
    mask = extinction > 0
    mask[0] = True
    masked = ct.RadianceOperator(scene, views, device, estimator=estimator, mask=mask, **options)
    rendering = masked.render(extinction, SAMPLES, SEED, STREAM, True)
    for name, value in of_rendering(rendering):
        yield f"masked: {name}", value
    yield "masked: replay gradient", digest(masked.gradient(rendering, adjoint, 0.0))
    yield from of_table(masked, rendering, adjoint, mask)


def of_table(operator: Any, rendering: Any, adjoint: np.ndarray, mask: np.ndarray) -> Iterator[tuple[str, str]]:
    """The adjoint gradient by the radiance table, and its Jacobian."""
    import pyopencl.array

    # Older revisions have both in one class.
    table = found("TableGradient", "RadianceTable")(operator)
    change = np.where(mask, np.random.default_rng(2).normal(size=mask.shape), 0).astype(np.float32)
    change = pyopencl.array.to_device(operator.device.queue, change)
    for turn in range(2):
        gradient, tangent = table.gradient(rendering, adjoint, change)
        yield f"table gradient {turn}", digest(gradient)
        yield f"table tangent {turn}", digest(tangent)
    sums = found("JacobianSums", "JacobianAverage")(operator)
    sums.add(rendering, 1.0)
    yield "jacobian: near", digest(sums._near)
    yield "jacobian: far", digest(sums._far)
    yield "jacobian: product", digest(sums.jacobian @ np.arange(mask.sum()))
    yield "jacobian: transposed product", digest(sums.jacobian.T @ np.arange(len(operator.pixels)))


def of_fluxes(scene: Any, extinction: np.ndarray, device: Any, radius: Any) -> Iterator[tuple[str, str]]:
    options = {"effective_radius": radius} if radius is not None else {}
    try:
        operator = ct.FluxOperator(scene, device, **options)
    except ct.CloudtomoError:  # open sides over what reflects
        return
    fluxes = operator.compute(extinction, PHOTONS, SEED)
    for name in ("reflected", "direct", "diffuse", "absorbed"):
        yield f"flux: {name}", digest(getattr(fluxes, name).value)
    yield "flux: audit", digest(fluxes.audit)


def of_steps(device: Any) -> Iterator[tuple[str, str]]:
    """A prior's gradient, and steps of descent."""
    import pyopencl.array

    random = np.random.default_rng(4)
    shape = (5, 6, 7)
    extinction = (random.uniform(0, 9, shape) * (random.random(shape) > 0.3)).astype(np.float32)
    on_device = pyopencl.array.to_device(device.queue, extinction)
    prior = ct.Prior(smoothness=0.3, monotonicity=0.2, sparsity=0.7)
    value, gradient = found("PriorOperator")(prior, shape, device).value_and_gradient(on_device, 1.3, 0.4)
    yield "prior: value", digest(np.array(value))
    yield "prior: gradient", digest(gradient)
    start = extinction[extinction > 0]
    slopes = [slope[extinction > 0] for slope in random.normal(size=(STEPS, *shape)).astype(np.float32)]
    nothing, image = np.zeros_like(start), found("AveragedImage").empty(1)
    for name, kind in (("adam", ct.Adam), ("sgd", ct.SGD)):
        for parametrisation in ("extinction", "square-root"):
            solver = kind(parametrisation=parametrisation, step_size=0.2)
            state = found("DescentState")(start, start, start, nothing, nothing, 0, image, None)
            for slope in slopes:
                state = solver.moved(state, slope, device)
            for array in ("extinction", "estimate", "before", "first_moment", "second_moment"):
                yield f"{name}, {parametrisation}: {array}", digest(getattr(state, array))


def sparse_cloud() -> np.ndarray:
    """A few dense boxes in a grid that is skipped by blocks of several voxels, km^-1."""
    extinction = np.zeros((72, 70, 6), np.float32)
    random = np.random.default_rng(7)
    for corner in random.integers(0, (66, 64, 4), (5, 3)):
        box = tuple(slice(start, start + size) for start, size in zip(corner, (6, 6, 2)))
        extinction[box] = random.uniform(5, 60, (6, 6, 2))
    return extinction


Case = tuple[str, Callable[[Any], Iterator[tuple[str, str]]]]


def small_cases() -> Iterator[Case]:
    """The tests' scenes from all their sensors, and what of them has fluxes."""
    sys.path.insert(0, str(ROOT / "tests" / "kernels"))
    scenes = importlib.import_module("scenes")
    views = tuple(
        getattr(scenes, name) for name in ("ABOVE", "CAMERA", "SCANNER", "RADIOMETER", "RADIOMETER_BELOW", "RAYS")
    )
    for name, scene in scenes.SCENES.items():
        extinction = scenes.extinction_of(scene).astype(np.float32)
        radius = np.random.default_rng(6).uniform(5, 20, extinction.shape) if name == "phase table" else None
        for estimator in scenes.ESTIMATORS:
            yield (
                f"{name}, {estimator}",
                lambda device, s=scene, e=extinction, k=estimator, r=radius: of_radiances(s, views, e, k, device, r),
            )
        yield f"{name}, fluxes", lambda device, s=scene, e=extinction, r=radius: of_fluxes(s, e, device, r)
    wide = ct.Grid(shape=(72, 70, 6), spacing=(0.02, 0.02, 0.1), origin=(0.0, 0.0, 0.3))
    extinction = sparse_cloud()
    above = ct.OrthographicView(width=1.6, pixels=(6, 6), zenith=35, azimuth=20)
    for sides in ("open", "periodic"):
        scene = ct.Scene(grid=wide, sun=ct.Sun(zenith=50, azimuth=200), boundary=ct.Boundary(horizontal=sides))
        yield (
            f"sparse, {sides}",
            lambda device, s=scene: of_radiances(s, (above,), extinction, "side-flights", device, None),
        )
        yield f"sparse, {sides}, fluxes", lambda device, s=scene: of_fluxes(s, extinction, device, None)


def scene_c_cases() -> Iterator[Case]:
    """Scene C of the paper, from above and from aside; nothing where its file is not."""
    path = Path(os.environ.get("CLOUDTOMO_DATA", Path(__file__).resolve().parents[2] / "shared" / "data"), "scene_c.nc")
    if not path.exists():
        print(f"{path} is not there: scene C is left out", file=sys.stderr)
        return
    import xarray

    with xarray.open_dataset(path) as file:
        extinction = file["extinction"].transpose("x", "y", "z").values.astype(np.float32)
    grid = ct.Grid(shape=extinction.shape, spacing=(0.02, 0.02, 0.04))
    scene = ct.Scene(grid=grid, sun=ct.Sun(zenith=0.0), surface=ct.Surface(albedo=0.01))
    views = tuple(
        ct.PerspectiveView(
            position=(x, 0.38, 1.647), target=(0.38, 0.38, 1.013), up=(0, 1, 0), field_of_view=85.4, pixels=(16, 16)
        )
        for x in (0.38, 1.0)
    )
    yield "scene C", lambda device: of_radiances(scene, views, extinction, "side-flights", device, None)


def digests() -> dict[str, str]:
    """Every digest, by case and quantity."""
    device = ct.choose_device()
    print(f"{ROOT} on {device.name}", file=sys.stderr)
    cases = [*small_cases(), ("steps", of_steps), *scene_c_cases()]
    result = {}
    for case, compute in cases:
        for name, value in compute(device):
            result[f"{case} | {name}"] = value
        print(case, file=sys.stderr, flush=True)
    return result


def compare(before: dict[str, str], after: dict[str, str]) -> int:
    """Prints what differs; 1 if anything does, or is in one only."""
    wrong = 0
    for name in sorted(before.keys() | after.keys()):
        if before.get(name) != after.get(name):
            wrong += 1
            missing = "only before" if name not in after else "only after" if name not in before else "differs"
            print(f"{missing}: {name}")
    print(f"{len(before.keys() & after.keys())} digests in both, {wrong} differ or are missing")
    return int(wrong > 0)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    commands.add_parser("digests", help="compute and store").add_argument("file", type=Path)
    two = commands.add_parser("compare", help="two files of digests")
    two.add_argument("before", type=Path)
    two.add_argument("after", type=Path)
    arguments = parser.parse_args()
    if arguments.command == "compare":
        return compare(json.loads(arguments.before.read_text()), json.loads(arguments.after.read_text()))
    arguments.file.write_text(json.dumps(digests(), indent=1) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
