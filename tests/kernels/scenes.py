"""Small scenes in which paths of the kernels are compared with others."""

import numpy as np

from cloudtomo_cl.reference import paths as reference
from cloudtomo_cl.scene.grid import Grid
from cloudtomo_cl.scene.phase import DoubleHenyeyGreenstein, HenyeyGreenstein, TabulatedPhaseFunction
from cloudtomo_cl.scene.scene import Air, Boundary, Cloud, Scene, Sun, Surface
from cloudtomo_cl.scene.sensors import OrthographicView, PerspectiveView, PushBroomView, RadiometerView, RayView

GRID = Grid(shape=(3, 4, 3), spacing=(0.1, 0.08, 0.12), origin=(0.5, -0.2, 0.2))
PERIODIC = Boundary(horizontal="periodic")

ABOVE = OrthographicView(width=0.45, pixels=(3, 3), zenith=25, azimuth=200)
CAMERA = PerspectiveView((0.6, -0.6, 1.0), (0.65, -0.05, 0.3), 35.0, (3, 3))
SCANNER = PushBroomView((0.5, -0.3, 0.9), (0.8, 0.2, 0.9), 40.0, (2, 2), along_track_angle=15.0)
RADIOMETER = RadiometerView(zenith=50, azimuth=160, pixels=(2, 2))
RADIOMETER_BELOW = RadiometerView(zenith=150, azimuth=70, pixels=(2, 2))
# From above and beside, from far away, from the ground, from inside; two pass the domain by.
RAYS = RayView(
    origins=[
        (0.6, -0.1, 0.9), (0.0, -0.1, 0.3), (70.6, 50, 90), (0.63, -0.07, 0.0), (0.62, -0.05, 0.41), (0.72, -0.6, 0.3),
        (0.67, -0.18, 0.2), (0.55, 300, 0.35), (9, 9, 40),
    ],
    directions=[
        (0.1, 0.2, -1), (1, 0.05, 0.03), (-70, -50.1, -89.6), (0.1, 0.1, 1), (-0.3, 0.2, -0.1), (-0.1, 1, 0.05),
        (0.05, 1, 0.6), (0.0003, -300, -0.03), (0.2, 0.1, -1),
    ],
    pixels=(3, 3),
)  # fmt: skip


# Three radii: peaks that grow sharper, a bump near 140 degrees. Single precision holds its angles.
ANGLES = (0.0, 1.0, 2.0, 4.0, 7.0, 11.0, 20.0, 40.0, 70.0, 100.0, 130.0, 140.0, 150.0, 180.0)
TABLE = TabulatedPhaseFunction.normalised(
    ANGLES,
    [
        width * np.exp(-np.array(ANGLES) / 3 * width) + np.exp(-np.array(ANGLES) / 25)
        + 0.02 * (1 + np.exp(-(((np.array(ANGLES) - 140) / 10) ** 2)))
        for width in (1.0, 2.0, 4.0)
    ],
    effective_radius=(5.0, 10.0, 20.0),
    single_scattering_albedo=(1.0, 0.95, 0.9),
)  # fmt: skip
# Below, beside and above the grid, with a gap that holds none.
OUTSIDE_AIR = Air((3.0, 0.5, 1.0, 0.0, 0.4), 0.7, levels=(0.0, 0.1, 0.3, 0.7, 0.9, 1.4))


def optics(g, albedo=1.0):
    return Cloud(single_scattering_albedo=albedo, phase_function=HenyeyGreenstein(g=g))


SCENES = {
    "isotropic, overhead sun": Scene(GRID, Sun(zenith=0), optics(0.0)),
    "forward peak": Scene(GRID, Sun(zenith=0), optics(0.85)),
    "backward, oblique sun": Scene(GRID, Sun(zenith=60, azimuth=130), optics(-0.4)),
    "absorbing": Scene(GRID, Sun(zenith=30, azimuth=10), optics(0.85, 0.8)),
    "air": Scene(GRID, Sun(zenith=45, azimuth=250), optics(0.85), Air((2.0, 1.0, 0.0), 0.9)),
    "ground": Scene(GRID, Sun(zenith=20, azimuth=45), optics(0.85), surface=Surface(0.6)),
    "periodic": Scene(GRID, Sun(zenith=70, azimuth=30), optics(0.85), boundary=PERIODIC),
    "air, ground, periodic": Scene(
        GRID, Sun(zenith=60, azimuth=300), optics(0.85, 0.85), Air(0.7), Surface(0.3), PERIODIC
    ),
}
SCENES |= {
    "double Henyey-Greenstein": Scene(
        GRID, Sun(zenith=40, azimuth=100), Cloud(0.95, DoubleHenyeyGreenstein(0.9, -0.5, 0.8)), surface=Surface(0.2)
    ),
    "phase table": Scene(GRID, Sun(zenith=40, azimuth=100), Cloud(phase_function=TABLE, effective_radius=8.0)),
    "air outside, open": Scene(GRID, Sun(zenith=45, azimuth=20), optics(0.85), OUTSIDE_AIR, Surface(0.3)),
    "air outside, periodic": Scene(
        GRID, Sun(zenith=65, azimuth=200), optics(0.7, 0.7), OUTSIDE_AIR, Surface(0.3), PERIODIC
    ),
}
ESTIMATORS = ["plain", "side-flights", "branches"]


def extinction_of(scene, seed=3):
    """Random, km^-1, a third of the voxels empty; values that single precision holds."""
    random = np.random.default_rng(seed)
    values = random.uniform(2, 20, scene.grid.shape) * (random.random(scene.grid.shape) > 0.33)
    return values.astype(np.float32).astype(float)


def reference_paths(scene, extinction, operator, samples, seed, iteration, **options):
    """Contributions of every path by the reference: a list of samples, of lists of pixels.

    options : effective_radius, truncation; those of the operator
    """
    return [
        [
            reference.path(
                scene, extinction, operator.views[view], seed, iteration, view, pixel, sample,
                operator.estimator != "plain", with_branches=operator.estimator == "branches", **options,
            )
            for view, pixel in operator.pixels.astype(int)
        ]
        for sample in range(samples)
    ]  # fmt: skip


def radiances(paths):
    """Sums of the contributions, in the same order."""
    return np.array([[sum(c.radiance for c in contributions) for contributions in row] for row in paths])


def kernel_paths(rendering):
    """Radiance of every path of a rendering that kept them, shape (samples, pixels)."""
    paths = np.concatenate([paths.get()[0] for _, paths in rendering._launches])
    return paths.reshape(rendering.samples, -1).astype(float)
