"""Which solver: the three of this package, told apart by `type`."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import BeforeValidator, Field

from cloudtomo_cl.inversion.solvers.descent import SGD, Adam
from cloudtomo_cl.inversion.solvers.gauss_newton import GaussNewton


def _with_type(table: Any) -> Any:
    """A table without a type is of the default solver."""
    if isinstance(table, dict) and "type" not in table:
        return {"type": "gauss-newton", **table}
    return table


AnySolver = GaussNewton | Adam | SGD
# As a table of the settings.
SolverTable = Annotated[Annotated[AnySolver, Field(discriminator="type")], BeforeValidator(_with_type)]
