"""The files that a command reads: a settings file, and those that it names."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from cloudtomo_cl.files.netcdf import is_netcdf
from cloudtomo_cl.settings.tables import read_tables


def input_files(path: Path, overrides: Sequence[str] = ()) -> tuple[Path, ...]:
    """A file and, if it holds settings, all files that these name (clouds, phase functions, rays, images, priors).

    Parameters
    ----------
    path : a settings file, or netCDF
    overrides : `key=value`, see `overrides.with_overrides`

    Raises
    ------
    SettingsError : the file is neither netCDF nor TOML
    """
    if is_netcdf(path):
        return (path,)
    return (path, *_named(read_tables(path, overrides), path.parent))


def _named(tables: Any, folder: Path) -> Iterator[Path]:
    """What keys `file` have in tables, and in tables and lists inside of these."""
    if isinstance(tables, list):
        for table in tables:
            yield from _named(table, folder)
    elif isinstance(tables, dict):
        for name, value in tables.items():
            if name == "file" and isinstance(value, str):
                yield folder / value
            else:
                yield from _named(value, folder)
