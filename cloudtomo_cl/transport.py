"""The operator from extinction to radiances, and its gradient."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

from cloudtomo_cl.device import Device, choose_device
from cloudtomo_cl.errors import DataError, TransportError
from cloudtomo_cl.layout import STRUCTS, ray_array, scene_struct, view_structs
from cloudtomo_cl.scene import Scene
from cloudtomo_cl.sensors import View

Estimator = Literal["side-flights", "plain"]

# Units of the fixed-point gradient per sr^-1 km deposited under the largest adjoint: rounding is
# far below the deposits that matter (about 1e-6), and a voxel's sum of them over all paths of a
# gradient may reach 2^31 before it overflows.
_FIXED_POINT_SCALE = 2.0**32
_LOST_SHARE_LIMIT = 1e-4
_FIRST_LAUNCH_PATHS = 1 << 18
_LARGEST_LAUNCH_PATHS = 1 << 24
_LAUNCH_SECONDS = 0.4


@dataclass(frozen=True)
class Rendering:
    """Radiances of the operator's pixels.

    Attributes
    ----------
    mean : W m^-2 sr^-1, shape (pixels,)
    standard_error : of the mean, same unit and shape
    halves : means over even and over odd samples, shape (pixels, 2)
    samples : paths per pixel
    """

    mean: np.ndarray
    standard_error: np.ndarray
    halves: np.ndarray
    samples: int
    seed: int
    iteration: int
    _extinction: Any = field(repr=False)
    _launches: list[tuple[int, Any]] = field(repr=False, default_factory=list)


class RadianceOperator:
    """Renders a scene's views, and differentiates them, by backward Monte Carlo.

    Parameters
    ----------
    scene : grid, optics, sun, air, surface, boundary
    views : the sensors
    device : where to compute; by default `choose_device()`
    pixels : which pixels, an integer array (pixels, 2) of (view, row * width + column); all by
        default
    estimator : "side-flights" (less noise under a forward peak; the mean is the same), or
        "plain", one local estimate at every interaction; by default side flights if the
        asymmetry of the droplets is at least 0.5

    Source: the supplement's Eqs. 1-19; docs/estimators.md.
    """

    def __init__(
        self,
        scene: Scene,
        views: Sequence[View],
        device: Device | None = None,
        pixels: np.ndarray | None = None,
        estimator: Estimator | None = None,
    ) -> None:
        import pyopencl as cl
        import pyopencl.array

        if not views:
            raise DataError("no view: a scene needs at least one to be rendered")
        self.scene = scene
        self.views = tuple(views)
        self.device = device or choose_device()
        self.estimator: Estimator = estimator or (
            "side-flights" if scene.cloud.phase_function.g >= 0.5 else "plain"
        )
        self.pixels = all_pixels(self.views) if pixels is None else np.ascontiguousarray(pixels, np.uint32)
        self._cl = cl
        self._array = pyopencl.array
        queue = self.device.queue
        self._scene = self._constant(scene_struct(scene, self.estimator == "side-flights"))
        self._views = self._constant(view_structs(self.views, scene.grid))
        self._rays = self._constant(ray_array(self.views, scene))
        self._pixels = self._constant(self.pixels)
        air = scene.air.profile(scene.grid) if scene.air else np.zeros(scene.grid.shape[2])
        self._air = self._constant(air.astype(np.float32))
        self._lost = pyopencl.array.zeros(queue, 1, np.uint32)
        self._render_paths = self.device.kernel("render", "render_paths")
        self._sum_paths = self.device.kernel("render", "sum_paths")
        self._replay_paths = self.device.kernel("gradient", "replay_paths")
        self._launch_paths = _FIRST_LAUNCH_PATHS

    def _constant(self, values: np.ndarray) -> Any:
        flags = self._cl.mem_flags.READ_ONLY | self._cl.mem_flags.COPY_HOST_PTR
        return self._cl.Buffer(self.device.context, flags, hostbuf=values)

    def _device_extinction(self, extinction: Any) -> Any:
        if tuple(extinction.shape) != self.scene.grid.shape:
            raise DataError(f"extinction has shape {tuple(extinction.shape)}, the grid {self.scene.grid.shape}")
        if isinstance(extinction, self._array.Array):
            return extinction
        values = np.ascontiguousarray(extinction, np.float32)
        check_extinction(values)
        return self._array.to_device(self.device.queue, values)

    def render(
        self,
        extinction: Any,
        samples: int,
        seed: int = 0,
        iteration: int = 0,
        keep_paths: bool = False,
        progress: Callable[[int], None] | None = None,
    ) -> Rendering:
        """Radiance of every pixel.

        Parameters
        ----------
        extinction : of the droplets, km^-1, shape of the grid; NumPy, or an array on the device
        samples : paths per pixel, even
        seed, iteration : together with view, pixel and sample these determine every path
        keep_paths : keep what `gradient` needs (4 bytes per path on the device)
        progress : called with the number of samples done so far

        Raises
        ------
        DataError : extinction of another shape, negative or not finite; samples odd
        TransportError : a radiance is not finite, or paths were lost
        """
        if samples < 2 or samples % 2:
            raise DataError(f"samples is {samples}: it must be even and at least 2 (halves are compared)")
        queue, count = self.device.queue, len(self.pixels)
        beta = self._device_extinction(extinction)
        size = count * STRUCTS["PixelSums"].itemsize
        sums = self._cl.Buffer(self.device.context, self._cl.mem_flags.READ_WRITE, size)
        self._cl.enqueue_fill_buffer(queue, sums, np.uint8(0), 0, sums.size)
        self._lost.fill(0)
        launches: list[tuple[int, Any]] = []
        first = 0
        while first < samples:
            number = int(np.clip(self._launch_paths // count, 1, samples - first))
            paths = self._array.empty(queue, number * count, np.float32)
            self._timed(
                number * count,
                self._render_paths,
                *self._arguments(beta, first, number * count, seed, iteration),
                paths.data,
                self._lost.data,
            )
            self.device.launch(
                self._sum_paths, count, paths.data, np.uint32(count), np.uint32(first), np.uint32(number), sums
            )
            if keep_paths:
                launches.append((first, paths))
            first += number
            if progress:
                progress(first)
        return self._rendering(sums, samples, seed, iteration, beta, launches)

    def _arguments(self, beta: Any, first: int, paths: int, seed: int, iteration: int) -> tuple[Any, ...]:
        return (
            self._scene,
            self._views,
            self._rays,
            self._pixels,
            beta.data,
            self._air,
            np.uint32(len(self.pixels)),
            np.uint32(first),
            np.uint32(paths),
            np.uint32(seed),
            np.uint32(iteration),
        )

    def _timed(self, paths: int, kernel: Any, *arguments: Any) -> None:
        """Launches, and sizes the next launch so that a desktop's watchdog and a progress bar live."""
        start = time.perf_counter()
        self.device.launch(kernel, paths, *arguments)
        self.device.queue.finish()
        rate = paths / max(time.perf_counter() - start, 1e-6)
        self._launch_paths = int(
            np.clip(rate * _LAUNCH_SECONDS, self._launch_paths // 2, min(2 * self._launch_paths, _LARGEST_LAUNCH_PATHS))
        )

    def _rendering(
        self, sums: Any, samples: int, seed: int, iteration: int, beta: Any, launches: list[tuple[int, Any]]
    ) -> Rendering:
        host = np.empty(len(self.pixels), STRUCTS["PixelSums"])
        self._cl.enqueue_copy(self.device.queue, host, sums)
        irradiance = self.scene.sun.irradiance
        halves = irradiance * (host["half_sum"].astype(float) + host["half_low"]) / (samples // 2)
        mean = halves.mean(axis=1)
        square = irradiance**2 * (host["square_sum"].astype(float) + host["square_low"]) / samples
        standard_error = np.sqrt(np.maximum(square - mean**2, 0.0) / (samples - 1))
        wrong = ~np.isfinite(standard_error)
        if wrong.any():
            view, pixel = self.pixels[np.argmax(wrong)]
            raise TransportError(
                f"radiance is not finite in view {view}, pixel {pixel} (seed {seed}, iteration {iteration})"
            )
        lost = int(self._lost.get()[0])
        if lost > _LOST_SHARE_LIMIT * samples * len(self.pixels):
            raise TransportError(
                f"{lost} paths were lost in horizontal flight: with periodic sides, "
                "tilt the views that look along the horizon"
            )
        return Rendering(mean, standard_error, halves, samples, seed, iteration, beta, launches)

    def gradient(self, rendering: Rendering, adjoint: np.ndarray) -> Any:
        """The gradient of a cost with respect to extinction, by replay of a rendering's paths.

        Parameters
        ----------
        rendering : made by this operator with keep_paths
        adjoint : derivative of the cost with respect to `rendering.halves`, shape (pixels, 2).
            For an unbiased gradient the entry of one half must not depend on that half's own
            paths (see `objective.crossed_halves`).

        Returns
        -------
        an array on the device, float32, shape of the grid, cost per km^-1

        Raises
        ------
        DataError : the rendering did not keep its paths, or adjoint has another shape
        """
        if not rendering._launches:
            raise DataError("this rendering kept no paths: render with keep_paths=True")
        if adjoint.shape != (len(self.pixels), 2):
            raise DataError(f"adjoint has shape {adjoint.shape}, not ({len(self.pixels)}, 2)")
        queue = self.device.queue
        total = self._array.zeros(queue, self.scene.grid.shape, np.int64)
        largest = float(np.abs(adjoint).max())
        if not np.isfinite(largest):
            raise DataError("adjoint is not finite")
        if largest > 0:
            factors = self._constant((adjoint * (_FIXED_POINT_SCALE / largest)).astype(np.float32))
            for first, paths in rendering._launches:
                arguments = self._arguments(
                    rendering._extinction, first, paths.size, rendering.seed, rendering.iteration
                )
                self._timed(paths.size, self._replay_paths, *arguments, paths.data, factors, total.data)
        scale = largest / _FIXED_POINT_SCALE * self.scene.sun.irradiance / (rendering.samples // 2)
        return total.astype(np.float32) * np.float32(scale)

    def images(self, values: np.ndarray) -> list[np.ndarray]:
        """Values per pixel as one image (rows, columns) per view; NaN where no pixel is."""
        images = [np.full(view.pixels[0] * view.pixels[1], np.nan) for view in self.views]
        for index, image in enumerate(images):
            chosen = self.pixels[:, 0] == index
            image[self.pixels[chosen, 1]] = values[chosen]
        return [image.reshape(view.pixels[1], view.pixels[0]) for image, view in zip(images, self.views)]


def all_pixels(views: Sequence[View]) -> np.ndarray:
    """Every pixel of every view: an array (pixels, 2) of (view, row * width + column)."""
    counts = [view.pixels[0] * view.pixels[1] for view in views]
    return np.column_stack(
        [np.repeat(np.arange(len(views)), counts), np.concatenate([np.arange(count) for count in counts])]
    ).astype(np.uint32)


def check_extinction(values: np.ndarray) -> None:
    """Raises DataError if an extinction is negative or not finite anywhere."""
    wrong = ~(np.isfinite(values) & (values >= 0))
    if wrong.any():
        voxel = tuple(int(i) for i in np.unravel_index(np.argmax(wrong), values.shape))
        raise DataError(f"extinction at voxel {voxel} is {values[voxel]}: it must be finite and at least 0 km^-1")
