"""Phase functions of droplets: densities over the sphere in sr^-1, integral 1.

`cosine` is the cosine of the scattering angle, 1 for light that goes straight on. Each class has
the asymmetry `g`, the mean of that cosine, and `density(cosine)`.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BeforeValidator, ConfigDict, Field
from pydantic.dataclasses import dataclass

from cloudtomo_cl.arguments import place, require_kinds
from cloudtomo_cl.errors import InvalidSettingError
from cloudtomo_cl.messages import answering
from cloudtomo_cl.scene.arrays import as_numbers

# Largest error of a table's integral: rounded values and coarse angles pass, another
# normalisation does not.
NORMALISATION_TOLERANCE = 0.01
# Errors of an integral up to this are rounding: then the table is left as it is, bit by bit.
_ROUNDING = 1e-12


def _tuples(value: Any) -> Any:
    """Lists and arrays as nested tuples."""
    if isinstance(value, np.ndarray):
        value = value.tolist()
    return tuple(_tuples(entry) for entry in value) if isinstance(value, (list, tuple)) else value


def _rows(value: Any) -> Any:
    """Rows of a table as nested tuples; a single row may come without the brackets around it."""
    value = _tuples(value)
    return (value,) if isinstance(value, tuple) and value and not isinstance(value[0], tuple) else value


Asymmetry = Annotated[float, Field(ge=-0.99, le=0.99)]
_Degrees = Annotated[float, Field(ge=0, le=180)]
_Density = Annotated[float, Field(ge=0, allow_inf_nan=False)]
_Radius = Annotated[float, Field(gt=0, allow_inf_nan=False)]
_Fraction = Annotated[float, Field(ge=0, le=1)]


def _henyey_greenstein(cosine: np.ndarray | float, g: float) -> np.ndarray:
    """Henyey and Greenstein 1941, Eq. 2, as a density over the sphere, sr^-1."""
    return (1 - g**2) / (4 * np.pi * (1 + g**2 - 2 * g * as_numbers(cosine, "cosine")) ** 1.5)


@answering
@dataclass(frozen=True, config=ConfigDict(extra="forbid"))
class HenyeyGreenstein:
    """Henyey and Greenstein 1941.

    Attributes
    ----------
    g : asymmetry, the mean cosine of the scattering angle, positive for forward scattering. Beyond
        0.99 the peak is too sharp for the kernels' single precision.
    """

    g: Asymmetry
    type: Literal["henyey-greenstein"] = "henyey-greenstein"

    def density(self, cosine: np.ndarray | float) -> np.ndarray:
        """The phase function, sr^-1, shape of `cosine`."""
        return _henyey_greenstein(cosine, self.g)


@answering
@dataclass(frozen=True, config=ConfigDict(extra="forbid"))
class DoubleHenyeyGreenstein:
    """A forward and a backward lobe (Irvine 1965): the sum of two of Henyey and Greenstein's.

    Attributes
    ----------
    forward_g, backward_g : asymmetries of the two lobes, -0.99 to 0.99; the second is usually negative
    forward_fraction : share of the light in the forward lobe, 0 to 1
    """

    forward_g: Asymmetry
    backward_g: Asymmetry
    forward_fraction: _Fraction
    type: Literal["double-henyey-greenstein"] = "double-henyey-greenstein"

    @property
    def g(self) -> float:
        """The asymmetry of the sum."""
        return self.forward_fraction * self.forward_g + (1 - self.forward_fraction) * self.backward_g

    def density(self, cosine: np.ndarray | float) -> np.ndarray:
        """The phase function, sr^-1, shape of `cosine`."""
        forward, backward = (_henyey_greenstein(cosine, g) for g in (self.forward_g, self.backward_g))
        return self.forward_fraction * forward + (1 - self.forward_fraction) * backward


@answering
@dataclass(frozen=True, config=ConfigDict(extra="forbid"))
class TabulatedPhaseFunction:
    """A phase function from a table, for instance from Mie theory, for one or several droplet radii.

    Between the angles of the table it is linear in the cosine of the angle. Its integral over
    the sphere must be 1 within 1 % (`normalised` takes any other table); it is then made 1.

    Attributes
    ----------
    angle : n >= 2 scattering angles, degrees, increasing from 0 to 180
    values : a row of n densities, sr^-1, for each effective radius; one row if there is no radius
    effective_radius : effective radius of each row's droplets, micrometres, increasing; may be empty
    single_scattering_albedo : single-scattering albedo of each row's droplets, 0 to 1; None: the Cloud's
    """

    angle: Annotated[tuple[_Degrees, ...], BeforeValidator(_tuples), Field(min_length=2)]
    values: Annotated[tuple[tuple[_Density, ...], ...], BeforeValidator(_rows), Field(min_length=1)]
    effective_radius: Annotated[tuple[_Radius, ...], BeforeValidator(_tuples)] = ()
    single_scattering_albedo: Annotated[tuple[_Fraction, ...], BeforeValidator(_tuples)] | None = None
    type: Literal["table"] = "table"

    def __repr__(self) -> str:
        radii = self.effective_radius
        text = f", effective radius {radii[0]:g} to {radii[-1]:g} um ({len(radii)})" if radii else ""
        return f"TabulatedPhaseFunction({len(self.angle)} angles{text})"

    def __post_init__(self) -> None:
        angle, count = np.array(self.angle), max(len(self.effective_radius), 1)
        if angle[0] != 0 or angle[-1] != 180:
            raise ValueError(
                f"angle runs from {angle[0]:g} to {angle[-1]:g} degrees: it must run from exactly 0 to exactly 180"
            )
        _check_increasing("angle", angle)
        _check_increasing("effective_radius", np.array(self.effective_radius))
        if len(self.values) != count:
            raise ValueError(
                f"values has {len(self.values)} rows: it must have {count}, one for each effective_radius (one if none)"
            )
        for index, row in enumerate(self.values):
            if len(row) != len(angle):
                raise ValueError(f"values[{index}] has {len(row)} entries: angle has {len(angle)}")
        if self.single_scattering_albedo is not None and len(self.single_scattering_albedo) != count:
            raise ValueError(
                f"single_scattering_albedo has {len(self.single_scattering_albedo)} entries: it must have {count}, "
                "one for each row of values"
            )
        values = np.array(self.values)
        integral = sphere_integral(angle, values)
        wrong = ~(np.abs(integral - 1) <= NORMALISATION_TOLERANCE)
        if wrong.any():
            worst = int(np.argmax(wrong))
            raise ValueError(
                f"values[{worst}] integrates to {integral[worst]:.6g} over the sphere{_guess(integral[worst])}; it "
                "must be 1 within 1 %, in sr^-1, linear in the cosine between the angles: divide the values by "
                "their integral, as TabulatedPhaseFunction.normalised does, or give more angles in the forward peak"
            )
        if (np.abs(integral - 1) > _ROUNDING).any():
            object.__setattr__(self, "values", _tuples(values / integral[:, None]))

    @classmethod
    def normalised(
        cls,
        angle: Any,
        values: Any,
        effective_radius: Any = (),
        single_scattering_albedo: Any = None,
    ) -> TabulatedPhaseFunction:
        """A table of any normalisation (4 pi, intensities ...), divided by its integral over the sphere.

        Parameters
        ----------
        as the attributes of the class, but `values` in any unit

        Raises
        ------
        InvalidSettingError : a row whose integral is zero or not finite, and as the class does
        """
        angle = as_numbers(angle, "angle")
        values = np.atleast_2d(as_numbers(values, "values"))
        if angle.ndim == 1 and values.shape[1:] == angle.shape and len(angle) >= 2:
            integral = sphere_integral(angle, values)
            if not (np.isfinite(integral) & (integral > 0)).all():
                raise InvalidSettingError(
                    f"values integrate to {list(integral)} over the sphere: they cannot be normalised"
                )
            values = values / integral[:, None]
        return cls(angle, values, effective_radius, single_scattering_albedo)

    @property
    def g(self) -> float:
        """The asymmetry of the middle row."""
        return float(self.asymmetry()[len(self.values) // 2])

    def asymmetry(self) -> np.ndarray:
        """The mean cosine of the scattering angle for each row, shape (k,)."""
        angle, values = np.radians(self.angle), np.array(self.values)
        step, middle = _cosine_steps(angle), (np.cos(angle[1:]) + np.cos(angle[:-1])) / 2
        mean, fall = (values[:, :-1] + values[:, 1:]) / 2, values[:, :-1] - values[:, 1:]
        # The integral of a product of two linear functions, exactly.
        return 2 * np.pi * ((mean * middle + fall * step / 12) * step).sum(axis=1)

    def density(self, cosine: np.ndarray | float, row: int | None = None) -> np.ndarray:
        """The phase function of a row (default: the middle one), sr^-1, shape of `cosine`.

        Raises
        ------
        InvalidArgumentError : cosine holds no numbers, or row is none of the table's
        """
        require_kinds("TabulatedPhaseFunction.density", row=(row, place(len(self.values)).or_none()))
        row = len(self.values) // 2 if row is None else row
        nodes = np.cos(np.radians(self.angle))
        return np.interp(as_numbers(cosine, "cosine"), nodes[::-1], np.array(self.values[row])[::-1])


def _check_increasing(name: str, values: np.ndarray) -> None:
    wrong = np.flatnonzero(~(np.diff(values) > 0))
    if len(wrong):
        index = int(wrong[0]) + 1
        raise ValueError(
            f"{name} must increase: entry {index} is {values[index]:g}, the one before it {values[index - 1]:g}"
        )


def _guess(integral: float) -> str:
    """What the author of a table with this integral may have meant."""
    if abs(integral / (4 * np.pi) - 1) <= 0.05:
        return " (its normalisation is the common one to 4 pi)"
    if abs(integral / (2 * np.pi) - 1) <= 0.05:
        return " (its integral over the cosine alone is 1)"
    return ""


def _cosine_steps(angle: np.ndarray) -> np.ndarray:
    """cos(angle[i]) - cos(angle[i + 1]), without the cancellation near 0 and 180 degrees; radians."""
    return 2 * np.sin((angle[1:] + angle[:-1]) / 2) * np.sin((angle[1:] - angle[:-1]) / 2)


def sphere_integral(angle: np.ndarray, values: np.ndarray) -> np.ndarray:
    """The integral over the sphere of a table that is linear in the cosine between its angles.

    Parameters
    ----------
    angle : scattering angles, degrees, shape (n,)
    values : densities at these angles, shape (..., n)

    Returns
    -------
    integral : integral, unit of values times sr, shape (...)
    """
    values = np.asarray(values, dtype=np.float64)
    return np.pi * ((values[..., 1:] + values[..., :-1]) * _cosine_steps(np.radians(angle))).sum(axis=-1)


def _with_type(table: Any) -> Any:
    """A table of settings with g but no type is a `HenyeyGreenstein`."""
    if isinstance(table, dict) and "type" not in table and "g" in table:
        return {"type": "henyey-greenstein", **table}
    return table


AnyPhaseFunction = HenyeyGreenstein | DoubleHenyeyGreenstein | TabulatedPhaseFunction
# A phase function as a table of the settings.
PhaseFunction = Annotated[
    Annotated[AnyPhaseFunction, Field(discriminator="type")],
    BeforeValidator(_with_type),
]
