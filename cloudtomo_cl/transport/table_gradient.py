"""The gradient of a cost by the radiance table, with the cameras' paths as the adjoint."""

from __future__ import annotations

from functools import partial

import numpy as np

from cloudtomo_cl.opencl.arrays import DeviceArray
from cloudtomo_cl.transport.directions import FEATURES
from cloudtomo_cl.transport.gradient import deposited
from cloudtomo_cl.transport.radiance import RadianceOperator
from cloudtomo_cl.transport.radiance_table import RadianceTable
from cloudtomo_cl.transport.rendering import Rendering
from cloudtomo_cl.transport.table_builder import RadianceTableBuilder

# Of a pixel's paths, for each ray along which the derivatives of first flights are made.
_PATHS_PER_RAY = 4


def rays(rendering: Rendering) -> int:
    """Of each pixel of a rendering, along which the derivatives of first flights are made: an even number."""
    return max(2, 2 * round(rendering.samples / 2 / _PATHS_PER_RAY))


class TableGradient:
    """Gradients by the radiance table, which is made for each of them and freed after it.

    Parameters
    ----------
    operator : with a mask, whose voxels have a gradient

    Raises
    ------
    DataError : the operator has no mask, or there is not memory enough

    Source: the derivative of the equation of transfer with respect to the extinction is a source
    of (source function - radiance), weighted with the adjoint (Martin, Cairns and Bal 2014, "Adjoint
    methods for adjusting three-dimensional atmosphere and surface properties to fit multi-angle/
    multi-pixel polarimetric measurements"; Levis et al. 2020 drop a part of it); here the adjoint is
    sampled by the cameras' paths, exactly, and the radiance by photons.
    """

    def __init__(self, operator: RadianceOperator) -> None:
        self._operator = operator
        self._builder = RadianceTableBuilder(operator)

    def gradient(
        self, rendering: Rendering, adjoint: np.ndarray, change: DeviceArray | None = None
    ) -> tuple[DeviceArray, np.ndarray]:
        """The gradient of a cost with respect to extinction; as `RadianceOperator.gradient`.

        Parameters
        ----------
        change : of the extinction, km^-1, shape of the grid, on the device; by default none

        Returns
        -------
        gradient : on the device, float32, shape of the grid, cost per km^-1; 0 outside of the mask
        tangent : derivative of each pixel's radiance along the change, W m^-2 sr^-1, shape (pixels,)

        Raises
        ------
        AuditError, TransportError : as `RadianceOperator.gradient`
        DataError, DeviceError : as `RadianceTableBuilder.at`
        """
        operator, samples = self._operator, rendering.samples
        deposit = partial(self._deposit, self._builder.at(rendering), rendering, change)
        gradient, tangent = deposited(operator.scene, operator.device, operator.shares, adjoint, samples, deposit)
        return gradient, operator.shares.gathered(tangent) * operator.scene.sun.irradiance / samples

    def _deposit(
        self,
        table: RadianceTable,
        rendering: Rendering,
        change: DeviceArray | None,
        factors: DeviceArray,
        total: DeviceArray,
    ) -> np.ndarray:
        """Adds what this rank's paths deposit (`deposited`); returns the sums of its pixels' tangents."""
        operator = self._operator
        if change is None:
            change = operator.device.zeros(operator.scene.grid.shape, np.float32)
        arguments = table.arguments | {"adjoint": factors, "change": change, "gradient": total}
        features = (*rendering.path_features, *FEATURES)
        along_paths, along_rays = (
            operator.device.kernel("derivatives", name, features) for name in ("gradient_paths", "gradient_rays")
        )
        tangent, left = np.zeros(len(operator.shares)), rays(rendering)
        weight, pixels = rendering.samples / left, len(tangent)
        for launch in operator.stored_launches(rendering):
            of_paths = operator.device.empty(launch.paths, np.float32)
            launch.run(along_paths, **arguments, path_tangent=of_paths)
            tangent = _added_in_order(tangent, of_paths.get().reshape(-1, pixels))
            of_rays = operator.device.empty(launch.paths, np.float32)
            done = launch.run_rays(along_rays, pixels, left, **arguments, ray_tangent=of_rays, weight=weight)
            tangent = _added_in_order(tangent, of_rays.get()[: done * pixels].reshape(-1, pixels))
            left -= done
        return tangent


def _added_in_order(sums: np.ndarray, paths: np.ndarray) -> np.ndarray:
    """Sums of shape (pixels,) and what paths add, shape (paths, pixels), one after the other.

    So the bits follow neither from how launches are cut nor from which pixels are in them: NumPy would add a single
    column in pairs.
    """
    rows = np.vstack([sums, paths])
    return np.hstack([rows, rows]).sum(axis=0)[: len(sums)] if len(sums) == 1 else rows.sum(axis=0)
