"""The same scenes in Mitsuba 3 (Jakob et al. 2022), the nearest differentiable renderer of volumes."""

from __future__ import annotations

import os
from glob import glob
from typing import Any

import numpy as np

from benchmarks.scenes import Case
from cloudtomo_cl.scene.sensors import image_axes, line_of_sight

_LIBRARIES = "/usr/lib/*/libLLVM.so.19*", "/usr/lib/llvm-19/lib/libLLVM.so*", "/usr/lib/*/libLLVM*"
VARIANT = "llvm_ad_mono"
# km: Mitsuba starts rays up to 3e-4 (1 + their coordinates) beside a surface, and takes a ground within that of the
# cloud's box for hit from inside.
_GROUND_BELOW = 5e-3


class Missing(Exception):
    """The peer is not installed, or does not run here."""


def load() -> Any:
    """The module, with its variant chosen. Raises Missing."""
    libraries = [path for pattern in _LIBRARIES for path in sorted(glob(pattern))]
    if libraries:
        os.environ.setdefault("DRJIT_LIBLLVM_PATH", libraries[0])
    try:
        import mitsuba
    except ImportError:
        raise Missing("mitsuba is not installed: pip install '.[bench]', and Debian's libllvm19") from None
    try:
        mitsuba.set_variant(VARIANT)
        mitsuba.Float(1.0) + 1.0
    except Exception as error:
        raise Missing(f"mitsuba's {VARIANT} does not run ({str(error).splitlines()[0]}): DRJIT_LIBLLVM_PATH") from None
    return mitsuba


class MitsubaScene:
    """A case as Mitsuba sees it: nearest voxel, no cap on the number of scatterings.

    The ground lies at z = 0 or, where that is too close to the grid, 5 m below it. The camera stands outside of the
    grid.
    """

    def __init__(self, case: Case) -> None:
        self.mitsuba = mi = load()
        import drjit

        self.drjit = drjit
        self.view, self.count = case.view, case.view.pixels[0] * case.view.pixels[1]
        extent = [float(edge) for edge in case.scene.grid.extent]
        origin = [float(corner) for corner in case.scene.grid.origin]
        transform = mi.ScalarTransform4f().translate(origin)
        self.key = "cloud.interior_medium.sigma_t.data"
        data = np.ascontiguousarray(case.extinction.transpose(2, 1, 0)[..., None])
        volume = {
            "type": "gridvolume", "grid": mi.VolumeGrid(data), "filter_type": "nearest", "accel": False,
            "to_world": transform.scale(extent),
        }  # fmt: skip
        phase = {"type": "hg", "g": case.scene.cloud.phase_function.g}
        medium = {
            "type": "heterogeneous", "sigma_t": volume, "phase": phase,
            "albedo": case.scene.cloud.single_scattering_albedo,
        }  # fmt: skip
        film = {
            "type": "hdrfilm", "width": case.view.pixels[0], "height": case.view.pixels[1],
            "pixel_format": "luminance", "component_format": "float32", "rfilter": {"type": "box"},
        }  # fmt: skip
        _, up = image_axes(line_of_sight(case.view.position, case.view.target), case.view.up)
        look = mi.ScalarTransform4f().look_at(
            origin=list(case.view.position), target=list(case.view.target), up=[float(x) for x in up]
        )
        description = {
            "type": "scene",
            "sensor": {
                "type": "perspective", "fov": case.view.field_of_view, "fov_axis": "x", "to_world": look,
                "near_clip": 1e-3, "far_clip": 1e3, "film": film, "sampler": {"type": "independent"},
            },
            "cloud": {
                "type": "cube", "bsdf": {"type": "null"}, "interior": medium,
                "to_world": transform.scale([edge / 2 for edge in extent]).translate([1, 1, 1]),
            },
            "sun": {
                "type": "directional", "direction": [-float(x) for x in case.scene.sun.direction],
                "irradiance": case.scene.sun.irradiance,
            },
        }  # fmt: skip
        ground = min(0.0, origin[2] - _GROUND_BELOW)
        if case.scene.surface.albedo > 0:
            description["ground"] = {
                "type": "rectangle",
                "to_world": mi.ScalarTransform4f().translate([0, 0, ground]).scale([1000, 1000, 1]),
                "bsdf": {"type": "diffuse", "reflectance": case.scene.surface.albedo},
            }  # fmt: skip
        self.scene = mi.load_dict(description)
        # -1: as many scatterings as there are; its roulette as it comes.
        path = {"type": "volpath", "max_depth": -1, "hide_emitters": True}
        self.forward = mi.load_dict(path)
        self.moments = mi.load_dict({"type": "moment", "nested": path})
        self.adjoint = mi.load_dict({"type": "prbvolpath", "max_depth": -1, "hide_emitters": True})
        self.parameters = mi.traverse(self.scene)

    def render(self, samples: int, seed: int) -> np.ndarray:
        """Radiances, shape (rows, columns)."""
        image = self.mitsuba.render(self.scene, integrator=self.forward, spp=samples, seed=seed)
        return np.array(image)[..., 0]

    def sample_variance(self, samples: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
        """Mean and variance of single paths, shape (rows, columns) each."""
        image = np.array(self.mitsuba.render(self.scene, integrator=self.moments, spp=samples, seed=seed))
        # The film's own luminance, that of the nested integrator thrice, and its squares thrice.
        mean, square = image[..., 1].astype(float), image[..., 4].astype(float)
        return mean, np.maximum(square - mean**2, 0.0)

    def gradient(self, samples: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
        """An image, and the derivative of its mean with respect to the extinction, shape of the grid."""
        mi, dr = self.mitsuba, self.drjit
        data = self.parameters[self.key]
        dr.enable_grad(data)
        self.parameters[self.key] = data
        self.parameters.update()
        image = mi.render(
            self.scene, self.parameters, integrator=self.adjoint, spp=samples, seed=2 * seed, seed_grad=2 * seed + 1
        )
        dr.backward(dr.sum(image, axis=None) / self.count)
        gradient = np.array(dr.grad(data))[..., 0].transpose(2, 1, 0)
        dr.disable_grad(data)
        return np.array(image)[..., 0], gradient
