"""Which component of a mixture each patch comes from, most likely."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from cloudtomo_cl.inversion.halo import Halo
from cloudtomo_cl.inversion.mixture import Mixture
from cloudtomo_cl.inversion.patch_kernels import LANES, NO_PATCH, PatchKernels
from cloudtomo_cl.inversion.patches import Patches
from cloudtomo_cl.opencl.arrays import DeviceArray
from cloudtomo_cl.opencl.device import Device
from cloudtomo_cl.opencl.layout import places

# Patches in a block, which belongs to one rank.
_PATCHES_OF_BLOCK = 64


@dataclass(frozen=True, eq=False)
class Components:
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
    def of(cls, mixture: Mixture, noise: float, device: Device) -> Components:
        """The components of a mixture."""
        whitening, means = mixture.whitening(noise)
        values = whitening.shape[1]
        rows = np.zeros((len(mixture), values, -(-values // LANES) * LANES))
        rows[:, :, :values] = whitening
        precisions = mixture.precisions(noise)
        slopes = np.einsum("kij,kj->ki", precisions, mixture.means)
        arrays = {
            "whitening": rows, "white_means": means, "constants": mixture.constants(noise), "precision": precisions,
            "slope": slopes,
        }  # fmt: skip
        kept = {name: device.constant(array.astype(np.float32)) for name, array in arrays.items()}
        return cls(noise, **kept, diagonal=np.diagonal(precisions, axis1=1, axis2=2).copy())


class ComponentChoice:
    """Chooses the patches' components; each rank chooses those of a part of the patches.

    Parameters
    ----------
    patches : around the voxels of a mask
    mixture : for patches of this size
    kernels : for patches of this size
    halo : where their values are
    """

    def __init__(self, patches: Patches, mixture: Mixture, kernels: PatchKernels, halo: Halo) -> None:
        self._mixture, self._kernels, self._halo = mixture, kernels, halo
        device, self._shape = kernels.device, patches.voxels.mask.shape
        self._shares = device.ranks.dealt(np.arange(len(patches)) // _PATCHES_OF_BLOCK)
        self._patch = np.asarray(np.ravel_multi_index(tuple(patches.centres.T), self._shape))
        self._centre = device.constant(places(self._shares.taken(patches.centres)))
        self._guess = device.empty(self._shape, np.uint16)
        self._guess.fill(NO_PATCH)
        self._components: Components | None = None

    def components(self, noise: float) -> Components:
        """The components for a noise; the last ones are kept, since many steps have the same noise."""
        found = self._components
        if found is None or found.noise != noise:
            found = self._components = Components.of(self._mixture, noise, self._kernels.device)
        return found

    def at(self, u: DeviceArray, noise: float) -> tuple[DeviceArray, float]:
        """The likeliest component of each patch, on the grid, and the cost of all patches together.

        u : extinction in units of s, shape (voxels,); it is written into the halo
        noise : standard deviation of the patches' noise, in units of s
        """
        shares = self._shares
        component, cost = self._kernels.device.ranks.together(lambda: self._of_rank(u, noise))
        if shares.owner is not None:
            found = component.get()
            flat = found.reshape(-1)
            flat[self._patch] = shares.gathered(flat[shares.taken(self._patch)])
            component.set(found)
        self._guess = component
        return component, float(np.sum(shares.gathered(cost.get()[: len(shares)]), dtype=np.float64))

    def _of_rank(self, u: DeviceArray, noise: float) -> tuple[DeviceArray, DeviceArray]:
        """Components and costs of this rank's patches."""
        self._halo.spread(u)
        components, count = self.components(noise), len(self._shares)
        # The last components are a good guess, which does not change the result.
        component = self._guess.copy()
        cost = self._kernels.device.empty(max(count, 1), np.float32)
        self._kernels.launch(
            "choose_components", count, patch_count=count, centre=self._centre, shape=self._shape,
            halo=self._halo.shape, values=self._halo.values, component_count=len(self._mixture),
            whitening=components.whitening, white_means=components.white_means, constants=components.constants,
            component=component, cost=cost,
        )  # fmt: skip
        return component, cost
