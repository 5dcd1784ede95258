"""Several views at once: rings and strings of sensors, as multi-angle campaigns fly them; all-sky cameras.

Each formation is a table `[[view]]` of the settings too, and stands for several views.
"""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from pydantic import ConfigDict, Field, model_validator
from pydantic.dataclasses import dataclass

from cloudtomo_cl.arguments import NUMBER, require_kinds, several
from cloudtomo_cl.errors import InvalidSettingError
from cloudtomo_cl.memory import require
from cloudtomo_cl.messages import answering
from cloudtomo_cl.scene.grid import Coordinate, Length, Triple
from cloudtomo_cl.scene.scene import Angle
from cloudtomo_cl.scene.sensors import (
    BYTES_PER_RAY,
    OrthographicView,
    PerspectiveView,
    Pixels,
    PushBroomView,
    RayView,
)

AlongTrackAngle = Annotated[float, Field(gt=-90, lt=90)]
AlongTrackAngles = Annotated[tuple[AlongTrackAngle, ...], Field(min_length=1, max_length=10_000)]

# Far more than any campaign flies; every camera is an object with its own image.
_MOST_CAMERAS = 10_000
# View angles at the ground, degrees from nadir, of MISR's nine cameras Df to Da.
# Source: Diner et al. 1998, IEEE Trans. Geosci. Remote Sens. 36, 1072-1087.
MISR_ANGLES = (70.5, 60.0, 45.6, 26.1, 0.0, -26.1, -45.6, -60.0, -70.5)


def _check_height(height: float, target: Triple) -> None:
    """Raises ValueError if sensors at a height, km, do not look down on a target, or stand below the ground."""
    if not height > target[2]:
        raise ValueError(f"height is {height} km: it must be above the target's {target[2]} km")
    if height < 0:
        raise ValueError("height lies below the ground, z = 0: raise it")


@answering
@dataclass(frozen=True, config=ConfigDict(extra="forbid"))
class RingOfViews:
    """Cameras on a horizontal ring that look at one point, and one at nadir above it.

    Attributes
    ----------
    target : point that all cameras look at, km
    height : height of the cameras above the ground, km
    radius : radius of the ring around the vertical through the target, km
    field_of_view : angle across an image's width, degrees
    pixels : (width, height) of each image
    count : number of cameras on the ring
    azimuth : azimuth of the first camera on the ring, degrees from +x towards +y; the others follow in this sense
    nadir : whether a camera above the target comes first; its image has north up
    """

    target: Triple
    height: Coordinate
    radius: Length
    field_of_view: Annotated[float, Field(gt=0, lt=180)]
    pixels: Pixels
    count: Annotated[int, Field(ge=1, le=_MOST_CAMERAS)] = 8
    azimuth: Angle = 0.0
    nadir: bool = True
    type: Literal["ring"] = "ring"

    @model_validator(mode="after")
    def _check(self) -> RingOfViews:
        _check_height(self.height, self.target)
        return self

    def views(self) -> tuple[PerspectiveView, ...]:
        """The cameras: nadir first, then around the ring."""
        east, north, _ = self.target
        angles = np.radians(self.azimuth + 360.0 * np.arange(self.count) / self.count)
        positions = [(east, north)] if self.nadir else []
        positions += [(east + self.radius * np.cos(angle), north + self.radius * np.sin(angle)) for angle in angles]
        return tuple(
            PerspectiveView((x, y, self.height), self.target, self.field_of_view, self.pixels) for x, y in positions
        )


@answering
@dataclass(frozen=True, config=ConfigDict(extra="forbid"))
class StringOfViews:
    """Orthographic views of one point from several angles along a flight track, as from a satellite.

    All images have the flight direction up.

    Attributes
    ----------
    width : width of each image, km, measured across the rays
    pixels : (width, height) of each image
    along_track_angles : view angles, degrees from nadir, positive where the sensor looks ahead and still
        stands behind the target. By default MISR's nine.
    azimuth : flight direction, degrees from +x (east) towards +y (north)
    target : point in the middle of every image, km; by default the domain's centre
    """

    width: Length
    pixels: Pixels
    along_track_angles: AlongTrackAngles = MISR_ANGLES
    azimuth: Angle = 90.0
    target: Triple | None = None
    type: Literal["string"] = "string"

    def views(self) -> tuple[OrthographicView, ...]:
        """One view for each angle, in their order."""
        ahead = np.radians(self.azimuth)
        return tuple(
            OrthographicView(
                width=self.width,
                pixels=self.pixels,
                zenith=abs(angle),
                # A sensor that looks ahead stands behind.
                azimuth=self.azimuth + (180.0 if angle > 0 else 0.0),
                up=(np.cos(ahead), np.sin(ahead), 0.0),
                target=self.target,
            )
            for angle in self.along_track_angles
        )


