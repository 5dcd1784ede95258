"""The derivative of a camera ray's radiance by the source function along it.

Written from the equations, one ray after the other, to check the kernels by (kernels/camera_rays.h). In pieces of the
ray, k = 1 ... n, droplets have a source function S_k each:

    R = sum over k of c_k S_k (exp(-t_{k-1}) - exp(-t_k)) + radiance from behind

with t_k the depth of droplets and air up to the end of piece k, and c_k the droplets' share of it. A little more of
droplets along l km of piece k changes that by l (S_k exp(-t_k) - R_{>k}). What air and ground send is the radiance of
the ray's own path, where no droplet is the first that it meets.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from cloudtomo_cl.reference.flights import air_layers, outside_crossings, voxel_crossings
from cloudtomo_cl.reference.scattering import droplet_density, middle_row
from cloudtomo_cl.scene.grid import Grid
from cloudtomo_cl.scene.scene import Scene

# Optical depths: up to which flights do not end; beyond their end, up to which light is followed.
EXPECTED_DEPTH, DEPTH_BEHIND = 2.0, 2.0
# Pieces of a cell, in which sunlight changes: their depth, and how many at most.
STEP_DEPTH, MOST_STEPS = 0.3, 8
_NODES, _WEIGHTS = ((x + 1) / 2 if n == 0 else x / 2 for n, x in enumerate(np.polynomial.legendre.leggauss(8)))
# Sunlight is constant in a voxel of less depth along its three edges together, and changes by no more than that of one
# of more.
LEAST_CHANGE, MOST_CHANGE = 0.1, 30.0


@dataclass(frozen=True, eq=False)
class Table:
    """A radiance table, on the host.

    Attributes
    ----------
    mask : voxels that it has, bool, shape of the grid
    parts : into which each of these is divided along x, y, z, shape (voxels, 3); cells are numbered voxel by voxel, z
        fastest
    source, scattered : what droplets scatter of diffuse light, and that less the radiance, sr^-1 for a sun of
        irradiance 1, shape (cells, bins)
    sunlight : direct, times the albedo, in units of what the cell's voxel has in its lower corner, shape (cells,)
    edges : of the rings that bins are in, degrees from the vertical, from 0 to 180
    azimuths : bins of each ring
    """

    mask: np.ndarray
    parts: np.ndarray
    source: np.ndarray
    scattered: np.ndarray
    sunlight: np.ndarray
    edges: tuple[float, ...]
    azimuths: tuple[int, ...]

    def first_cell(self, voxel: int) -> int:
        """Of a voxel of the mask, by its number."""
        return int(self.parts[:voxel].prod(axis=1).sum())

    def bin_of(self, direction: np.ndarray) -> int:
        """The bin of a direction: rings around the vertical, each of equal azimuths."""
        zenith = np.degrees(np.arccos(np.clip(direction[2], -1, 1)))
        ring = min(int(np.searchsorted(self.edges, zenith, side="right")) - 1, len(self.azimuths) - 1)
        turn = np.arctan2(direction[1], direction[0]) / (2 * np.pi) % 1
        return sum(self.azimuths[:ring]) + min(int(turn * self.azimuths[ring]), self.azimuths[ring] - 1)


class RayDerivative(NamedTuple):
    """Of one ray.

    Attributes
    ----------
    radiance : R, what droplets send, sr^-1 for a sun of irradiance 1
    derivative : sr^-1 km, shape of the grid
    """

    radiance: float
    derivative: np.ndarray


@dataclass(frozen=True, eq=False)
class _Pieces:
    """Of a ray, up to an optical depth.

    Attributes
    ----------
    voxels, cells : of each; the cell -1 outside of the table
    lengths : km
    sources : source functions, sr^-1
    depths : of droplets and air at the ends of the pieces, the first where the first one begins
    droplets : their share of each piece's depth
    has_left : whether the ray leaves the grid before that depth
    """

    voxels: list[tuple[int, int, int]]
    cells: np.ndarray
    lengths: np.ndarray
    sources: np.ndarray
    depths: np.ndarray
    droplets: np.ndarray
    has_left: bool

    @property
    def sent(self) -> np.ndarray:
        """By each, as the camera sees it, sr^-1."""
        sent: np.ndarray = self.sources * self.droplets * -np.diff(np.exp(-self.depths))
        return sent


def ray_derivative(
    scene: Scene,
    extinction: np.ndarray,
    table: Table,
    position: np.ndarray,
    direction: np.ndarray,
    optical_depth: float,
    u_particle: float,
    path_radiance: float,
) -> RayDerivative:
    """What a ray adds to the derivative of its pixel's radiance.

    Parameters
    ----------
    position, direction : of the ray, km
    optical_depth : up to which its path's first flight goes
    u_particle : uniform number, by which the first particle is chosen
    path_radiance : of that path, sr^-1 for a sun of irradiance 1
    """
    derivative = np.zeros(scene.grid.shape)
    ray = (scene, extinction, table, position, direction)
    all_pieces = _pieces(*ray, EXPECTED_DEPTH + optical_depth + DEPTH_BEHIND)
    if not np.any(all_pieces.cells >= 0):
        return RayDerivative(0.0, derivative)
    radiance = np.sum(all_pieces.sent) + _behind(table, all_pieces, direction)
    pieces = _pieces(*ray, EXPECTED_DEPTH + optical_depth)
    ends = pieces.depths[1:]
    met = (pieces.depths[:-1] < optical_depth) & (optical_depth <= ends) & (u_particle < pieces.droplets)
    from_others = 0.0 if met.any() else path_radiance
    behind = radiance - np.cumsum(pieces.sent)
    ended = np.maximum(pieces.depths - EXPECTED_DEPTH, 0.0)
    for_all = np.exp((ended[:-1] + ended[1:]) / 2)  # flights that have got so far, for all
    changes = (pieces.sources * np.exp(-ends) - behind) * for_all
    deposits = pieces.lengths * (changes - from_others * (optical_depth > ends))  # these have got so far by themselves
    for voxel, cell, deposit in zip(pieces.voxels, pieces.cells, deposits, strict=True):
        if cell >= 0:
            derivative[voxel] += deposit
    return RayDerivative(float(radiance), derivative)


def _behind(table: Table, pieces: _Pieces, direction: np.ndarray) -> float:
    """What droplets send from behind all pieces, as the camera sees it."""
    if pieces.has_left:
        return 0.0
    place = pieces.cells[pieces.cells >= 0][-1], table.bin_of(direction)
    return float(np.exp(-pieces.depths[-1]) * (table.source[place] - table.scattered[place]))


def _pieces(
    scene: Scene, extinction: np.ndarray, table: Table, position: np.ndarray, direction: np.ndarray, most: float
) -> _Pieces:
    """A ray's pieces: of the cells that it crosses, up to an optical depth of `most`."""
    grid = scene.grid
    voxels, starts, crossed = voxel_crossings(grid, position, direction, scene.boundary.horizontal == "periodic")
    inside = (starts[0], starts[-1] + crossed[-1]) if len(voxels) else None
    outside, outside_starts, outside_lengths = outside_crossings(scene, position, direction, inside)
    before = outside_starts < (starts[0] if len(voxels) else 0.0)
    depth = first_depth = float(np.sum((outside * outside_lengths)[before]))
    column = np.full(grid.shape, -1)
    column[table.mask] = np.arange(table.mask.sum())
    levels, layers = air_layers(scene)
    lowest = int(np.argmin(np.abs(levels - grid.origin[2])))
    sun_density = droplet_density(scene, middle_row(scene), scene.sun.direction @ direction)
    found: list[tuple[tuple[int, int, int], int, float, float, float, float]] = []
    has_left = True
    for (x, y, z), start, whole in zip(voxels, starts, crossed, strict=True):
        droplets, air = extinction[x, y, z], layers[lowest + z]
        length = whole
        if depth + (droplets + air) * whole >= most:
            has_left, length = False, max(most - depth, 0.0) / (droplets + air)
        corner = (
            np.array(grid.origin)
            + np.array(_unwrapped(grid, position + (start + whole / 2) * direction)) * grid.spacing
        )
        entry = position + start * direction - corner  # km from the voxel's lower corner
        index = int(column[x, y, z])
        for cell, first, last, mean in _steps(scene, table, index, entry, direction, length, droplets):
            source = 0.0
            if cell >= 0:
                source = table.source[cell, table.bin_of(direction)] + sun_density * mean * table.sunlight[cell]
            found.append(((x, y, z), cell, last - first, source, droplets, droplets + air))
        depth += (droplets + air) * length
        if not has_left:
            break
    cells, lengths, sources, of_droplets, of_all = (np.array([piece[n] for piece in found]) for n in range(1, 6))
    depths = first_depth + np.concatenate([[0.0], np.cumsum(of_all * lengths)])
    shares = np.divide(of_droplets, of_all, out=np.zeros(len(found)), where=of_all > 0)
    return _Pieces([piece[0] for piece in found], cells, lengths, sources, depths, shares, has_left)


