"""The forward model against numbers that others published, and against exact results.

The cases are data: a scene, what is measured in it, and the number to find. `run` computes
them with photons as many as one likes; docs/measurements/validation.md has the table with many.

Every value is free of the sun's irradiance: fluxes are over the incident one, mu0 F0, and
radiances are reflectance factors, pi L / (mu0 F0).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from cloudtomo_cl.clouds.readers import ReadingOptions, read_cloud
from cloudtomo_cl.files import i3rc
from cloudtomo_cl.opencl.device import Device
from cloudtomo_cl.scene.grid import Grid
from cloudtomo_cl.scene.phase import HenyeyGreenstein
from cloudtomo_cl.scene.scene import Air, Boundary, Cloud, Scene, Sun, Surface
from cloudtomo_cl.scene.sensors import RadiometerView
from cloudtomo_cl.transport.flux import Fluxes, FluxOperator
from cloudtomo_cl.transport.radiance import RadianceOperator

PHOTONS = 1_000_000
QUICK_PHOTONS = 100_000
# A mean passes within this share of the published one or within so many standard errors (the
# published value's own included, where it is known), whichever is larger.
SHARE, STANDARD_ERRORS = 0.003, 3.0
# Columns pass if their r.m.s. difference, over their mean, is below this, or above it by less than
# so many standard errors.
COLUMNS_SHARE = 0.015
# Relative standard error of I3RC's mean radiances. By reciprocity the oblique one of experiment 1
# (sun in the zenith, seen from 60 degrees) is the nadir one of experiment 2; published are 0.40425
# and 0.40607, 0.45 % apart. Half of that is the least that both can be wrong by.
I3RC_RADIANCE_ERROR = 0.002
# Standard errors below this share of a value are single precision's, not the method's.
_ROUNDING = 1e-6
# Fluxes by the name of the quantity: which fields of the flux operator are added.
FLUXES: dict[str, tuple[str, ...]] = {
    "R": ("reflected",),
    "T": ("transmitted",),
    "A": ("absorbed",),
    "T diffuse": ("diffuse",),
    "T direct": ("direct",),
    "R + T + A": ("reflected", "transmitted", "absorbed"),
}


@dataclass(frozen=True)
class Quantity:
    """What is measured in a scene, and the number to find.

    Attributes
    ----------
    name : of a flux (a key of FLUXES), or of what the view sees
    published : mean over the domain
    view : the sensor of a radiance; none for a flux
    consensus : I3RC's name of the quantity's columns, if they are compared too
    published_error : standard error of the published value, where it is known
    block : columns are averaged over block x block of them before they are compared
    """

    name: str
    published: float
    view: RadiometerView | None = None
    consensus: str | None = None
    published_error: float = 0.0
    block: int = 1


@dataclass(frozen=True, eq=False)
class Experiment:
    """A scene with its quantities.

    Attributes
    ----------
    extinction : km^-1, shape of the scene's grid
    source : who says so
    i3rc : case and experiment, if there are consensus files
    effort : photons of the fluxes, relative to the other experiments
    radiance_effort : photons of each radiance, likewise; by default as many as of the fluxes
    """

    name: str
    scene: Scene
    extinction: np.ndarray
    quantities: tuple[Quantity, ...]
    source: str
    i3rc: tuple[int, int] | None = None
    effort: float = 1.0
    radiance_effort: float | None = None


@dataclass(frozen=True)
class Reciprocity:
    """Two experiments of one quantity that must give the same value."""

    name: str
    first: Experiment
    second: Experiment


@dataclass(frozen=True)
class Row:
    """A line of the table.

    Attributes
    ----------
    published, value, standard_error : for columns: 0, the r.m.s. difference over the mean,
        and the standard error of that
    photons : of this value
    columns : compares columns, not means
    published_error : standard error of the published value, 0 where it is not known
    """

    experiment: str
    quantity: str
    source: str
    published: float
    value: float
    standard_error: float
    photons: int
    columns: bool = False
    published_error: float = 0.0

    @property
    def difference(self) -> float:
        """Relative to the published value; of columns the r.m.s. difference itself."""
        if self.columns or self.published == 0:
            return self.value - self.published
        return self.value / self.published - 1

    @property
    def standard_errors(self) -> float:
        """The difference in standard errors; NaN where the value has no noise but rounding."""
        noise = self.standard_error > _ROUNDING * abs(self.value)
        return (self.value - self.published) / self.standard_error if noise else np.nan

    @property
    def passed(self) -> bool:
        """Within the tolerance of SHARE and STANDARD_ERRORS, or of COLUMNS_SHARE."""
        if self.columns:
            return self.value <= COLUMNS_SHARE + STANDARD_ERRORS * self.standard_error
        noise = float(np.hypot(self.standard_error, self.published_error))
        return abs(self.value - self.published) <= max(SHARE * abs(self.published), STANDARD_ERRORS * noise)


# --- scenes -----------------------------------------------------------------------------

PERIODIC = Boundary(horizontal="periodic")
ONE_COLUMN = Grid(shape=(1, 1, 1), spacing=(1.0, 1.0, 1.0))


def map_of_columns(image: np.ndarray) -> np.ndarray:
    """An image of a RadiometerView, [row, column], as a map of columns, [x, y]."""
    return image[::-1].T


def slab(sun_cosine: float, optical_depth: float, g: float, albedo: float) -> tuple[Scene, np.ndarray]:
    """A plane-parallel layer of droplets over a black surface."""
    sun = Sun(zenith=float(np.degrees(np.arccos(sun_cosine))))
    cloud = Cloud(single_scattering_albedo=albedo, phase_function=HenyeyGreenstein(g=g))
    return Scene(ONE_COLUMN, sun, cloud, boundary=PERIODIC), np.full((1, 1, 1), optical_depth)


def rayleigh_slab(sun_cosine: float, optical_depth: float) -> tuple[Scene, np.ndarray]:
    """A plane-parallel layer of molecules over a black surface."""
    sun = Sun(zenith=float(np.degrees(np.arccos(sun_cosine))))
    return Scene(ONE_COLUMN, sun, air=Air(optical_depth), boundary=PERIODIC), np.zeros((1, 1, 1))


# --- published values -------------------------------------------------------------------

I3RC_SOURCE = "I3RC consensus"
VAN_DE_HULST = "van de Hulst 1980"
SWEIGART = "Sweigart 1970"
CHANDRASEKHAR = "Chandrasekhar 1960"

STEP_GRID = Grid(shape=(32, 1, 1), spacing=(0.5 / 32, 0.5, 0.25))
STEP_EXTINCTION = np.repeat([2.0, 18.0], 16).reshape(32, 1, 1) / 0.25
# Experiment, the sun's zenith angle, single-scattering albedo, and the consensus: flux or
# view (I3RC's name), and the domain's mean.
STEP_CLOUD: tuple[tuple[int, float, float, dict[str, float]], ...] = (
    (1, 0.0, 1.0, {"R": 0.32760, "T": 0.67240, "Iu": 0.25640, "I602": 0.40425}),
    (2, 60.0, 1.0, {"R": 0.58044, "T": 0.41956, "Iu": 0.40607, "Id": 0.39303, "I602": 0.56674}),
    (4, 60.0, 0.99, {"R": 0.47654, "T": 0.32490, "A": 0.19858, "Iu": 0.32256, "Id": 0.30941, "I601": 0.88616}),
)
# Columns of 30 m. The tops of the clouds lie at multiples of 1 m; the optical depth of every column
# is kept whatever the height of the layers is, and docs/decisions/landsat-layers.md says how little depends on it.
LANDSAT_SPACING = (0.03, 0.03, 0.1)  # km
LANDSAT = {"R": 0.30449, "T": 0.69553, "Iu": 0.21521}
# The consensus's nadir radiances are noisy column by column: docs/decisions/landsat-blocks.md.
LANDSAT_RADIANCE_BLOCK = 4
# The sun shines from the side of low x: it stands at azimuth 180. I3RC counts azimuths of
# views from the direction in which sunlight travels, so that I601 looks into the forward peak.
# Compared with the columns of every consensus: mirror images do not fit.
I3RC_SUN_AZIMUTH = 180.0
# A consensus that is not among the distributed files.
NO_COLUMNS = {(1, 2, "T")}

# Name, scene, {quantity: value}, source. van de Hulst's tables 12 and 37; fluxes.
SLABS: tuple[tuple[str, tuple[Scene, np.ndarray], dict[str, float], str], ...] = (
    (
        "HG slab, g 0.75, depth 1",
        slab(1.0, 1.0, 0.75, 1.0),
        {"R": 0.07874, "T diffuse": 0.55338, "T direct": 0.36788},
        VAN_DE_HULST,
    ),
    ("HG slab, g 0.75, depth 8", slab(1.0, 8.0, 0.75, 1.0), {"R": 0.50642, "T diffuse": 0.49325}, VAN_DE_HULST),
    ("isotropic slab, mu0 0.1, depth 32", slab(0.1, 32.0, 0.0, 1.0), {"R": 0.97845, "T": 0.02155}, VAN_DE_HULST),
    ("isotropic slab, mu0 0.1, depth 32, albedo 0.2", slab(0.1, 32.0, 0.0, 0.2), {"R": 0.08266}, VAN_DE_HULST),
    ("isotropic slab, mu0 0.1, depth 0.03125", slab(0.1, 0.03125, 0.0, 1.0), {"R": 0.13462}, VAN_DE_HULST),
    ("Rayleigh slab, mu0 0.080442, depth 0.2", rayleigh_slab(0.080442, 0.2), {"R": 0.49685}, SWEIGART),
    ("Rayleigh slab, mu0 0.080442, depth 5", rayleigh_slab(0.080442, 5.0), {"R": 0.89395}, SWEIGART),
)
# Single-scattering albedo, plane albedo, nadir reflectance factor; the sun is overhead.
SEMI_INFINITE = ((0.9, 0.41495, 0.38507), (0.99, 0.75272, 0.75669))
# Optical depth that stands for infinity: what would come back from below it is less than 1e-13.
SEMI_INFINITE_DEPTH = 200.0


def step_cloud() -> Iterator[Experiment]:
    """I3RC case 1: half of the columns have optical depth 2, the others 18; HG with g 0.85."""
    views = {
        "Iu": ("nadir", RadiometerView.of_columns(STEP_GRID, 0.0)),
        "Id": ("zenith", RadiometerView.of_columns(STEP_GRID, 180.0)),
        "I601": ("oblique, azimuth 0", RadiometerView.of_columns(STEP_GRID, 60.0, 0.0)),
        "I602": ("oblique, azimuth 180", RadiometerView.of_columns(STEP_GRID, 60.0, 180.0)),
    }
    for number, sun_zenith, albedo, consensus in STEP_CLOUD:
        scene = Scene(
            STEP_GRID, Sun(sun_zenith, I3RC_SUN_AZIMUTH), Cloud(single_scattering_albedo=albedo), boundary=PERIODIC
        )
        quantities = []
        for key, value in consensus.items():
            name, view = views.get(key, (key, None))
            columns = None if (1, number, key) in NO_COLUMNS else key
            error = 0.0 if view is None else I3RC_RADIANCE_ERROR * value
            quantities.append(Quantity(name, value, view, columns, error))
        name = f"I3RC step cloud, exp {number}"
        yield Experiment(name, scene, STEP_EXTINCTION, tuple(quantities), I3RC_SOURCE, (1, number))


def landsat(files: Path) -> Experiment:
    """I3RC case 3, experiment 1: a cloud from a Landsat image, the sun overhead."""
    cloud = read_cloud(files / "scene43.tau.128x128", ReadingOptions(spacing=LANDSAT_SPACING))
    grid, extinction = cloud.grid, cloud.extinction
    scene = Scene(grid, Sun(0.0, I3RC_SUN_AZIMUTH), Cloud(1.0), boundary=PERIODIC)
    nadir = RadiometerView.of_columns(grid, 0.0)
    quantities = (
        Quantity("R", LANDSAT["R"], None, "R"),
        Quantity("T", LANDSAT["T"], None, "T"),
        Quantity("nadir", LANDSAT["Iu"], nadir, "Iu", I3RC_RADIANCE_ERROR * LANDSAT["Iu"], LANDSAT_RADIANCE_BLOCK),
    )
    # Sixteen thousand columns share the photons, and a path's radiance is 2.6 times as noisy as it is large.
    name = "I3RC Landsat cloud, exp 1"
    return Experiment(name, scene, extinction, quantities, I3RC_SOURCE, (3, 1), effort=4.0, radiance_effort=10.0)


def slabs() -> Iterator[Experiment]:
    """Plane-parallel layers: fluxes."""
    for name, (scene, extinction), values, source in SLABS:
        quantities = tuple(Quantity(quantity, value) for quantity, value in values.items())
        yield Experiment(name, scene, extinction, quantities, source)


def semi_infinite() -> Iterator[Experiment]:
    """Isotropic scattering without end, the sun overhead: Chandrasekhar's H."""
    for albedo, plane_albedo, nadir in SEMI_INFINITE:
        scene, extinction = slab(1.0, SEMI_INFINITE_DEPTH, 0.0, albedo)
        quantities = (Quantity("R", plane_albedo), Quantity("nadir", nadir, RadiometerView.of_columns(ONE_COLUMN, 0.0)))
        yield Experiment(f"semi-infinite isotropic, albedo {albedo}", scene, extinction, quantities, CHANDRASEKHAR)


