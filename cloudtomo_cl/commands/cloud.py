"""`cloudtomo cloud`: read, generate, change, summarise, plot and write clouds. Imports what is slow when it runs."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cloudtomo_cl.commands import options, stopping
from cloudtomo_cl.errors import DataError, InvalidSettingError, SettingsError, printable

if TYPE_CHECKING:
    from cloudtomo_cl.clouds.volume import CloudVolume
    from cloudtomo_cl.scene.grid import Grid

HELP = "read, change or generate a cloud"

DESCRIPTION = """\
Read a cloud, or generate one; crop, pad, rotate, coarsen and tile it (in this order); summarise, plot, write it.

FILE may be
  netCDF    extinction, liquid water content or mixing ratio over x, y, z, in m or km, also on stretched levels;
            AT3D's files (density, reff) among them
  text      pyshdom's, AT3D's and SHDOM's (liquid water content and effective radius), I3RC's tau with dz beside it
  .npy .mat a three-dimensional array, with --spacing and --units
Water becomes extinction by 3 LWC / (2 rho r_e), or by a table of `cloudtomo mie`. What is written is netCDF with
extinction(z, y, x) in km^-1 on uniform voxels, and effective_radius in um where it is known."""

EXAMPLES = """\
examples:
  cloudtomo cloud rico32x37x26.txt --output cloud.nc --png cloud.png
  cloudtomo cloud les.nc --variable QN --time -1 --droplet-number 70 --crop x=1.2:2.4 y=0:1.2 --output cloud.nc
  cloudtomo cloud extinction.npy --spacing 0.02 0.02 0.04 --units m-1 --order zyx --output cloud.nc
  cloudtomo cloud cloud.nc --vti cloud.vti
  cloudtomo cloud cloud.nc --pad x=2 y=2 z=0:4 --coarsen 2 2 1 --output coarse.nc
  cloudtomo cloud --generate cumulus --shape 32 32 32 --spacing 0.025 0.025 0.025 --seed 1 --output cloud.nc"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of the command; they are the parameters of `run`."""
    triple: dict[str, Any] = {"nargs": 3, "metavar": ("DX", "DY", "DZ")}
    parser.add_argument("file", nargs="?", type=Path, metavar="FILE", help="the cloud to read")
    parser.add_argument("--output", type=Path, metavar="FILE", help="where the cloud goes, netCDF")
    parser.add_argument("--png", type=Path, metavar="FILE", help="a picture of it (.png, .pdf, .svg)")
    options.add_vti(parser)

    made = parser.add_argument_group("to generate one")
    made.add_argument("--generate", metavar="KIND", help="cumulus, field, tower or stratocumulus")
    made.add_argument("--shape", nargs=3, type=int, metavar=("NX", "NY", "NZ"), help="voxels along x, y, z")
    made.add_argument("--seed", type=options.seed, default=0, help="of the generated cloud (default 0)")

    read = parser.add_argument_group("to read one: what the file leaves open")
    read.add_argument("--spacing", type=float, **triple, help="edges of a voxel, km (also of a generated cloud)")
    read.add_argument("--variable", metavar="NAME", help="the field, where there are several")
    read.add_argument("--units", metavar="UNIT", help="of the field: km-1, m-1, 'g m-3', 'kg m-3', 'g kg-1', 'kg kg-1'")
    read.add_argument("--order", default="xyz", metavar="AXES", help="axes of a plain array (default xyz)")
    read.add_argument("--time", type=int, metavar="INDEX", help="time step, from 0; -1 is the last")
    read.add_argument("--select", nargs="+", metavar="DIM=INDEX", help="along a dimension that is not space or time")
    read.add_argument("--missing", choices=["refuse", "clear"], default="refuse", help="values: or take as clear")
    read.add_argument("--effective-radius", type=float, metavar="UM", help="of all droplets, um")
    read.add_argument("--droplet-number", type=float, metavar="N", help="cm^-3; gives the radius where no file does")
    read.add_argument("--droplet-table", type=Path, metavar="FILE", help="Mie table that water becomes extinction by")
    read.add_argument("--wavelength", type=float, metavar="NM", help="nm, of a Mie table that has several")
    read.add_argument("--layer", type=float, metavar="DZ", help="of uniform layers, km (default: the thinnest)")

    change = parser.add_argument_group("to change it, in this order")
    change.add_argument("--crop", nargs="+", metavar="AXIS=A:B", help="km, for instance x=0.2:0.6 z=:1.2")
    change.add_argument("--pad", nargs="+", metavar="AXIS=N", help="clear voxels on both sides, or below:above: z=0:4")
    change.add_argument("--rotate", type=int, metavar="DEGREES", help="about the vertical, from x to y: 90, 180, 270")
    change.add_argument("--coarsen", nargs=3, type=int, metavar=("X", "Y", "Z"), help="voxels to average along x, y, z")
    change.add_argument("--tile", nargs=2, type=int, metavar=("X", "Y"), help="copies along x and y")
    options.add_overwrite(parser)
    options.add_quiet(parser)


