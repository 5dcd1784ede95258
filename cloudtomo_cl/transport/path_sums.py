"""Paths that are walked, and added up by pixel (kernels/image.cl)."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from cloudtomo_cl.opencl.layout import MOST_BRANCHES, STRUCTS
from cloudtomo_cl.opencl.pace import Pace
from cloudtomo_cl.transport.audit import Budget
from cloudtomo_cl.transport.device_pixels import DevicePixels
from cloudtomo_cl.transport.medium import Medium
from cloudtomo_cl.transport.rendering_memory import kept
from cloudtomo_cl.transport.samples import Samples

# Macro of kernels whose paths branch (kernels/walk/branches.h).
BRANCHES = "CLOUDTOMO_BRANCHES"
# The longest sum that a work item makes in one launch. Watchdogs end launches that take too long, and Mesa's llvmpipe
# ends loops after 65,535 rounds without an error.
_LONGEST_SUM = 1 << 15


class PathSums:
    """Walks the paths of pixels, launch by launch.

    Parameters
    ----------
    pace : of the launches
    features : macros of kernels that walk these paths
    """

    def __init__(self, pace: Pace, features: tuple[str, ...]) -> None:
        self._pace = pace
        self._branches = MOST_BRANCHES if BRANCHES in features else 0
        self._render, self._sum = (
            pace.device.kernel("image", name, features) for name in ("render_paths", "sum_paths")
        )

    def of(
        self,
        medium: Medium,
        pixels: DevicePixels,
        samples: Samples,
        budget: Budget,
        store_paths: bool,
        progress: Callable[[int], None] | None,
    ) -> tuple[np.ndarray, list[tuple[int, Any]] | None]:
        """The sums of this rank's pixels, the kernels' PixelSums, shape (pixels,); and stored paths, by launches.

        Of a launch there are the number of its first sample, and the radiances of its paths, float32, shape (1, paths);
        of paths that branch further rows with those of the branches (parameters.py).
        """
        count, device = len(pixels.shares), self._pace.device
        host = np.empty(count, STRUCTS["PixelSums"])
        launches: list[tuple[int, Any]] = []
        if not count:
            return host, launches if store_paths else None
        sums = device.buffer(host.nbytes)
        device.clear(sums)
        done = 0
        while done < samples.count:
            first = samples.first + done
            number = int(np.clip(self._pace.work_items // count, 1, samples.count - done))
            stores_branches = bool(store_paths and self._branches)
            paths = device.empty((1 + self._branches * stores_branches, number * count), np.float32)
            walk = pixels.paths(medium, first, number * count, samples.seed, samples.stream)
            self._pace.launch(
                self._render, number * count, **walk, path_radiance=paths, stores_branches=stores_branches,
                budget=budget.data,
            )  # fmt: skip
            for part in parts(number, _LONGEST_SUM):
                device.launch(self._sum, count, paths, count, first, *part, sums)
            if store_paths:
                launches.append((first, kept(device, paths, launches)))
            done += number
            if progress:
                progress(done)
        device.read(sums, host)
        return host, launches if store_paths else None


def statistics(sums: np.ndarray, count: int, irradiance: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """What sums over paths say of the radiances.

    Parameters
    ----------
    sums : the kernels' PixelSums, shape (pixels,)
    count : paths per pixel
    irradiance : of the sun, W m^-2

    Returns
    -------
    mean, standard_error, halves : W m^-2 sr^-1, shapes (pixels,), (pixels,) and (pixels, 2); see `Rendering`
    """
    halves = irradiance * (sums["half_sum"].astype(float) + sums["half_low"]) / (count // 2)
    mean = halves.mean(axis=1)
    square = irradiance**2 * (sums["square_sum"].astype(float) + sums["square_low"]) / count
    return mean, np.sqrt(np.maximum(square - mean**2, 0.0) / (count - 1)), halves


def parts(count: int, most: int) -> list[tuple[int, int]]:
    """The numbers from 0 to below `count` in parts (begin, end) of at most `most`."""
    return [(begin, min(begin + most, count)) for begin in range(0, count, most)]
