"""How soon images under the sun's forward peak reach a wanted noise, by each estimator.

    python scripts/forward_peak.py CLOUD.nc [--seeds 3] [--samples 400] [--view nadir]

For some views of a cloud over a surface of albedo 0.01: the processor seconds in which the mean of the image would
reach a standard error of 1 %, by the plain estimator (a local estimate at every interaction), with side flights, with
branches as well (the default), and with paths where the noise is (`render_to_error`), as often as there are seeds.
Times are those of the processor, all cores together, kernels built before; only their ratios say something.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

import cloudtomo_cl as ct
from cloudtomo_cl.files.extinction import read_extinction
from cloudtomo_cl.transport.adaptive import render_to_error

PIXELS = (76, 76)
ESTIMATORS = ("plain", "side-flights", "branches")


def views(grid: ct.Grid) -> Iterator[tuple[str, ct.Sun, ct.OrthographicView]]:
    """Name, sun, and a camera that sees all of the cloud."""
    width = 1.6 * max(grid.shape[0] * grid.spacing[0], grid.shape[1] * grid.spacing[1])
    for name, sun_zenith, zenith in (
        ("nadir, sun 0", 0, 0),
        ("oblique 60, sun 0", 0, 60),
        ("nadir, sun 60", 60, 0),
        ("oblique 60, facing the sun at 60", 60, 60),
    ):
        view = ct.OrthographicView(zenith=zenith, azimuth=0, width=width, pixels=PIXELS)
        yield name, ct.Sun(zenith=sun_zenith, azimuth=180), view


def mean_of_image(rendering: ct.Rendering) -> tuple[float, float]:
    """And its standard error."""
    return rendering.mean.mean(), float(np.sqrt((rendering.standard_error**2).sum())) / rendering.mean.size


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("cloud", type=Path)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--samples", type=int, default=400, help="paths per pixel; half as many where they are placed")
    parser.add_argument("--view", default="", help="only those with this in their name")
    settings = parser.parse_args()
    grid, extinction = read_extinction(settings.cloud)
    for name, sun, view in views(grid):
        if settings.view not in name:
            continue
        scene = ct.Scene(grid=grid, sun=sun, surface=ct.Surface(0.01))
        operators = {name: ct.RadianceOperator(scene, [view], estimator=name) for name in ESTIMATORS}
        for operator in operators.values():
            operator.render(extinction, 8)
        found: dict[str, list[tuple[float, float, float]]] = {}
        for seed in range(1, settings.seeds + 1):
            for estimator in (*ESTIMATORS, "placed"):
                start = time.process_time()
                if estimator == "placed":
                    most = settings.samples / 2 * len(operator.pixels)
                    rendering = render_to_error(operator, extinction, 1e-9, seed, most_paths=most)
                else:
                    rendering = operators[estimator].render(extinction, settings.samples, seed)
                found.setdefault(estimator, []).append((*mean_of_image(rendering), time.process_time() - start))
        print(name)
        plain = None
        for estimator, runs in found.items():
            means, errors, seconds = np.array(runs).T
            wanted = (errors / means / 0.01) ** 2 * seconds
            plain = wanted if plain is None else plain
            total = float(np.sqrt((errors**2).sum())) / len(errors)
            ratio = plain / wanted
            print(
                f"  {estimator:13s} mean {means.mean():.6f} +- {total:.6f}, 1 % in {wanted.mean():.2f} processor s,"
                f" {plain.mean() / wanted.mean():.1f} times sooner than plain ({ratio.min():.1f} to {ratio.max():.1f})",
                flush=True,
            )


if __name__ == "__main__":
    main()
