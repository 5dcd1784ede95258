"""The structs and arrays that host and kernels share: one description serves both sides."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from cloudtomo_cl.opencl.parameters import macros
from cloudtomo_cl.scene.grid import Grid
from cloudtomo_cl.scene.phase import DoubleHenyeyGreenstein, TabulatedPhaseFunction
from cloudtomo_cl.scene.scene import Scene
from cloudtomo_cl.scene.sensors import RayView, View

STRUCTS: dict[str, np.dtype] = {
    "Scene": np.dtype(
        [
            ("shape", np.int32, 3),  # voxels along x, y, z
            ("periodic", np.int32),  # whether the domain repeats itself horizontally
            ("spacing", np.float32, 3),  # km
            ("base_height", np.float32),  # height of the domain's bottom above the ground, km
            ("sun", np.float32, 3),  # unit vector towards the sun
            ("forward_g", np.float32),  # the droplets' double Henyey-Greenstein phase function
            ("backward_g", np.float32),
            ("forward_fraction", np.float32),
            ("wide_g", np.float32),  # asymmetry after two scatterings by droplets
            ("table_rows", np.int32),  # rows of the droplets' phase table; 0: there is no table
            ("table_nodes", np.int32),  # angles of the phase table
            ("air_layers", np.int32),  # number of layers from the ground to the atmosphere's top
            ("air_layers_below", np.int32),  # number of layers below the grid
            ("droplet_albedo", np.float32),  # single-scattering albedo, without a table
            ("air_albedo", np.float32),  # single-scattering albedo of molecules
            ("surface_albedo", np.float32),
            ("side_flights", np.int32),  # whether there are side flights; 0: the plain local estimate
            ("truncation", np.float32),  # largest local estimate, sr^-1
            ("skips_empty", np.int32),  # whether walks skip blocks that hold nothing
            ("empty_shift", np.int32),  # such blocks have 2^empty_shift voxels along each axis
        ]
    ),
    "View": np.dtype(
        [
            ("origin", np.float32, 9),  # at (u, v) = (0, 0), per u, per v; km from the domain's lower corner
            ("direction", np.float32, 9),  # at (u, v) = (0, 0), per u, per v
            ("width", np.int32),  # pixels
            ("height", np.int32),
            ("first_ray", np.int32),  # index of the first ray in the array of rays; -1: the view is affine
        ]
    ),
    "VirtualCollision": np.dtype(
        [
            ("position", np.float32, 3),  # voxel units
            ("direction", np.float32, 3),  # unit vector
            ("voxel", np.int32, 3),
            ("throughput", np.float32),  # throughput of the path on this flight
            ("share", np.float32),  # share of this flight in the local estimate where it ends
            ("event", np.uint32),  # number of the flight
            ("aside", np.int32),  # whether it is a side flight
            ("path", np.uint32),  # number of the path in its launch
            ("of", np.uint32),  # virtual collisions that the path met; this one stands for all of them
        ]
    ),
    "Tile": np.dtype(  # voxels near a pixel's line of sight: near_field.h
        [
            ("axis", np.int32),  # axis along which the line of sight crosses most voxels
            ("first_slab", np.int32),  # index of the first slab, a layer of voxels across that axis
            ("slabs", np.int32),  # number of slabs
            ("centre", np.float32, 2),  # position of the line in slab 0 along the next two axes, voxels
            ("slope", np.float32, 2),  # change of that position from slab to slab, voxels
        ]
    ),
    "PixelSums": np.dtype(
        [
            ("half_sum", np.float32, 2),  # sums of the radiances of even and of odd samples, sr^-1
            ("half_low", np.float32, 2),  # rest of these sums that rounding cut off (compensated summation)
            ("square_sum", np.float32),  # sum of the squared radiances of all samples, sr^-2
            ("square_low", np.float32),  # rest of it
        ]
    ),
    "Minimisation": np.dtype(  # state of a minimisation: minimise.cl
        [
            ("length", np.float32),  # length of the next step, in units of its direction
            ("conjugation", np.float32),  # factor of the last change in the next direction
            ("curvature", np.float32),  # second derivative along the last change
            ("taken", np.float32),  # factor with which the last change was taken; 0: not at all
            ("gained", np.float32),  # decrease of the function in all steps
            ("steps", np.int32),  # number of steps taken
            ("poor", np.int32),  # number of last steps in a row that gained little
            ("ended", np.int32),  # whether the minimisation has ended
        ]
    ),
}

# How the weight of paths ends (walk/budget.h): what stands before LAUNCHED sums up to it, the weight of all paths.
# KILLED_VARIANCE and TRUNCATED (radiance, sr^-1) are no part of this balance.
TERMINATIONS = (
    "TOP", "BOTTOM", "SIDES", "MISSED", "ABSORBED", "SURFACE", "KILLED", "LOST",
    "LAUNCHED", "KILLED_VARIANCE", "TRUNCATED",
)  # fmt: skip
# Weights that photons add up in each column of the grid (flux.cl).
FLUXES = ("REFLECTED", "DIRECT", "DIFFUSE", "ABSORBED")
# Units of the fixed-point sums of a weight of 1, and number of copies of the energy budget (walk/budget.h).
WEIGHT_UNIT = 2.0**24
BUDGET_COPIES = 64
# Largest number of branches of a path (walk/branches.h).
MOST_BRANCHES = 4
TABLE_UNIT = 2.0**30
# Units of the fixed-point sums of derivatives per sr^-1 km: rounding is far below the deposits that matter (about
# 1e-6), and a sum of them may reach 2^30 before it overflows.
DERIVATIVE_UNIT = 2.0**32
# Width of a pixel's tile across its line of sight, voxels: near_field.h.
TILE_WIDTH = 5
# Largest number of paths of a pixel: kernels number them with unsigned integers of 32 bits.
MOST_SAMPLES = 2**32 - 1
# Sums in fixed point that leave this range on either side have overflowed: fixed_point.py.
LARGEST_SUM = 2**62


def _constants() -> str:
    """The names that both sides share, in OpenCL C."""
    lines = [
        f"typedef enum {{ {', '.join(f'{kind.upper()}_{name}' for name in names)} }} {kind};"
        for kind, names in (("Termination", TERMINATIONS), ("Flux", FLUXES))
    ]
    lines.append(f"#define TERMINATIONS {len(TERMINATIONS)}")
    lines.append(f"#define WEIGHT_UNIT {WEIGHT_UNIT:.1f}f")
    lines.append(f"#define BUDGET_COPIES {BUDGET_COPIES}")
    lines.append(f"#define MOST_BRANCHES {MOST_BRANCHES}u")
    lines.append(f"#define TABLE_UNIT {TABLE_UNIT:.1f}f")
    lines.append(f"#define DERIVATIVE_UNIT {DERIVATIVE_UNIT:.1f}f")
    lines.append(f"#define TILE_WIDTH {TILE_WIDTH}")
    lines.append(f"#define LARGEST_SUM {LARGEST_SUM}ul")
    return "\n".join(lines)


def declarations(device: Any) -> str:
    """OpenCL C declarations of all that both sides share; the structs' layout is checked against the device's."""
    from pyopencl.tools import get_or_register_dtype, match_dtype_to_c_struct

    parts = [_constants()]
    for name, dtype in STRUCTS.items():
        matched, declaration = match_dtype_to_c_struct(device, name, dtype)
        get_or_register_dtype(name, matched)
        if matched != dtype:
            raise AssertionError(f"struct {name}: the device pads it to {matched}")
        parts.append(declaration)
    parts.append(macros())
    return "\n".join(parts)


def scene_struct(
    scene: Scene,
    side_flights: bool = False,
    truncation: float = np.inf,
    skips_empty: bool = False,
    empty_shift: int = 0,
) -> np.ndarray:
    """The kernels' Scene, shape (); truncation in sr^-1."""
    struct = np.zeros((), STRUCTS["Scene"])
    struct["shape"] = scene.grid.shape
    struct["periodic"] = scene.boundary.horizontal == "periodic"
    struct["spacing"] = scene.grid.spacing
    struct["base_height"] = scene.grid.origin[2]
    struct["sun"] = scene.sun.direction
    phase = scene.cloud.phase_function
    if isinstance(phase, TabulatedPhaseFunction):
        struct["table_rows"], struct["table_nodes"] = len(phase.values), len(phase.angle)
    elif isinstance(phase, DoubleHenyeyGreenstein):
        struct["forward_g"], struct["backward_g"] = phase.forward_g, phase.backward_g
        struct["forward_fraction"] = phase.forward_fraction
    else:
        struct["forward_g"], struct["forward_fraction"] = phase.g, 1.0
    struct["wide_g"] = phase.g**2
    levels, _ = scene.air_layers()
    struct["air_layers"] = len(levels) - 1
    struct["air_layers_below"] = scene.air_layers_below()
    struct["droplet_albedo"] = scene.cloud.single_scattering_albedo
    struct["air_albedo"] = scene.air.single_scattering_albedo if scene.air else 1.0
    struct["surface_albedo"] = scene.surface.albedo
    struct["side_flights"] = side_flights
    struct["truncation"] = truncation
    struct["skips_empty"] = skips_empty
    struct["empty_shift"] = empty_shift
    return struct


