"""Views: positions of the sensors and orientations of their images.

Row 0 is the top of an image as the viewer sees it, columns run left to right. An affine view
gives its rays as affine functions of the image coordinates (u, v) in [0, 1]^2, u to the
right and v down from the upper left corner; a RayView lists them. That is all that the
kernels know of a sensor.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import fields, replace
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import ConfigDict, Field, PlainSerializer, PlainValidator, WithJsonSchema, model_validator
from pydantic.dataclasses import dataclass

from cloudtomo_cl.arguments import NUMBER, a, require_kinds
from cloudtomo_cl.errors import DataError, InvalidArgumentError
from cloudtomo_cl.messages import answering
from cloudtomo_cl.scene.arrays import as_numbers
from cloudtomo_cl.scene.box import clip_to_box
from cloudtomo_cl.scene.cards import card
from cloudtomo_cl.scene.grid import Count, Grid, Length, Triple
from cloudtomo_cl.scene.scene import Angle, Scene, direction

Pixels = tuple[Count, Count]
# Arrays that live at the same time while the rays of a `RayView` are made, for each ray.
BYTES_PER_RAY = 160
# Largest distance of a sensor, km. Positions have single precision in the kernels, at this distance 8 m. Up to there,
# images of a cloud of 0.8 km in 24 pixels agree with an orthographic view's: in the mean to 0.1 %, in pixels to 5 %.
FARTHEST = 1e5
# Sine of the angle below the horizon from which on rays of an orthographic view can be taken up above the domain.
_SHALLOW = 0.05


def _require_near(name: str, position: Triple) -> None:
    """Raises ValueError for a camera so far away that single precision does not tell its rays apart."""
    if max(map(abs, position)) > FARTHEST:
        raise ValueError(
            f"{name} lies farther than {FARTHEST:g} km away, where single precision no longer tells its rays apart: "
            "use an orthographic view, whose rays are parallel"
        )


def image_axes(line_of_sight: np.ndarray, up: Triple | None) -> tuple[np.ndarray, np.ndarray]:
    """Unit vectors to the right and up in the image of a viewer looking along a unit vector.

    Without `up`, that is +z; for a vertical line of sight it is north.

    Raises
    ------
    ValueError : `up` is parallel to the line of sight
    """
    if up is None:
        vertical = np.hypot(line_of_sight[0], line_of_sight[1]) < 1e-6
        up = (0.0, 1.0, 0.0) if vertical else (0.0, 0.0, 1.0)
    right = np.cross(line_of_sight, np.asarray(up, dtype=float))
    norm = np.linalg.norm(right)
    if norm < 1e-6 * max(float(np.linalg.norm(up)), 1e-300):
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


def _card_of(view: Any) -> str:
    """The card of a view's fields that a notebook shows."""
    given = {field.name: getattr(view, field.name) for field in fields(view) if field.name != "type"}
    return card(type(view).__name__, {name: str(value) for name, value in given.items() if value is not None})


