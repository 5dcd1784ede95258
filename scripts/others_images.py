"""Recovers a cloud from images that another program made, beside a recovery from this project's own at the same noise.

    python scripts/others_images.py --voxels 16 --pixels 32 --output runs/others-16
    python scripts/others_images.py --scene-c --pixels 76 --paths 1024 --cpu-seconds 900 --output runs/others-c

Mitsuba 3 renders nine views of a generated cumulus, or of scene C (CLOUDTOMO_DATA), several times with other random
numbers. The mean of the renders is an image and their scatter its standard error, pooled over neighbouring pixels;
both go into a file of images as anybody would write it (docs/how-to/images-from-elsewhere.md). Then this project
renders the same views, without its own means against noise, with so many paths that the noise is the same. First the
images are compared pixel by pixel: z, their difference over its standard error, has the mean 0 and the mean square 1
if they differ by noise alone. Then both are recovered with the same settings, seeds and CPU seconds.

Needs `pip install '.[bench]'` and an LLVM library (Debian's libllvm19; DRJIT_LIBLLVM_PATH says where). What is in the
output folder already is not made again.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from benchmarks.mitsuba_peer import Missing, MitsubaScene
from benchmarks.scenes import Case, data_folder

import cloudtomo_cl as ct
from cloudtomo_cl.scene.pixel_errors import pooled_standard_errors

# The generated cloud's domain, km, above the ground; its nine cameras as scene C's.
_EDGE, _BASE = 0.8, 0.2
_HEIGHT, _RADIUS, _FIELD_OF_VIEW = 2.0, 0.7, 40.0
# Noise of two files of images is the same if their variances differ by no more.
_SAME_NOISE, _TRIALS = 0.05, 5
# The first trial has so many times fewer paths than the other images, but at least so many.
_PILOT, _LEAST_PILOT = 8, 128
# Standard error, in mean radiances, below which a difference is not measured in standard errors.
_NOISELESS = 0.01
# Added to the seeds of the images that own ones are held against.
_AGAIN = 1000


@dataclass(frozen=True)
class Problem:
    """A scene, its views, and the extinction that images are made from, km^-1."""

    scene: ct.Scene
    views: tuple[ct.PerspectiveView, ...]
    extinction: np.ndarray


def generated(voxels: int, pixels: int) -> Problem:
    """A cumulus on voxels^3 voxels, nine views of it."""
    grid = ct.Grid(shape=(voxels,) * 3, spacing=(_EDGE / voxels,) * 3, origin=(0.0, 0.0, _BASE))
    scene = ct.Scene(grid=grid, sun=ct.Sun(zenith=25.0, azimuth=40.0), surface=ct.Surface(albedo=0.05))
    ring = ct.RingOfViews(
        target=grid.centre, height=_HEIGHT, radius=_RADIUS, field_of_view=_FIELD_OF_VIEW, pixels=(pixels, pixels)
    )
    return Problem(scene, ring.views(), ct.cumulus(grid, seed=5, peak=60.0))


def scene_c(pixels: int) -> Problem:
    """Scene C of the paper in its own cameras (source_scenes.py)."""
    from source_scenes import SCENES

    source = SCENES["c"]
    grid, extinction = ct.read_extinction(data_folder() / "scene_c.nc")
    scene = ct.Scene(grid=grid, sun=ct.Sun(zenith=0.0), surface=ct.Surface(albedo=0.01))
    ring = ct.RingOfViews(
        target=(source.centre, source.centre, source.target_height), height=source.height, radius=source.ring_radius,
        field_of_view=source.field_of_view, pixels=(pixels, pixels),
    )  # fmt: skip
    return Problem(scene, ring.views(), extinction)


def image_of_renders(renders: np.ndarray, paths: int) -> tuple[np.ndarray, np.ndarray]:
    """Mean and standard error of several renders of one view with other random numbers, pooled over neighbours.

    renders : shape (renders, rows, columns); paths : of all of them together, per pixel
    """
    error = renders.std(axis=0, ddof=1) / np.sqrt(len(renders))
    return renders.mean(axis=0), pooled_standard_errors(error, float(paths))


def cropped(grid: ct.Grid, extinction: np.ndarray) -> tuple[ct.Grid, np.ndarray]:
    """The box of the voxels that hold cloud: the rest is empty in any case, and Mitsuba pays for it."""
    voxels = np.argwhere(extinction > 0)
    first, end = voxels.min(axis=0), voxels.max(axis=0) + 1
    x, y, z = (float(o + n * d) for o, n, d in zip(grid.origin, first, grid.spacing))
    inside = extinction[tuple(slice(a, b) for a, b in zip(first, end))]
    return ct.Grid(shape=inside.shape, spacing=grid.spacing, origin=(x, y, z)), inside


def images_of_mitsuba(problem: Problem, paths: int, renders: int, seed: int) -> ct.Measurements:
    """The views as Mitsuba renders them."""
    grid, extinction = cropped(problem.scene.grid, problem.extinction)
    images, errors = [], []
    for number, view in enumerate(problem.views):
        peer = MitsubaScene(Case("", replace(problem.scene, grid=grid), view, extinction))
        # No two renders of any view or seed share their random numbers.
        seeds = [(seed * len(problem.views) + number) * renders + n for n in range(renders)]
        each = [peer.render(paths // renders, one).astype(float) for one in seeds]
        image, error = image_of_renders(np.array(each), paths)
        images.append(image)
        errors.append(error)
        print(f"  view {number + 1} of {len(problem.views)}: mean radiance {image.mean():.5g}", flush=True)
    return ct.Measurements(problem.views, tuple(images), tuple(errors))


def own_images(problem: Problem, paths: int, seed: int, like: ct.Measurements) -> ct.Measurements:
    """The views as this project renders them by plain local estimates, with the noise of other images."""
    operator = ct.RadianceOperator(problem.scene, problem.views, estimator="plain")
    count = max(_LEAST_PILOT, paths // _PILOT)
    for _ in range(_TRIALS):
        images = ct.Measurements.rendered(operator, operator.render(problem.extinction, count, seed))
        ratio = (noise(images) / noise(like)) ** 2
        print(f"  {count} paths a pixel: {ratio:.3f} of the other images' variance", flush=True)
        if abs(ratio - 1) < _SAME_NOISE:
            break
        count = max(2, 2 * round(count * ratio / 2))
    return images


def noise(measurements: ct.Measurements) -> float:
    """Median standard error of the pixels brighter than the mean, over the mean radiance.

    The root mean square is that of the rarest bright paths, which Mitsuba's roulette makes rarer and brighter; in a
    recovery pixels that have one weigh little.
    """
    errors, images = (
        np.concatenate([array.ravel() for array in arrays])
        for arrays in (measurements.standard_errors, measurements.images)
    )
    return float(np.median(errors[images > images.mean()]) / images.mean())


def agreement(theirs: ct.Measurements, ours: ct.Measurements) -> dict[str, float]:
    """How far images differ, pixel by pixel and as a whole, with what noise alone would do to each number.

    z is of pixels with an error of at least 1 % of the mean radiance. Ground that the cloud hardly lights has nearly
    none, and what it has comes by rare paths: there the relative difference is told.
    """
    first, second = (np.concatenate([image.ravel() for image in one.images]) for one in (theirs, ours))
    error = np.hypot(*(np.concatenate([array.ravel() for array in one.standard_errors]) for one in (theirs, ours)))
    noisy = error > _NOISELESS * second.mean()
    z = (first - second)[noisy] / error[noisy]
    means = first.sum(), second.sum()
    variance = [sum((array**2).sum() for array in one.standard_errors) for one in (theirs, ours)]
    return {
        "pixels": z.size,
        "mean z": float(z.mean()),
        "its error": float(1 / np.sqrt(z.size)),
        "mean z^2": float(np.mean(z**2)),
        "largest |z|": float(np.abs(z).max()),
        "mean radiance / ours - 1": float(means[0] / means[1] - 1),
        "error of that": float(np.hypot(np.sqrt(variance[0]) / means[0], np.sqrt(variance[1]) / means[1])),
        "other pixels / ours - 1": float(first[~noisy].sum() / second[~noisy].sum() - 1) if not noisy.all() else 0.0,
        "noise, theirs": noise(theirs),
        "noise, ours": noise(ours),
    }


def recovered(problem: Problem, images: ct.Measurements, seed: int, cpu_seconds: float) -> dict[str, float]:
    """Errors of a recovery that ends after so many seconds of all its threads together."""
    start = time.process_time()
    result = ct.reconstruct(
        problem.scene, images, seed=seed, uncertainty=0, stop=lambda: time.process_time() - start > cpu_seconds
    )
    return {
        "eps": float(ct.epsilon(result.extinction, problem.extinction)),
        "delta": float(ct.delta(result.extinction, problem.extinction)),
        "cpu_seconds": time.process_time() - start,
        "iterations": len(result.history),
        "cost": result.history[-1].cost,
    }


def kept(file: Path, make: Callable[[], ct.Measurements]) -> ct.Measurements:
    """Images from a file; made if it is not there."""
    if not file.exists():
        print(f"{file}", flush=True)
        ct.write_measurements(file, make())
    return ct.read_measurements(file)


def show(row: dict[str, dict[str, float]]) -> None:
    """To the terminal."""
    for name, numbers in row.items():
        print(f"{name}: " + ", ".join(f"{key} {value:.4g}" for key, value in numbers.items()), flush=True)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scene-c", action="store_true", help="scene C in place of a generated cloud")
    parser.add_argument("--voxels", type=int, default=16, help="along each edge of the generated cloud (16)")
    parser.add_argument("--pixels", type=int, default=32, help="width of the images (32)")
    parser.add_argument("--paths", type=int, default=1024, help="of Mitsuba, per pixel (1024)")
    parser.add_argument("--renders", type=int, default=16, help="by which these are divided (16)")
    parser.add_argument("--seeds", type=int, nargs="+", default=[2], help="of images and recoveries (2)")
    parser.add_argument("--cpu-seconds", type=float, default=120.0, help="of each recovery (120)")
    parser.add_argument("--again", action="store_true", help="recover from the second own images, too: the spread")
    parser.add_argument("--output", type=Path, required=True)
    arguments = parser.parse_args()
    arguments.output.mkdir(parents=True, exist_ok=True)
    problem = scene_c(arguments.pixels) if arguments.scene_c else generated(arguments.voxels, arguments.pixels)
    file = arguments.output / "numbers.json"
    rows = json.loads(file.read_text()) if file.exists() else {}
    for seed in arguments.seeds:
        try:
            theirs = kept(
                arguments.output / f"mitsuba-{seed}.nc",
                lambda seed=seed: images_of_mitsuba(problem, arguments.paths, arguments.renders, seed),  # type: ignore[misc]
            )
        except Missing as reason:
            print(reason, file=sys.stderr)
            return 2
        ours, again = (
            kept(
                arguments.output / f"{name}-{seed}.nc",
                lambda more=more, seed=seed, theirs=theirs: own_images(problem, arguments.paths, more + seed, theirs),  # type: ignore[misc]
            )
            for name, more in (("own", 0), ("again", _AGAIN))
        )
        row = rows.setdefault(str(seed), {})
        row |= {"mitsuba - own": agreement(theirs, ours), "own - own": agreement(again, ours)}
        recoveries = {"mitsuba": theirs, "own": ours} | ({"own, again": again} if arguments.again else {})
        for name, images in recoveries.items():
            if f"from {name}" not in row:
                row[f"from {name}"] = recovered(problem, images, seed, arguments.cpu_seconds)
                file.write_text(json.dumps(rows, indent=1) + "\n")
        print(f"seed {seed}")
        show(row)
    return 0


if __name__ == "__main__":
    sys.exit(main())