@answering
@dataclass(frozen=True, config=ConfigDict(extra="forbid"))
class StringOfScans:
    """Push-broom images of one place from several angles along one flight track.

    Each stretch is moved along the track, against the direction in which its scan looks, so that all
    images cover the same ground at the target's height.

    Attributes
    ----------
    target : point in the middle of every image, km
    height : height of the track above the ground, km
    length : length of each scanned stretch of the track, km
    field_of_view : angle across the track, degrees
    pixels : numbers of pixels (across, along) the track
    along_track_angles : view angles, degrees from nadir, positive ahead; by default MISR's nine
    azimuth : flight direction, degrees from +x (east) towards +y (north)
    """

    target: Triple
    height: Coordinate
    length: Length
    field_of_view: Annotated[float, Field(gt=0, lt=180)]
    pixels: Pixels
    along_track_angles: AlongTrackAngles = MISR_ANGLES
    azimuth: Angle = 90.0
    type: Literal["scans"] = "scans"

    @model_validator(mode="after")
    def _check(self) -> StringOfScans:
        _check_height(self.height, self.target)
        return self

    def views(self) -> tuple[PushBroomView, ...]:
        """One view for each angle, in their order."""
        azimuth = np.radians(self.azimuth)
        ahead, above = np.array([np.cos(azimuth), np.sin(azimuth)]), self.height - self.target[2]
        views = []
        for angle in self.along_track_angles:
            middle = np.array(self.target[:2]) - above * np.tan(np.radians(angle)) * ahead
            start, end = middle - self.length / 2 * ahead, middle + self.length / 2 * ahead
            views.append(
                PushBroomView(
                    (start[0], start[1], self.height),
                    (end[0], end[1], self.height),
                    self.field_of_view,
                    self.pixels,
                    angle,
                )
            )
        return tuple(views)


def fisheye_rays(position: Triple, pixels: int, field_of_view: float = 180.0) -> tuple[RayView, np.ndarray]:
    """An all-sky camera: an equidistant fisheye that looks straight up.

    The zenith angle of a pixel grows in proportion to its distance from the image's centre. Row 0
    is north; the sky is seen from below, so east is on the left. There is one ray for each pixel,
    through its centre, and none for pixels outside of the image's circle.

    Parameters
    ----------
    position : position of the camera, km
    pixels : number of pixels along the circle's diameter
    field_of_view : angle from one side of the circle to the other, degrees; 180 reaches the horizon

    Returns
    -------
    view : the rays of the pixels inside the circle, row after row, as one row of pixels
    circle : pixels inside the circle, bool, shape (pixels, pixels). `image[circle] = radiance` makes the image.

    Raises
    ------
    InvalidSettingError : pixels is not positive or not whole, field_of_view is not above 0 and at most 180, position is
        below the ground
    InvalidArgumentError : an argument is of another kind
    """
    require_kinds(
        "fisheye_rays",
        position=(position, several(3, NUMBER)),
        pixels=(pixels, NUMBER),
        field_of_view=(field_of_view, NUMBER),
    )
    if pixels < 1 or pixels % 1:
        raise InvalidSettingError(f"pixels is {pixels}: it must be a whole number of at least 1")
    if not 0 < field_of_view <= 180:
        raise InvalidSettingError(f"field_of_view is {field_of_view}: it must be above 0 and at most 180 degrees")
    square = float(pixels) * float(pixels)  # around the circle
    require(BYTES_PER_RAY * square, f"an all-sky camera of {pixels:g} pixels across", "use fewer")
    places = (2 * np.arange(pixels) + 1) / pixels - 1
    east, north = np.meshgrid(-places, -places)
    distance = np.hypot(east, north)
    circle = distance < 1
    zenith, azimuth = np.radians(field_of_view / 2) * distance[circle], np.arctan2(north[circle], east[circle])
    directions = np.column_stack([np.sin(zenith) * np.cos(azimuth), np.sin(zenith) * np.sin(azimuth), np.cos(zenith)])
    return RayView(np.tile(np.asarray(position, dtype=float), (len(directions), 1)), directions), circle
