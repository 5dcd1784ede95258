"""The data term of a linear model on a device: weighted residuals without the calibration's part, and damping."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np

from cloudtomo_cl.inversion.calibration import Calibration
from cloudtomo_cl.inversion.vectors import MINIMISE_FEATURES, Vectors
from cloudtomo_cl.opencl.arrays import DeviceArray
from cloudtomo_cl.opencl.device import Device
from cloudtomo_cl.opencl.gathering import Gathering
from cloudtomo_cl.parallel.ranks import Shares
from cloudtomo_cl.transport.jacobian import Jacobian

# Number of a view's pixels in each partial sum.
_PIXELS_OF_PART = 64


class ResidualWeights:
    """Weighted residuals without what the views' gains and motions explain, W C r, on a device.

    Parameters
    ----------
    weights : weights W of the squared residuals, shape (pixels,)
    calibration : calibration C of the views
    image : image that gains multiply, shape (pixels,)
    device : device that computes

    Attributes
    ----------
    device : device that computes
    """

    def __init__(self, weights: np.ndarray, calibration: Calibration, image: np.ndarray, device: Device) -> None:
        self.device, self._pixels = device, len(weights)
        self._weights = device.array(weights.astype(np.float32))
        basis, matrix = calibration.explained(image)
        self._basis_count = basis.shape[1]
        self._view = device.constant(calibration.view.astype(np.uint32))
        self._basis = device.constant(basis.astype(np.float32))
        self._weighted = device.constant((weights[:, None] * basis).astype(np.float32))
        self._matrix = device.constant(matrix.astype(np.float32))
        self._views = len(matrix) // self._basis_count if self._basis_count else 0
        self._fitted = device.zeros(max(len(matrix), 1), np.float32)
        # Each view's pixels in parts, whose sums are added in their order: the same bits on every device.
        order = np.argsort(calibration.view, kind="stable")
        sizes = np.bincount(calibration.view, minlength=self._views)
        parts = -(-sizes // _PIXELS_OF_PART)
        starts = [np.arange(count) * _PIXELS_OF_PART + first for count, first in zip(parts, np.cumsum(sizes) - sizes)]
        self._parts = int(parts.sum())
        self._part_start = device.constant(np.concatenate([*starts, [len(order)]]).astype(np.uint32))
        self._first_part = device.constant(np.concatenate([[0], np.cumsum(parts)]).astype(np.uint32))
        self._order = device.constant(order.astype(np.uint32))
        self._sums = device.zeros(max(self._parts * self._basis_count, 1), np.float32)

    def weigh(self, residual: DeviceArray, result: DeviceArray) -> None:
        """Writes W C times a residual into `result`; both have the shape (pixels,)."""
        if self._basis_count:
            self._launch(
                "sum_basis", self._parts * self._basis_count, part_count=self._parts, part_start=self._part_start,
                pixels=self._order, weighted_basis=self._weighted, residual=residual, sums=self._sums,
            )  # fmt: skip
            self._launch(
                "fit_views", self._views * self._basis_count, view_count=self._views, first_part=self._first_part,
                sums=self._sums, matrix=self._matrix, fitted=self._fitted,
            )  # fmt: skip
        self._launch(
            "weigh_residual", self._pixels, pixel_count=self._pixels, view=self._view, basis=self._basis,
            fitted=self._fitted, weights=self._weights, residual=residual, result=result,
        )  # fmt: skip

    def _launch(self, name: str, work_items: int, **arguments: Any) -> None:
        kernel = self.device.kernel("minimise", name, MINIMISE_FEATURES)
        self.device.launch(kernel, work_items, basis_count=self._basis_count, **arguments)


class DataTerm:
    """1/2 r^T W C r + 1/2 (x - start)^T D (x - start), r = residual + J (x - start); see `Term`.

    Parameters
    ----------
    jacobian : Jacobian J of the images, shape (pixels, voxels)
    residual_weights : weights W C of the residual
    residual : modelled minus measured image at the start, shape (pixels,)
    start : extinction around which images are linear, km^-1, shape (voxels,)
    damping : diagonal of D, shape (voxels,)
    """

    quadratic: ClassVar[bool] = True
    repeatable: ClassVar[bool] = True

    def __init__(
        self,
        jacobian: Jacobian,
        residual_weights: ResidualWeights,
        residual: np.ndarray,
        start: np.ndarray,
        damping: np.ndarray,
    ) -> None:
        self._jacobian, self._residual_weights, device = jacobian, residual_weights, residual_weights.device
        self._vectors, self._pixels = Vectors(device, len(start)), Vectors(device, len(residual))
        self._residual, self._start = self._pixels.of(residual), self._vectors.of(start)
        self._damping = self._vectors.of(damping)
        self._change, self._transposed = self._vectors.zeros(), self._vectors.zeros()
        self._image, self._weighed = self._pixels.zeros(), self._pixels.zeros()

    @property
    def shares(self) -> Shares | None:
        """See `Term`."""
        return self._jacobian.voxel_shares

    def gradient(self, x: np.ndarray) -> np.ndarray:
        """The gradient at x, shape (voxels,), float64, on the host."""
        gradient = self._vectors.zeros()
        self.add_gradient(self._vectors.of(x), gradient)
        Gathering(self._residual_weights.device, self.shares).complete(gradient)
        return gradient.get().astype(float)

    def add_gradient(self, x: DeviceArray, result: DeviceArray) -> None:
        self._vectors.launch("find_change", x=x, start=self._start, result=self._change)
        self._jacobian.times(self._change, self._image)
        self._pixels.add(1.0, self._residual, self._image)
        self._add(self._change, result)

    def add_product(self, x: DeviceArray, result: DeviceArray) -> None:
        self._jacobian.times(x, self._image)
        self._add(x, result)

    def _add(self, change: DeviceArray, result: DeviceArray) -> None:
        """Adds J^T W C times `self._image`, and D times a change of the extinction."""
        self._residual_weights.weigh(self._image, self._weighed)
        self._jacobian.transposed(self._weighed, self._transposed)
        self._vectors.launch(
            "add_damped", transposed=self._transposed, damping=self._damping, change=change, result=result
        )
