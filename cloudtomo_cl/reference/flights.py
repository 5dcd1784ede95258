"""Rays and flights of the slow transport (paths.py): through the voxels of the grid, and the air around it.

Lengths are in km, extinction in km^-1. Equation numbers are those of the supplement on the monotonicity prior.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from cloudtomo_cl.reference.scattering import Particle, droplet_in_voxel
from cloudtomo_cl.scene.grid import Grid
from cloudtomo_cl.scene.scene import Air, Scene
from cloudtomo_cl.scene.sensors import View


def camera_ray(view: View, grid: Grid, column: float, row: float) -> tuple[np.ndarray, np.ndarray]:
    """The ray of a point of an image.

    Parameters
    ----------
    column, row : in pixels from the upper left corner of the image; pixel (i, j) is the
        square from (i, j) to (i + 1, j + 1)

    Returns its origin (km, shape (3,)) and its direction, a unit vector.
    """
    width, height = view.pixels
    if view.type == "rays":
        index = int(row) * width + int(column)
        return view.origins[index], view.directions[index]
    top = grid.origin[2] + grid.extent[2]
    if view.type == "push-broom":
        start, end = np.array(view.start), np.array(view.end)
        ahead = (end - start) / np.sqrt(np.sum((end - start) ** 2))
        to_the_right = np.array([ahead[1], -ahead[0], 0.0])
        tilt = np.radians(view.along_track_angle)
        slope = (2 * column / width - 1) * np.tan(np.radians(view.field_of_view) / 2)
        direction = np.sin(tilt) * ahead + slope * to_the_right
        direction[2] -= np.cos(tilt)
        # The track ends at the top of the image.
        return start + (1 - row / height) * (end - start), direction / np.linalg.norm(direction)
    if view.type == "radiometer":
        theta, phi = np.radians(view.zenith), np.radians(view.azimuth)
        direction = -np.array([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)])
        east = grid.origin[0] + column / width * grid.extent[0]
        north = grid.origin[1] + (1 - row / height) * grid.extent[1]
        return np.array([east, north, top if view.zenith < 90 else grid.origin[2]]), direction
    if view.position is not None and view.target is not None:
        sight = np.subtract(view.target, view.position).astype(float)
        sight /= np.linalg.norm(sight)
    else:
        assert view.zenith is not None and view.azimuth is not None
        theta, phi = np.radians(view.zenith), np.radians(view.azimuth)
        sight = -np.array([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)])
    up = view.up
    if up is None:
        up = (0.0, 1.0, 0.0) if abs(sight[2]) > 1 - 1e-12 else (0.0, 0.0, 1.0)
    right = np.cross(sight, up)
    right /= np.linalg.norm(right)
    upward = np.cross(right, sight)
    # From the image's centre, in units of half its width: pixels are square.
    to_right, to_top = 2 * column / width - 1, (height - 2 * row) / width
    if view.type == "perspective":
        tangent = np.tan(np.radians(view.field_of_view / 2))
        direction = sight + tangent * (to_right * right + to_top * upward)
        return np.array(view.position, float), direction / np.linalg.norm(direction)
    offset = view.width / 2 * (to_right * right + to_top * upward)
    if view.position is not None:
        return np.array(view.position, float) + offset, sight
    centre = np.array(grid.centre if view.target is None else view.target, float) + offset
    # From above any atmosphere.
    return centre - sight * (max(top - centre[2], 0.0) + 100.0) / -sight[2], sight


def voxel_crossings(
    grid: Grid, position: np.ndarray, direction: np.ndarray, periodic: bool = False
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Every voxel that a ray crosses: all intersections with faces, sorted.

    Parameters
    ----------
    position : km, shape (3,), anywhere
    direction : a unit vector, shape (3,)
    periodic : whether the domain is repeated horizontally

    Returns the voxels, int of shape (n, 3); the distances at which the ray enters them (km
    from position, shape (n,)); and the lengths of the crossings (km, shape (n,)). Crossings
    of no length are left out. A ray that runs inside a face belongs to the upper voxel.

    Raises
    ------
    ValueError : the ray stays in a periodic domain for ever
    """
    start = (np.asarray(position, float) - grid.origin) / grid.spacing  # voxel units
    speed = np.asarray(direction, float) / grid.spacing  # voxels per km
    near, far = 0.0, np.inf
    for axis in (2,) if periodic else (0, 1, 2):
        if speed[axis] == 0:
            if not 0 <= start[axis] <= grid.shape[axis]:
                far = -np.inf
            continue
        ends = np.sort((np.array([0, grid.shape[axis]]) - start[axis]) / speed[axis])
        near, far = max(near, ends[0]), min(far, ends[1])
    if not near < far:
        return np.zeros((0, 3), int), np.zeros(0), np.zeros(0)
    if far == np.inf:
        raise ValueError("a horizontal ray never leaves a periodic domain")
    cuts = [near, far]
    for axis in range(3):
        if speed[axis] != 0:
            lower, upper = np.sort(start[axis] + np.array([near, far]) * speed[axis])
            faces = np.arange(np.ceil(lower), np.floor(upper) + 1)
            cuts.extend((faces - start[axis]) / speed[axis])
    distances = np.sort(np.clip(cuts, near, far))
    lengths = np.diff(distances)
    middles = start + (distances[:-1] + lengths / 2)[:, None] * speed
    voxels = np.floor(middles).astype(int)
    shape = np.array(grid.shape)
    horizontal = voxels[:, :2] % shape[:2] if periodic else np.clip(voxels[:, :2], 0, shape[:2] - 1)
    voxels = np.column_stack([horizontal, np.clip(voxels[:, 2], 0, shape[2] - 1)])
    # Faces that differ by rounding only would cut off slivers.
    real = lengths > 1e-13 * max(1.0, far)
    return voxels[real], distances[:-1][real], lengths[real]


