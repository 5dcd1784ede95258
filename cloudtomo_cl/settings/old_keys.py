"""Keys of earlier versions: each is answered with the one that took its place."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from cloudtomo_cl.errors import SettingsError

_SOLVER_KEYS = {
    "step": "step_size",
    "variable": "parametrisation",
    "decay1": "beta1",
    "decay2": "beta2",
    "halving": "step_half_life",
    "averaging": "iterate_average_window",
    "image_memory": "image_average_window",
}


def refuse_old_keys(path: Path, tables: Mapping[str, Any]) -> None:
    """SettingsError that names what each old key of a run file is called now."""
    lines = []
    if "optimizer" in tables:
        lines.append("[optimizer] is now [solver]")
    for table in ("optimizer", "solver"):
        given = tables.get(table)
        if not isinstance(given, Mapping):
            continue
        lines += [f"{table}.{old} is now solver.{new}" for old, new in _SOLVER_KEYS.items() if old in given]
        if given.get("gradient") == "field":
            lines.append(f'{table}.gradient "field" is now solver.gradient "adjoint"')
    if isinstance(tables.get("prior"), Mapping) and "clear" in tables["prior"]:
        lines.append("prior.clear is now prior.sparsity_scale")
    if lines:
        raise SettingsError("\n".join(f"{path}: {line}" for line in lines))
