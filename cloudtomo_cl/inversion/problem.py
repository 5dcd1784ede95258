"""The inverse problem: from images to the extinction of the voxels that may hold cloud."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from cloudtomo_cl.arguments import NUMBER, WHOLE, a, require_kinds, several
from cloudtomo_cl.blas import with_one_blas_thread
from cloudtomo_cl.errors import DataError
from cloudtomo_cl.inversion.bound_priors import stage_prior
from cloudtomo_cl.inversion.brightness import brightness_text
from cloudtomo_cl.inversion.carving import carved_mask
from cloudtomo_cl.inversion.noise_units import NoiseUnits
from cloudtomo_cl.inversion.objective import AveragedImage
from cloudtomo_cl.inversion.pixels import ActivePixels, active_pixels
from cloudtomo_cl.inversion.priors import PRIOR, AnyPrior, PatchPrior, Regulariser
from cloudtomo_cl.inversion.stage_prior import StagePrior
from cloudtomo_cl.inversion.voxels import Voxels
from cloudtomo_cl.opencl.device import Device
from cloudtomo_cl.opencl.devices import choose_device
from cloudtomo_cl.opencl.driver import device_errors
from cloudtomo_cl.scene.arrays import as_numbers
from cloudtomo_cl.scene.grid import Grid, coarsened
from cloudtomo_cl.scene.masks import checked_mask
from cloudtomo_cl.scene.measurements import Measurements, check_wavelength
from cloudtomo_cl.scene.pointing import checked_motions, moved
from cloudtomo_cl.scene.scene import Scene
from cloudtomo_cl.transport.radiance import RadianceOperator
from cloudtomo_cl.transport.table_gradient import TableGradient

if TYPE_CHECKING:
    from cloudtomo_cl.inversion.linear_model import LinearModel

# Paths for derivatives: their number per voxel of the mask, and the least number of all. Voxels beyond VOXELS_PER_PIXEL
# for each pixel do not count.
PATHS_PER_VOXEL = 90
VOXELS_PER_PIXEL = 2
_LEAST_PATHS = 50_000


@dataclass(frozen=True, eq=False)
class Problem:
    """Least squares: find the x >= 0 that minimises 1/2 sum w (image(x) - measured)^2 plus the prior.

    The unknowns x are the extinctions of the mask's voxels, km^-1, in the order of `extinction[mask]`.

    Attributes
    ----------
    voxels : grid and mask of the unknowns
    active : valid pixels that look at these voxels, and what was measured there
    operator : operator that renders and differentiates these pixels
    prior : prior for these voxels
    prior_weight : factor of the prior
    samples : paths per pixel for derivatives; by default the solver's choice
    motions : motions of the views (`scene.pointing`), shape (views, 3), with which solvers that find them start; None:
        all 0
    """

    voxels: Voxels
    active: ActivePixels
    operator: RadianceOperator
    prior: StagePrior
    prior_weight: float = 1.0
    samples: int | None = None
    motions: np.ndarray | None = None

    @classmethod
    def of(
        cls,
        scene: Scene,
        measurements: Measurements,
        *,
        mask: np.ndarray | None = None,
        prior: AnyPrior | Regulariser | None = None,
        grid: Sequence[int] | None = None,
        device: Device | None = None,
        prior_weight: float = 1.0,
        samples: int | None = None,
    ) -> Problem:
        """The problem of a scene and its images.

        Parameters
        ----------
        scene : grid, optics, sun, air, surface, boundary
        measurements : images and views
        mask : voxels that may hold cloud, bool, or 0 and 1, on the scene's grid; by default by carving (`carve`)
        prior : a `PatchPrior` (the default), a `Prior`, or a user's object, see `Regulariser`
        grid : numbers of voxels along x, y, z, on the same domain; by default the scene's
        device : device that computes; by default `choose_device()`
        prior_weight : factor of the prior
        samples : paths per pixel for derivatives, even; by default the solver's choice

        Raises
        ------
        DataError : an array does not fit the scene's grid, scene and images are at different wavelengths, the images
            are far brighter or darker than clouds can be, no voxel may hold cloud, or no pixel sees one
        """
        require_kinds(
            "Problem.of",
            scene=(scene, a(Scene)),
            measurements=(measurements, a(Measurements)),
            prior=(prior, PRIOR.or_none()),
            grid=(grid, several(3, WHOLE).or_none()),
            device=(device, a(Device).or_none()),
            prior_weight=(prior_weight, NUMBER),
        )
        check_wavelength(scene, measurements)
        brightness_text(scene, measurements)  # which refuses what no cloud can be
        device = device or choose_device()
        if mask is None:
            mask = carved_mask(scene, measurements, device)
        mask = checked_mask(mask, scene.grid)
        shape = scene.grid.shape if grid is None else tuple(grid)
        coarse = replace(scene, grid=scene.grid.with_shape(shape))
        voxels = Voxels(coarse.grid, coarsened(mask, shape))
        active = active_pixels(measurements, coarse.grid, voxels.mask)
        operator = RadianceOperator(coarse, active.views, device, active.listed, mask=voxels.mask)
        prior = PatchPrior() if prior is None else prior
        return cls(voxels, active, operator, stage_prior(prior, voxels, device), prior_weight, samples)

    def __repr__(self) -> str:
        return f"Problem({len(self.active)} pixels, {len(self.voxels)} voxels of {self.grid.text})"

    @property
    def grid(self) -> Grid:
        """The grid that the unknowns lie on."""
        return self.voxels.grid

    @property
    def mask(self) -> np.ndarray:
        """Which voxels may hold cloud: bool, shape of the grid."""
        return self.voxels.mask

    @property
    def pixels(self) -> np.ndarray:
        """(view, row * width + column) of the active pixels, shape (pixels, 2)."""
        return self.active.listed

    @property
    def radiance(self) -> np.ndarray:
        """Measured radiances, W m^-2 sr^-1, shape (pixels,)."""
        return self.active.radiance

    @property
    def weights(self) -> np.ndarray:
        """Weights w of the squared residuals, shape (pixels,)."""
        return self.active.weights

    @property
    def default_samples(self) -> int:
        """Default number of paths per pixel for derivatives."""
        voxels = min(len(self.voxels), VOXELS_PER_PIXEL * len(self.active))
        return max(2, 2 * round(max(PATHS_PER_VOXEL * voxels, _LEAST_PATHS) / len(self.active) / 2))

    def with_motions(self, motions: np.ndarray) -> Problem:
        """The same problem with the views after small motions (`scene.pointing`), shape (views, 3)."""
        motions = checked_motions(motions, len(self.active.views))
        if not np.any(motions):
            return self
        views = [moved(view, motion, self.grid) for view, motion in zip(self.active.views, motions)]
        return replace(self, operator=self.operator.of_views(views))

    def on_grid(self, x: np.ndarray) -> np.ndarray:
        """Extinctions of the voxels on the grid, km^-1, float32; 0 outside of the mask."""
        return self.voxels.on_grid(x)

    def linearise(self, x: np.ndarray, *, samples: int | None = None, seed: int = 0, stream: int = 1) -> LinearModel:
        """Images and their derivatives at an extinction.

        Parameters
        ----------
        x : extinction of the mask's voxels, km^-1, shape (voxels,)
        samples : paths per pixel, even; by default `default_samples`
        seed, stream : seed and stream of the random numbers; the same ones give the same model

        Raises
        ------
        DataError : x has another shape, or is negative or not finite; there is not enough memory
        TransportError, AuditError : the device computes wrongly
        """
        from cloudtomo_cl.inversion.linear_model import LinearModel
        from cloudtomo_cl.transport.jacobian_average import JacobianAverage

        x = self.checked(x)
        operator, grid = self.operator.without_branches(), self.on_grid(x)
        rendering = operator.render(grid, self.paths_per_pixel(samples), seed, stream, store_paths=True)
        derivatives = JacobianAverage(operator)
        derivatives.add(rendering, 1.0)
        return LinearModel(x.copy(), rendering.mean, rendering.standard_error**2, derivatives.jacobian, rendering)

    @device_errors("the cost and its gradient")
    @with_one_blas_thread
    def value_and_gradient(
        self, x: np.ndarray, *, samples: int | None = None, seed: int = 0, stream: int = 1
    ) -> tuple[float, np.ndarray]:
        """The cost (data term plus prior) and its gradient in km, shape (voxels,), as for `scipy.optimize.minimize`.

        Neither is biased by the images' noise. With the same seed and stream they are functions of x alone.
        Parameters and errors are those of `linearise`.
        """
        x = self.checked(x)
        rendering = self.operator.render(self.on_grid(x), self.paths_per_pixel(samples), seed, stream, store_paths=True)
        image = AveragedImage.empty(len(self.active))
        data = (rendering.halves, self.radiance, self.weights, self.active.calibration)
        value, _ = image.cost(*data)
        gradient, _ = TableGradient(self.operator).gradient(rendering, image.adjoint(*data))
        of_prior, prior_gradient = self.prior.value_and_gradient(x, self.units())
        return value + of_prior, gradient.get()[self.mask].astype(float) + prior_gradient

    def units(self, modelled_noise: float = 0.0) -> NoiseUnits:
        """The factors of the prior.

        modelled_noise : part of the data term that the modelled images' noise adds
        """
        require_kinds("Problem.units", modelled_noise=(modelled_noise, NUMBER))
        measured = self.active.unit
        both = measured + 2 * modelled_noise / len(self.active)
        return NoiseUnits(self.prior_weight * measured, both, self.prior_weight)

    def paths_per_pixel(self, samples: int | None = None) -> int:
        """Paths per pixel for derivatives: those given, or the problem's, or the default; `render` refuses 0."""
        return next(count for count in (samples, self.samples, self.default_samples) if count is not None)

    def checked(self, x: np.ndarray, name: str = "x") -> np.ndarray:
        """Values of the mask's voxels in double precision, shape (voxels,). DataError, by a name, if they are none."""
        x = as_numbers(x, name)
        if x.shape != (len(self.voxels),):
            raise DataError(f"{name} has shape {x.shape}: it must be ({len(self.voxels)},), the voxels of the mask")
        return x
