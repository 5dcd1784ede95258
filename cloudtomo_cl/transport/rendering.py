"""Radiances of pixels as they were rendered, and what several of them are together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from cloudtomo_cl.errors import DataError
from cloudtomo_cl.files.measurements import measurements_dataset
from cloudtomo_cl.renamed import renamed_attributes
from cloudtomo_cl.scene.cards import card
from cloudtomo_cl.scene.measurements import Measurements
from cloudtomo_cl.transport.audit import Audit, combined


@renamed_attributes(iteration="stream")
@dataclass(frozen=True, eq=False)
class Rendering:
    """Radiances of the operator's pixels.

    Attributes
    ----------
    mean : W m^-2 sr^-1, shape (pixels,)
    standard_error : of the mean, same unit and shape, by the pixel's own paths: squares of it are unbiased, and sums
        of them hold. As a pixel's error bar, or as its weight, with few paths it does not, for rare bright paths make
        most of the light: `Measurements.rendered` has errors that do
    halves : means over even and over odd samples, shape (pixels, 2)
    samples : paths per pixel; an array (pixels,) if they differ (`adaptive.render_to_error`)
    seed, stream : what the paths were drawn with
    audit : what became of the paths

    A copy by `copy` or `pickle` has all of these, but neither stored paths (`gradient` refuses it) nor operator
    (`to_dataset` does): its images are those of `Measurements.rendered(operator, rendering)`.
    """

    mean: np.ndarray
    standard_error: np.ndarray
    halves: np.ndarray
    samples: Any
    seed: int
    stream: int
    audit: Audit
    _medium: Any = field(repr=False)  # a Medium; None of a copy
    _launches: list[tuple[int, Any]] | None = field(repr=False, default=None)
    _operator: Any = field(repr=False, default=None)

    def __reduce__(self) -> tuple[Any, ...]:
        """Without what lives on a device."""
        numbers = (self.mean, self.standard_error, self.halves, self.samples, self.seed, self.stream, self.audit)
        return Rendering, (*numbers, None)

    @property
    def path_features(self) -> tuple[str, ...]:
        """Macros of kernels that walk its paths again."""
        return self._operator.path_features

    def to_dataset(self) -> Any:
        """Its images as an xarray Dataset, with views, units and standard errors: see `measurements_dataset`.

        Raises DataError where the operator has no pixel of a view: there is no image; and of a copy.
        """
        if self._operator is None:
            raise DataError(
                "this rendering is a copy, which has no views: write measurements_dataset(Measurements.rendered("
                "operator, rendering))"
            )
        return measurements_dataset(Measurements.rendered(self._operator, self))

    def _repr_html_(self) -> str:
        images = [] if self._operator is None else self._operator.images(self.mean)
        samples = f"{np.mean(self.samples):.6g} paths per pixel, seed {self.seed}"
        return card(
            "Rendering", {"mean radiance": f"{self.mean.mean():.4g} W m^-2 sr^-1", "made by": samples}, _named(images)
        )

    def __repr__(self) -> str:
        radiance, samples = f"mean {self.mean.mean():.4g} W m^-2 sr^-1", np.mean(self.samples)
        return f"Rendering({self.mean.size} pixels, {radiance}, {samples:.6g} paths per pixel, seed {self.seed})"


def _named(images: Sequence[np.ndarray]) -> list[tuple[str, np.ndarray]]:
    return [(f"view {number}", image) for number, image in enumerate(images)]


def pooled(first: Rendering, second: Rendering, share: float | None = None) -> Rendering:
    """Two renderings of the same pixels with different paths. It has no stored paths: there are no gradients of it.

    share : of the first in their mean, for paths of different estimators; by default that of its paths
    """
    if share is None:
        share = first.samples / (first.samples + second.samples)
    return replace(
        first,
        mean=share * first.mean + (1 - share) * second.mean,
        halves=share * first.halves + (1 - share) * second.halves,
        standard_error=np.hypot(share * first.standard_error, (1 - share) * second.standard_error),
        samples=first.samples + second.samples,
        _launches=None,
    )


def joined(parts: Sequence[Rendering], operator: Any) -> Rendering:
    """Renderings of some pixels after others with the same paths each, as one of all pixels, which are `operator`'s.

    It has no stored paths.
    """
    mean, error, halves = (
        np.concatenate([getattr(one, name) for one in parts]) for name in ("mean", "standard_error", "halves")
    )
    audit = combined([one.audit for one in parts])
    return replace(
        parts[0], mean=mean, standard_error=error, halves=halves, audit=audit, _launches=None, _operator=operator
    )