def view_structs(views: Sequence[View], grid: Grid, top: float | None = None) -> np.ndarray:
    """The kernels' View of every view, shape (views,); `top` as in `AffineView.rays`."""
    structs = np.zeros(len(views), STRUCTS["View"])
    rays = 0
    for struct, view in zip(structs, views):
        struct["width"], struct["height"] = view.pixels
        if isinstance(view, RayView):
            struct["first_ray"] = rays
            rays += len(view.origins)
            continue
        origin, direction = view.rays(grid, top)
        origin = origin.copy()
        origin[0] -= grid.origin
        struct["origin"] = origin.ravel()
        struct["direction"] = direction.ravel()
        struct["first_ray"] = -1
    return structs


def sun_view_struct(scene: Scene, box: tuple[np.ndarray, np.ndarray] | None = None) -> tuple[np.ndarray, float]:
    """The sun's view of the domain, whose rays photons start along: a View, and its horizontal area, km^2.

    It is the top of the domain (or of the atmosphere), a pixel for each column; with open sides
    wider by what of the sides the sun can see.

    box : lower and upper corner, shape (3,), km from the domain's lower corner, of the part of an open domain that
        photons are to meet; by default all of it
    """
    grid, to_sun = scene.grid, scene.sun.direction
    lower, upper = np.zeros(3), np.array(grid.extent)
    top = scene.top - grid.origin[2]
    if scene.boundary.horizontal == "open":
        if box is not None:
            (lower, upper), top = box, box[1][2]
        shift = (upper[2] - lower[2]) * to_sun[:2] / to_sun[2]
        lower, upper = np.minimum(lower[:2], lower[:2] + shift), np.maximum(upper[:2], upper[:2] + shift)
    columns = np.ceil((upper - lower)[:2] / grid.spacing[:2] - 1e-9).astype(int)
    struct = np.zeros((), STRUCTS["View"])
    struct["origin"] = [*lower[:2], top, upper[0] - lower[0], 0, 0, 0, upper[1] - lower[1], 0]
    struct["direction"][:3] = -to_sun
    struct["width"], struct["height"] = columns
    struct["first_ray"] = -1
    return struct, float(np.prod((upper - lower)[:2]))


def ray_array(views: Sequence[View], scene: Scene) -> np.ndarray:
    """The rays of all views that are lists of rays, one after the other.

    Returns an array (rays, 6), float32: origins in km from the domain's lower corner,
    directions. It has one ray that nobody looks at if there is no such view.
    """
    arrays = [
        np.hstack([view.starts(scene) - scene.grid.origin, view.directions])
        for view in views
        if isinstance(view, RayView)
    ]
    return np.concatenate(arrays or [np.zeros((1, 6))]).astype(np.float32)


def places(voxels: np.ndarray) -> np.ndarray:
    """Voxels (x, y, z), shape (voxels, 3), as kernels take them: uint16, with a fourth number, 0."""
    found = np.zeros((len(voxels), 4), np.uint16)
    found[:, :3] = voxels
    return found
