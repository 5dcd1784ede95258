"""The patch prior's kernels (patches.cl): choice of the patches' components, and the resulting quadratic function."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from cloudtomo_cl.inversion.mixture import Mixture
from cloudtomo_cl.inversion.patches import Patches
from cloudtomo_cl.inversion.vectors import Vectors
from cloudtomo_cl.opencl.arrays import DeviceArray
from cloudtomo_cl.opencl.device import Device, device_errors
from cloudtomo_cl.opencl.gathering import Gathering
from cloudtomo_cl.opencl.memory import Footprint
from cloudtomo_cl.transport.voxel_shares import ROW, voxel_shares

# Patches in a block, which belongs to one rank.
_PATCHES_OF_BLOCK = 64
# Voxels of a tile of the stencil, in a row along z; and the component number of places without a patch.
_LANES, _NO_PATCH = ROW, 65535


# Share of the tiles' voxels that are near cloud, and number of voxels that share a patch of 5 x 5 x 3 with one voxel.
_TILES_FILLED, _NEIGHBOURS = 0.6, 405


def stencil_footprint(voxels: int) -> Footprint:
    """Memory of a step's stencil for a number of voxels near cloud."""
    size = 4.0 * _NEIGHBOURS * voxels / _TILES_FILLED
    return Footprint(size, size)


