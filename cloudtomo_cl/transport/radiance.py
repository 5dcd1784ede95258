"""The operator from extinction to radiances, and its gradient."""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Any, Literal, get_args

import numpy as np

from cloudtomo_cl.arguments import CALLABLE, NUMBER, TRUTH, a, many, require_kinds
from cloudtomo_cl.errors import DataError, TransportError
from cloudtomo_cl.memory import voxels_of
from cloudtomo_cl.opencl.arrays import DeviceArray
from cloudtomo_cl.opencl.device import Device
from cloudtomo_cl.opencl.devices import choose_device
from cloudtomo_cl.opencl.driver import device_errors
from cloudtomo_cl.opencl.pace import Pace
from cloudtomo_cl.parallel.ranks import Ranks, Shares
from cloudtomo_cl.renamed import renamed_arguments, renamed_attributes
from cloudtomo_cl.scene.arrays import real_numbers, unmasked
from cloudtomo_cl.scene.scene import Scene
from cloudtomo_cl.scene.sensors import View
from cloudtomo_cl.transport.audit import Budget, check_replays
from cloudtomo_cl.transport.device_pixels import DevicePixels
from cloudtomo_cl.transport.device_scene import DeviceScene
from cloudtomo_cl.transport.gradient import deposited
from cloudtomo_cl.transport.launches import Launch, StoredLaunch
from cloudtomo_cl.transport.medium import LARGEST_VOXEL_DEPTH, Medium
from cloudtomo_cl.transport.path_sums import BRANCHES, PathSums, statistics
from cloudtomo_cl.transport.rendering import Rendering, joined
from cloudtomo_cl.transport.rendering_memory import on_device, pixels_at_once, require_memory
from cloudtomo_cl.transport.samples import Samples
from cloudtomo_cl.transport.virtual_collisions import FEW_PATHS, VirtualCollisions

# Asymmetry of the droplets from which paths branch by default.
BRANCHING_G = 0.5
Estimator = Literal["branches", "side-flights", "plain"]