def run(
    file: Path | None,
    output: Path | None,
    png: Path | None,
    vti: Path | None,
    generate: str | None,
    shape: list[int] | None,
    seed: int,
    crop: list[str] | None,
    pad: list[str] | None,
    rotate: int | None,
    coarsen: list[int] | None,
    tile: list[int] | None,
    quiet: bool,
    overwrite: bool,
    **reading: Any,
) -> None:
    """Reads or generates, changes, writes and summarises a cloud; `reading` are the fields of `ReadingOptions`."""
    from cloudtomo_cl.files.netcdf import require_file

    if (file is None) == (generate is None):
        raise SettingsError("give either FILE, or --generate cumulus (or field, tower, stratocumulus)")
    if generate is None and shape is not None:
        raise SettingsError("--shape belongs to --generate; to change a file's voxels use --crop, --pad or --coarsen")
    if generate is not None and output is None and vti is None:
        raise SettingsError("--generate needs --output too")
    if file is not None:
        require_file(file)
    options.check_outputs(overwrite, output=output, png=png, vti=vti, inputs=(file, reading["droplet_table"]))
    steps = {"crop": crop, "pad": pad, "rotate": rotate, "coarsen": coarsen, "tile": tile}
    bounds = None if crop is None else _pairs("crop", crop, float, (None, None))
    clear = None if pad is None else _pairs("pad", pad, int, (0, 0))
    if file is not None:
        volume = _read(file, reading)
    else:
        assert generate is not None
        for name, value in reading.items():
            if name != "spacing" and value not in (None, "xyz", "refuse"):
                raise SettingsError(f"--{name.replace('_', '-')} belongs to FILE, not to --generate: leave it out")
        volume = _generated(generate, shape, reading["spacing"], seed)
    stopping.check()
    volume = _changed(volume, bounds, clear, rotate, coarsen, tile)
    stopping.check()
    if output is not None:
        made: dict[str, Any] = {"generator": generate, "seed": seed} if file is None else {"cloud_file": file.name}
        made.update(shape=shape, **reading, **steps)
        _write(output, volume, {name: _plain(value) for name, value in made.items() if value is not None})
    if png is not None:
        stopping.check()
        _plot(png, volume)
    if vti is not None:
        stopping.check()
        _write_vti(vti, volume)
    if not quiet:
        for name, value in volume.summary().items():
            print(printable(f"{name:<24}{value}"))
        for path in (output, png, vti):
            if path is not None:
                print(f"{path} is written")


def _plain(value: Any) -> Any:
    """In the types of JSON."""
    return value.name if isinstance(value, Path) else value


def _read(file: Path, reading: dict[str, Any]) -> CloudVolume:
    from cloudtomo_cl.clouds.readers import ReadingOptions, read_cloud

    if reading["spacing"] is not None:
        reading = {**reading, "spacing": tuple(reading["spacing"])}
    if reading["select"] is not None:
        pairs = [word.partition("=") for word in reading["select"]]
        if not all(name and index.lstrip("-").isdecimal() and len(index) < 10 for name, _, index in pairs):
            raise SettingsError(f"--select {' '.join(reading['select'])}: write for instance --select member=3")
        reading = {**reading, "select": {name: int(index) for name, _, index in pairs}}
    for name, value in reading.items():
        for number in value if isinstance(value, tuple) else (value,):
            if isinstance(number, float) and not number > 0:
                raise SettingsError(f"--{name.replace('_', '-')} is {number}: it must be above 0")
    return read_cloud(file, ReadingOptions(**reading))


