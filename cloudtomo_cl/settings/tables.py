"""Settings from TOML files.

A table of the file is a class of the Python API (Sun, Cloud, Stage ...), so that both have the
same words, units and checks. TOML knows the types of JSON, so a file is checked in JSON's
strict mode: "60" is not a number, a list is a tuple.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    ValidationError,
    ValidationInfo,
    model_validator,
)
from pydantic.dataclasses import dataclass

from cloudtomo_cl.errors import DataError, SettingsError
from cloudtomo_cl.files.phase import read_phase_function
from cloudtomo_cl.files.text import read_text
from cloudtomo_cl.inversion.priors import PatchPrior, Prior
from cloudtomo_cl.inversion.solvers.choice import SolverTable, of_default_type
from cloudtomo_cl.inversion.solvers.gauss_newton import GaussNewton
from cloudtomo_cl.inversion.stages import Stage
from cloudtomo_cl.inversion.uncertainty import DRAWS, MOST_DRAWS
from cloudtomo_cl.messages import error_text, lines_of
from cloudtomo_cl.scene.formations import RingOfViews, StringOfScans, StringOfViews
from cloudtomo_cl.scene.grid import Grid
from cloudtomo_cl.scene.noise import Noise
from cloudtomo_cl.scene.phase import HenyeyGreenstein, PhaseFunction
from cloudtomo_cl.scene.scene import Air, Boundary, Cloud, Fraction, NotNegative, Positive, Scene, Sun, Surface
from cloudtomo_cl.scene.sensors import (
    OrthographicView,
    PerspectiveView,
    PushBroomView,
    RadiometerView,
    RayView,
    View,
)
from cloudtomo_cl.settings.old_keys import refuse_old_keys
from cloudtomo_cl.settings.overrides import with_overrides
from cloudtomo_cl.settings.stored import scene_of_tables

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib


def _beside_settings(path: Path, info: ValidationInfo) -> Path:
    """Relative paths start at the settings file's folder."""
    path = Path((info.context or {}).get("folder", "."), path)
    try:
        there = path.is_file()
    except (OSError, ValueError):  # a name that is too long, or has a zero byte
        there = False
    if not there:
        raise ValueError(f"there is no file {path}")
    return path


# Bytes: far beyond any settings, which have some hundred lines.
_LARGEST_SETTINGS = 1 << 24
InputFile = Annotated[Path, AfterValidator(_beside_settings)]
Seed = Annotated[int, Field(ge=0, lt=2**32)]


@dataclass(frozen=True, config=ConfigDict(extra="forbid"))
class File:
    """A table that names a file.

    Attributes
    ----------
    file : netCDF with extinction(x, y, z), also among images as `cloudtomo render` writes them
    """

    file: InputFile


@dataclass(frozen=True, config=ConfigDict(extra="forbid"))
class ImageFile(File):
    """The images to recover the cloud from.

    Attributes
    ----------
    file : netCDF; images as `cloudtomo render` writes them
    wavelength : nm, which images, where the file holds those at several wavelengths
    """

    wavelength: Positive | None = None


@dataclass(frozen=True, config=ConfigDict(extra="forbid"))
class RayFile:
    """A view that is a list of rays, in a file that `io.read_rays` reads.

    Attributes
    ----------
    file : netCDF with origin(ray, axis) in km and direction(ray, axis)
    """

    file: InputFile
    type: Literal["rays"] = "rays"

    def views(self) -> tuple[RayView]:
        """The view. DataError names what is wrong with the file."""
        from cloudtomo_cl.files.measurements import read_rays

        return (read_rays(self.file),)


Formation = RingOfViews | StringOfViews | StringOfScans
ViewTable = Annotated[
    PerspectiveView | OrthographicView | PushBroomView | RadiometerView | RayFile | Formation,
    Field(discriminator="type"),
]
ViewTables = Annotated[tuple[ViewTable, ...], Field(min_length=1)]