class AffineView(ABC):
    """A view whose rays are affine functions of the image coordinates."""

    pixels: Pixels

    @abstractmethod
    def rays(self, grid: Grid, top: float | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Ray origins (km) and directions as affine functions of (u, v).

        Parameters
        ----------
        grid : grid of the domain
        top : height above which there is nothing, km; by default the domain's top

        Returns two arrays of shape (3, 3): the value at (0, 0), its change over u, over v.
        Along each image coordinate either the origin changes or the direction, not both.
        """

    def _repr_html_(self) -> str:
        return _card_of(self)

    def with_pixels(self, pixels: Pixels) -> View:
        """The same field of view with other numbers of pixels (width, height)."""
        return replace(self, pixels=pixels)  # type: ignore[type-var, return-value]

    def project(self, grid: Grid, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Where points appear in the image: the inverse of `rays`.

        Parameters
        ----------
        grid : grid of the domain
        points : points in the scene, km, shape (..., 3)

        Returns
        -------
        u, v : image coordinates, outside of [0, 1] beside the frame; shape (...)
        depth : distance along the line of sight, km; where it is not positive the point lies behind
            the sensor, and u, v have no meaning

        Raises
        ------
        DataError : points of another shape; grid or points are of another kind (InvalidArgumentError)
        """
        points = as_numbers(points, "points")
        if points.shape[-1:] != (3,):
            raise DataError(f"points have shape {points.shape}: it must be (..., 3), x, y, z in km")
        origin, direction = self.rays(grid)
        # Where the origin moves with u, point = origin + u change + depth direction; where the
        # direction does, its change comes times u and depth. The same with v.
        moves = np.any(origin[1:], axis=1)
        axes = np.array([direction[0], *np.where(moves[:, None], origin[1:], direction[1:])])
        depth, u, v = np.moveaxis((points - origin[0]) @ np.linalg.inv(axes), -1, 0)
        with np.errstate(divide="ignore", invalid="ignore"):
            return u if moves[0] else u / depth, v if moves[1] else v / depth, depth


@answering
@dataclass(frozen=True, config=ConfigDict(extra="forbid"))
class PerspectiveView(AffineView):
    """A pinhole camera, on an aircraft or on the ground.

    A camera that looks straight up has north at the top of its image and so east on the left:
    the sky is seen from below, the ground from above.

    Attributes
    ----------
    position, target : points, km; the camera stands at position and looks at target
    up : a direction that is up in the image; by default +z, or north if the line of sight is vertical
    field_of_view : degrees, across the image's width
    pixels : (width, height)
    aspect : height of the image over its width; by default pixels are square
    """

    position: Triple
    target: Triple
    field_of_view: Annotated[float, Field(gt=0, lt=180)]
    pixels: Pixels
    up: Triple | None = None
    aspect: Length | None = None
    type: Literal["perspective"] = "perspective"

    @model_validator(mode="after")
    def _check(self) -> PerspectiveView:
        image_axes(line_of_sight(self.position, self.target), self.up)
        if self.position[2] < 0:
            raise ValueError("position lies below the ground, z = 0: raise it")
        _require_near("position", self.position)
        return self

    @property
    def _aspect(self) -> float:
        """Height of the image over its width."""
        return self.pixels[1] / self.pixels[0] if self.aspect is None else self.aspect

    def with_pixels(self, pixels: Pixels) -> View:
        """The same field of view in other pixels (width, height); also where these are not square."""
        return replace(self, pixels=pixels, aspect=self._aspect)

    def rays(self, grid: Grid, top: float | None = None) -> tuple[np.ndarray, np.ndarray]:
        """See AffineView."""
        sight = line_of_sight(self.position, self.target)
        right, up = image_axes(sight, self.up)
        width = 2 * np.tan(np.radians(self.field_of_view) / 2)
        height = width * self._aspect
        corner = sight - width / 2 * right + height / 2 * up
        origin = np.array([self.position, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)])
        return origin, np.array([corner, width * right, -height * up])