def air_layers(scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    """Levels of all layers of air, km above the ground, and the extinction of their molecules, km^-1."""
    return _air_layers(scene.air, scene.grid)


@lru_cache
def _air_layers(air: Air | None, grid: Grid) -> tuple[np.ndarray, np.ndarray]:
    return (air or Air(extinction=0.0)).layers(grid)


def outside_crossings(
    scene: Scene, position: np.ndarray, direction: np.ndarray, inside: tuple[float, float] | None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Layers of air that a ray crosses outside of the grid, but for the distances `inside` of it, km.

    Returns the layers' extinctions (km^-1), the distances at which they are entered, and the lengths (km).
    """
    height, rise = position[2], direction[2]
    if scene.air is None or not scene.air.is_outside or rise == 0:
        return np.zeros(0), np.zeros(0), np.zeros(0)
    levels, extinction = air_layers(scene)
    cuts = np.sort(np.maximum((levels - height) / rise, 0.0))
    cuts = np.unique(np.concatenate([cuts, np.clip(inside or (), cuts[0], cuts[-1])]))
    starts, lengths = cuts[:-1], np.diff(cuts)
    middles = starts + lengths / 2
    layer = np.clip(np.searchsorted(levels, height + middles * rise) - 1, 0, len(extinction) - 1)
    outside = np.ones(len(starts), bool) if inside is None else (middles < inside[0]) | (middles > inside[1])
    return extinction[layer][outside], starts[outside], lengths[outside]


@dataclass(frozen=True, eq=False)
class Flight:
    """A free flight, or the way to the sun.

    Attributes
    ----------
    lengths : flown in every voxel, km, shape of the grid
    depth : optical depth flown through
    position : where it collided or left all that scatters, km (None: it never met any of it)
    collided : whether it did
    voxel : where it collided (None: outside of the grid, or not at all)
    through_side : whether it left the grid by a side
    """

    lengths: np.ndarray
    depth: float
    position: np.ndarray | None = None
    collided: bool = False
    voxel: tuple[int, int, int] | None = None
    through_side: bool = False

    def length_from(self, start: np.ndarray) -> float:
        """km to where it collided; infinite if it did not."""
        return float(np.linalg.norm(self.position - start)) if self.collided else np.inf


def fly(
    scene: Scene, extinction: np.ndarray, position: np.ndarray, direction: np.ndarray, reach: float = np.inf
) -> Flight:
    """Flies until an optical depth `reach` of droplets and air, or out of both (Eqs. 3, 12, 16)."""
    grid = scene.grid
    voxels, starts, crossed = voxel_crossings(grid, position, direction, scene.boundary.horizontal == "periodic")
    lengths = np.zeros(grid.shape)
    met = len(voxels) > 0
    inside = (starts[0], starts[-1] + crossed[-1]) if met else None
    levels, layers = air_layers(scene)
    below = int(np.argmin(np.abs(levels - grid.origin[2])))
    total = extinction[tuple(voxels.T)] + layers[below + voxels[:, 2]]
    others, other_starts, others_crossed = outside_crossings(scene, position, direction, inside)
    if len(others):
        order = np.argsort(np.concatenate([starts, other_starts]), kind="stable")
        voxels = np.concatenate([voxels, np.full((len(others), 3), -1)])[order]
        starts = np.concatenate([starts, other_starts])[order]
        crossed = np.concatenate([crossed, others_crossed])[order]
        total = np.concatenate([total, others])[order]
    if len(starts) == 0:
        return Flight(lengths, 0.0)
    depths = np.concatenate([[0.0], np.cumsum(total * crossed)])  # at the faces
    collided = bool(depths[-1] >= reach)
    if collided:
        last = int(np.argmax(depths >= reach)) - 1
        voxels, starts, crossed = voxels[: last + 1], starts[: last + 1], crossed[: last + 1].copy()
        crossed[last] = (reach - depths[last]) / total[last]
    in_grid = voxels[:, 0] >= 0
    np.add.at(lengths, tuple(voxels[in_grid].T), crossed[in_grid])
    end = position + (starts[-1] + crossed[-1]) * direction
    if collided:
        x, y, z = (int(i) for i in voxels[-1])
        return Flight(lengths, reach, end, True, (x, y, z) if x >= 0 else None)
    left = 0.0 if inside is None else (position + inside[1] * direction)[2] - grid.origin[2]
    side = met and 1e-9 < left < grid.extent[2] - 1e-9
    return Flight(lengths, float(depths[-1]), end, through_side=side)


def transmittance(scene: Scene, extinction: np.ndarray, position: np.ndarray, direction: np.ndarray) -> float:
    """From a position to where a ray leaves all that scatters."""
    return float(np.exp(-fly(scene, extinction, position, direction).depth))


def met_particle(
    scene: Scene,
    extinction: np.ndarray,
    effective_radius: np.ndarray | None,
    flight: Flight,
    u: float,
    u_row: float,
    virtual: np.ndarray | None = None,
) -> tuple[Particle, float, float]:
    """The particle of a collision, its single-scattering albedo, and 1 / extinction of a droplet, else 0.

    virtual : extinction of virtual droplets, which is added to the last; shape of the grid, km^-1 (gradient.py)
    """
    if flight.voxel is not None:
        levels, layers = air_layers(scene)
        air = layers[int(np.argmin(np.abs(levels - scene.grid.origin[2]))) + flight.voxel[2]]
        droplets = extinction[flight.voxel]
        if u * (droplets + air) < droplets:
            radius = None if effective_radius is None else effective_radius[flight.voxel]
            added = 0.0 if virtual is None else virtual[flight.voxel]
            return *droplet_in_voxel(scene, radius, u_row), 1 / (droplets + added)
    return Particle("molecule"), scene.air.single_scattering_albedo, 0.0  # type: ignore[union-attr]
