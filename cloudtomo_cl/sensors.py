"""Views: where the sensors stand and how their images lie.

Row 0 is the top of an image as the viewer sees it, columns run left to right. Every view
gives its rays as affine functions of the image coordinates (u, v) in [0, 1]^2, u to the
right and v down from the upper left corner: that is all that the kernels know of a sensor.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import ConfigDict, Field, PlainSerializer, PlainValidator, WithJsonSchema, model_validator
from pydantic.dataclasses import dataclass

from cloudtomo_cl.grid import Count, Grid, Length, Triple
from cloudtomo_cl.scene import Angle, direction

Pixels = tuple[Count, Count]


def image_axes(line_of_sight: np.ndarray, up: Triple) -> tuple[np.ndarray, np.ndarray]:
    """Unit vectors to the right and up in the image of a viewer looking along a direction.

    Raises
    ------
    ValueError : `up` is parallel to the line of sight
    """
    right = np.cross(line_of_sight, np.asarray(up, dtype=float))
    norm = np.linalg.norm(right)
    if norm < 1e-6 * max(np.linalg.norm(up), 1e-300):
        raise ValueError("up is parallel to the line of sight: choose another, for instance [0, 1, 0]")
    right /= norm
    return right, np.cross(right, line_of_sight)


def line_of_sight(position: Triple, target: Triple) -> np.ndarray:
    """Unit vector from position to target."""
    sight = np.subtract(target, position)
    norm = np.linalg.norm(sight)
    if norm == 0:
        raise ValueError("position and target are the same point: move one of them")
    return sight / norm


def image_aspect(view: PerspectiveView | OrthographicView) -> float:
    """Height of a view's image over its width."""
    return view.pixels[1] / view.pixels[0] if view.aspect is None else view.aspect


