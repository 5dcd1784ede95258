"""The settings that files keep of how they were made, as their JSON attribute `settings`."""

from __future__ import annotations

import json
import os
from typing import Annotated, Any

from pydantic import ConfigDict, Field, ValidationError
from pydantic.dataclasses import dataclass

from cloudtomo_cl.errors import DataError, SettingsError
from cloudtomo_cl.files.netcdf import load_dataset
from cloudtomo_cl.files.wavelengths import at_wavelength


def read_settings(
    path: str | os.PathLike[str], required: bool = True, wavelength: float | None = None
) -> dict[str, Any]:
    """The settings that were written with a file of measurements.

    Parameters
    ----------
    path : of the file
    required : whether a file without any, from elsewhere, is refused; otherwise it has an empty table
    wavelength : nm, of which the scene is, where the file holds several

    Raises
    ------
    DataError : no such file, not netCDF; no attribute `settings`, or it is not a JSON table
    SettingsError : a number in it cannot be
    """
    text = at_wavelength(path, load_dataset(path), wavelength).attrs.get("settings")
    if text is None and not required:
        return {}
    if text is None:
        raise DataError(f"{path}: no attribute settings: the file was written without them")
    try:
        settings = json.loads(text)
    except (TypeError, ValueError, RecursionError):
        settings = None
    if not isinstance(settings, dict):
        raise DataError(f"{path}: the attribute settings is not a JSON table")
    _check_settings(path, settings)
    if "iteration" in settings:
        settings = {"stream": settings.pop("iteration"), **settings}
    return settings


@dataclass(frozen=True, config=ConfigDict(strict=True, extra="ignore"))
class _StoredNumbers:
    """What files keep of how they were made, beside the tables that have models of their own.

    `iteration` is what earlier versions called `stream`, the random numbers'.
    """

    seed: Annotated[int, Field(ge=0, lt=2**32)] = 0
    samples: Annotated[int, Field(ge=1, lt=2**31)] = 1
    stream: Annotated[int, Field(ge=0, lt=2**32)] = 0
    iteration: Annotated[int, Field(ge=0, lt=2**32)] = 0
    target_error: Annotated[float, Field(gt=0, lt=10)] = 1.0
    photons: Annotated[float, Field(ge=1, le=1e15)] = 1.0
    cloud_file: str = ""


def _check_settings(path: Any, settings: dict[str, Any]) -> None:
    """Checks what is stored as it would be in a settings file. SettingsError names the key."""
    known = {name: value for name, value in settings.items() if name in _StoredNumbers.__dataclass_fields__}
    try:
        _StoredNumbers(**known)
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(str(part) for part in first["loc"][:1])
        shown = repr(known.get(key))[:60]
        raise SettingsError(
            f"{path}: its attribute settings stores {key} = {shown}: "
            f"{first['msg'].replace('Input should be', 'it must be')}; render or reconstruct it again"
        ) from None
