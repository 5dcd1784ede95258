"""Ways to spoil settings and files: keys, numbers, text, bytes, variables; each a function of random numbers."""

from __future__ import annotations

import contextlib
import copy
import json
import random
from pathlib import Path
from typing import Any

NUMBERS: list[Any] = [
    0, -1, 1, 2, 3, 0.5, -0.5, 1e-300, 1e-30, 1e30, 1e308, -1e308, 10**12, 2**31, 2**32, 2**63, 10**30, 89.999999,
    90, 180, 360, 1e-6, float("nan"), float("inf"), float("-inf"),
]  # fmt: skip
OTHERS: list[Any] = [
    True, False, "", "60", "x", "\u2603", "a\nb", "\x00", "../../etc/passwd", ".", "/", "n" * 5000, [], [1], [[]],
    [[1]], {}, {"a": 1}, {"type": "perspective"}, {"type": ["a"]}, [1, "a"], ["a"] * 3, [1.0] * 3, [1.0] * 20_000,
    [{"a": {}}], [[[[[[[1]]]]]]], [0, 0, 0], [10**30] * 3, [-1, 1, 1], [10**12] * 2, [10**7] * 3, [4, 4],
]  # fmt: skip


def toml(tables: Any) -> str:
    """A table as TOML, all values in line."""
    return "".join(f"{key(name)} = {value(entry)}\n" for name, entry in tables.items())


def key(name: str) -> str:
    return json.dumps(str(name))


def value(entry: Any) -> str:
    if isinstance(entry, bool):
        return str(entry).lower()
    if isinstance(entry, (int, float)):
        return repr(entry)
    if isinstance(entry, str):
        return json.dumps(entry)
    if isinstance(entry, dict):
        return "{" + ", ".join(f"{key(name)} = {value(inner)}" for name, inner in entry.items()) + "}"
    return "[" + ", ".join(map(value, entry)) + "]"


def places(node: Any, found: list[tuple[Any, Any]]) -> list[tuple[Any, Any]]:
    """Every (container, key) of a nest of tables and lists."""
    for name in list(node) if isinstance(node, dict) else range(len(node)):
        found.append((node, name))
        if isinstance(node[name], (dict, list)):
            places(node[name], found)
    return found


def spoilt_settings(tables: dict[str, Any], rng: random.Random) -> bytes:
    tables = json.loads(json.dumps(tables))
    for _ in range(rng.choice([1, 1, 1, 2, 5])):
        container, name = rng.choice(places(tables, []))
        what = rng.randrange(6)
        if what == 0:
            del container[name]
        elif what == 1 and isinstance(container, dict):
            container[rng.choice([str(name) + "s", str(name).upper(), "", "\u00e9", "a.b", str(name)[:-1]])] = (
                container.pop(name)
            )
        elif what == 2:
            container[name] = copy.deepcopy(rng.choice(OTHERS))
        elif what == 3 and isinstance(container[name], list):
            container[name] = container[name] * rng.choice([2, 3, 1000])
        elif what == 4 and isinstance(container, dict):
            container[rng.choice(["extra", "file", "type", "zenith", "g", "position"])] = copy.deepcopy(
                rng.choice(OTHERS + NUMBERS)
            )
        else:
            container[name] = rng.choice(NUMBERS)
        if not tables:
            break
    text = toml(tables)
    return spoilt_text(text.encode(), rng) if rng.random() < 0.25 else text.encode()


def spoilt_text(text: bytes, rng: random.Random) -> bytes:
    """Characters and lines cut, doubled, moved, exchanged."""
    content = bytearray(text)
    for _ in range(rng.choice([1, 1, 3, 10])):
        place = rng.randrange(len(content) + 1)
        what = rng.randrange(5)
        if what == 0:
            del content[place : place + rng.choice([1, 1, 5, 50])]
        elif what == 1:
            bits = [b"[", b"]", b'"', b"=", b"\x00", b"\xff", "\u2603".encode(), b"\n", b"-"]
            content[place:place] = rng.choice(bits)
        elif what == 2:
            content[place:place] = content[place : place + 30]
        elif what == 3:
            content = content[:place]
        else:
            lines = content.split(b"\n")
            rng.shuffle(lines)
            content = bytearray(b"\n".join(lines))
    return bytes(content)