def solve_affine(axes: np.ndarray, offsets: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Coefficients of offsets (..., 3) with respect to three axes, the rows of a (3, 3) array."""
    inverse = np.linalg.inv(axes)
    first, second, third = np.moveaxis(offsets @ inverse, -1, 0)
    return first, second, third


@dataclass(frozen=True, config=ConfigDict(extra="forbid"))
class PerspectiveView:
    """A pinhole camera.

    Attributes
    ----------
    position, target : km; the camera stands at position and looks at target
    up : a direction that is up in the image
    field_of_view : degrees, across the image's width
    pixels : (width, height)
    aspect : height of the image over its width; by default pixels are square
    """

    position: Triple
    target: Triple
    field_of_view: Annotated[float, Field(gt=0, lt=180)]
    pixels: Pixels
    up: Triple = (0.0, 0.0, 1.0)
    aspect: Length | None = None
    type: Literal["perspective"] = "perspective"

    @model_validator(mode="after")
    def _check(self) -> PerspectiveView:
        image_axes(line_of_sight(self.position, self.target), self.up)
        if self.position[2] < 0:
            raise ValueError("position lies below the ground, z = 0: raise it")
        return self

    def rays(self, grid: Grid) -> tuple[np.ndarray, np.ndarray]:
        """Ray origins (km) and directions as affine functions of (u, v).

        Returns two arrays of shape (3, 3): the value at (0, 0), its change over u, over v.
        """
        sight = line_of_sight(self.position, self.target)
        right, up = image_axes(sight, self.up)
        width = 2 * np.tan(np.radians(self.field_of_view) / 2)
        height = width * image_aspect(self)
        corner = sight - width / 2 * right + height / 2 * up
        origin = np.array([self.position, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)])
        return origin, np.array([corner, width * right, -height * up])

    def project(self, grid: Grid, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Where points appear in the image: the inverse of `rays`.

        Parameters
        ----------
        grid : of the domain
        points : km, shape (..., 3)

        Returns
        -------
        u, v : image coordinates, outside of [0, 1] beside the frame; shape (...)
        depth : along the line of sight, km; where it is not positive the point lies behind the
            sensor, and u, v mean nothing
        """
        origin, axes = self.rays(grid)
        depth, u, v = solve_affine(axes, points - origin[0])
        with np.errstate(divide="ignore", invalid="ignore"):
            return u / depth, v / depth, depth


@dataclass(frozen=True, config=ConfigDict(extra="forbid"))
class OrthographicView:
    """Parallel rays, as from a satellite far away.

    The line of sight is given by position and target, or by the direction (zenith, azimuth)
    from the scene to the sensor; the image's centre then looks at the target, by default
    the domain's centre, from beyond the domain.

    Attributes
    ----------
    width : of the image in km, measured across the rays
    pixels : (width, height)
    position, target : km
    zenith, azimuth : degrees; zenith below 90 (use position and target to look up)
    up : a direction that is up in the image; for a line of sight along z the default is north
    aspect : height of the image over its width; by default pixels are square
    """

    width: Length
    pixels: Pixels
    position: Triple | None = None
    target: Triple | None = None
    zenith: Annotated[float, Field(ge=0, lt=90)] | None = None
    azimuth: Angle = 0.0
    up: Triple | None = None
    aspect: Length | None = None
    type: Literal["orthographic"] = "orthographic"

    @model_validator(mode="after")
    def _check(self) -> OrthographicView:
        if (self.position is None) == (self.zenith is None):
            raise ValueError("give either position and target, or zenith and azimuth")
        if self.position is not None:
            if self.target is None:
                raise ValueError("position needs a target")
        right, up = self._axes()
        if self.position is not None:
            lowest = self.position[2] - self.width / 2 * (abs(right[2]) + image_aspect(self) * abs(up[2]))
            if lowest < -1e-9:
                raise ValueError(f"the image's edge lies {-lowest:.3g} km below the ground, z = 0: raise position")
        return self

    def _sight(self) -> np.ndarray:
        if self.position is not None and self.target is not None:
            return line_of_sight(self.position, self.target)
        assert self.zenith is not None
        return -direction(self.zenith, self.azimuth)

    def _axes(self) -> tuple[np.ndarray, np.ndarray]:
        """Unit vectors to the right and up in the image."""
        sight = self._sight()
        vertical = np.hypot(sight[0], sight[1]) < 1e-6
        return image_axes(sight, self.up or ((0.0, 1.0, 0.0) if vertical else (0.0, 0.0, 1.0)))

    def rays(self, grid: Grid) -> tuple[np.ndarray, np.ndarray]:
        """Ray origins (km) and directions as affine functions of (u, v); see PerspectiveView."""
        height = self.width * image_aspect(self)
        sight = self._sight()
        if self.position is not None:
            centre = np.asarray(self.position)
        else:
            assert self.zenith is not None
            target = np.asarray(grid.centre if self.target is None else self.target)
            # Far enough up that the whole image plane lies above the domain.
            top = grid.origin[2] + grid.extent[2]
            rise = top - target[2] + (self.width + height) * np.sin(np.radians(self.zenith))
            centre = target - sight * max(rise, 0.0) / np.cos(np.radians(self.zenith))
        right, up = self._axes()
        corner = centre - self.width / 2 * right + height / 2 * up
        return np.array([corner, self.width * right, -height * up]), np.array([sight, np.zeros(3), np.zeros(3)])

    def project(self, grid: Grid, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Where points appear in the image; see PerspectiveView."""
        origin, axes = self.rays(grid)
        depth, u, v = solve_affine(np.array([axes[0], origin[1], origin[2]]), points - origin[0])
        return u, v, depth


def _rows_of_three(values: Any) -> np.ndarray:
    """A copy that cannot be written to, so that a view stays what it was."""
    try:
        array = np.array(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise ValueError("must be an array of numbers of shape (rays, 3)") from None
    if array.ndim != 2 or array.shape[1] != 3 or not len(array):
        raise ValueError(f"has shape {array.shape}: it must have (rays, 3), with at least one ray")
    wrong = ~np.isfinite(array).all(axis=1)
    if wrong.any():
        raise ValueError(f"row {np.argmax(wrong)} is not finite")
    array.setflags(write=False)
    return array


RowsOfThree = Annotated[
    np.ndarray,
    PlainValidator(_rows_of_three),
    PlainSerializer(lambda array: array.tolist(), when_used="json"),
    WithJsonSchema({"type": "array"}),
]


@dataclass(frozen=True, eq=False, config=ConfigDict(extra="forbid"))
class RayView:
    """Arbitrary rays, one for each pixel: for sensors that no other view describes.

    A pixel's samples all take its ray. Pixels need not lie side by side in space, so the
    image is never resampled: a reconstruction keeps its pixels in every stage.

    Attributes
    ----------
    origins : km, shape (rays, 3), in or around the domain, not below the ground
    directions : in which the sensor looks, shape (rays, 3), of any length; kept as unit vectors
    pixels : (width, height), ray `row * width + column` belongs to a pixel; by default (rays, 1)
    """

    origins: RowsOfThree
    directions: RowsOfThree
    pixels: Pixels = None  # type: ignore[assignment]  # a pair after the check
    type: Literal["rays"] = "rays"

    @model_validator(mode="after")
    def _check(self) -> RayView:
        count = len(self.origins)
        if len(self.directions) != count:
            raise ValueError(f"there are {count} origins and {len(self.directions)} directions: give as many of both")
        length = np.linalg.norm(self.directions, axis=1, keepdims=True)
        if not length.all():
            raise ValueError(f"directions: row {np.argmin(length)} is zero, which is no direction")
        if (self.origins[:, 2] < 0).any():
            row = int(np.argmax(self.origins[:, 2] < 0))
            raise ValueError(f"origins: row {row} lies below the ground, z = 0: raise it")
        directions = self.directions / length
        directions.setflags(write=False)
        object.__setattr__(self, "directions", directions)
        if self.pixels is None:
            object.__setattr__(self, "pixels", (count, 1))
        if self.pixels[0] * self.pixels[1] != count:
            raise ValueError(f"pixels are {self.pixels[0]} x {self.pixels[1]} for {count} rays: give as many of both")
        return self

    def __eq__(self, other: object) -> bool:
        return (
            isinstance(other, RayView)
            and self.pixels == other.pixels
            and np.array_equal(self.origins, other.origins)
            and np.array_equal(self.directions, other.directions)
        )

    def __hash__(self) -> int:
        return hash((self.pixels, self.origins.tobytes(), self.directions.tobytes()))

    def starts(self, grid: Grid, periodic: bool) -> np.ndarray:
        """Points from which the rays see the same, but close to the domain: km, shape (rays, 3).

        Kernels have single precision, which is some metres at the distance of a satellite. A ray
        that comes from outside starts where it enters the domain, or, if it passes the domain by
        on its way down, at the ground. In a periodic domain it starts within the domain.
        """
        lower, extent = np.asarray(grid.origin), np.asarray(grid.extent)
        axes = [2] if periodic else [0, 1, 2]
        near, far = clip_to_box(self.origins, self.directions, lower, lower + extent, axes)
        with np.errstate(divide="ignore", invalid="ignore"):
            to_ground = self.origins[:, 2] / np.maximum(-self.directions[:, 2], 0.0)
        misses = np.where(np.isfinite(to_ground), to_ground, 0.0)
        starts = self.origins + np.where(near < far, near, misses)[:, None] * self.directions
        if periodic:
            starts[:, :2] -= extent[:2] * np.floor((starts[:, :2] - lower[:2]) / extent[:2])
        return starts


def clip_to_box(
    start: np.ndarray, step: np.ndarray, lower: np.ndarray, upper: np.ndarray, axes: Sequence[int] = (0, 1, 2)
) -> tuple[np.ndarray, np.ndarray]:
    """Where rays `start + t step`, t >= 0, lie in a box: they do for near <= t <= far (the slab test).

    Parameters
    ----------
    start, step : shape (..., 3)
    lower, upper : corners of the box, shape (3,)
    axes : along which the box ends

    Returns
    -------
    near, far : shape (...); a ray misses the box where near > far
    """
    axes = list(axes)
    with np.errstate(divide="ignore", invalid="ignore"):
        to_lower = (lower - start)[..., axes] / step[..., axes]
        to_upper = (upper - start)[..., axes] / step[..., axes]
    # A ray within the plane of a face gives 0/0: the face does not bound it.
    enters = np.nan_to_num(np.minimum(to_lower, to_upper), nan=-np.inf).max(axis=-1)
    leaves = np.nan_to_num(np.maximum(to_lower, to_upper), nan=np.inf).min(axis=-1)
    return np.maximum(enters, 0.0), leaves


View = Annotated[PerspectiveView | OrthographicView | RayView, Field(discriminator="type")]
