"""3-D cloud extinction from images taken from several directions.

Lengths are in km, extinction in km^-1, angles in degrees, radiance in W m^-2 sr^-1; x runs
east, y north, z up, and the ground is z = 0.
"""

from cloudtomo_cl.carving import carve
from cloudtomo_cl.clouds import cumulus
from cloudtomo_cl.device import choose_device, list_devices
from cloudtomo_cl.droplets import DropletTable, extinction_from_water
from cloudtomo_cl.errors import CloudtomoError
from cloudtomo_cl.flux import Fluxes, FluxOperator
from cloudtomo_cl.formations import MISR_ANGLES, RingOfViews, StringOfScans, StringOfViews, fisheye_rays
from cloudtomo_cl.grid import Grid
from cloudtomo_cl.inversion import Reconstruction, reconstruct
from cloudtomo_cl.io import (
    read_extinction,
    read_measurements,
    read_rays,
    write_extinction,
    write_measurements,
    write_rays,
)
from cloudtomo_cl.measurements import Measurements
from cloudtomo_cl.metrics import delta, epsilon
from cloudtomo_cl.mie import droplet_table
from cloudtomo_cl.optimizer import Optimizer
from cloudtomo_cl.phase import DoubleHenyeyGreenstein, HenyeyGreenstein, TabulatedPhaseFunction
from cloudtomo_cl.phase_files import read_droplet_table, read_phase_function, write_phase_function
from cloudtomo_cl.prior import Prior
from cloudtomo_cl.scene import Air, Boundary, Cloud, Scene, Sun, Surface
from cloudtomo_cl.sensors import (
    OrthographicView,
    PerspectiveView,
    PushBroomView,
    RadiometerView,
    RayView,
)
from cloudtomo_cl.stages import Stage, automatic_stages
from cloudtomo_cl.transport import RadianceOperator, Rendering

__all__ = [
    "Air",
    "Boundary",
    "Cloud",
    "CloudtomoError",
    "DoubleHenyeyGreenstein",
    "DropletTable",
    "FluxOperator",
    "Fluxes",
    "Grid",
    "HenyeyGreenstein",
    "MISR_ANGLES",
    "Measurements",
    "Optimizer",
    "OrthographicView",
    "PerspectiveView",
    "Prior",
    "PushBroomView",
    "RadianceOperator",
    "RadiometerView",
    "RayView",
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
    "extinction_from_water",
    "fisheye_rays",
    "list_devices",
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
