"""The field of radiance inside a cloud, and the gradient that it gives."""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np

from cloudtomo_cl.errors import DataError
from cloudtomo_cl.opencl.fixed_point import require_sums
from cloudtomo_cl.opencl.layout import TABLE_UNIT
from cloudtomo_cl.opencl.memory import Footprint
from cloudtomo_cl.scene.phase import PhaseFunction
from cloudtomo_cl.transport.radiance import FIXED_POINT_SCALE, RadianceOperator, Rendering, largest_adjoint

if TYPE_CHECKING:
    pass

# Rings of directions around the vertical, degrees from it, and their azimuths: cells of about
# 0.17 sr, smaller near the vertical.
_EDGES = (0.0, 8.0, 16.0, 28.0, 42.0, 60.0, 80.0, 100.0, 125.0, 150.0, 180.0)
_AZIMUTHS = (1, 4, 6, 8, 10, 12, 12, 10, 8, 4)
_FIRST = tuple(int(first) for first in np.concatenate([[0], np.cumsum(_AZIMUTHS)[:-1]]))
BINS = sum(_AZIMUTHS)
_FEATURES = (
    f"DIRECTION_RINGS {len(_AZIMUTHS)}",
    f"DIRECTION_BINS {BINS}",
    "RING_COSINES " + ", ".join(f"{np.cos(np.radians(edge)):.8f}f" for edge in _EDGES),
    "RING_AZIMUTHS " + ", ".join(map(str, _AZIMUTHS)),
    "RING_FIRSTS " + ", ".join(map(str, _FIRST)),
)
# Points in each cell of directions over which phase functions are averaged.
_POINTS = 12
# A cell with less than so many crossings of a voxel leans on its neighbours'; one without any
# neighbour on the mean of all voxels.
_OWN_CROSSINGS, _NEIGHBOUR_CROSSINGS = 5.0, 0.05
# The table on the device, with what is added to it; on the host, and what smoothing it takes.
_BYTES_PER_CELL, _HOST_BYTES_PER_CELL = 20, 40
# Kernels count the table's entries with signed integers of 32 bits.
_MOST_CELLS = 2**31 - 1
# After so many gradients the table is made anew, and what it held before fades.
_FADING = 0.7
_REFRESH = 4


def table_footprint(voxels: int) -> Footprint:
    """What a `RadianceTable` of so many voxels takes."""
    return Footprint(_BYTES_PER_CELL * voxels * BINS, 16 * voxels * BINS, _HOST_BYTES_PER_CELL * voxels * BINS)