def _generated(kind: str, shape: list[int] | None, spacing: list[float] | None, seed: int) -> CloudVolume:
    from cloudtomo_cl.clouds.generate import PRESETS
    from cloudtomo_cl.clouds.volume import CloudVolume

    if kind not in PRESETS:
        known = ", ".join(f"{name} ({preset.description})" for name, preset in PRESETS.items())
        raise SettingsError(f"--generate {kind} is unknown: there are {known}")
    preset = PRESETS[kind]
    grid = _grid(shape or list(preset.grid.shape), spacing)
    if spacing is None:
        # Other voxels of the preset's own domain.
        grid = preset.grid.with_shape(grid.shape)
    return CloudVolume(grid, preset.generate(grid, seed))


def _grid(shape: list[int], spacing: list[float] | None) -> Grid:
    from cloudtomo_cl.scene.grid import Grid

    try:
        return Grid(shape=tuple(shape), spacing=tuple(spacing or (1.0, 1.0, 1.0)))  # type: ignore[arg-type]
    except InvalidSettingError as error:
        first = error.details[0]
        message = first["msg"].replace("Input should be", "must be")
        raise SettingsError(f"--{first['loc'][0]}: {message}, is {first['input']}") from None


def _changed(
    volume: CloudVolume,
    crop: list[tuple[Any, Any]] | None,
    pad: list[tuple[Any, Any]] | None,
    rotate: int | None,
    coarsen: list[int] | None,
    tile: list[int] | None,
) -> CloudVolume:
    """Crop, pad, rotate, coarsen, tile: those that were asked for."""
    if crop is not None:
        volume = volume.cropped(crop)
    if pad is not None:
        volume = volume.padded(pad)
    if rotate is not None:
        volume = volume.rotated(rotate)
    if coarsen is not None:
        volume = volume.coarsened(coarsen)
    if tile is not None:
        volume = volume.tiled(*tile)
    if not volume.extinction.any():
        raise DataError("no cloud is left: extinction is zero in every voxel; crop less")
    return volume


def _pairs(option: str, words: list[str], number: Any, absent: tuple[Any, Any]) -> list[tuple[Any, Any]]:
    """x=1:2 y=3 as a pair for x, y and z; one number stands for both, an empty one for what is absent."""
    pairs = dict.fromkeys("xyz", absent)
    for word in words:
        axis, _, values = word.partition("=")
        lower, colon, upper = values.partition(":")
        try:
            if axis not in pairs or not values or (option == "crop" and not colon):
                raise ValueError
            first = number(lower) if lower else absent[0]
            pairs[axis] = (first, (number(upper) if upper else absent[1]) if colon else first)
        except ValueError:
            example = "x=0.2:0.6 z=:1.2 (km)" if option == "crop" else "x=2 z=0:4 (voxels)"
            raise SettingsError(f"--{option} {word!r} is not understood: write for instance {example}") from None
    return list(pairs.values())


def _write(output: Path, volume: CloudVolume, made: dict[str, Any]) -> None:
    from cloudtomo_cl.commands.provenance import source, versions
    from cloudtomo_cl.files.extinction import write_extinction

    attributes = {"source": source(), "settings": made, "versions": versions()}
    write_extinction(output, volume.grid, volume.extinction, attributes, volume.effective_radius, volume.wavelength)


def _write_vti(vti: Path, volume: CloudVolume) -> None:
    from cloudtomo_cl.files.vti import write_vti

    quantities = {"extinction": (volume.extinction, "km-1")}
    if volume.effective_radius is not None:
        quantities["effective_radius"] = (volume.effective_radius, "um")
    write_vti(vti, volume.grid, quantities)


def _plot(png: Path, volume: CloudVolume) -> None:
    from cloudtomo_cl.report.plots import new_figure, plot_cloud, save_figure

    figure = new_figure(10, 7.5)
    plot_cloud(figure, volume.grid, volume.extinction, volume.effective_radius)
    save_figure(png, figure)
