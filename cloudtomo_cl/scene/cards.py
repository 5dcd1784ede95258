"""Cards that notebooks show of an object (`_repr_html_`): title, facts, small pictures; no plotting library."""

from __future__ import annotations

import base64
import html
import struct
import zlib
from collections.abc import Iterable, Mapping, Sequence

import numpy as np

# Size to which pictures are scaled on the page, largest number of pixels along an axis, number of pictures shown.
_SIDE, _LARGEST, MOST_PICTURES = 112, 256, 6
# Share of the pixels that are not brighter than white.
_CUT = 0.999


def card(title: str, facts: Mapping[str, str], pictures: Sequence[tuple[str, np.ndarray]] = ()) -> str:
    """HTML of a title, a table of facts, and pictures with their names.

    pictures : name and array of each picture, row 0 at the top, all on one grey scale from 0; NaN is transparent
    """
    rows = "".join(
        f'<tr><td style="text-align:left;opacity:.7">{html.escape(name)}</td>'
        f'<td style="text-align:left">{html.escape(value)}</td></tr>'
        for name, value in facts.items()
    )
    shown = pictures[:MOST_PICTURES]
    values = [image[np.isfinite(image)] for _, image in shown]
    white = max((float(np.quantile(one, _CUT)) for one in values if one.size), default=0.0)
    drawn = "".join(_figure(name, image, white) for name, image in shown)
    more = len(pictures) - len(shown)
    rest = f'<span style="opacity:.7">and {more} more</span>' if more > 0 else ""
    return f"<div><b>{html.escape(title)}</b><table>{rows}</table><div>{drawn}{rest}</div></div>"


def table(names: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """HTML of a table."""
    head = "".join(f"<th>{html.escape(name)}</th>" for name in names)
    body = "".join("<tr>" + "".join(f"<td>{html.escape(cell)}</td>" for cell in row) + "</tr>" for row in rows)
    return f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"


def _figure(name: str, image: np.ndarray, white: float) -> str:
    step = -(-max(image.shape) // _LARGEST)
    image = image[::step, ::step]
    height, width = image.shape
    scale = _SIDE / max(height, width)
    data = base64.b64encode(png(image, white)).decode("ascii")
    return (
        '<figure style="display:inline-block;margin:4px;text-align:center">'
        f'<img alt="{html.escape(name)}" src="data:image/png;base64,{data}" '
        f'style="width:{max(width * scale, 1):.0f}px;height:{max(height * scale, 1):.0f}px;image-rendering:pixelated">'
        f'<figcaption style="font-size:80%">{html.escape(name)}</figcaption></figure>'
    )


def png(image: np.ndarray, white: float) -> bytes:
    """A PNG file of grey values from 0 (black) to `white`, with an alpha channel: NaN is transparent.

    Source: PNG (Portable Network Graphics) Specification, 2nd edition, W3C 2003, clauses 5, 9 and 11.
    """
    known = np.isfinite(image)
    grey = np.where(known, image, 0.0) / (white if white > 0 else 1.0)
    pixels = np.dstack([(grey.clip(0, 1) * 255).round(), known * 255]).astype(np.uint8)
    height, width = image.shape
    lines = np.concatenate([np.zeros((height, 1), np.uint8), pixels.reshape(height, 2 * width)], axis=1)  # no filter

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    header = struct.pack(">IIBBBBB", width, height, 8, 4, 0, 0, 0)  # 8 bits of grey and alpha
    data = zlib.compress(lines.tobytes())
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", data) + chunk(b"IEND", b"")
