"""`cloudtomo init`: commented settings files to start from. Imports what is slow when it runs."""

from __future__ import annotations

import argparse
from pathlib import Path

from cloudtomo_cl.commands import options, stopping
from cloudtomo_cl.errors import SettingsError

HELP = "write settings, or a whole example, to start from"

DESCRIPTION = """\
Write a commented settings file to start from: of a scene to render, or of a reconstruction; or a folder with a whole
example: a small cloud, its images, and settings that recover it within a minute.

With --cloud the views are chosen so that the whole cloud is in every image: one from above and a ring of eight.
Everything optional is there as a comment, with its default."""

EXAMPLES = """\
examples:
  cloudtomo init example
  cloudtomo init render --cloud cloud.nc
  cloudtomo init reconstruct --measurements images.nc --truth cloud.nc
  cloudtomo init render --schema scene.schema.json"""

_FILES = {"render": "scene.toml", "reconstruct": "run.toml", "example": "example"}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of the command; they are the parameters of `run`."""
    parser.add_argument("kind", choices=list(_FILES), nargs="?", default="render", help="(default: render)")
    parser.add_argument(
        "--schema", type=Path, metavar="FILE",
        help="write the JSON schema of such settings in place of settings: for editors that complete and check TOML",
    )  # fmt: skip
    parser.add_argument(
        "--output", type=options.folder, metavar="FILE", help="by default scene.toml, run.toml, or the folder example"
    )
    parser.add_argument("--cloud", type=Path, metavar="FILE", help="of a scene: the cloud that the views shall see")
    parser.add_argument("--measurements", type=Path, metavar="FILE", help="of a run: the images (default images.nc)")
    parser.add_argument("--truth", type=Path, metavar="FILE", help="of a run: the known cloud to compare with")
    options.add_overwrite(parser)
    options.add_quiet(parser)


def run(
    kind: str,
    schema: Path | None,
    output: Path | None,
    cloud: Path | None,
    measurements: Path | None,
    truth: Path | None,
    quiet: bool,
    overwrite: bool,
) -> None:
    """Writes a settings file."""
    from cloudtomo_cl.commands.new_settings import run_file, scene_file
    from cloudtomo_cl.files.netcdf import check_output
    from cloudtomo_cl.files.whole import written_whole

    if schema is not None:
        return _write_schema(kind, schema, overwrite, quiet)
    if kind == "example":
        return _example(output or Path(_FILES[kind]), (cloud, measurements, truth), overwrite, quiet)
    if kind == "render" and (measurements is not None or truth is not None):
        raise SettingsError("--measurements and --truth belong to `cloudtomo init reconstruct`")
    if kind == "reconstruct" and cloud is not None:
        raise SettingsError("--cloud belongs to `cloudtomo init render`; a known cloud to compare with is --truth")
    output = output or Path(_FILES[kind])
    if kind == "reconstruct":
        measurements = measurements or output.parent / "images.nc"
    named = [file for file in (cloud, measurements, truth) if file is not None]
    check_output(output, overwrite, inputs=named)
    if measurements is None:
        text = scene_file(cloud, output.parent)
    else:
        text = run_file(measurements, truth, output.parent)
    stopping.check()
    with written_whole(output) as partial:
        partial.write_text(text, encoding="utf-8")
    if not quiet:
        used = "--output images.nc --png previews" if kind == "render" else "--output run"
        print(f"{output} is written: look through it, then run\n  cloudtomo {kind} {output} {used}")


def _example(folder: Path, given: tuple[Path | None, ...], overwrite: bool, quiet: bool) -> None:
    """A folder with all that a first recovery needs."""
    from cloudtomo_cl.commands.example import write_example

    if any(path is not None for path in given):
        raise SettingsError("an example has a cloud of its own: --cloud belongs to `init render`, the others to a run")
    write_example(folder, overwrite, quiet)
    if not quiet:
        print(f"{folder} is ready: recover the cloud from its images by\n"
              f"  cloudtomo reconstruct {folder / 'run.toml'} --output {folder / 'run'}")  # fmt: skip


def _write_schema(kind: str, path: Path, overwrite: bool, quiet: bool) -> None:
    """The JSON schema of scene files or of run files."""
    import json

    from cloudtomo_cl.files.netcdf import check_output
    from cloudtomo_cl.files.whole import written_whole
    from cloudtomo_cl.settings.tables import ReconstructSettings, RenderSettings

    if kind == "example":
        raise SettingsError("--schema is of `init render` or `init reconstruct`: an example has both")
    check_output(path, overwrite, (".json",), "--schema")
    model: type[RenderSettings] | type[ReconstructSettings] = (
        RenderSettings if kind == "render" else ReconstructSettings
    )
    with written_whole(path) as partial:
        partial.write_text(json.dumps(model.model_json_schema(), indent=1) + "\n", encoding="utf-8")
    if not quiet:
        print(f"{path} is written: editors with a TOML server take it from a first line\n#:schema ./{path.name}")
