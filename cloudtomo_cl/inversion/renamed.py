"""Names of earlier versions: each is answered with the one that took its place."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from cloudtomo_cl.errors import DataError

ARGUMENTS = {
    "optimizer": "solver: a GaussNewton, Adam or SGD, whose arguments were those of Optimizer",
    "keep_paths": "store_paths",
    "iteration": "stream",
}


def refuse_old_names(function: str, given: Mapping[str, Any]) -> None:
    """DataError for an argument that has another name now; TypeError for one that never was."""
    for name in given:
        if name in ARGUMENTS:
            raise DataError(f"{function}: the argument {name} is now {ARGUMENTS[name]}")
        raise TypeError(f"{function}() got an unexpected keyword argument {name!r}")
