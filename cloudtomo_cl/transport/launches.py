"""Paths that kernels walk together, and stored ones that they walk again."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from cloudtomo_cl.opencl.pace import Pace


@dataclass(frozen=True)
class Launch:
    """Paths that are walked together.

    Attributes
    ----------
    paths : how many
    """

    paths: int
    _pace: Pace
    _walk: dict[str, Any]

    def walk(self, kernel: Any, work_items: int, **arguments: Any) -> None:
        """Runs a kernel that walks other paths of the same pixels."""
        self._pace.device.launch(kernel, work_items, **self._walk, **arguments)


@dataclass(frozen=True)
class StoredLaunch(Launch):
    """Paths of a rendering that are walked again together."""

    _samples: int
    _stored: dict[str, Any]

    @property
    def _arguments(self) -> dict[str, Any]:
        return self._walk | self._stored

    def run(self, kernel: Any, **arguments: Any) -> None:
        """Runs a kernel on them; given are its own arguments, beside those of all replays."""
        self._pace.launch(kernel, self.paths, **self._arguments, **arguments)

    def run_part(self, kernel: Any, begin: int, end: int, **arguments: Any) -> None:
        """Runs a kernel on the paths `begin` to `end`; begin is a multiple of the work groups' size."""
        self._pace.device.launch(kernel, end - begin, global_offset=begin, **self._arguments, **arguments)

    def run_rays(self, kernel: Any, pixels: int, most: int, **arguments: Any) -> int:
        """Runs a kernel on rays of the pixels' first samples here; returns of how many: `most`, or all there are."""
        rays = min(most, self._samples)
        if rays:
            self._pace.device.launch(kernel, pixels * rays, **self._arguments, **arguments, ray_count=rays)
        return rays

    def run_rows(self, kernel: Any, pixels: int, **arguments: Any) -> None:
        """Runs a kernel on the paths of so many of the pixels (`first_pixel` is among the arguments)."""
        self._pace.launch(kernel, pixels * self._samples, **self._arguments, **arguments)
