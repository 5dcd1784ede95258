# The public names: __init__.py gives them, and imports where they come from when they are first used.
from .clouds.generate import cumulus
from .clouds.mie import droplet_table, droplet_tables
from .clouds.readers import ReadingOptions, read_cloud
from .clouds.volume import CloudVolume
from .commands.notebook import ProgressDisplay
from .errors import (
    AuditError,
    BuildError,
    CloudtomoError,
    DataError,
    DeviceError,
    Interrupted,
    InvalidArgumentError,
    InvalidSettingError,
    MissingPackageError,
    RecoveryWarning,
    SettingsError,
    TransportError,
)
from .files.extinction import extinction_dataset, read_extinction, write_extinction
from .files.measurements import (
    measurements_dataset,
    read_measurements,
    read_rays,
    write_measurements,
    write_rays,
)
from .files.phase import read_droplet_table, read_phase_function, write_phase_function
from .files.vti import write_vti
from .files.wavelengths import read_wavelengths
from .inversion.carving import carve
from .inversion.checkpoint import Checkpoint, read_checkpoint
from .inversion.linear_model import LinearModel
from .inversion.priors import PatchPrior, Prior, Regulariser
from .inversion.problem import Problem
from .inversion.reconstruct import reconstruct
from .inversion.records import History, IterationRecord, Reconstruction
from .inversion.solvers.descent import SGD, Adam
from .inversion.solvers.gauss_newton import GaussNewton
from .inversion.solvers.protocol import Progress, Solver
from .inversion.stages import Stage, automatic_stages
from .inversion.voxels import Voxels
from .opencl.devices import choose_device, list_devices
from .opencl.several import on_devices
from .report.volume import plot_volume
from .scene.droplets import DropletTable, extinction_at, extinction_from_water
from .scene.formations import MISR_ANGLES, RingOfViews, StringOfScans, StringOfViews, fisheye_rays
from .scene.grid import Grid
from .scene.measurements import Measurements
from .scene.metrics import delta, epsilon
from .scene.noise import Noise
from .scene.phase import DoubleHenyeyGreenstein, HenyeyGreenstein, TabulatedPhaseFunction
from .scene.poses import camera_from_pose
from .scene.scene import Air, Boundary, Cloud, Scene, Sun, Surface
from .scene.sensors import (
    OrthographicView,
    PerspectiveView,
    PushBroomView,
    RadiometerView,
    RayView,
)
from .transport.adaptive import render_to_error
from .transport.audit import Audit
from .transport.flux import Fluxes, FluxOperator
from .transport.jacobian import Jacobian
from .transport.radiance import RadianceOperator, Rendering

__all__ = [
    "Adam",
    "Air",
    "Audit",
    "AuditError",
    "Boundary",
    "BuildError",
    "Checkpoint",
    "Cloud",
    "CloudVolume",
    "CloudtomoError",
    "DataError",
    "DeviceError",
    "DoubleHenyeyGreenstein",
    "DropletTable",
    "FluxOperator",
    "Fluxes",
    "GaussNewton",
    "Grid",
    "HenyeyGreenstein",
    "History",
    "Interrupted",
    "InvalidArgumentError",
    "InvalidSettingError",
    "IterationRecord",
    "Jacobian",
    "LinearModel",
    "MISR_ANGLES",
    "Measurements",
    "MissingPackageError",
    "Noise",
    "OrthographicView",
    "PatchPrior",
    "PerspectiveView",
    "Prior",
    "Problem",
    "Progress",
    "ProgressDisplay",
    "PushBroomView",
    "RadianceOperator",
    "RadiometerView",
    "RayView",
    "ReadingOptions",
    "Reconstruction",
    "RecoveryWarning",
    "Regulariser",
    "Rendering",
    "RingOfViews",
    "SGD",
    "Scene",
    "SettingsError",
    "Solver",
    "Stage",
    "StringOfScans",
    "StringOfViews",
    "Sun",
    "Surface",
    "TabulatedPhaseFunction",
    "TransportError",
    "Voxels",
    "automatic_stages",
    "camera_from_pose",
    "carve",
    "choose_device",
    "cumulus",
    "delta",
    "droplet_table",
    "droplet_tables",
    "epsilon",
    "extinction_at",
    "extinction_dataset",
    "extinction_from_water",
    "fisheye_rays",
    "list_devices",
    "measurements_dataset",
    "on_devices",
    "plot_volume",
    "read_checkpoint",
    "read_cloud",
    "read_droplet_table",
    "read_extinction",
    "read_measurements",
    "read_phase_function",
    "read_rays",
    "read_wavelengths",
    "reconstruct",
    "render_to_error",
    "write_extinction",
    "write_measurements",
    "write_phase_function",
    "write_rays",
    "write_vti",
]