def spoil(path: Path, rng: random.Random) -> None:
    if rng.random() < 0.6:
        spoil_netcdf(path, rng)
    else:
        path.write_bytes(spoilt_bytes(path.read_bytes(), rng))


def spoilt_bytes(content: bytes, rng: random.Random) -> bytes:
    damaged = bytearray(content)
    what = rng.randrange(5)
    if what == 0:
        return bytes(damaged[: rng.randrange(len(damaged) + 1)])
    if what == 1:
        start = rng.randrange(len(damaged))
        damaged[start : start + rng.choice([4, 64, 1024])] = b""
    elif what == 2:
        start = rng.randrange(len(damaged))
        length = min(rng.choice([4, 64, 1024]), len(damaged) - start)
        damaged[start : start + length] = rng.choice([b"\x00", b"\xff"]) * length
    else:
        for _ in range(rng.choice([1, 5, 50])):
            damaged[rng.randrange(len(damaged))] ^= 1 << rng.randrange(8)
    return bytes(damaged)


def spoil_netcdf(path: Path, rng: random.Random) -> None:
    """One or two things wrong in a netCDF file that is otherwise sound."""
    import numpy as np
    import xarray as xr

    with xr.open_dataset(path, decode_times=False) as opened:
        data = opened.load()
    for _ in range(rng.choice([1, 1, 2])):
        name = rng.choice(sorted(map(str, data.variables)))
        variable = data[name]
        what = rng.randrange(10)
        if what == 0:
            data = data.drop_vars(name)
        elif what == 1:
            data = data.rename({name: rng.choice([f"{name}2", name.upper(), "\u00e9", "radiance_", "beta"])})
        elif what == 2:
            data[name].attrs["units"] = rng.choice(["m", "degrees_east", "", 5, [1, 2], "g m-3", "\u00b5m", "KM"])
        elif what == 3 and variable.dims:
            dims = list(map(str, variable.dims))
            axis = rng.choice(dims)
            data = data.isel({axis: slice(0, rng.choice([0, 1, 2]))})
        elif what == 4 and variable.size and variable.dtype.kind == "f":
            values = variable.values.copy()
            values.flat[rng.randrange(values.size)] = rng.choice([np.nan, np.inf, -np.inf, -1, 1e30, 1e38, 1e-38, 0])
            data[name] = (variable.dims, values, variable.attrs)
        elif what == 5 and variable.size and variable.dtype.kind in "fiu":
            factor = rng.choice([0, -1, 1e3, 1e30, 1e-30, np.nan])
            data[name] = (variable.dims, variable.values * factor, variable.attrs)
        elif what == 6 and variable.dtype.kind in "fiub":
            kind = rng.choice(["U", "i8", "i2", "?", "f4"])
            with np.errstate(all="ignore"):
                values = variable.values.astype(kind)
            data[name] = (variable.dims, values.astype(object) if kind == "U" else values, variable.attrs)
        elif what == 7:
            data.attrs["settings"] = rng.choice(
                [5, [1, 2], "", "{", "[]", "5", '{"scene": 5}', '{"scene": []}', '{"scene": {"sun": 5}}', "[" * 5000,
                 '{"scene": {"grid": {"shape": [1e9, 1, 1]}}}', '{"scene": {"sun": {"zenith": NaN}}}']
            )  # fmt: skip
        elif what == 8 and variable.dims:
            dims = variable.dims
            values = variable.values[..., ::-1] if variable.ndim else variable.values
            data[name] = (dims, values, variable.attrs)
        elif what == 9 and variable.ndim > 1:
            data[name] = variable.expand_dims(time=2) if rng.random() < 0.5 else variable.isel({variable.dims[0]: 0})
    path.unlink()
    with contextlib.suppress(Exception):
        data.to_netcdf(path, format=rng.choice(["NETCDF4", "NETCDF4", "NETCDF3_64BIT"]))
    if not path.exists():
        path.write_bytes(b"")
