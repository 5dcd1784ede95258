"""Measured images and the views they were taken from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from cloudtomo_cl.errors import DataError
from cloudtomo_cl.grid import resample
from cloudtomo_cl.sensors import RayView, View

if TYPE_CHECKING:
    from cloudtomo_cl.transport import RadianceOperator, Rendering


@dataclass(frozen=True)
class Measurements:
    """Images of one cloud.

    Attributes
    ----------
    views : one per image
    images : radiance, W m^-2 sr^-1, each of shape (rows, columns) of its view
    standard_errors : of the radiances, same unit and shapes; zero where unknown
    """

    views: tuple[View, ...]
    images: tuple[np.ndarray, ...]
    standard_errors: tuple[np.ndarray, ...]

    @classmethod
    def rendered(cls, operator: RadianceOperator, rendering: Rendering) -> Measurements:
        """All pixels of a rendering as images."""
        images, errors = (tuple(operator.images(values)) for values in (rendering.mean, rendering.standard_error))
        return cls(operator.views, images, errors)

    def __post_init__(self) -> None:
        if not self.views:
            raise DataError("measurements: there is no view: at least one image is needed")
        for name, arrays in (("images", self.images), ("standard_errors", self.standard_errors)):
            if len(arrays) != len(self.views):
                raise DataError(f"measurements: {len(arrays)} {name} for {len(self.views)} views")
            for index, (view, array) in enumerate(zip(self.views, arrays)):
                if array.shape != view.pixels[::-1]:
                    raise DataError(
                        f"measurements: {name} of view {index} have shape {array.shape}, "
                        f"the view has {view.pixels[1]} rows and {view.pixels[0]} columns"
                    )
                wrong = ~np.isfinite(array)
                if wrong.any():
                    row, column = np.argwhere(wrong)[0]
                    where = f"view {index} are not finite at row {row}, column {column}"
                    raise DataError(f"measurements: {name} of {where}")
        for index, error in enumerate(self.standard_errors):
            if (error < 0).any():
                raise DataError(f"measurements: standard_errors of view {index} are negative: they must be at least 0")

    def __repr__(self) -> str:
        sizes = sorted({view.pixels for view in self.views})
        pixels = ", ".join(f"{width} x {height}" for width, height in sizes[:3]) + (", ..." if len(sizes) > 3 else "")
        least = min((float(image.min()) for image in self.images), default=np.nan)
        most = max((float(image.max()) for image in self.images), default=np.nan)
        radiances = f"radiance {least:.4g} to {most:.4g} W m^-2 sr^-1"
        return f"Measurements({len(self.views)} views of {pixels} pixels, {radiances})"

    def resampled(self, pixels: Sequence[tuple[int, int]]) -> Measurements:
        """The same images averaged over larger pixels, (width, height) for each view.

        Raises
        ------
        DataError : other pixels for a view that is a list of rays
        """
        views: list[View] = []
        images, errors = [], []
        for view, image, error, (width, height) in zip(self.views, self.images, self.standard_errors, pixels):
            if isinstance(view, RayView):
                if (width, height) != view.pixels:
                    raise DataError("a view that is a list of rays has no larger pixels: keep those it has")
                views.append(view)
            else:
                views.append(view.with_pixels((width, height)))
            images.append(resample(image, (height, width)))
            # Independent pixels: variances add with the squares of their shares.
            share = width * height / image.size
            errors.append(np.sqrt(resample(error**2, (height, width)) * min(share, 1.0)))
        return Measurements(tuple(views), tuple(images), tuple(errors))

    def at_share(self, share: float) -> Measurements:
        """The images with `share` of their width and height, but at least 8 pixels or all there are.

        Views that are lists of rays keep theirs.
        """
        if share == 1:
            return self
        return self.resampled(
            [
                view.pixels
                if isinstance(view, RayView)
                else tuple(min(count, max(8, round(share * count))) for count in view.pixels)  # type: ignore[misc]
                for view in self.views
            ]
        )

    def differences(self, modelled: Measurements) -> list[np.ndarray]:
        """Modelled minus measured radiance in standard errors of both together; NaN where neither is known."""
        differences = []
        for index, image in enumerate(self.images):
            error = np.hypot(self.standard_errors[index], modelled.standard_errors[index])
            difference = modelled.images[index] - image
            differences.append(np.divide(difference, error, out=np.full(image.shape, np.nan), where=error > 0))
        return differences
