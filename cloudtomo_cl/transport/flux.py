"""Fluxes through the top and the bottom of a domain, and absorption, by photons from the sun."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from cloudtomo_cl.arguments import CALLABLE, a, require_kinds
from cloudtomo_cl.errors import DataError
from cloudtomo_cl.opencl.device import Device
from cloudtomo_cl.opencl.devices import choose_device
from cloudtomo_cl.opencl.driver import device_errors
from cloudtomo_cl.opencl.fixed_point import summed
from cloudtomo_cl.opencl.layout import FLUXES, MOST_SAMPLES, WEIGHT_UNIT, sun_view_struct
from cloudtomo_cl.opencl.pace import Pace
from cloudtomo_cl.scene.scene import Scene
from cloudtomo_cl.scene.seeds import checked_seed
from cloudtomo_cl.transport.audit import Audit, Budget
from cloudtomo_cl.transport.device_scene import DeviceScene
from cloudtomo_cl.transport.medium import Medium

# Standard errors are from the spread of so many independent parts of a run.
_BATCHES = 32


@dataclass(frozen=True, eq=False)
class Estimate:
    """A Monte Carlo estimate and its standard error: two arrays, or two numbers."""

    value: Any
    standard_error: Any


@dataclass(frozen=True, eq=False)
class Fluxes:
    """Fluxes of the columns of a grid, W m^-2, arrays (nx, ny).

    Top and bottom are those of the grid; with air outside of it, those of the atmosphere.

    Attributes
    ----------
    reflected : upward through the top
    direct : downward through the bottom, not scattered
    diffuse : downward through the bottom, scattered; light that a surface sent up and the cloud
        sent down again counts every time
    absorbed : in the column, by droplets and molecules
    incident : downward through the top, mu0 times the irradiance; a number
    photons : launched
    audit : what became of them
    """

    reflected: Estimate
    direct: Estimate
    diffuse: Estimate
    absorbed: Estimate
    incident: float
    photons: int
    seed: int
    audit: Audit
    _batches: np.ndarray

    def __repr__(self) -> str:
        names = ("reflected", "transmitted", "absorbed")
        means = ", ".join(f"{name} {self.domain_mean(name).value:.4g}" for name in names)
        return f"Fluxes({means} of {self.incident:.4g} W m^-2, {self.photons:.3g} photons, seed {self.seed})"

    @property
    def transmitted(self) -> Estimate:
        """Direct and diffuse."""
        return self._of(("DIRECT", "DIFFUSE"), mean=False)

    def domain_mean(self, name: str) -> Estimate:
        """The mean over all columns, two floats, of "reflected", "direct", "diffuse", "transmitted" or "absorbed"."""
        known = ("transmitted", *(flux.lower() for flux in FLUXES))
        if not (isinstance(name, str) and name in known):
            raise DataError(f"domain_mean: name is {name!r}: it must be one of {', '.join(known)}")
        return self._of(("DIRECT", "DIFFUSE") if name == "transmitted" else (name.upper(),), mean=True)

    def _of(self, names: tuple[str, ...], mean: bool) -> Estimate:
        batches = self._batches[:, [FLUXES.index(name) for name in names]].sum(axis=1)
        return _estimate(batches.mean(axis=(1, 2)) if mean else batches)


def _estimate(batches: np.ndarray) -> Estimate:
    """The mean of independent batches, along the first axis."""
    error = batches.std(axis=0, ddof=1) / np.sqrt(len(batches))
    mean = batches.mean(axis=0)
    return Estimate(mean, error) if mean.ndim else Estimate(float(mean), float(error))


def checked_photons(photons: Any) -> int:
    """A number of photons as a Python integer, exact. DataError if it is no whole number above 0."""
    try:
        number = int(photons)
        is_whole = bool(number == photons)
    except (TypeError, ValueError, OverflowError):
        number, is_whole = 0, False
    if not is_whole or number < 1:
        raise DataError(f"photons is {photons!r}: it must be a whole number of at least 1")
    return number


def can_be_open(scene: Scene) -> bool:
    """Whether fluxes of a scene can be had with open sides: nothing arrives from an endless plane beside it."""
    return scene.surface.albedo == 0 and (scene.air is None or not scene.air.is_outside)


class FluxOperator:
    """Follows photons from the sun; the walk is the one of the radiances.

    Parameters
    ----------
    scene : grid, optics, sun, air, surface, boundary
    device : where to compute; by default `choose_device()`
    effective_radius : as in `RadianceOperator`

    Raises
    ------
    DataError : open sides over a surface that reflects, or beside air: what arrives from outside of
        the domain would need an endless plane of photons
    """

    @device_errors("preparing the fluxes")
    def __init__(
        self, scene: Scene, device: Device | None = None, *, effective_radius: np.ndarray | None = None
    ) -> None:
        require_kinds("FluxOperator", scene=(scene, a(Scene)), device=(device, a(Device).or_none()))
        if scene.boundary.horizontal == "open" and not can_be_open(scene):
            raise DataError(
                "fluxes with open sides over a reflecting surface, or in air that goes on beside the grid, would need "
                'endlessly many photons: choose boundary.horizontal = "periodic", or a black surface and no such air'
            )
        self.scene = scene
        self.device = device or choose_device()
        self._device_scene = DeviceScene(scene, self.device, effective_radius)
        sun_view, self._area = sun_view_struct(scene)
        self._pixels = int(sun_view["width"]) * int(sun_view["height"])
        self._sun_view = self.device.constant(sun_view)
        self._trace_photons = self.device.kernel("flux", "trace_photons", self._device_scene.features)
        self._pace = Pace(self.device)

    @device_errors("the fluxes")
    def compute(
        self,
        extinction: Any,
        photons: int = 1_000_000,
        seed: int = 0,
        progress: Callable[[int], None] | None = None,
    ) -> Fluxes:
        """Fluxes of every column.

        Parameters
        ----------
        extinction : of the droplets, km^-1, shape of the grid; NumPy, or an array on the device
        photons : at least, a whole number (1e6 is one); rounded up to a multiple of what 32 independent parts need
        seed : determines every photon
        progress : called with the number of photons done so far

        Raises
        ------
        DataError : extinction of another shape, negative or not finite; no photons, too many, or no whole number of
            them
        AuditError : energy was lost or gained (see `Audit.check`)
        TransportError : a column's sum has overflowed
        """
        require_kinds("FluxOperator.compute", progress=(progress, CALLABLE.or_none()))
        photons = checked_photons(photons)
        seed = checked_seed(seed)
        medium = self._device_scene.medium(extinction, skips_empty=True)
        samples = -(-photons // (_BATCHES * self._pixels))  # per pixel of the sun and batch
        if _BATCHES * samples > MOST_SAMPLES:
            most = MOST_SAMPLES // _BATCHES * _BATCHES * self._pixels
            raise DataError(f"photons is {min(photons, 10**300):.6g}: this scene has at most {most:.6g}")
        budget = Budget(self.device)
        batches = self._traced(medium, samples, seed, budget, progress)
        launched = _BATCHES * samples * self._pixels
        audit = budget.audit()
        audit.check(launched)
        # A photon stands for its share of the sunlight through the plane that the sun sees.
        column_area = self.scene.grid.spacing[0] * self.scene.grid.spacing[1]
        incident = self.scene.sun.irradiance * float(self.scene.sun.direction[2])
        batches *= incident * self._area / column_area / (samples * self._pixels)
        named = {name.lower(): _estimate(batches[:, index]) for index, name in enumerate(FLUXES)}
        return Fluxes(**named, incident=incident, photons=launched, seed=seed, audit=audit, _batches=batches)

    def _traced(
        self, medium: Medium, samples: int, seed: int, budget: Budget, progress: Callable[[int], None] | None
    ) -> np.ndarray:
        """Weights that photons have left in the columns, shape (batches, kinds, nx, ny).

        samples : of every pixel of the sun's view in each batch
        """
        ranks = self.device.ranks
        # Samples are numbered through all batches, and every rank has a range of them.
        own = ranks.part(_BATCHES * samples)

        def trace() -> np.ndarray:
            batches = np.zeros((_BATCHES, len(FLUXES), *self.scene.grid.shape[:2]), np.int64)
            for batch in range(own.start // samples, -(-own.stop // samples)):
                begin, end = max(own.start, batch * samples), min(own.stop, (batch + 1) * samples)
                columns = self.device.zeros(batches.shape[1:], np.int64)
                while begin < end:
                    number = int(np.clip(self._pace.work_items // self._pixels, 1, end - begin))
                    self._pace.launch(
                        self._trace_photons,
                        number * self._pixels,
                        **medium.arguments,
                        sun_view=self._sun_view,
                        pixel_count=self._pixels,
                        first_sample=begin,
                        photon_count=number * self._pixels,
                        seed=seed,
                        columns=columns,
                        budget=budget.data,
                    )
                    begin += number
                    if progress:
                        progress((begin - own.start) * _BATCHES * samples // len(own) * self._pixels)
                batches[batch] = columns.get()
            return batches

        sums = summed(ranks.together(trace), ranks, "a flux", "batch, kind and column")
        for batch in sums:
            batch.view(float)[...] = batch / WEIGHT_UNIT
        return sums.view(float)
