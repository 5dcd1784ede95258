"""The choice among the three solvers of this package, by their `type`."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import BeforeValidator, Field

from cloudtomo_cl.inversion.solvers.descent import SGD, Adam
from cloudtomo_cl.inversion.solvers.gauss_newton import GaussNewton


def of_default_type(name: str) -> BeforeValidator:
    """A validator that takes a table without a type for one of the type `name`."""

    def with_type(table: Any) -> Any:
        return {"type": name, **table} if isinstance(table, dict) and "type" not in table else table

    return BeforeValidator(with_type)


AnySolver = GaussNewton | Adam | SGD
# A solver as a table of the settings.
SolverTable = Annotated[Annotated[AnySolver, Field(discriminator="type")], of_default_type("gauss-newton")]