def views(tables: Sequence[ViewTable]) -> tuple[View, ...]:
    """The views of all tables [[view]], in their order; a table may stand for several."""
    found: list[View] = []
    for table in tables:
        found.extend(table.views() if isinstance(table, (RayFile, Formation)) else (table,))
    return tuple(found)


def _phase_function_file(value: Any, info: ValidationInfo) -> Any:
    """A table of a phase function may lie in a file; its numbers then take the file's place."""
    if not isinstance(value, dict) or "file" not in value or value.get("type", "table") != "table":
        return value
    if set(value) - {"type", "file"} or not isinstance(value["file"], str):
        raise ValueError('a phase function from a file is { type = "table", file = "NAME" }, with no other key')
    return read_phase_function(_beside_settings(Path(value["file"]), info), (info.context or {}).get("wavelength"))


@dataclass(frozen=True, kw_only=True, config=ConfigDict(extra="forbid"))
class CloudTable(Cloud):
    """The droplets' optics, whose phase function may lie in a file.

    Attributes
    ----------
    phase_function : of the droplets; `{ type = "table", file = "mie.nc" }` takes a table from netCDF
    """

    phase_function: Annotated[PhaseFunction, BeforeValidator(_phase_function_file)] = HenyeyGreenstein(g=0.85)

    def optics(self) -> Cloud:
        """Without the files."""
        return Cloud(**{field.name: getattr(self, field.name) for field in fields(Cloud)})


@dataclass(frozen=True, kw_only=True, config=ConfigDict(extra="forbid"))
class CloudFile(CloudTable):
    """The droplets' optics, and the file of their extinction.

    Attributes
    ----------
    file : netCDF with extinction(x, y, z); `cloudtomo cloud` makes it from other formats
    """

    file: InputFile


@dataclass(frozen=True, config=ConfigDict(extra="forbid"))
class PatchPriorTable(PatchPrior):
    """Every patch of a cloud, 5 x 5 x 3 voxels, comes from a mixture of Gaussians that was learnt from clouds.

    See docs/explanation/patches.md.
    """

    file: InputFile | None = None


PriorTable = Annotated[Annotated[PatchPriorTable | Prior, Field(discriminator="type")], of_default_type("patches")]


@dataclass(frozen=True, config=ConfigDict(extra="forbid"))
class Run:
    """How a reconstruction runs.

    Attributes
    ----------
    seed : of the random numbers
    time_limit : s, over all resumes; no iteration begins that would end later if it is as long as the
        last one. No limit by default
    checkpoint_interval : s between checkpoints within a stage; more, where the disk is slow
    uncertainty : draws that the standard error of the extinction is made of, at the end (Gauss-Newton only); 0: none.
        They take about as long as an iteration or two, whatever the time limit
    """

    seed: Seed = 0
    time_limit: Positive | None = None
    checkpoint_interval: NotNegative = 60.0
    uncertainty: Annotated[int, Field(ge=0, le=MOST_DRAWS)] = DRAWS


@dataclass(frozen=True, config=ConfigDict(extra="forbid"))
class Spectrum:
    """Wavelengths: the scene is rendered at each, into one file.

    Attributes
    ----------
    wavelengths : nm, increasing. With several, the phase function must be a table that has them all
        (`cloudtomo mie --wavelength 672 2130`): from it follow the droplets' extinction and albedo at each
    irradiance : W m^-2, of the sun at each wavelength; in place of that in `[sun]`
    surface_albedo : at each wavelength; in place of that in `[surface]`
    reference : nm, at which the cloud's file has its extinction, where the file does not say it; by default the first
    """

    wavelengths: Annotated[tuple[Positive, ...], Field(min_length=1)]
    irradiance: Annotated[tuple[Positive, ...], Field(min_length=1)] | None = None
    surface_albedo: Annotated[tuple[Fraction, ...], Field(min_length=1)] | None = None
    reference: Positive | None = None

    @model_validator(mode="after")
    def _check(self) -> Spectrum:
        if any(later <= one for one, later in zip(self.wavelengths, self.wavelengths[1:])):
            raise ValueError("wavelengths must increase, in nm")
        for name in ("irradiance", "surface_albedo"):
            values = getattr(self, name)
            if values is not None and len(values) != len(self.wavelengths):
                raise ValueError(f"{name} has {len(values)} entries for {len(self.wavelengths)} wavelengths")
        return self

    def at(self, scene: Scene, index: int) -> Scene:
        """The scene with what `index`, that of a wavelength, says of it."""
        if self.irradiance is not None:
            scene = replace(scene, sun=replace(scene.sun, irradiance=self.irradiance[index]))
        if self.surface_albedo is not None:
            scene = replace(scene, surface=Surface(self.surface_albedo[index]))
        return replace(scene, wavelength=self.wavelengths[index])


