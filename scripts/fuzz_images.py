"""Writes images of known views into netCDF files of many forms, and checks that they are read as what they are.

    python scripts/fuzz_images.py [--cases 2000] [--first 0] [--seed 0]

The counterpart of fuzz_netcdf.py, whose loop it shares, for files of measurements: units of radiances and of every
field of the views in many spellings, absent ones, other orders of dimensions, rows, columns and vector components,
packing, fill values of every convention, flags, lists of rays, views' keys that are not given, and what nobody can
read. The oracle is the images, their errors and the views. A case is right, refused (with a message), or wrong.
"""

from __future__ import annotations

import random
import sys
from pathlib import Path
from typing import Any

import netCDF4
import numpy as np
from fuzz_netcdf import DEFAULT_FILL, Case, run_cases

from cloudtomo_cl.errors import CloudtomoError
from cloudtomo_cl.files.measurements import OPTIONAL_VIEW_FIELDS, VIEW_FIELDS, read_measurements
from cloudtomo_cl.scene.measurements import Measurements
from cloudtomo_cl.scene.sensors import OrthographicView, PerspectiveView, PushBroomView, RadiometerView, RayView

LENGTHS = {"km": 1.0, "m": 1e3, "kilometers": 1.0, "metre": 1e3, "cm": 1e5, "ft": 1 / 0.3048e-3}
ANGLES = {"degree": 1.0, "degrees": 1.0, "deg": 1.0, "radian": np.pi / 180, "rad": np.pi / 180, "°": 1.0}
NUMBERS = {"1": 1.0, "%": 100.0, "percent": 100.0}
RADIANCES = {
    "W m-2 sr-1": 1.0, "W m^-2 sr^-1": 1.0, "W/(m^2 sr)": 1.0, "W m**-2 sr**-1": 1.0, "mW m-2 sr-1": 1e3,
    "W/m2/sr": 1.0, "mW cm-2 sr-1": 0.1, "watt m-2 sr-1": 1.0, "W·m⁻²·sr⁻¹": 1.0, "kg s-3 sr-1": 1.0,
}  # fmt: skip
UNITS = {"km": LENGTHS, "degree": ANGLES}
OTHER_UNITS = {"km": ["degree", "hPa", "s", "1"], "degree": ["km", "K", "1"], "1": ["km", "K"]}


def some_views(rng: random.Random) -> tuple[Any, ...]:
    """Two to four views of several kinds, of different sizes or of one."""

    def pixels() -> tuple[int, int]:
        return rng.choice([(5, 4), (5, 4), (3, 6), (4, 4)])

    def number(lower: float, upper: float) -> float:
        return round(rng.uniform(lower, upper), 3)

    def place(height: tuple[float, float]) -> tuple[float, float, float]:
        return number(-2, 2), number(-2, 2), number(*height)

    makers = [
        lambda: PerspectiveView(place((1.5, 9)), place((0, 1)), number(8, 60), pixels()),
        lambda: PerspectiveView(place((1.5, 9)), place((0, 1)), number(8, 60), pixels(), up=(0.1, 1.0, 0.2)),
        lambda: OrthographicView(number(0.5, 3), pixels(), zenith=number(8, 70), azimuth=number(10, 350)),
        lambda: OrthographicView(number(0.5, 3), pixels(), zenith=number(8, 70), target=place((0, 1)), aspect=1.25),
        lambda: PushBroomView((number(-2, -1), 0.1, 3.0), (1.2, number(0, 1), 3.0), 25.0, pixels(), number(-60, 60)),
        lambda: RadiometerView(number(8, 70), pixels(), azimuth=number(10, 350)),
        lambda: _rays(rng, pixels()),
    ]
    return tuple(rng.choice(makers)() for _ in range(rng.choice([2, 3, 4])))