class RadianceTable:
    """A table of the diffuse radiance by voxel and direction, and gradients by it.

    Parameters
    ----------
    operator : with a mask, whose voxels the field covers

    Raises
    ------
    DataError : the operator has no mask, or there is not memory enough

    Source: the derivative of the equation of transfer with respect to the extinction is a source
    of (source function - radiance), weighted with the adjoint (Martin, Cairns and Bal 2014, "Adjoint
    methods for adjusting three-dimensional atmosphere and surface properties to fit multi-angle/
    multi-pixel polarimetric measurements"; Levis et al. 2020 drop a part of it); here the adjoint is
    sampled by the cameras' paths, exactly, and the radiance by the table they fill.
    """

    def __init__(self, operator: RadianceOperator) -> None:
        if operator.mask is None:
            raise DataError("a radiance table needs the mask of its operator: give one, for instance of ones")
        self._operator = operator
        device, mask = operator.device, operator.mask
        self._mask = mask
        self.columns = int(mask.sum())
        table_footprint(self.columns).require(
            device,
            f"the radiance table of {self.columns} voxels",
            'choose a smaller mask or grid, or solver.gradient = "replay"',
        )
        if 2 * self.columns * BINS > _MOST_CELLS:
            raise DataError(
                f"the radiance table of {self.columns} voxels is more than kernels count: choose a smaller mask or "
                'grid, or solver.gradient = "replay"'
            )
        column = np.full(mask.shape, -1, np.int32)
        column[mask] = np.arange(self.columns)
        self.column = device.constant(column)
        self._voxel = device.constant(np.flatnonzero(mask).astype(np.int32))
        features = (*operator.features, *_FEATURES)
        self._gradient_paths = device.kernel("derivatives", "gradient_paths", features)
        self._direct_sunlight = device.kernel("derivatives", "direct_sunlight", features)
        self.features = features
        cloud = operator.scene.cloud
        # Of a phase table the middle row stands for all: it is what flights to the sun are drawn from.
        albedos = getattr(cloud.phase_function, "single_scattering_albedo", None) or (cloud.single_scattering_albedo,)
        self._albedo = albedos[len(albedos) // 2]
        self._scattering = scattering_matrix(cloud.phase_function)
        self._table = np.zeros((self.columns, BINS, 2), np.float32)  # km, sr^-1 km
        self._field = device.zeros((self.columns, BINS, 2), np.int64)
        self._scattered = device.zeros((self.columns, BINS), np.float32)
        self._sunlight = device.zeros(self.columns, np.float32)
        self._gradients = 0

    def gradient(self, rendering: Rendering, adjoint: np.ndarray, change: Any) -> tuple[Any, np.ndarray]:
        """The gradient of a cost with respect to extinction; as `RadianceOperator.gradient`.

        Parameters
        ----------
        change : of the extinction, km^-1, shape of the grid, on the device

        Returns
        -------
        gradient : on the device, float32, shape of the grid, cost per km^-1; 0 outside of the mask
        tangent : derivative of each pixel's radiance along the change, W m^-2 sr^-1, shape (pixels,)

        The rendering's paths go into the table for the gradients after
        this one; before the first, they fill it.

        Raises
        ------
        AuditError, TransportError : as `RadianceOperator.gradient`
        """
        if self._gradients == 0:
            self._walk(rendering, np.zeros_like(adjoint), change)
        if self._gradients % _REFRESH == 0:
            self._refresh(rendering)
        self._gradients += 1
        return self._walk(rendering, adjoint, change)

    def prepare(self, rendering: Rendering) -> None:
        """Makes the table at a rendering's extinction, for kernels that take it by `buffers`.

        It is made of the paths that went into it before; the first time the rendering's own fill it.
        """
        operator = self._operator
        if self._gradients == 0:
            nothing = operator.device.zeros(operator.scene.grid.shape, np.float32)
            self._walk(rendering, np.zeros((len(operator.pixels), 2)), nothing)
        self._refresh(rendering)
        self._gradients += 1

    def arrays(self) -> dict[str, np.ndarray]:
        """All that a gradient changes, as arrays on the host."""
        arrays = {"field": self._field, "scattered": self._scattered, "sunlight": self._sunlight}
        own = {"table": self._table.copy(), "gradients": np.array(self._gradients)}
        return own | {name: array.get() for name, array in arrays.items()}

    def restore(self, state: dict[str, np.ndarray]) -> None:
        """Goes on from what `arrays` gave."""
        self._table = state["table"].copy()
        self._gradients = int(state["gradients"])
        for name, array in (("field", self._field), ("scattered", self._scattered), ("sunlight", self._sunlight)):
            array.set(state[name])

    @property
    def buffers(self) -> dict[str, Any]:
        """The table as kernels take it."""
        return {
            "column": self.column, "scattered": self._scattered, "sunlight": self._sunlight, "table_sums": self._field
        }  # fmt: skip

    def _walk(self, rendering: Rendering, adjoint: np.ndarray, change: Any) -> tuple[Any, np.ndarray]:
        operator = self._operator
        total = operator.device.zeros(operator.scene.grid.shape, np.int64)
        largest = largest_adjoint(adjoint)
        shares = adjoint / largest if largest > 0 else np.zeros_like(adjoint)
        factors = operator.device.constant((shares * FIXED_POINT_SCALE).astype(np.float32))
        tangent = np.zeros(len(operator.pixels))
        for launch in operator.stored_launches(rendering):
            paths = operator.device.empty(launch.paths, np.float32)
            launch.run(
                self._gradient_paths, **self.buffers, adjoint=factors, change=change, gradient=total,
                path_tangent=paths,
            )  # fmt: skip
            tangent += paths.get().reshape(-1, len(operator.pixels)).sum(axis=0, dtype=float)
        require_sums(total.get(), "the gradient", "voxel")
        irradiance = operator.scene.sun.irradiance
        unit = largest / FIXED_POINT_SCALE * irradiance / (rendering.samples // 2)
        with operator.device.lock:  # pyopencl's own kernels, too, are shared by threads
            gradient = total.astype(np.float32) * np.float32(unit)
        return gradient, tangent * irradiance / rendering.samples

    def _refresh(self, rendering: Rendering) -> None:
        """Makes source and radiance anew from what paths have brought, at a rendering's extinction."""
        self._table *= _FADING
        field = self._field.get()
        require_sums(field, "the radiance table", "voxel of the mask, direction and kind")
        self._table += field / np.float32(TABLE_UNIT)
        self._operator.device.clear(self._field)
        radiance = self._radiance()
        scattered = self._albedo * (radiance @ self._scattering.T) - radiance
        self._scattered.set(scattered.astype(np.float32))
        medium = rendering._medium
        self._operator.device.launch(
            self._direct_sunlight, self.columns, **medium.arguments, voxel=self._voxel, count=self.columns,
            sunlight=self._sunlight,
        )  # fmt: skip
        self._sunlight *= np.float32(self._albedo)

    def _radiance(self) -> np.ndarray:
        """Radiance by voxel and direction, sr^-1: its own cell's, as far as it is known."""
        edge = float(np.mean(self._operator.scene.grid.spacing))
        length, brought = self._table[..., 0], self._table[..., 1]
        everywhere = brought.sum(axis=0) / np.maximum(length.sum(axis=0), 1e-30)
        near = []
        for values in (length, brought):  # one after the other, for the sake of memory
            full = np.zeros((*self._mask.shape, BINS), np.float32)
            full[self._mask] = values
            near.append(_with_neighbours(full)[self._mask])
        least = _NEIGHBOUR_CROSSINGS * edge
        neighbours = (near[1] + least * everywhere) / (near[0] + least)
        # A voxel's own brightness, which its neighbours need not have.
        expected, found = (length * neighbours).sum(axis=1), brought.sum(axis=1)
        lit = expected[expected > 0]
        level = 0.3 * np.median(lit) if len(lit) else 1.0
        ratio = np.clip((found + level) / (expected + level), 0.05, 10.0)[:, None]
        own = _OWN_CROSSINGS * edge
        return (brought + own * ratio * neighbours) / (length + own)


def _with_neighbours(values: np.ndarray) -> np.ndarray:
    """Sums over a voxel and the 26 around it, shape (x, y, z, ...).

    SciPy's uniform_filter takes twice the time, much of the host's in an stream.
    """
    for axis in range(3):
        before = np.moveaxis(values, axis, 0)
        total = before.copy()
        total[1:] += before[:-1]
        total[:-1] += before[1:]
        values = np.moveaxis(total, 0, axis)
    return values


@lru_cache
def scattering_matrix(phase_function: PhaseFunction) -> np.ndarray:
    """Share of the light from direction bin j that droplets scatter into bin i, per sr of i's own direction.

    Returns an array (bins, bins): the source function in bin i is its sum over j times the radiance in j.
    """
    random = np.random.default_rng(0)
    directions, angles = [], []
    for ring, count in enumerate(_AZIMUTHS):
        upper, lower = np.cos(np.radians(_EDGES[ring : ring + 2]))
        for azimuth in range(count):
            u = (np.indices((_POINTS, _POINTS)).reshape(2, -1).T + random.random((_POINTS**2, 2))) / _POINTS
            cosine, phi = lower + (upper - lower) * u[:, 0], 2 * np.pi * (azimuth + u[:, 1]) / count
            sine = np.sqrt(1 - cosine**2)
            directions.append(np.column_stack([sine * np.cos(phi), sine * np.sin(phi), cosine]))
            angles.append((upper - lower) * 2 * np.pi / count)
    # From j to i as from i to j, but for the bins' sizes.
    mean = np.empty((BINS, BINS))
    for i, first in enumerate(directions):
        for j, second in enumerate(directions[: i + 1]):
            mean[i, j] = mean[j, i] = phase_function.density(np.clip(first @ second.T, -1, 1)).mean()
    matrix = mean * angles
    return matrix / matrix.sum(axis=1, keepdims=True)