@dataclass(frozen=True, eq=False)
class _Components:
    """A mixture's components as kernels take them, on the device, for patches with noise of one standard deviation.

    Attributes
    ----------
    noise : standard deviation of the noise, in units of s
    whitening, white_means, constants : arrays for a component's density (`Mixture.whitening`, `Mixture.constants`)
    precision, slope : precisions, and precisions times means: a component's quadratic and linear form
    diagonal : diagonals of the precisions, on the host, shape (components, values)
    """

    noise: float
    whitening: Any
    white_means: Any
    constants: Any
    precision: Any
    slope: Any
    diagonal: np.ndarray

    @classmethod
    def of(cls, mixture: Mixture, noise: float, device: Device) -> _Components:
        """The components of a mixture."""
        whitening, means = mixture.whitening(noise)
        values = whitening.shape[1]
        rows = np.zeros((len(mixture), values, -(-values // _LANES) * _LANES))
        rows[:, :, :values] = whitening
        precisions = mixture.precisions(noise)
        slopes = np.einsum("kij,kj->ki", precisions, mixture.means)
        arrays = {
            "whitening": rows, "white_means": means, "constants": mixture.constants(noise), "precision": precisions,
            "slope": slopes,
        }  # fmt: skip
        kept = {name: device.constant(array.astype(np.float32)) for name, array in arrays.items()}
        return cls(noise, **kept, diagonal=np.diagonal(precisions, axis1=1, axis2=2).copy())


class PatchOperator:
    """The patch prior on a device: where its patches and tiles lie, and the kernels that choose components.

    Parameters
    ----------
    patches : patches around the voxels of the mask
    mixture : mixture for patches of this size
    device : device that computes

    Attributes
    ----------
    voxel_shares : which rank computes the products for which voxels: those of its tiles of the stencil
    """

    @device_errors("the prior")
    def __init__(self, patches: Patches, mixture: Mixture, device: Device) -> None:
        self.patches, self.mixture, self.device = patches, mixture, device
        mask = patches.voxels.mask
        self.shape, self.voxels = mask.shape, len(patches.voxels)
        self.vectors = Vectors(device, self.voxels)
        margins = np.array(mixture.size) - 1
        tiles_along = -(-mask.shape[2] // _LANES)
        self.halo = tuple(np.array([*mask.shape[:2], tiles_along * _LANES]) + 2 * margins)
        at = np.argwhere(mask)
        constant = device.constant
        self._shares = device.ranks.dealt(np.arange(len(patches)) // _PATCHES_OF_BLOCK)
        self._patch = np.asarray(np.ravel_multi_index(tuple(patches.centres.T), mask.shape))
        self._patch_of_rank = self._shares.taken(self._patch)
        self._centre = constant(_ushort4(self._shares.taken(patches.centres)))
        self.place = constant(np.ravel_multi_index(tuple((at + margins).T), self.halo).astype(np.uint32))
        self.voxel_shares = voxel_shares(mask, device.ranks)
        is_mine = np.zeros(self.voxels, bool)
        is_mine[self.voxel_shares.own] = True
        # The fourth number says whether the voxel is another rank's.
        self.voxel = constant(np.column_stack([at, ~is_mine]).astype(np.uint16))
        # This rank's tiles that hold a voxel of the mask, and the numbers of their voxels; a tile has one owner.
        numbers = np.full((*mask.shape[:2], tiles_along * _LANES), -1, np.int32)
        numbers[:, :, : mask.shape[2]][mask] = np.arange(self.voxels)
        self._numbers = numbers.reshape(-1, _LANES)
        last = self._numbers.max(axis=1)
        chosen = np.flatnonzero((last >= 0) & is_mine[last])
        self._numbers = self._numbers[chosen]
        x, y, z = np.unravel_index(chosen, (*mask.shape[:2], tiles_along))
        self._corners = _ushort4(np.column_stack([x, y, z * _LANES]))
        self._corner = constant(self._corners)
        self.values = device.zeros(self.halo, np.float32)
        self._guess = device.empty(self.shape, np.uint16)
        self._guess.fill(_NO_PATCH)
        self._components: _Components | None = None
        self.offsets = int(np.prod(2 * np.array(mixture.size) - 1))
        self._features = tuple(
            f"{name} {value}"
            for name, value in zip(
                ("PATCH_X", "PATCH_Y", "PATCH_Z", "LANES", "NO_PATCH"), (*mixture.size, _LANES, _NO_PATCH)
            )
        )

    def components(self, noise: float) -> _Components:
        """The components for a noise; the last ones are kept, since many steps have the same noise."""
        found = self._components
        if found is None or found.noise != noise:
            found = self._components = _Components.of(self.mixture, noise, self.device)
        return found

    def launch(self, name: str, work_items: int, **arguments: Any) -> None:
        """Runs one of the kernels of patches.cl."""
        if work_items:
            self.device.launch(self.device.kernel("patches", name, self._features), work_items, **arguments)

    def spread(self, x: DeviceArray, scale: float = 1.0) -> None:
        """Writes scale times the voxels' values into the array that kernels read, `values`."""
        self.vectors.launch("spread_values", factor=scale, place=self.place, x=x, values=self.values)

    def chosen_components(self, u: DeviceArray, noise: float) -> tuple[DeviceArray, float]:
        """The likeliest component of each patch, on the grid, and the cost of all patches together.

        u : extinction in units of s; it is written into `values`
        noise : standard deviation of the patches' noise, in units of s
        """
        shares = self._shares
        component, cost = self.device.ranks.together(lambda: self._chosen_of_rank(u, noise))
        if shares.owner is not None:
            found = component.get()
            flat = found.reshape(-1)
            flat[self._patch] = shares.gathered(flat[self._patch_of_rank])
            component.set(found)
        self._guess = component
        return component, float(np.sum(shares.gathered(cost.get()[: len(shares)]), dtype=np.float64))

    def _chosen_of_rank(self, u: DeviceArray, noise: float) -> tuple[DeviceArray, DeviceArray]:
        """Components and costs of this rank's patches."""
        self.spread(u)
        device, mixture, count = self.device, self.components(noise), len(self._shares)
        # The last components are a good guess, which does not change the result.
        component = self._guess.copy()
        cost = device.empty(max(count, 1), np.float32)
        self.launch(
            "choose_components", count, patch_count=count, centre=self._centre, shape=self.shape, halo=self.halo,
            values=self.values, component_count=len(self.mixture), whitening=mixture.whitening,
            white_means=mixture.white_means, constants=mixture.constants, component=component, cost=cost,
        )  # fmt: skip
        return component, cost

    def tiles_near_cloud(self, component: DeviceArray) -> tuple[np.ndarray, np.ndarray]:
        """This rank's tiles with a voxel in a patch with cloud: their first voxels, and the numbers of their voxels."""
        tiles = len(self._corners)
        reached = self.device.empty(max(tiles, 1), np.uint8)
        self.launch(
            "find_tiles", tiles, tile_count=tiles, corner=self._corner, shape=self.shape, component=component,
            reached=reached,
        )  # fmt: skip
        chosen = np.flatnonzero(reached.get()[:tiles])
        return self._corners[chosen], self._numbers[chosen]


class PatchQuadratic:
    """The sum of all patches' quadratic forms, with the components that are likeliest at u, minus a clear sky's value.

    Parameters
    ----------
    operator : patch prior on the device
    u : extinction in units of s, shape (voxels,)
    noise : standard deviation of the patches' noise, in units of s
    weight_of_clear : weight of patches without cloud; others have the weight 1

    Attributes
    ----------
    value : value of the function at u
    shares : which rank computes which elements of products
    """

    @device_errors("the prior")
    def __init__(self, operator: PatchOperator, u: np.ndarray, noise: float, weight_of_clear: float = 1.0) -> None:
        self._operator, self._at, self.shares = operator, u, operator.voxel_shares
        self._gradient: np.ndarray | None = None
        device = operator.device
        self._component, self.value = operator.chosen_components(device.array(u.astype(np.float32)), noise)
        components = operator.components(noise)
        corners, numbers = operator.tiles_near_cloud(self._component)
        self._tiles = len(corners)
        self._corner, self._number = device.constant(corners), device.constant(numbers)
        device.ranks.together(lambda: self._assemble(components))
        self._sum_patches(components, weight_of_clear)
        self.value += 0.5 * (1 - 1 / weight_of_clear) * float(self.clear @ np.square(u))

    def _assemble(self, components: _Components) -> None:
        """Computes the stencil of this rank's tiles."""
        operator, device = self._operator, self._operator.device
        self._stencil = device.empty(max(self._tiles, 1) * operator.offsets * _LANES, np.float32)
        columns = operator.offsets // (2 * operator.mixture.size[2] - 1)
        operator.launch(
            "assemble_stencil", self._tiles * columns * _LANES, tile_count=self._tiles, corner=self._corner,
            number=self._number, shape=operator.shape, component=self._component,
            precision=components.precision, stencil=self._stencil,
        )  # fmt: skip

    def _sum_patches(self, components: _Components, weight_of_clear: float) -> None:
        operator, device = self._operator, self._operator.device
        diagonals = components.diagonal.copy()
        diagonals[0] *= weight_of_clear  # the first component stands for patches without cloud
        self._of_means, self._clear, self._diagonal = (device.empty(operator.voxels, np.float32) for _ in range(3))
        operator.launch(
            "sum_patches", operator.voxels, voxel_count=operator.voxels, voxel=operator.voxel, shape=operator.shape,
            component=self._component, slope=components.slope,
            diagonal_of=device.constant(diagonals.astype(np.float32)), of_means=self._of_means,
            clear=self._clear, diagonal=self._diagonal,
        )  # fmt: skip
        # The means' part is used in products alone, of which each rank computes the elements of its voxels.
        gathering = Gathering(device, self.shares)
        gathering.complete(self._clear)
        gathering.complete(self._diagonal)

    @cached_property
    def components(self) -> np.ndarray:
        """The number of each patch's component, shape (patches,)."""
        return self._component.get()[tuple(self._operator.patches.centres.T)]

    @cached_property
    def diagonal(self) -> np.ndarray:
        """The diagonal of the Hessian, shape (voxels,)."""
        return self._diagonal.get().astype(float)

    @cached_property
    def clear(self) -> np.ndarray:
        """The part of patches without cloud in that diagonal, shape (voxels,): it is their whole Hessian."""
        return self._clear.get().astype(float)

    @device_errors("the prior")
    def add_product(
        self, x: DeviceArray, result: DeviceArray, factor: float, scale: float = 1.0, means: float = 0.0
    ) -> None:
        """Adds factor times the Hessian's product with scale x to a result, shape (voxels,).

        Each of several ranks computes the elements of its voxels (`shares`); the others are undefined.

        means : 0 for this product; 1 for the gradient at scale x
        """
        operator = self._operator
        operator.spread(x, scale)
        operator.launch(
            "add_stencil_product", self._tiles, tile_count=self._tiles, corner=self._corner, number=self._number,
            halo=operator.halo, stencil=self._stencil, values=operator.values, factor=factor, result=result,
        )  # fmt: skip
        operator.launch(
            "add_diagonal_product", operator.voxels, voxel_count=operator.voxels, place=operator.place,
            clear=self._clear, of_means=self._of_means, means=means, values=operator.values, factor=factor,
            result=result,
        )  # fmt: skip

    def _gradient_at_u(self) -> np.ndarray:
        # No cached_property: before Python 3.12 it holds one lock for all objects, and ranks that are threads wait for
        # each other in here.
        if self._gradient is None:
            self._gradient = self._product(self._at, means=1.0)
        return self._gradient

    def times(self, change: np.ndarray) -> np.ndarray:
        """The Hessian's product with a vector, shape (voxels,), float64."""
        # Often the change is 0: where the function is asked for at the u of its components.
        return self._product(change, means=0.0) if np.any(change) else np.zeros(len(change))

    def value_and_gradient(self, u: np.ndarray) -> tuple[float, np.ndarray]:
        """Value and gradient at another u, shape (voxels,)."""
        change = u - self._at
        product = self.times(change)
        gradient = self._gradient_at_u()
        return self.value + float((gradient + 0.5 * product) @ change), gradient + product

    def _product(self, x: np.ndarray, means: float) -> np.ndarray:
        device = self._operator.device
        result = device.zeros(len(x), np.float32)
        self.add_product(device.array(x.astype(np.float32)), result, 1.0, means=means)
        Gathering(device, self.shares).complete(result)
        return result.get().astype(float)


def _ushort4(places: np.ndarray) -> np.ndarray:
    """Places (x, y, z) as kernels take them: with a fourth number, 0."""
    found = np.zeros((len(places), 4), np.uint16)
    found[:, :3] = places
    return found