# --- exact cases ------------------------------------------------------------------------


def single_scattering() -> Experiment:
    """A layer of one voxel so dark that light scatters once: the nadir radiance in closed form.

    L = F0 albedo f(sun, nadir) / (1 + 1 / mu0) (1 - exp(-depth (1 + 1 / mu0)))
    """
    cosine, depth, g, albedo = 0.5, 1.5, 0.85, 1e-5
    scene, extinction = slab(cosine, depth, g, albedo)
    slant = 1 + 1 / cosine
    phase_function = (1 - g * g) / (4 * np.pi * (1 + g * g + 2 * g * cosine) ** 1.5)
    expected = np.pi / cosine * albedo * phase_function / slant * (1 - np.exp(-depth * slant))
    quantities = (
        Quantity("nadir", float(expected), RadiometerView.of_columns(ONE_COLUMN, 0.0)),
        Quantity("T direct", float(np.exp(-depth / cosine))),
    )
    return Experiment("single scattering in one voxel", scene, extinction, quantities, "closed form")


def empty_domain() -> Experiment:
    """Nothing but a sunlit surface: its albedo is what is seen."""
    grid = Grid(shape=(2, 2, 2), spacing=(0.1, 0.1, 0.1), origin=(0.0, 0.0, 0.3))
    scene = Scene(grid, Sun(50.0, 20.0), surface=Surface(0.4), boundary=PERIODIC)
    quantities = (
        Quantity("nadir", 0.4, RadiometerView.of_columns(grid, 0.0)),
        Quantity("oblique", 0.4, RadiometerView.of_columns(grid, 40.0)),
        Quantity("R", 0.4),
        Quantity("T direct", 1.0),
        Quantity("A", 0.0),
    )
    return Experiment("empty domain over a surface of albedo 0.4", scene, np.zeros(grid.shape), quantities, "exact")


