"""What files keep of the settings that they were made with, in the types of JSON."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import TypeAdapter, ValidationError
from pydantic_core import PydanticSerializationError, to_json

from cloudtomo_cl.errors import SettingsError
from cloudtomo_cl.files.extinction import read_effective_radius, read_extinction
from cloudtomo_cl.files.stored_settings import read_settings
from cloudtomo_cl.messages import error_text, lines_of
from cloudtomo_cl.scene.noise import Noise
from cloudtomo_cl.scene.scene import Scene
from cloudtomo_cl.settings.overrides import with_overrides


def kept_scene(
    path: Path, overrides: Sequence[str], wavelength: float | None = None
) -> tuple[Scene, np.ndarray, np.ndarray | None, dict[str, Any]]:
    """Scene, extinction, effective radius and settings that a file of images or fluxes keeps, at a wavelength."""
    stored = read_settings(path, wavelength=wavelength)
    if not isinstance(stored.get("scene"), dict):
        raise SettingsError(f"{path}: keeps no scene to render again: give a scene file, or images of cloudtomo render")
    described = scene_of_tables(path, with_overrides(stored["scene"], overrides))
    _, extinction = read_extinction(path, wavelength)
    return described, extinction, read_effective_radius(path), {"cloud_file": path.name, **stored}


def scene_of_tables(path: Path, tables: dict[str, Any]) -> Scene:
    """The scene of what `stored_scene` made, or of tables in its place. SettingsError if it is none."""
    try:
        return TypeAdapter(Scene).validate_json(_json(path, tables), strict=True)
    except ValidationError as error:
        lines = lines_of(error, tables, TypeAdapter(Scene).json_schema())
        raise SettingsError(error_text(str(path), lines)) from None


def _json(path: Path, tables: Any) -> bytes:
    """Tables as JSON, which is checked as strictly as TOML: "60" is no number. SettingsError if they are none."""
    try:
        return to_json(tables)
    except (PydanticSerializationError, ValueError, RecursionError) as error:
        raise SettingsError(f"{path}: stores settings that are none: {error}") from None


def noise_of_table(path: Path, table: Any) -> Noise:
    """The noise that a file of images keeps, as `stored_noise` made it. SettingsError if it is none."""
    try:
        return TypeAdapter(Noise).validate_json(_json(path, table), strict=True)
    except ValidationError as error:
        lines = lines_of(error, table if isinstance(table, dict) else {}, TypeAdapter(Noise).json_schema())
        raise SettingsError(error_text(str(path), [f"noise: {line}" for line in lines])) from None


def stored_noise(noise: Noise) -> dict[str, Any]:
    """Noise in the types of JSON: what a measurements file keeps of it."""
    return TypeAdapter(Noise).dump_python(noise, mode="json")


def stored_scene(scene: Scene) -> dict[str, Any]:
    """A scene in the types of JSON: what a measurements file keeps of it."""
    tables: dict[str, Any] = TypeAdapter(Scene).dump_python(scene, mode="json")
    if scene.wavelength is None:
        del tables["wavelength"]  # as before there were any
    return tables