@answering
@dataclass(frozen=True, config=ConfigDict(extra="forbid"))
class OrthographicView(AffineView):
    """Parallel rays, as from a satellite far away.

    The line of sight is given by position and target, or by the direction (zenith, azimuth)
    from the scene to the sensor; the image's centre then looks at the target, by default
    the domain's centre, from beyond the domain.

    Attributes
    ----------
    width : width of the image, km, measured across the rays
    pixels : (width, height)
    position, target : points, km: the sensor looks from position at target
    zenith, azimuth : direction towards the sensor, degrees; zenith below 90 (use position and target to look up)
    up : a direction that is up in the image; by default +z, or north if the line of sight is vertical
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
            if self.sight()[2] > -_SHALLOW:
                _require_near("position", self.position)
        right, up = self._axes()
        if self.position is not None:
            lowest = self.position[2] - self.width / 2 * (abs(right[2]) + self._aspect * abs(up[2]))
            if lowest < -1e-9:
                raise ValueError(f"the image's edge lies {-lowest:.3g} km below the ground, z = 0: raise position")
        return self

    @property
    def _aspect(self) -> float:
        """Height of the image over its width."""
        return self.pixels[1] / self.pixels[0] if self.aspect is None else self.aspect

    def with_pixels(self, pixels: Pixels) -> View:
        """The same field of view in other pixels (width, height); also where these are not square."""
        return replace(self, pixels=pixels, aspect=self._aspect)

    def sight(self) -> np.ndarray:
        """The unit vector in which the sensor looks."""
        if self.position is not None and self.target is not None:
            return line_of_sight(self.position, self.target)
        assert self.zenith is not None
        return -direction(self.zenith, self.azimuth)

    def _axes(self) -> tuple[np.ndarray, np.ndarray]:
        """Unit vectors to the right and up in the image."""
        return image_axes(self.sight(), self.up)

    def rays(self, grid: Grid, top: float | None = None) -> tuple[np.ndarray, np.ndarray]:
        """See AffineView."""
        require_kinds("rays", grid=(grid, a(Grid)), top=(top, NUMBER.or_none()))
        sight, (right, up) = self.sight(), self._axes()
        height = self.width * self._aspect
        top = grid.origin[2] + grid.extent[2] if top is None else top
        if self.position is not None:
            centre = self._nearer(np.asarray(self.position), grid, top)
        else:
            assert self.zenith is not None
            target = np.asarray(grid.centre if self.target is None else self.target)
            # Far enough up that the whole image plane lies in the void.
            rise = top - target[2] + (self.width + height) * np.sin(np.radians(self.zenith))
            centre = target - sight * max(rise, 0.0) / np.cos(np.radians(self.zenith))
        corner = centre - self.width / 2 * right + height / 2 * up
        return np.array([corner, self.width * right, -height * up]), np.array([sight, np.zeros(3), np.zeros(3)])

    def _nearer(self, centre: np.ndarray, grid: Grid, top: float) -> np.ndarray:
        """The image plane's centre, moved down along its rays to above `top` and before the domain.

        They see the same from there, and single precision is some metres at the distance of a
        geostationary satellite.
        """
        sight, (right, up) = self.sight(), self._axes()
        if sight[2] >= 0:
            return centre
        corners = np.stack(np.meshgrid(*zip(grid.origin, np.add(grid.origin, grid.extent))), axis=-1)
        lowest = centre[2] - self.width / 2 * (abs(right[2]) + self._aspect * abs(up[2]))
        void = min(((corners - centre) @ sight).min(), (lowest - top) / -sight[2])
        return centre + max(void, 0.0) * sight


@answering
@dataclass(frozen=True, config=ConfigDict(extra="forbid"))
class PushBroomView(AffineView):
    """A line scanner on a straight and level flight track: perspective across it, parallel along it.

    The image is seen with the flight direction up: row 0 is the end of the track (the line that
    was scanned last), columns run from the left to the right of the flight. A flight to the
    north gives an image with north up and east on the right.

    Attributes
    ----------
    start, end : ends of the track, km, at the same height
    field_of_view : angle across the track, degrees
    pixels : numbers of pixels (across, along) the track
    along_track_angle : view angle, degrees from nadir, positive ahead (fore), negative back (aft)
    """

    start: Triple
    end: Triple
    field_of_view: Annotated[float, Field(gt=0, lt=180)]
    pixels: Pixels
    along_track_angle: Annotated[float, Field(gt=-90, lt=90)] = 0.0
    type: Literal["push-broom"] = "push-broom"

    @model_validator(mode="after")
    def _check(self) -> PushBroomView:
        # Heights that a file has in metres or feet differ by rounding.
        if not np.isclose(self.start[2], self.end[2], rtol=1e-9, atol=0.0):
            raise ValueError(f"start is at {self.start[2]} km, end at {self.end[2]} km: the track must be level")
        if self.start[:2] == self.end[:2]:
            raise ValueError("start and end are the same point: move one of them")
        if self.start[2] < 0:
            raise ValueError("the track lies below the ground, z = 0: raise it")
        _require_near("start", self.start)
        _require_near("end", self.end)
        return self

    def rays(self, grid: Grid, top: float | None = None) -> tuple[np.ndarray, np.ndarray]:
        """See AffineView."""
        ahead, down = line_of_sight(self.start, self.end), np.array([0.0, 0.0, -1.0])
        right = np.cross(ahead, -down)
        angle = np.radians(self.along_track_angle)
        sight = np.cos(angle) * down + np.sin(angle) * ahead
        width = 2 * np.tan(np.radians(self.field_of_view) / 2)
        origin = np.array([self.end, np.zeros(3), np.subtract(self.start, self.end)])
        return origin, np.array([sight - width / 2 * right, width * right, np.zeros(3)])


@answering
@dataclass(frozen=True, config=ConfigDict(extra="forbid"))
class RadiometerView(AffineView):
    """The radiance that leaves the domain's top, or reaches its bottom, in one direction.

    As in I3RC, pixels tile the horizontal plane of the top: a pixel is the mean over its area,
    not over an area across the rays, and an oblique ray goes on from there through the sides
    or, in a periodic domain, through its copies. The image is a map: row 0 is north (largest
    y), columns run from west to east, also when it looks up.

    Attributes
    ----------
    zenith, azimuth : direction from the scene to the sensor, degrees. With a zenith below 90 the radiance
        leaves the top; above, it reaches the bottom, and the sensor looks up.
    pixels : numbers of pixels (along x, along y); `of_columns` has one for each column of a grid
    """

    zenith: Annotated[float, Field(ge=0, le=180)]
    pixels: Pixels
    azimuth: Angle = 0.0
    type: Literal["radiometer"] = "radiometer"

    @model_validator(mode="after")
    def _check(self) -> RadiometerView:
        if abs(direction(self.zenith, self.azimuth)[2]) < 1e-6:
            raise ValueError("zenith is 90: no horizontal ray crosses the domain's top or bottom; tilt it")
        return self

    @classmethod
    def of_columns(cls, grid: Grid, zenith: float, azimuth: float = 0.0) -> RadiometerView:
        """The view with a pixel for each column of a grid."""
        require_kinds("RadiometerView.of_columns", grid=(grid, a(Grid)))
        return cls(zenith=zenith, azimuth=azimuth, pixels=grid.shape[:2])

    def rays(self, grid: Grid, top: float | None = None) -> tuple[np.ndarray, np.ndarray]:
        """See AffineView."""
        require_kinds("rays", grid=(grid, a(Grid)), top=(top, NUMBER.or_none()))
        (east, north, up), sight = grid.extent, -direction(self.zenith, self.azimuth)
        corner = np.add(grid.origin, (0.0, north, up if sight[2] < 0 else 0.0))
        origin = np.array([corner, (east, 0.0, 0.0), (0.0, -north, 0.0)])
        return origin, np.array([sight, np.zeros(3), np.zeros(3)])


def _rows_of_three(values: Any) -> np.ndarray:
    """A copy that cannot be written to, so that a view stays what it was."""
    try:
        array = np.array(as_numbers(values, "it"))
    except InvalidArgumentError:
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


@answering
@dataclass(frozen=True, eq=False, config=ConfigDict(extra="forbid"))
class RayView:
    """Arbitrary rays, one for each pixel: for sensors that no other view describes.

    All samples of a pixel take its ray. Pixels need not lie side by side in space, so the
    image is never resampled: a reconstruction keeps its pixels in every stage.

    Attributes
    ----------
    origins : starting points of the rays, km, shape (rays, 3), in or around the domain, not below the ground
    directions : directions in which the sensor looks, shape (rays, 3), of any length; kept as unit vectors
    pixels : (width, height); the ray `row * width + column` belongs to pixel (row, column); by default (rays, 1)
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
        # Unit vectors stay the same to the bit, so that views are equal when they are read back.
        directions = self.directions / np.where(np.abs(length - 1) < 1e-14, 1.0, length)
        directions.setflags(write=False)
        object.__setattr__(self, "directions", directions)
        if self.pixels is None:
            object.__setattr__(self, "pixels", (count, 1))
        if self.pixels[0] * self.pixels[1] != count:
            raise ValueError(f"pixels are {self.pixels[0]} x {self.pixels[1]} for {count} rays: give as many of both")
        return self

    def __repr__(self) -> str:
        return f"RayView({len(self.origins)} rays, {self.pixels[0]} x {self.pixels[1]} pixels)"

    def _repr_html_(self) -> str:
        return card("RayView", {"rays": str(len(self.origins)), "pixels": f"{self.pixels[0]} x {self.pixels[1]}"})

    def __eq__(self, other: object) -> bool:
        return (
            isinstance(other, RayView)
            and self.pixels == other.pixels
            and np.array_equal(self.origins, other.origins)
            and np.array_equal(self.directions, other.directions)
        )

    def __hash__(self) -> int:
        return hash((self.pixels, self.origins.tobytes(), self.directions.tobytes()))

    def starts(self, scene: Scene) -> np.ndarray:
        """Points close to the domain from which the rays see the same: km, shape (rays, 3).

        Kernels have single precision, which is some metres at the distance of a satellite. A ray
        through empty space starts where it enters the domain (or the atmosphere, with air outside
        of the grid), or at the ground, if it passes the domain on its way down. In a periodic
        domain it starts within the domain.
        """
        require_kinds("RayView.starts", scene=(scene, a(Scene)))
        lower, upper = np.array(scene.grid.origin), np.add(scene.grid.origin, scene.grid.extent)
        extent, periodic = scene.grid.extent, scene.boundary.horizontal == "periodic"
        air_outside = scene.air is not None and scene.air.is_outside
        axes = [2] if periodic or air_outside else [0, 1, 2]
        if air_outside:
            lower[2], upper[2] = 0.0, scene.top
        near, far = clip_to_box(self.origins, self.directions, lower, upper, axes)
        with np.errstate(divide="ignore", invalid="ignore"):
            to_ground = self.origins[:, 2] / np.maximum(-self.directions[:, 2], 0.0)
        misses = np.where(np.isfinite(to_ground), to_ground, 0.0)
        starts = self.origins + np.where(near < far, near, misses)[:, None] * self.directions
        if periodic:
            starts[:, :2] -= extent[:2] * np.floor((starts[:, :2] - lower[:2]) / extent[:2])
        return starts


View = Annotated[
    PerspectiveView | OrthographicView | PushBroomView | RadiometerView | RayView, Field(discriminator="type")
]