BROKEN_GRID = Grid(shape=(4, 4, 3), spacing=(0.25, 0.25, 0.2), origin=(0.0, 0.0, 0.1))


def broken_cloud() -> np.ndarray:
    """A cloud with holes on BROKEN_GRID, km^-1."""
    random = np.random.default_rng(6)
    return random.uniform(2, 12, BROKEN_GRID.shape) * (random.random(BROKEN_GRID.shape) > 0.4)


def energy() -> Experiment:
    """A broken cloud that absorbs, in air, over a black surface: nothing gets lost."""
    scene = Scene(BROKEN_GRID, Sun(40.0, 30.0), Cloud(0.95), Air(0.3), boundary=PERIODIC)
    return Experiment("energy, a broken cloud", scene, broken_cloud(), (Quantity("R + T + A", 1.0),), "exact")


def white_surface() -> Experiment:
    """Nothing absorbs above a surface that does not either: all light comes back."""
    grid = Grid(shape=(1, 1, 2), spacing=(1.0, 1.0, 0.5), origin=(0.0, 0.0, 0.2))
    scene = Scene(grid, Sun(60.0), Cloud(1.0), Air(0.4), Surface(1.0), PERIODIC)
    quantities = (Quantity("R", 1.0), Quantity("A", 0.0))
    return Experiment("uniform cloud over a surface of albedo 1", scene, np.full((1, 1, 2), 4.0), quantities, "exact")