@renamed_attributes(field="on_device", kept_launches="stored_launches")
class RadianceOperator:
    """Renders a scene's views, and differentiates them, by backward Monte Carlo.

    Parameters
    ----------
    scene : grid, optics, sun, air, surface, boundary
    views : the sensors
    device : where to compute; by default `choose_device()`
    pixels : which pixels, an integer array (pixels, 2) of (view, row * width + column); all by default
    estimator : "branches" or "side-flights" (both: less noise under a forward peak; the mean is the same), or
        "plain", one local estimate at every interaction; by default branches if the asymmetry of the droplets is at
        least 0.5

    effective_radius : of the droplets, micrometres, shape of the grid, for a phase table of
        several radii; by default `scene.cloud.effective_radius` everywhere
    truncation : cuts single local estimates to so many sr^-1. That removes rare bright points and
        makes the images too dark; `Rendering.audit.truncated` says by how much. By default nothing

    mask : bool, or 0 and 1, shape of the grid, where there may be droplets. Elsewhere every extinction must be 0
        and gradients are 0, for walks skip what is empty; by default everywhere

    Source: the supplement's Eqs. 1-19; docs/explanation/radiance.md.

    Raises
    ------
    DataError : no view; pixels that are not there; an unknown estimator; an effective radius or a mask that does not
        fit
    """

    def __repr__(self) -> str:
        views = f"{len(self.views)} views, {len(self.pixels)} pixels"
        return f"RadianceOperator({views}, {self.scene.grid.text}, {self.estimator}, on {self.device.name})"

    @device_errors("preparing a rendering")
    def __init__(
        self,
        scene: Scene,
        views: Sequence[View],
        device: Device | None = None,
        pixels: np.ndarray | None = None,
        estimator: Estimator | None = None,
        *,
        effective_radius: np.ndarray | None = None,
        truncation: float | None = None,
        mask: np.ndarray | None = None,
    ) -> None:
        require_kinds(
            "RadianceOperator",
            scene=(scene, a(Scene)),
            views=(views, many(View)),
            device=(device, a(Device).or_none()),
            truncation=(truncation, NUMBER.or_none()),
        )
        if not len(views):
            raise DataError("no view: a scene needs at least one to be rendered")
        if truncation is not None and not truncation > 0:
            raise DataError(f"truncation is {truncation}: it must be above 0 sr^-1")
        if estimator is not None and not (isinstance(estimator, str) and estimator in get_args(Estimator)):
            *others, last = (f'"{name}"' for name in get_args(Estimator))
            allowed = f"{', '.join(others)} or {last}"
            raise DataError(
                f"estimator is {estimator!r}: it must be {allowed}, or None for the one that suits the cloud"
            )
        self.scene = scene
        self.device = device or choose_device()
        self.estimator: Estimator = estimator or (
            "branches" if scene.cloud.phase_function.g >= BRANCHING_G else "plain"
        )
        if pixels is None:
            require_memory(self.device, scene.grid.shape, sum(voxels_of(view.pixels) for view in views))
        self._device_scene = DeviceScene(
            scene, self.device, effective_radius, self.estimator != "plain", truncation or np.inf, mask
        )
        self._pixels = DevicePixels(scene, views, self.device, pixels)
        self._pace = Pace(self.device)
        self._path_sums = PathSums(self._pace, self.path_features)
        self._virtual_collisions = VirtualCollisions(self._device_scene)

    @renamed_arguments(iteration="stream", keep_paths="store_paths")
    @device_errors("rendering")
    def render(
        self,
        extinction: Any,
        samples: int,
        seed: int = 0,
        stream: int = 0,
        store_paths: bool = False,
        progress: Callable[[int], None] | None = None,
        first_sample: int = 0,
    ) -> Rendering:
        """Radiance of every pixel.

        Parameters
        ----------
        extinction : of the droplets, km^-1, shape of the grid; NumPy, an array on the device, or what
            `on_device` has returned
        samples : paths per pixel, even
        seed, stream : together with view, pixel and sample these determine every path
        store_paths : keep what `gradient` needs (4 bytes per path on the device, 20 with branches)
        progress : called with the number of samples done so far
        first_sample : number of the first path of every pixel, even

        Raises
        ------
        DataError : extinction of another shape, negative or not finite; samples odd, or beyond 2^32; seed or
            stream no whole number of 32 bits
        TransportError : a radiance is not finite
        AuditError : energy was lost or gained (see `Audit.check`)
        """
        require_kinds(
            "RadianceOperator.render", store_paths=(store_paths, TRUTH), progress=(progress, CALLABLE.or_none())
        )
        at_once = min(self.ranks.all(pixels_at_once(self.device, voxels_of(self.scene.grid.shape), len(self.pixels))))
        if at_once < len(self.pixels) and not store_paths:
            options = {"seed": seed, "stream": stream, "first_sample": first_sample}
            return self._render_in_parts(at_once, extinction, samples, progress, **options)
        paths = Samples.checked(samples, seed, stream, first_sample)
        medium, budget = self.ranks.together(
            lambda: (self._device_scene.medium(extinction, skips_empty=not store_paths), Budget(self.device))
        )
        sums, launches = self.ranks.together(
            lambda: self._path_sums.of(medium, self._pixels, paths, budget, store_paths, progress)
        )
        return self._rendering(self.shares.gathered(sums), paths, budget, medium, launches)

    def _render_in_parts(
        self, at_once: int, extinction: Any, samples: int, progress: Callable[[int], None] | None, **options: Any
    ) -> Rendering:
        """As `render`, so many pixels at a time: with the same bits, but for the audit's rounding.

        options : those of `render`
        """
        found, pixels = [], self.pixels
        medium = self.ranks.together(lambda: self.on_device(extinction))
        for begin in range(0, len(pixels), at_once):
            part = self.ranks.together(partial(self.of_pixels, pixels[begin : begin + at_once]))

            def told(done: int, before: int = begin, count: int = len(part.pixels)) -> None:
                if progress:
                    progress(int((samples * before + done * count) / len(pixels)))

            found.append(part.render(medium, samples, progress=told, **options))
        return joined(found, self)

    @device_errors("putting the extinction on the device")
    def on_device(self, extinction: Any) -> Medium:
        """An extinction for several renders that keep no paths: looked through and put on the device once.

        Raises DataError as `render`.
        """
        return self._device_scene.medium(extinction, skips_empty=True)

    def of_pixels(self, pixels: np.ndarray) -> RadianceOperator:
        """The same operator for other pixels; see the class. DataError if one is not there."""
        return self._with(self._pixels.of_pixels(pixels))

    def of_views(self, views: Sequence[View]) -> RadianceOperator:
        """The same operator for other views that have the same pixels; see the class.

        Raises
        ------
        InvalidArgumentError : views are none
        """
        require_kinds("RadianceOperator.of_views", views=(views, many(View)))
        return self._with(self._pixels.of_views(views))

    def without_branches(self) -> RadianceOperator:
        """The same operator, with side flights alone if its paths branch."""
        if self.estimator != "branches":
            return self
        other = copy.copy(self)
        other.estimator = "side-flights"
        other._path_sums = PathSums(other._pace, other.path_features)
        return other

    def _with(self, pixels: DevicePixels) -> RadianceOperator:
        other = copy.copy(self)
        other._pixels = pixels
        return other

    @property
    def views(self) -> tuple[View, ...]:
        """The sensors."""
        return self._pixels.views

    @property
    def pixels(self) -> np.ndarray:
        """The pixels (view, row * width + column), uint32, shape (pixels, 2)."""
        return self._pixels.listed

    @property
    def mask(self) -> np.ndarray | None:
        """Where there may be droplets, bool, shape of the grid; None: everywhere."""
        return self._device_scene.mask

    @property
    def features(self) -> tuple[str, ...]:
        """Macros of kernels that walk through this scene."""
        return self._device_scene.features

    @property
    def path_features(self) -> tuple[str, ...]:
        """Macros of kernels that walk the pixels' paths."""
        return (*self.features, BRANCHES) if self.estimator == "branches" else self.features

    @property
    def scene_struct(self) -> Any:
        """The kernels' Scene."""
        return self._device_scene.struct

    @property
    def ranks(self) -> Ranks:
        """Those that share the pixels' paths."""
        return self.device.ranks

    @property
    def shares(self) -> Shares:
        """Which rank has which of the pixels."""
        return self._pixels.shares

    def _rendering(
        self,
        sums: np.ndarray,
        samples: Samples,
        budget: Budget,
        medium: Medium,
        launches: list[tuple[int, Any]] | None,
    ) -> Rendering:
        """What all ranks' sums are radiances of."""
        irradiance, count = self.scene.sun.irradiance, samples.count
        mean, standard_error, halves = statistics(sums, count, irradiance)
        wrong = ~np.isfinite(standard_error)
        if wrong.any():
            view, pixel = self.pixels[np.argmax(wrong)]
            drawn = f"seed {samples.seed}, stream {samples.stream}"
            raise TransportError(f"radiance is not finite in view {view}, pixel {pixel} ({drawn})")
        audit = budget.audit(float(mean.sum()) / irradiance * count)
        audit.check(count * len(self.pixels))
        return Rendering(
            mean, standard_error, halves, count, samples.seed, samples.stream, audit, medium, launches, self
        )

    @renamed_arguments(filling_limit="virtual_limit")
    @device_errors("the gradient")
    def gradient(self, rendering: Rendering, adjoint: np.ndarray, virtual_limit: float | None = None) -> Any:
        """The gradient of a cost with respect to extinction, by replay of a rendering's paths.

        It is unbiased in every voxel of the mask, those of extinction 0 included; outside of the mask it is 0.

        Parameters
        ----------
        rendering : made by this operator with store_paths
        adjoint : derivative of the cost with respect to `rendering.halves`, shape (pixels, 2).
            For an unbiased gradient the entry of one half must not depend on that half's own
            paths (see `objective.crossed_halves`).
        virtual_limit : extinction, km^-1, up to which virtual droplets add to a voxel's own, see
            kernels/replay.cl. It changes noise and time, not the mean, if it is above 0: without them voxels of
            extinction 0 are biased. By default such that a path meets a tenth of one

        Returns
        -------
        an array on the device, float32, shape of the grid, cost per km^-1

        Raises
        ------
        DataError : the rendering did not keep its paths; adjoint has another shape, or values beyond single precision;
            virtual_limit is negative
        AuditError : paths bring other radiances than before
        TransportError : a voxel's sum has overflowed
        """
        require_kinds("RadianceOperator.gradient", rendering=(rendering, a(Rendering)))
        if rendering._launches is None:
            raise DataError("this rendering kept no paths: render with store_paths=True (a copy of one has none)")
        adjoint = unmasked(adjoint, "adjoint")
        require_kinds("RadianceOperator.gradient", virtual_limit=(virtual_limit, NUMBER.or_none()))
        if adjoint.shape != (len(self.pixels), 2) or adjoint.dtype.kind not in "iuf":
            raise DataError(f"adjoint is {adjoint.dtype} {adjoint.shape}: it must be numbers ({len(self.pixels)}, 2)")
        if virtual_limit is not None and not 0 <= virtual_limit * min(self.scene.grid.spacing) <= LARGEST_VOXEL_DEPTH:
            raise DataError(
                f"virtual_limit is {virtual_limit}: it must be at least 0 km^-1, and an optical depth of at most "
                f"{LARGEST_VOXEL_DEPTH:g} across a voxel"
            )
        deposit = partial(self._replay, rendering, virtual_limit)
        return deposited(self.scene, self.device, self.shares, adjoint, rendering.samples, deposit)[0]

    def _replay(
        self, rendering: Rendering, virtual_limit: float | None, factors: DeviceArray, total: DeviceArray
    ) -> None:
        """Adds what this rank's paths deposit; see `deposited`."""
        extinction = rendering._medium.extinction.get()
        if virtual_limit is None:
            virtual_limit = self._virtual_collisions.limit(extinction, self._few_paths(rendering))
        virtual = self._virtual_collisions.extinction(extinction, virtual_limit)
        for launch in self.stored_launches(rendering):
            self._virtual_collisions.run(
                launch, rendering.path_features, adjoint=factors, virtual_extinction=virtual, gradient=total
            )

    def _few_paths(self, rendering: Rendering) -> Launch:
        """About `FEW_PATHS` of a rendering, of pixels all over the images; every rank has all of them."""
        count = len(self.pixels)
        evenly = np.unique(np.linspace(0, count - 1, min(count, FEW_PATHS)).astype(int))
        paths = len(evenly) * -(-FEW_PATHS // len(evenly))
        pixels = self.pixels[evenly]
        walk = self._pixels.paths(rendering._medium, 0, paths, rendering.seed, rendering.stream, pixels)
        return Launch(paths, self._pace, walk)

    def stored_launches(self, rendering: Rendering) -> Iterator[StoredLaunch]:
        """The launches of a rendering that kept its paths, for kernels to walk them again: those of this rank.

        Raises
        ------
        DataError : the rendering did not keep its paths
        AuditError : after the last of them, if paths have brought other radiances than before
        """
        require_kinds("RadianceOperator.stored_launches", rendering=(rendering, a(Rendering)))
        if rendering._launches is None:
            raise DataError("this rendering kept no paths: render with store_paths=True (a copy of one has none)")
        made_by: RadianceOperator = rendering._operator
        astray = self.device.zeros(1, np.uint32)
        for first, stored_paths in rendering._launches:
            radiances = on_device(self.device, stored_paths)
            paths = radiances.shape[1]
            walk = made_by._pixels.paths(rendering._medium, first, paths, rendering.seed, rendering.stream)
            stored = {"path_radiance": radiances, "astray": astray}
            yield StoredLaunch(paths, self._pace, walk, paths // len(self.shares), stored)
        check_replays(int(astray.get()[0]), rendering.samples * len(self.pixels))

    def images(self, values: np.ndarray) -> list[np.ndarray]:
        """Values per pixel as one image (rows, columns) per view; NaN where no pixel is.

        Raises DataError if there is not one value for each pixel; InvalidArgumentError if they are no numbers.
        """
        values = real_numbers(values, "values")
        if values.shape != (len(self.pixels),):
            raise DataError(f"values have shape {values.shape}: one is needed for each of {len(self.pixels)} pixels")
        images = [np.full(view.pixels[0] * view.pixels[1], np.nan) for view in self.views]
        for index, image in enumerate(images):
            chosen = self.pixels[:, 0] == index
            image[self.pixels[chosen, 1]] = values[chosen]
        return [image.reshape(view.pixels[1], view.pixels[0]) for image, view in zip(images, self.views)]
