"""Text files: read whole as text, whatever of the usual encodings they have, or refused with what is wrong."""

from __future__ import annotations

import codecs
import os
from pathlib import Path

from cloudtomo_cl.errors import DataError
from cloudtomo_cl.files.netcdf import require_file
from cloudtomo_cl.memory import require, size_text

_MARKS = (
    (codecs.BOM_UTF8, "utf-8-sig"),
    (codecs.BOM_UTF32_LE, "utf-32"),
    (codecs.BOM_UTF32_BE, "utf-32"),
    (codecs.BOM_UTF16_LE, "utf-16"),
    (codecs.BOM_UTF16_BE, "utf-16"),
)
# Bytes of memory for each byte of a file of numbers while it is read: words, lines and arrays.
_MEMORY_PER_BYTE = 12


def read_text(path: str | os.PathLike[str], most: int | None = None, latin: bool = False) -> str:
    """The text of a file in UTF-8, or in what its byte order mark says.

    Parameters
    ----------
    path : of a regular file
    most : bytes that such a file may have; by default as many as this machine's memory takes
    latin : whether text that is not UTF-8 is Latin-1, as comments may be beside numbers

    Raises
    ------
    DataError : no such file, a pipe or a device; too large; not text, or in another encoding
    """
    path = Path(path)
    require_file(path)
    size = path.stat().st_size
    if most is not None and size > most:
        raise DataError(f"{path}: has {size_text(size)}, and is no such file: they have {size_text(most)} at most")
    require(_MEMORY_PER_BYTE * size, f"{path}: reading it", "crop it")
    try:
        content = path.read_bytes()
    except OSError as error:
        raise DataError(f"{path}: cannot be read ({error.strerror})") from None
    encoding = next((name for mark, name in _MARKS if content.startswith(mark)), None)
    if encoding is None and b"\0" in content:
        raise DataError(f"{path}: is not text: it holds zero bytes (or is UTF-16 without its mark: save it as UTF-8)")
    try:
        return content.decode(encoding or "utf-8")
    except UnicodeDecodeError as error:
        if latin and encoding is None and _is_latin(content):
            return content.decode("latin-1")
        line = content.count(b"\n", 0, error.start) + 1
        raise DataError(
            f"{path}: is not {encoding or 'UTF-8'}: byte 0x{content[error.start]:02x} on line {line}: save it as UTF-8"
        ) from None


def _is_latin(content: bytes) -> bool:
    """Whether bytes are text of a one-byte encoding: no control characters but spaces and ends of lines."""
    return not any(byte < 32 and byte not in b"\t\n\r\f\x1a" for byte in content) and 127 not in content