def reciprocity() -> Reciprocity:
    """The mean reflectance of a periodic domain stays when sun and sensor change places.

    Source: Di Girolamo 1999, "Reciprocity principle applicable to reflected radiance
    measurements and the searchlight problem", Appl. Opt. 38.
    """

    def experiment(sun_zenith: float, view_zenith: float) -> Experiment:
        scene = Scene(BROKEN_GRID, Sun(sun_zenith, 0.0), Cloud(0.98), Air(0.3), Surface(0.3), PERIODIC)
        quantity = Quantity("nadir and 60", np.nan, RadiometerView.of_columns(BROKEN_GRID, view_zenith))
        return Experiment("reciprocity, a broken cloud", scene, broken_cloud(), (quantity,), "exact")

    return Reciprocity("reciprocity, a broken cloud", experiment(60.0, 0.0), experiment(0.0, 60.0))


def cases(files: Path | None = None) -> Iterator[Experiment | Reciprocity]:
    """All of them; those that need I3RC's files only if their folder is given."""
    yield from (single_scattering(), empty_domain(), energy(), white_surface(), reciprocity())
    yield from slabs()
    yield from semi_infinite()
    yield from step_cloud()
    if files is not None:
        yield landsat(files)


# --- computing --------------------------------------------------------------------------


