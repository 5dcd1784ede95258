"""VTK's files of image data (.vti): quantities on voxels, with their units, for ParaView and its like."""

from __future__ import annotations

import os
import zlib
from collections.abc import Mapping
from typing import Any
from xml.sax.saxutils import escape, quoteattr

import numpy as np

from cloudtomo_cl.arguments import PATH, Kind, a, require_kinds
from cloudtomo_cl.errors import DataError
from cloudtomo_cl.files.whole import written_whole
from cloudtomo_cl.scene.arrays import real_numbers
from cloudtomo_cl.scene.grid import Grid

ENDINGS = (".vti",)
_NUMBERS = {"f4": "Float32", "i1": "Int8"}


def _are_pairs(quantities: Any) -> bool:
    return isinstance(quantities, Mapping) and all(
        isinstance(name, str) and isinstance(pair, tuple) and len(pair) == 2 and isinstance(pair[1], str)
        for name, pair in quantities.items()
    )


def write_vti(path: str | os.PathLike[str], grid: Grid, quantities: Mapping[str, tuple[np.ndarray, str]]) -> None:
    """Writes quantities of a grid's voxels as cell data, x, y, z in km.

    Parameters
    ----------
    path : of the file; it is replaced whole or not at all
    quantities : by name: values of the grid's shape, stored in single precision (truth values as 0 and 1), and their
        unit; the first is the one that viewers show

    Raises
    ------
    DataError : no quantity, or one of another shape or kind (InvalidArgumentError); the file cannot be written

    Source: "VTK XML File Formats" of VTK's documentation; data is appended, compressed by zlib in one block.
    """
    pairs = Kind("a dict, by names, of pairs: values and their unit", _are_pairs)
    require_kinds("write_vti", path=(path, PATH), grid=(grid, a(Grid)), quantities=(quantities, pairs))
    if not quantities:
        raise DataError(f"{path}: there is no quantity to write")
    described, data, offset = [], [], 0
    for name, (values, unit) in quantities.items():
        values = real_numbers(values, f"{path}: {name}")
        if values.shape != grid.shape:
            raise DataError(f"{path}: {name} has shape {values.shape}, the grid {grid.shape}")
        stored = values.astype("i1" if values.dtype == bool else "<f4")
        block = _block(np.ascontiguousarray(stored.T).tobytes())  # x runs fastest
        described.append(
            f'<DataArray type="{_NUMBERS[stored.dtype.str[1:]]}" Name={quoteattr(name)} format="appended" '
            f'offset="{offset}"><InformationKey name="UNITS_LABEL" location="vtkDataArray">{escape(unit)}'
            "</InformationKey></DataArray>"
        )
        data.append(block)
        offset += len(block)
    extent = " ".join(f"0 {count}" for count in grid.shape)
    origin, spacing = (" ".join(map(repr, map(float, numbers))) for numbers in (grid.origin, grid.spacing))
    head = (
        '<?xml version="1.0"?>\n<VTKFile type="ImageData" version="1.0" byte_order="LittleEndian" '
        'header_type="UInt64" compressor="vtkZLibDataCompressor">\n'
        f'<ImageData WholeExtent="{extent}" Origin="{origin}" Spacing="{spacing}">\n<Piece Extent="{extent}">\n'
        f"<CellData Scalars={quoteattr(next(iter(quantities)))}>\n" + "\n".join(described) + "\n</CellData>\n"
        '</Piece>\n</ImageData>\n<AppendedData encoding="raw">\n_'
    )
    with written_whole(path) as partial:
        partial.write_bytes(b"".join([head.encode(), *data, b"\n</AppendedData>\n</VTKFile>\n"]))


def _block(values: bytes) -> bytes:
    """Bytes as VTK keeps them: the number of blocks, their size, that of a last smaller one, compressed sizes."""
    packed = zlib.compress(values)
    return np.array([1, len(values), 0, len(packed)], "<u8").tobytes() + packed