def _unwrapped(grid: Grid, point: np.ndarray) -> np.ndarray:
    """The voxel, in periodic copies of the grid beyond it too, that holds a point."""
    return np.floor((point - grid.origin) / grid.spacing)


def _steps(
    scene: Scene, table: Table, index: int, entry: np.ndarray, direction: np.ndarray, length: float, droplets: float
) -> list[tuple[int, float, float, float]]:
    """Pieces of a crossing of a voxel: cell, from and to, km, and the mean of direct sunlight, in units of
    what it is in the voxel's lower corner."""
    if index < 0:
        return [(-1, 0.0, length, 1.0)]
    spacing, sun = np.array(scene.grid.spacing), scene.sun.direction
    parts = table.parts[index]
    cuts = [0.0, length]
    for axis in range(3):
        if direction[axis] != 0:
            faces = np.arange(1, parts[axis]) * spacing[axis] / parts[axis]
            cuts.extend((faces - entry[axis]) / direction[axis])
    faces = np.unique(np.clip(cuts, 0.0, length))
    size = spacing.sum()
    rate = 0.0 if droplets * size < LEAST_CHANGE else min(droplets, MOST_CHANGE / size)
    found = []
    for first, last in zip(faces[:-1], faces[1:], strict=True):
        middle = (entry + (first + last) / 2 * direction) / spacing
        part = np.clip(np.floor(middle * parts), 0, parts - 1).astype(int)
        cell = table.first_cell(index) + int(np.ravel_multi_index(tuple(part), tuple(parts)))
        steps = 1 if rate == 0 else int(np.clip(np.ceil(droplets * (last - first) / STEP_DEPTH), 1, MOST_STEPS))
        ends = np.linspace(first, last, steps + 1)
        for begin, end in zip(ends[:-1], ends[1:], strict=True):
            # Of the exponential of rate x way towards the sun: by quadrature.
            way = sun @ (entry[:, None] + direction[:, None] * (begin + (end - begin) * _NODES))
            found.append((cell, begin, end, float(_WEIGHTS @ np.exp(rate * way))))
    return found