def run(
    case: Experiment | Reciprocity, device: Device, photons: int, seed: int = 0, files: Path | None = None
) -> list[Row]:
    """The lines of the table of one case.

    Parameters
    ----------
    photons : for each radiance and for all fluxes of an experiment together, times the experiment's efforts
    files : the folder with I3RC's files, to compare columns

    Raises
    ------
    DataError : a file of `files` cannot be read
    """
    if isinstance(case, Reciprocity):
        (first,), (second,) = run(case.first, device, photons, seed), run(case.second, device, photons, seed + 1)
        error = float(np.hypot(first.standard_error, second.standard_error))
        return [Row(case.name, first.quantity, first.source, first.value, second.value, error, 2 * photons)]
    # Read before the work.
    consensus = {
        quantity.name: i3rc.read_consensus(files, *case.i3rc, quantity.consensus)
        for quantity in case.quantities
        if files is not None and case.i3rc is not None and quantity.consensus is not None
    }
    of_radiances = int(photons * (case.radiance_effort or case.effort))
    photons = int(photons * case.effort)
    measured = [
        radiance(case, quantity.view, device, of_radiances, seed) if quantity.view is not None else None
        for quantity in case.quantities
    ]
    fluxes = None
    if any(quantity.view is None for quantity in case.quantities):
        fluxes = FluxOperator(case.scene, device).compute(case.extinction, photons=photons, seed=seed)
    incident = case.scene.sun.irradiance * np.cos(np.radians(case.scene.sun.zenith))
    rows = []
    for quantity, found in zip(case.quantities, measured):
        if found is None:
            assert fluxes is not None
            means = [fluxes.domain_mean(name) for name in FLUXES[quantity.name]]
            value = sum(mean.value for mean in means) / incident
            # What one of them has more another has less: for their sum this is an upper bound.
            error = float(np.sqrt(sum(mean.standard_error**2 for mean in means))) / incident
        else:
            value, error = found[0].mean(), float(np.sqrt((found[1] ** 2).sum())) / found[0].size
        paths = photons if found is None else of_radiances
        row = Row(case.name, quantity.name, case.source, quantity.published, float(value), error, paths)
        rows.append(replace(row, published_error=quantity.published_error))
        if quantity.name in consensus:
            if found is None:
                assert fluxes is not None
                found = flux_columns(fluxes, FLUXES[quantity.name][0], incident)
            rows.append(compare_columns(rows[-1], *found, consensus[quantity.name], quantity.block))
    return rows


