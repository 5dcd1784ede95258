# The public names: __init__.py gives them, and imports where they come from when they are first used.
from .carving import carve
from .cloud_files import ReadingOptions, read_cloud
from .cloud_volume import CloudVolume
from .clouds import cumulus
from .device import choose_device, list_devices
from .droplets import DropletTable, extinction_from_water
from .errors import CloudtomoError
from .flux import Fluxes, FluxOperator
from .formations import MISR_ANGLES, RingOfViews, StringOfScans, StringOfViews, fisheye_rays
from .grid import Grid
from .inversion import Reconstruction, reconstruct
from .io import (
    extinction_dataset,
    measurements_dataset,
    read_extinction,
    read_measurements,
    read_rays,
    write_extinction,
    write_measurements,
    write_rays,
)
from .measurements import Measurements
from .metrics import delta, epsilon
from .mie import droplet_table
from .noise import Noise
from .optimizer import Optimizer
from .phase import DoubleHenyeyGreenstein, HenyeyGreenstein, TabulatedPhaseFunction
from .phase_files import read_droplet_table, read_phase_function, write_phase_function
from .prior import Prior
from .scene import Air, Boundary, Cloud, Scene, Sun, Surface
from .sensors import (
    OrthographicView,
    PerspectiveView,
    PushBroomView,
    RadiometerView,
    RayView,
)
from .stages import Stage, automatic_stages
from .transport import RadianceOperator, Rendering

__all__ = [
    "Air",
    "Boundary",
    "Cloud",
    "CloudVolume",
    "CloudtomoError",
    "DoubleHenyeyGreenstein",
    "DropletTable",
    "FluxOperator",
    "Fluxes",
    "Grid",
    "HenyeyGreenstein",
    "MISR_ANGLES",
    "Measurements",
    "Noise",
    "Optimizer",
    "OrthographicView",
    "PerspectiveView",
    "Prior",
    "PushBroomView",
    "RadianceOperator",
    "RadiometerView",
    "RayView",
    "ReadingOptions",
    "Reconstruction",
    "Rendering",
    "RingOfViews",
    "Scene",
    "Stage",
    "StringOfScans",
    "StringOfViews",
    "Sun",
    "Surface",
    "TabulatedPhaseFunction",
    "automatic_stages",
    "carve",
    "choose_device",
    "cumulus",
    "delta",
    "droplet_table",
    "epsilon",
    "extinction_dataset",
    "extinction_from_water",
    "fisheye_rays",
    "list_devices",
    "measurements_dataset",
    "read_cloud",
    "read_droplet_table",
    "read_extinction",
    "read_measurements",
    "read_phase_function",
    "read_rays",
    "reconstruct",
    "write_extinction",
    "write_measurements",
    "write_phase_function",
    "write_rays",
]