def _rays(rng: random.Random, pixels: tuple[int, int]) -> RayView:
    generator = np.random.default_rng(rng.randrange(1000))
    count = pixels[0] * pixels[1]
    directions = generator.normal(size=(count, 3)) - np.array([0, 0, 2.0])
    return RayView(generator.uniform(0.1, 2, (count, 3)), directions, pixels)


class Writer(Case):
    """A case: the file that it draws, and what must come of it."""

    def __init__(self, rng: random.Random) -> None:
        super().__init__(rng)
        self.options: dict[str, Any] = {}
        self.views = some_views(rng)
        generator = np.random.default_rng(rng.randrange(10_000))
        self.images = [generator.uniform(0.05, 0.2, view.pixels[::-1]) for view in self.views]
        self.errors = [0.01 * image for image in self.images]
        self.gains = [round(rng.uniform(0.0, 0.05), 3) for _ in self.views] if self.chance(0.4) else None
        if self.chance(0.5):
            for image in self.images:
                image[rng.randrange(image.shape[0]), rng.randrange(image.shape[1])] = np.nan
        # Marks of missing numbers that somebody may write into keys that a view does not have.
        self.absent = rng.choice([np.nan, np.nan, "fill", "fill"])
        # One unit of lengths and one of angles in a file, or one for each field.
        self.common = {"km": rng.choice(list(LENGTHS)), "degree": rng.choice(list(ANGLES))}
        self.mixed = self.chance(0.3)

    def write(self, path: Path) -> None:
        rng = self.rng
        format = rng.choice(["NETCDF4", "NETCDF4", "NETCDF3_64BIT_OFFSET", "NETCDF4_CLASSIC"])
        with netCDF4.Dataset(path, "w", format=format) as file:
            self.file = file
            self.rows = max(view.pixels[1] for view in self.views)
            self.columns = max(view.pixels[0] for view in self.views)
            for name, count in (("view", len(self.views)), ("row", self.rows), ("column", self.columns), ("axis", 3)):
                file.createDimension(name, count)
            self.axes()
            self.sizes()
            self.pictures()
            self.fields()
            self.rays()
            self.distract()

    def variable(self, name: str, kind: str, dims: tuple[str, ...], values: Any, fill: Any = False, **attributes: Any):
        """A variable with its dimensions in some order."""
        order = list(range(len(dims)))
        if self.chance(0.3):
            self.rng.shuffle(order)
        variable = self.file.createVariable(name, kind, tuple(dims[index] for index in order), fill_value=fill)
        variable.set_auto_maskandscale(False)
        variable[:] = np.asarray(values).transpose(order)
        variable.setncatts(attributes)
        return variable

    # ---- coordinates

    def axes(self) -> None:
        """In which order rows, columns and components come, and whether the file says so."""
        rng, self.order = self.rng, {}  # type: ignore[var-annotated]
        equal = len({view.pixels for view in self.views}) == 1
        for name, count in (("row", self.rows), ("column", self.columns)):
            numbers, attributes = np.arange(count), {}
            what = rng.random()
            if what < 0.2:
                self.order[name] = slice(None, None, -1)
                numbers = numbers[::-1]
                if name == "row" and equal and self.chance(0.3):
                    numbers, attributes = np.arange(count), {"positive": "up"}
            elif what < 0.3 and self.careless:
                numbers = rng.choice([numbers * 2, numbers // 2, numbers + 0.3 * numbers])
                self.spoil(f"{name} does not number")
            elif what < 0.5:
                continue
            variable = self.file.createVariable(name, rng.choice(["i4", "f8", "f4"]), (name,))
            variable[:] = numbers + (0 if self.careless and self.told else rng.choice([0, 0, 1]))
            variable.setncatts(attributes)
        self.letters = [0, 1, 2]
        if self.chance(0.3):
            rng.shuffle(self.letters)
        named = ["xyz"[index] for index in self.letters]
        if self.slips(0.1):
            named = ["east", "north", "up"]
            self.spoil("components have other names")
        elif self.letters == [0, 1, 2] and self.chance(0.3):
            return
        if self.file.data_model == "NETCDF4" and self.chance(0.5):
            self.file.createVariable("axis", str, ("axis",))[:] = np.array(named, object)
        else:
            self.file.createVariable("axis", "S1", ("axis",))[:] = np.array([name[0] for name in named], "S1")

    def sizes(self) -> None:
        kind = self.rng.choice(["i4", "f8", "i2"])
        heights, widths = ([view.pixels[index] for view in self.views] for index in (1, 0))
        if self.slips(0.06):
            heights, widths = widths, heights
            self.spoil("height and width are swapped")
        for name, values in (("image_height", heights), ("image_width", widths)):
            self.variable(name, kind, ("view",), values, units="1")
        types = [view.type for view in self.views]
        if self.slips(0.04):
            types[0] = self.rng.choice(["pinhole", "", "orthographic "])
            self.spoil("another type of view")
        if self.file.data_model == "NETCDF4" and self.chance(0.6):
            self.file.createVariable("view_type", str, ("view",))[:] = np.array(types, object)
            return
        self.file.createDimension("letters", 14)
        letters = self.file.createVariable("view_type", "S1", ("view", "letters"))
        if self.chance(0.7):
            letters._Encoding = "utf-8"
        letters.set_auto_chartostring(False)
        letters[:] = netCDF4.stringtochar(np.array(types, "S14"))

    # ---- radiances

    def block(self, images: list[np.ndarray]) -> np.ndarray:
        """Images beside each other, in the file's order of rows and columns."""
        values = np.full((len(images), self.rows, self.columns), np.nan)
        for index, image in enumerate(images):
            values[index, : image.shape[0], : image.shape[1]] = image
        return values[:, self.order.get("row", slice(None)), self.order.get("column", slice(None))]

    def pictures(self) -> None:
        rng = self.rng
        units = rng.choice(list(RADIANCES))
        values, errors = self.block(self.images), self.block(self.errors)
        flagged = self.chance(0.3)
        if flagged:
            self.flags(np.isfinite(values) | np.isnan(errors))
            values = np.where(np.isnan(values) & np.isfinite(errors), 0.123, values)
        if self.slips(0.1) and not flagged:
            place = tuple(rng.choice(np.argwhere(np.isfinite(values)).tolist()))
            # A mark of -1 in a small unit may as well be noise.
            marks = [-999.0, -9999.9, 1e20, -99.0, *([-1.0] if RADIANCES[units] == 1.0 else [])]
            values[place] = rng.choice(marks) / RADIANCES[units]
            self.spoil("an undeclared fill in a pixel")
        if self.slips(0.05):
            values[np.isnan(values) & np.isnan(errors)] = 0.0
            if not np.isnan(self.block(self.errors)).any():
                self.told.append("nothing beyond the images")
            else:
                self.spoil("zeros beyond the images")
        own = rng.choice(list(RADIANCES)) if self.chance(0.3) else units
        if self.slips(0.08):
            index = tuple(rng.choice(np.argwhere(np.isfinite(values)).tolist()))
            errors[index] = rng.choice([np.nan, -0.1, np.inf])
            self.spoil("an error that cannot be")
        self.put("radiance", values, units)
        self.put("radiance_standard_error", errors, own)

    def put(self, name: str, values: np.ndarray, units: str) -> None:
        """Radiances, or their errors, packed or not, with missing ones marked in some way."""
        rng, dims = self.rng, ("view", "row", "column")
        attributes: dict[str, Any] = {"units": units}
        factor = RADIANCES[units]
        what = rng.random() if self.careless else 1.0
        if what < 0.06:
            attributes = rng.choice([{}, {"units": ""}])
            self.spoil(f"{name} without units, in {units}")
            if factor == 1.0 or name == "radiance":  # nobody can know
                factor = 1.0
        elif what < 0.1:
            attributes = {"units": rng.choice(["1", "W m-2", "K", "W m-2 sr-1 um-1", "W m-2 nm-1 sr-1", "furlong"])}
            self.spoil(f"{name} in {attributes['units']}")
        stored = values * factor
        kind = rng.choice(["f8", "f8", "packed", "scaled"])
        if not np.isfinite(stored[~np.isnan(stored)]).all() or np.nanmax(np.abs(stored)) > 10 * 0.2 * factor:
            kind = "f8"
        missing = np.isnan(stored)
        if kind == "packed":
            scale = float(np.nanmax(stored)) / 2**30
            stored = np.round(stored / scale)
            attributes.update(scale_factor=scale, add_offset=0.0)
            if self.chance(0.3):
                stored, attributes["add_offset"] = stored - 1000.0, 1000.0 * scale
        elif kind == "scaled":
            attributes["scale_factor"] = rng.choice([1, 2, 0.5])
            stored = stored / attributes["scale_factor"]
        number = {"packed": "i4"}.get(kind, "f8")
        told = ["_FillValue", "missing_value", "FillValue", "nodata", "default"]
        # A valid range would tell of a mark that nothing else tells of.
        told += ["nan", "valid_range"] * (kind == "f8" and "an undeclared fill in a pixel" not in self.told)
        how = rng.choice(told)
        fill = DEFAULT_FILL[number] if how == "default" else -9999 if number == "i4" else -9999.0
        if how == "nan":
            fill = np.nan
        if how == "valid_range":
            attributes["valid_range"] = np.array([0.0, 100 * factor])
        elif how in ("missing_value", "FillValue", "nodata"):
            attributes[how] = np.array(fill, number)
        stored = np.where(missing, fill, stored)
        number = "f8" if not (np.abs(stored[~np.isnan(stored)]) < 2**31).all() else number
        stored = stored.astype(number)
        self.variable(name, number, dims, stored, fill if how == "_FillValue" else False, **attributes)

    def flags(self, good: np.ndarray) -> None:
        rng = self.rng
        attributes: dict[str, Any] = {}
        values = good.astype(np.int8)
        fill: Any = False
        what = rng.random()
        if what < 0.3:
            attributes = {
                "flag_values": np.array([0, 1], "i1"),
                "flag_meanings": rng.choice(["bad good", "invalid valid"]),
            }
        elif what < 0.5:
            fill = np.int8(0)
        elif what < 0.6 and self.careless:
            attributes = {"flag_values": np.array([0, 1], "i1"), "flag_meanings": "good bad"}
            values = 1 - values
            self.spoil("flags the other way round")
        elif what < 0.7 and self.careless:
            values = np.where(good, 1, 3).astype(np.int8)
            self.spoil("flags of several values")
        self.variable("valid", "i1", ("view", "row", "column"), values, fill, **attributes)

    # ---- views

    def fields(self) -> None:
        rng = self.rng
        for name, (extra, unit, _) in VIEW_FIELDS.items():
            given = [getattr(view, name, None) for view in self.views]
            if name in OPTIONAL_VIEW_FIELDS and not any(value is not None for value in given):
                continue
            nothing = (np.nan,) * 3 if extra else np.nan
            values = np.array([nothing if value is None else value for value in given], float)
            if extra:
                values = values[:, self.letters]
            self.field(name, ("view", *extra), unit, values)
        if self.gains is not None:
            units = rng.choice(list(NUMBERS))
            self.variable("calibration_error", "f8", ("view",), np.array(self.gains) * NUMBERS[units], units=units)

    def field(self, name: str, dims: tuple[str, ...], unit: str, values: np.ndarray) -> None:
        rng = self.rng
        known = UNITS.get(unit, {"1": 1.0})
        units = rng.choice(list(known)) if self.mixed else self.common.get(unit, "1")
        factor, attributes = known[units], {"units": units}
        what = rng.random() if self.careless else 1.0
        there = bool(np.isfinite(values).any())
        if what < 0.06 and there:
            attributes = rng.choice([{}, {"units": ""}])
            self.spoil(f"{name} without units, in {units}")
        elif what < 0.09 and there:
            attributes = {"units": rng.choice(OTHER_UNITS[unit])}
            if (attributes["units"], unit) != ("1", "1"):
                self.spoil(f"{name} in {attributes['units']}")
        elif what < 0.12 and np.isfinite(values).any() and values.ndim == 2:
            index = int(np.argmax(np.isfinite(values).all(axis=1)))
            values = values.copy()
            values[index, 1] = np.nan
            self.spoil(f"{name} is missing in part")
        if unit == "1" and attributes.get("units") == "1":
            attributes = rng.choice([{}, {"units": "1"}])
        stored, fill = values * factor, False
        if self.absent == "fill":
            how = rng.choice(["_FillValue", "missing_value", "missing_value"])
            stored = np.where(np.isnan(stored), -9999.0, stored)
            if how == "_FillValue":
                fill = -9999.0
            else:
                attributes["missing_value"] = -9999.0
            if self.slips(0.08) and np.isnan(values).any():
                attributes.pop("missing_value", None)
                fill = False
                self.spoil(f"{name} has an undeclared fill")
        self.variable(name, "f8", dims, stored, fill, **attributes)

    def rays(self) -> None:
        lists = [view for view in self.views if isinstance(view, RayView)]
        if not lists:
            return
        origins = np.concatenate([view.origins for view in lists])[:, self.letters]
        directions = np.concatenate([view.directions for view in lists])[:, self.letters]
        if self.slips(0.1):
            chosen = self.rng.choice([np.arange(len(origins) - 1), np.append(0, np.arange(len(origins)))])
            origins, directions = origins[chosen], directions[chosen]
            self.spoil("another number of rays")
        self.file.createDimension("ray", len(origins))
        self.field("ray_origin", ("ray", "axis"), "km", origins)
        self.variable("ray_direction", "f8", ("ray", "axis"), directions * self.rng.choice([1.0, 2.5]))

    def distract(self) -> None:
        if self.chance(0.2):
            self.file.createVariable("reflectance", "f4", ("view", "row", "column"))[:] = 0.5
        if self.chance(0.2):
            view = self.file.createVariable("view", "i4", ("view",))
            view[:] = np.arange(len(self.views))


def outcome(path: Path, writer: Writer) -> tuple[str, str]:
    """What became of a case, and why."""
    try:
        read = read_measurements(path)
    except CloudtomoError as error:
        return "refused", str(error)
    except Exception as error:  # a traceback
        return "wrong", f"{type(error).__name__}: {error}"
    wrong = _differs(writer, read)
    return ("wrong", wrong) if wrong else ("right", "")


def _differs(writer: Writer, read: Measurements) -> str:
    if [view.type for view in read.views] != [view.type for view in writer.views]:
        return f"views {[view.type for view in read.views]}"
    for index, (view, other) in enumerate(zip(read.views, writer.views)):
        for name in ("pixels", "origins", "directions", *VIEW_FIELDS):
            value, expected = getattr(view, name, None), getattr(other, name, None)
            if (value is None) != (expected is None):
                return f"view {index} has {name} {value}, not {expected}"
            if value is not None and not np.allclose(value, expected, rtol=1e-9, atol=1e-12):
                return f"view {index} has {name} {value}, not {expected}"
        image, error = writer.images[index], writer.errors[index]
        if not np.allclose(read.images[index], image, rtol=1e-6, equal_nan=True):
            return f"image {index} is {read.images[index].ravel()[:3]}, not {image.ravel()[:3]}"
        good = np.isfinite(image)
        if not np.allclose(read.standard_errors[index][good], error[good], rtol=1e-6):
            return f"errors {index} are {read.standard_errors[index].ravel()[:3]}, not {error.ravel()[:3]}"
    if not np.allclose(read.calibration_errors, writer.gains or 0.0):
        return f"gains {read.calibration_errors}"
    return ""


if __name__ == "__main__":
    sys.exit(run_cases(__doc__.splitlines()[0], Writer, outcome))