def radiance(
    experiment: Experiment, view: RadiometerView, device: Device, photons: int, seed: int
) -> tuple[np.ndarray, np.ndarray]:
    """Reflectance factors of the columns and their standard errors, each of shape (nx, ny)."""
    sun = experiment.scene.sun
    factor = np.pi / (sun.irradiance * np.cos(np.radians(sun.zenith)))
    operator = RadianceOperator(experiment.scene, [view], device)
    samples = 2 * max(photons // (2 * len(operator.pixels)), 1)
    rendering = operator.render(experiment.extinction, samples, seed)
    mean, error = (
        factor * map_of_columns(operator.images(values)[0]) for values in (rendering.mean, rendering.standard_error)
    )
    return mean, error


def flux_columns(fluxes: Fluxes, name: str, incident: float) -> tuple[np.ndarray, np.ndarray]:
    """Fluxes of the columns over the incident one and their standard errors, each of shape (nx, ny)."""
    estimate = getattr(fluxes, name)
    return estimate.value / incident, estimate.standard_error / incident


def compare_columns(
    mean: Row, value: np.ndarray, standard_error: np.ndarray, consensus: np.ndarray, block: int = 1
) -> Row:
    """The r.m.s. difference of columns from a consensus, over the consensus's mean.

    Our own noise is subtracted in the mean square (its expectation is the squared standard
    error); the noise of the consensus is not.

    Parameters
    ----------
    mean : the line of the domain's mean
    value, standard_error, consensus : shape (nx, ny)
    block : of columns that are averaged before; must divide nx and ny
    """
    blocks = (value.shape[0] // block, block, value.shape[1] // block, block)
    value, consensus = (columns.reshape(blocks).mean(axis=(1, 3)) for columns in (value, consensus))
    standard_error = np.sqrt((standard_error**2).reshape(blocks).sum(axis=(1, 3))) / block**2
    square = (value - consensus) ** 2
    noise = standard_error**2
    mean_square = float((square - noise).mean())
    # Var(square - noise) = 4 d^2 noise + 2 noise^2 with the true difference d, d^2 = square - noise.
    error_of_square = float(np.sqrt(np.maximum(4 * square * noise - 2 * noise**2, 0.0).sum())) / value.size
    rms = np.sqrt(max(mean_square, 0.0))
    error = error_of_square / (2 * max(rms, np.sqrt(error_of_square)))
    scale = float(consensus.mean())
    quantity = f"{mean.quantity}, {value.size} " + ("columns" if block == 1 else f"blocks of {block} x {block}")
    return Row(
        mean.experiment, quantity, mean.source, 0.0, float(rms / scale), float(error / scale), mean.photons, True
    )