class RenderSettings(BaseModel):
    """A scene file: what `cloudtomo render` reads."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    cloud: CloudFile
    sun: Sun
    view: ViewTables
    spectrum: Spectrum | None = None
    air: Air | None = None
    surface: Surface = Surface()
    boundary: Boundary = Boundary()
    noise: Noise | None = None

    def scene(self, grid: Grid) -> Scene:
        """The scene, on the grid of the cloud's file."""
        return Scene(grid, self.sun, self.cloud.optics(), self.air, self.surface, self.boundary)


class FluxSettings(RenderSettings):
    """A scene file as `cloudtomo flux` reads it: its views and their noise, if there are any, mean nothing."""

    view: ViewTables | None = None  # type: ignore[assignment]


class ReconstructSettings(BaseModel):
    """A run file: what `cloudtomo reconstruct` reads.

    The tables of the scene that are absent are those that the measurements were made with.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    measurements: ImageFile
    truth: File | None = None
    grid: Grid | None = None
    sun: Sun | None = None
    cloud: CloudTable | None = None
    air: Air | None = None
    surface: Surface | None = None
    boundary: Boundary | None = None
    view: ViewTables | None = None
    stage: Annotated[tuple[Stage, ...], Field(min_length=1)] | None = None
    prior: PriorTable = PatchPriorTable()
    solver: SolverTable = GaussNewton()
    run: Run = Run()

    def scene(self, stored: dict[str, Any]) -> Scene:
        """The scene of these settings, completed by those stored with the measurements.

        Parameters
        ----------
        stored : what `stored_scene` made, or nothing

        Raises
        ------
        SettingsError : neither knows the grid or the sun, or what is stored is no scene
        """
        if not isinstance(stored, dict):
            raise SettingsError(f"{self.measurements.file}: what it stores as scene in its settings is no table")
        tables: dict[str, Any] = dict(stored)
        for name in ("grid", "sun", "cloud", "air", "surface", "boundary"):
            given = getattr(self, name)
            if given is not None:
                tables[name] = given.optics() if isinstance(given, CloudTable) else given
        for name in ("grid", "sun"):
            if tables.get(name) is None:
                raise SettingsError(f"{self.measurements.file} does not store [{name}]: add this table to the run file")
        return scene_of_tables(self.measurements.file, tables)


Settings = TypeVar("Settings", RenderSettings, FluxSettings, ReconstructSettings)


def read_render_settings(
    path: str | Path, overrides: Sequence[str] = (), wavelength: float | None = None
) -> RenderSettings:
    """Reads a scene file. SettingsError names the file, the key, what is wrong and what is allowed.

    `overrides` are `key=value`, see `overrides.with_overrides`. `wavelength` (nm) is one of its spectrum's, by default
    the first: the phase function is the file's at this one, and so is the standard atmosphere's air.
    """
    return _scene_settings(Path(path), overrides, wavelength, RenderSettings)


def read_flux_settings(
    path: str | Path, overrides: Sequence[str] = (), wavelength: float | None = None
) -> FluxSettings:
    """Reads a scene file, which needs no views; as `read_render_settings`."""
    return _scene_settings(Path(path), overrides, wavelength, FluxSettings)


def read_tables(path: Path, overrides: Sequence[str] = ()) -> dict[str, Any]:
    """The tables of a settings file, as they stand there but for the overrides. SettingsError if it is not TOML."""
    return with_overrides(_read_toml(path), overrides)


def _scene_settings(path: Path, overrides: Sequence[str], wavelength: float | None, model: type[Settings]) -> Settings:
    tables = read_tables(path, overrides)
    spectrum = tables.get("spectrum")
    wavelengths = spectrum.get("wavelengths") if isinstance(spectrum, dict) else None
    if not isinstance(wavelengths, list) or not wavelengths or not isinstance(wavelengths[0], (int, float)):
        return _check(path, tables, model)  # which answers what is wrong with a spectrum
    wavelength = wavelengths[0] if wavelength is None else wavelength
    air = tables.get("air")
    if isinstance(air, dict) and "wavelength" in air:
        raise SettingsError(f"{path}: air.wavelength: [spectrum] says the wavelengths, leave it out")
    if isinstance(air, dict) and "extinction" in air and len(wavelengths) > 1:
        raise SettingsError(
            f"{path}: air.extinction is that of one wavelength, and there are {len(wavelengths)}: leave it out, and "
            "air is that of a standard atmosphere at each"
        )
    if isinstance(air, dict) and "extinction" not in air:
        air["wavelength"] = wavelength
    return _check(path, tables, model, wavelength)


def read_reconstruct_settings(path: str | Path, overrides: Sequence[str] = ()) -> ReconstructSettings:
    """Reads a run file; as `read_render_settings`."""
    path = Path(path)
    tables = with_overrides(_read_toml(path), overrides)
    if isinstance(tables.get("cloud"), dict) and "file" in tables["cloud"]:
        raise SettingsError(
            f"{path}: cloud.file is not read by a reconstruction; to compare with a known cloud write [truth] file"
        )
    refuse_old_keys(path, tables)
    images = tables.get("measurements")
    wavelength = images.get("wavelength") if isinstance(images, dict) else None
    known = isinstance(wavelength, (int, float)) and not isinstance(wavelength, bool)
    return _check(path, tables, ReconstructSettings, wavelength if known else None)


def repeated_reconstruct_settings(
    path: Path, stored: Mapping[str, Any], overrides: Sequence[str] = ()
) -> ReconstructSettings:
    """The settings of a finished run, from what its own reconstruction.nc keeps; scene and views are there too.

    SettingsError if the file keeps none.
    """
    tables = stored.get("reconstruct")
    if not isinstance(tables, dict):
        raise SettingsError(f"{path}: keeps no settings of a reconstruction: give a run file, or a reconstruction.nc")
    refuse_old_keys(path, tables)
    kept = {name: tables[name] for name in ("stage", "prior", "solver", "run") if tables.get(name) is not None}
    if not isinstance(kept.setdefault("run", {}), dict):
        raise SettingsError(f"{path}: its attribute settings stores run = {kept['run']!r:.60}: it must be a table")
    kept["run"] = {**kept["run"], "seed": stored.get("seed", 0)}
    kept["measurements"] = {"file": path.name}
    return _check(path, with_overrides(kept, overrides), ReconstructSettings)


def _read_toml(path: Path) -> dict[str, Any]:
    try:
        return tomllib.loads(read_text(path, _LARGEST_SETTINGS))
    except DataError as error:
        raise SettingsError(str(error)) from None
    except RecursionError:
        raise SettingsError(f"{path}: is no settings file: its tables are nested too deeply") from None
    except ValueError as error:  # of TOML, and of a number with too many digits
        raise SettingsError(f"{path}: is not TOML: {str(error).partition(';')[0]}") from None


def _check(path: Path, tables: dict[str, Any], model: type[Settings], wavelength: float | None = None) -> Settings:
    # Dates, which no key takes, become text and are refused as such.
    try:
        text = json.dumps(tables, default=str)
    except (RecursionError, ValueError) as error:
        raise SettingsError(f"{path}: is no settings file: {error}") from None
    try:
        context = {"folder": path.parent, "wavelength": wavelength}
        return model.model_validate_json(text, strict=True, context=context)
    except ValidationError as error:
        raise SettingsError(error_text(str(path), lines_of(error, tables, model.model_json_schema()))) from None
