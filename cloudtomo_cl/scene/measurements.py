"""Measured images and the views they were taken from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np

from cloudtomo_cl.arguments import NUMBER, NUMBERS, WHOLE, Kind, a, able, many, require_kinds, several
from cloudtomo_cl.errors import DataError
from cloudtomo_cl.renamed import renamed_attributes
from cloudtomo_cl.scene.arrays import unmasked
from cloudtomo_cl.scene.cards import card
from cloudtomo_cl.scene.grid import Grid, resample
from cloudtomo_cl.scene.pixel_errors import pooled_standard_errors
from cloudtomo_cl.scene.pointing import checked_motions, motion_errors, moved
from cloudtomo_cl.scene.scene import Scene
from cloudtomo_cl.scene.sensors import RayView, View

# Least share of a larger pixel that must be valid: half, up to rounding.
_LEAST_VALID = 0.5 - 1e-9
# From here on a number is no radiance but a mark for invalid pixels.
BEYOND_RADIANCES = 1e16
# Relative difference below which wavelengths count as the same.
_SAME_WAVELENGTH = 1e-5
# Standard errors of views: upper bound, beyond which a camera is not known at all, and the allowed range in words.
_ERRORS_OF_VIEWS = {
    "calibration_errors": (1.0, "at least 0, below 1"),
    "pointing_errors": (10.0, "at least 0, below 10 degrees"),
    "position_errors": (float("inf"), "at least 0 km, and finite"),
}


_ONE_FOR_EACH = Kind("a tuple or list, an array for each view", many(object).fits)


class _Renders(Protocol):
    """What makes images of a rendering: a `RadianceOperator`, which this layer must not import."""

    scene: Scene

    @property
    def views(self) -> tuple[View, ...]: ...

    def images(self, values: np.ndarray, /) -> list[np.ndarray]: ...


@renamed_attributes(bad_pixels="invalid_pixels")
@dataclass(frozen=True, eq=False)
class Measurements:
    """Images of one cloud; == tells whether two are the same object, not whether their radiances are equal.

    Attributes
    ----------
    views : views, one per image
    images : radiances, W m^-2 sr^-1, each of shape (rows, columns) of its view; NaN in invalid pixels
    standard_errors : standard errors of the radiances, same unit and shapes; 0 where unknown; without meaning in
        invalid pixels
    calibration_errors : standard errors of the views' gains, for instance 0.02 for gains of 1; empty: all exact.
        They are no part of `standard_errors`, since they are common to all pixels of a view
    pointing_errors : standard errors of the directions that the cameras look in and of the images' rotation, degrees;
        empty: all exact
    position_errors : standard errors of the positions of cameras, or of orthographic images, km; empty: all exact
    wavelength : wavelength in air, nm, if it is known
    """

    views: tuple[View, ...]
    images: tuple[np.ndarray, ...]
    standard_errors: tuple[np.ndarray, ...]
    calibration_errors: tuple[float, ...] = ()
    pointing_errors: tuple[float, ...] = ()
    position_errors: tuple[float, ...] = ()
    wavelength: float | None = None

    @classmethod
    def rendered(cls, operator: _Renders, rendering: Any) -> Measurements:
        """All pixels of a `Rendering` by a `RadianceOperator` as images.

        The standard errors are pooled over neighbours (`pixel_errors`): as error bars and as weights they hold, and
        the rendering's, from a single pixel's few paths, do not.
        """
        require_kinds(
            "Measurements.rendered",
            operator=(operator, able("a RadianceOperator", "images")),
            rendering=(rendering, Kind("a Rendering", lambda one: hasattr(one, "standard_error"))),
        )
        images, errors = (operator.images(values) for values in (rendering.mean, rendering.standard_error))
        samples = operator.images(np.broadcast_to(np.asarray(rendering.samples, np.float64), rendering.mean.shape))
        pooled = tuple(map(pooled_standard_errors, errors, samples))
        return cls(operator.views, tuple(images), pooled, wavelength=operator.scene.wavelength)

    def __post_init__(self) -> None:
        require_kinds("Measurements", views=(self.views, many(View)), wavelength=(self.wavelength, NUMBER.or_none()))
        if self.wavelength is not None:
            object.__setattr__(self, "wavelength", float(self.wavelength))
        for name in ("images", "standard_errors"):
            require_kinds("Measurements", **{name: (getattr(self, name), _ONE_FOR_EACH)})
            object.__setattr__(self, name, tuple(_radiances(array, name) for array in getattr(self, name)))
        if not len(self.views):
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
                bad = np.isnan(self.images[index])
                wrong = ~np.isfinite(array) & ~bad
                if wrong.any():
                    row, column = np.argwhere(wrong)[0]
                    where = f"view {index} are not finite at row {row}, column {column}"
                    hint = "" if name == "standard_errors" else ": set the radiance of invalid pixels to NaN"
                    raise DataError(f"measurements: {name} of {where}{hint}")
                beyond = ~bad & ~(np.abs(array) < BEYOND_RADIANCES)
                if beyond.any():
                    row, column = np.argwhere(beyond)[0]
                    raise DataError(
                        f"measurements: {name} of view {index} have {array[row, column]:g} at row {row}, column "
                        f"{column}: they must be below {BEYOND_RADIANCES:g} W m^-2 sr^-1; set invalid pixels to NaN"
                    )
                if bad.all():
                    raise DataError(f"measurements: all pixels of view {index} are bad: leave the view out")
        for name, (below, allowed) in _ERRORS_OF_VIEWS.items():
            require_kinds("Measurements", **{name: (getattr(self, name), NUMBERS)})
            values = tuple(map(float, getattr(self, name))) or (0.0,) * len(self.views)
            object.__setattr__(self, name, values)
            if len(values) != len(self.views):
                raise DataError(f"measurements: {len(values)} {name}, {len(self.views)} views")
            for index, value in enumerate(values):
                if not 0 <= value < below:
                    raise DataError(f"measurements: {name} of view {index} is {value}: {allowed}")
        if self.wavelength is not None and not 0 < self.wavelength < np.inf:
            raise DataError(f"measurements: wavelength is {self.wavelength:g}: it must be above 0 nm")
        for index, error in enumerate(self.standard_errors):
            if (error < 0).any():
                raise DataError(f"measurements: standard_errors of view {index} are negative: they must be at least 0")

    def __repr__(self) -> str:
        sizes = sorted({view.pixels for view in self.views})
        pixels = ", ".join(f"{width} x {height}" for width, height in sizes[:3]) + (", ..." if len(sizes) > 3 else "")
        least = min((float(np.nanmin(image)) for image in self.images), default=np.nan)
        most = max((float(np.nanmax(image)) for image in self.images), default=np.nan)
        radiances = f"radiance {least:.4g} to {most:.4g} W m^-2 sr^-1"
        bad = self.invalid_pixels
        light = "" if self.wavelength is None else f", {self.wavelength:g} nm"
        about = f"{len(self.views)} views of {pixels} pixels{light}, {radiances}"
        return f"Measurements({about}{f', {bad} bad' if bad else ''})"

    def _repr_html_(self) -> str:
        facts = {"views": str(len(self.views)), "pixels": str(sum(image.size for image in self.images))}
        facts["radiance"] = f"up to {max(float(np.nanmax(image)) for image in self.images):.4g} W m^-2 sr^-1"
        facts["invalid pixels"] = str(self.invalid_pixels)
        if self.wavelength is not None:
            facts["wavelength"] = f"{self.wavelength:g} nm"
        return card("Measurements", facts, [(f"view {n}", image) for n, image in enumerate(self.images)])

    @property
    def valid(self) -> tuple[np.ndarray, ...]:
        """Which pixels are valid: bool, the images' shapes."""
        return tuple(~np.isnan(image) for image in self.images)

    @property
    def invalid_pixels(self) -> int:
        """The number of invalid pixels in all images."""
        return sum(int(np.isnan(image).sum()) for image in self.images)

    def motion_errors(self, grid: Grid) -> np.ndarray:
        """Standard errors of the views' motions (`scene.pointing`), shape (views, 3).

        Raises
        ------
        DataError : a view with such an error is neither a camera nor orthographic
        """
        errors = []
        for index, (view, *given) in enumerate(zip(self.views, self.pointing_errors, self.position_errors)):
            try:
                errors.append(motion_errors(view, grid, *given))
            except DataError as error:
                raise DataError(f"measurements: view {index}: {error}") from None
        return np.array(errors)

    def moved(self, motions: np.ndarray | None, grid: Grid) -> Measurements:
        """The same images, of views after small motions (`scene.pointing`), shape (views, 3); None: no motion.

        Raises
        ------
        DataError : motions of another shape, or no numbers (InvalidArgumentError); a moved view that is none
        """
        require_kinds("Measurements.moved", grid=(grid, a(Grid)))
        motions = None if motions is None else checked_motions(motions, len(self.views))
        if motions is None or not np.any(motions):
            return self
        return replace(self, views=tuple(moved(view, motion, grid) for view, motion in zip(self.views, motions)))

    def resampled(self, pixels: Sequence[tuple[int, int]]) -> Measurements:
        """The same images averaged over larger pixels, (width, height) for each view.

        A larger pixel is the mean of the valid pixels in it, and invalid if they cover less than half of its area.

        Raises
        ------
        DataError : other pixels for a view that is a list of rays; pixels are no pairs of whole numbers, one for each
            view (InvalidArgumentError)
        """
        pairs = several(len(self.views), several(2, WHOLE))
        require_kinds("Measurements.resampled", pixels=(pixels, pairs))
        views: list[View] = []
        images, errors = [], []
        for view, image, error, (width, height) in zip(self.views, self.images, self.standard_errors, pixels):
            if isinstance(view, RayView):
                if (width, height) != view.pixels:
                    raise DataError("a view that is a list of rays has no larger pixels: keep those it has")
                views.append(view)
            else:
                views.append(view.with_pixels((width, height)))
            valid = ~np.isnan(image)
            covered = 1.0 if valid.all() else resample(valid.astype(float), (height, width))
            whole = np.where(covered >= _LEAST_VALID, covered, np.nan)
            images.append(resample(np.where(valid, image, 0.0), (height, width)) / whole)
            # Independent pixels: variances add with the squares of their shares.
            share = width * height / image.size
            variance = resample(np.where(valid, error**2, 0.0), (height, width)) / whole**2
            errors.append(np.sqrt(variance * min(share, 1.0)))
        return replace(self, views=tuple(views), images=tuple(images), standard_errors=tuple(errors))

    def at_share(self, share: float) -> Measurements:
        """The images with `share` of their width and height, but at least 8 pixels or all there are.

        Views that are lists of rays keep theirs.

        Raises
        ------
        DataError : share is not above 0 and at most 1, or no number (InvalidArgumentError)
        """
        require_kinds("Measurements.at_share", share=(share, NUMBER))
        if not 0 < share <= 1:
            raise DataError(f"share is {share}: it must be above 0 and at most 1")
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
        """Modelled minus measured radiance over the standard error of the difference; NaN where unknown or invalid."""
        require_kinds("Measurements.differences", modelled=(modelled, a(Measurements)))
        differences = []
        for index, image in enumerate(self.images):
            error = np.hypot(self.standard_errors[index], modelled.standard_errors[index])
            difference = modelled.images[index] - image
            differences.append(np.divide(difference, error, out=np.full(image.shape, np.nan), where=error > 0))
        return differences


def _radiances(array: Any, name: str) -> np.ndarray:
    """An array in a precision that holds squares of radiances; masked pixels are invalid ones.

    Raises
    ------
    DataError : it holds no real numbers
    """
    array = unmasked(array, f"measurements: {name}")
    if array.dtype.kind not in "biuf":
        raise DataError(f"measurements: {name} are of type {array.dtype}: they must be real numbers")
    return array if array.dtype.kind == "f" and array.itemsize >= 4 else array.astype(np.float64)


def check_wavelength(scene: Scene, measurements: Measurements) -> None:
    """Raises DataError if a scene and its images are known to be at different wavelengths."""
    one, other = scene.wavelength, measurements.wavelength
    if one is not None and other is not None and not np.isclose(one, other, rtol=_SAME_WAVELENGTH, atol=0.0):
        raise DataError(f"the scene is at {one:g} nm, the images are of {other:g} nm: take optics of their wavelength")
