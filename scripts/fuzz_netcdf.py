"""Writes one cloud into netCDF files of many forms, and checks that it is read as what it is, or refused.

    python scripts/fuzz_netcdf.py [--cases 2000] [--first 0] [--seed 0]

Every case draws how a model or a program might write the same cloud: extinction, water content or mixing ratio; names,
standard names, orders and units of variables and axes; falling axes, level numbers, half levels, pressure, bounds;
times and members; packing, fill values of every convention, in clear air, in the cloud, in air's density and the
droplets' radius; other variables that could be taken for the field; and what nobody can read. The oracle is the cloud:
every voxel's extinction, the spacing and the heights. A case is right, refused (with a message), or wrong; wrong is a
misreading, and the exit status is then 1. Refusals of files that say all there is to know are counted apart.
"""

from __future__ import annotations

import argparse
import collections
import random
import sys
import tempfile
from pathlib import Path
from typing import Any

import netCDF4
import numpy as np

from cloudtomo_cl.clouds.readers import ReadingOptions, read_cloud
from cloudtomo_cl.errors import CloudtomoError
from cloudtomo_cl.files.extinction import read_extinction

SHAPE, EDGES = (6, 5, 4), (0.05, 0.04, 0.03)
BASE = 0.3
RADIUS = 10.0
AIR = np.array([1.10, 1.09, 1.08, 1.07])
DEFAULT_FILL = {"f4": 9.969209968386869e36, "f8": 9.969209968386869e36, "i2": -32767, "i4": -2147483647}
LENGTHS = {
    "m": 1e3, "km": 1.0, "meters": 1e3, "kilometre": 1.0, "cm": 1e5, "ft": 1 / 0.3048e-3, "Metre": 1e3, "KM": 1.0,
}  # fmt: skip
UNITS: dict[str, dict[str, float]] = {
    "extinction": {"km-1": 1.0, "m-1": 1e-3, "1/km": 1.0, "m^-1": 1e-3, "km**-1": 1.0, "per m": 1e-3, "Mm-1": 1e3},
    "lwc": {"g m-3": 1.0, "kg m-3": 1e-3, "g/m3": 1.0, "g m^-3": 1.0, "kg/m**3": 1e-3, "mg m-3": 1e3, "g.m-3": 1.0},
    "ql": {"g kg-1": 1.0, "kg kg-1": 1e-3, "g/kg": 1.0, "kg/kg": 1e-3, "1": 1e-3, "mg/kg": 1e3},
}
NAMES = {
    "extinction": ["extinction", "ext", "beta"],
    "lwc": ["lwc", "LWC", "density", "liquid_water_content", "clwc"],
    "ql": ["ql", "QC", "qcloud", "QN", "clw"],
}
STANDARD = {
    "extinction": "volume_extinction_coefficient_in_air_due_to_cloud_particles",
    "lwc": "mass_concentration_of_cloud_liquid_water_in_air",
    "ql": "cloud_liquid_water_mixing_ratio",
}
AXES = {
    "x": ["x", "xt", "X", "west_east", "xc", "easting"],
    "y": ["y", "yt", "Y", "south_north", "yc", "northing"],
    "z": ["z", "zt", "height", "altitude", "lev", "Z"],
}


def truth() -> np.ndarray:
    """Extinction in km^-1, with no symmetry, and clear air around it."""
    extinction = np.zeros(SHAPE)
    extinction[1:5, 1:4, 1:3] = np.random.default_rng(3).uniform(15.0, 60.0, (4, 3, 2))
    return extinction


class Case:
    """What is drawn for a file: by what chances, and what it does that need not be read."""

    def __init__(self, rng: random.Random) -> None:
        self.rng, self.options, self.told = rng, {}, []  # type: ignore[var-annotated]
        # Whether the file says all there is to know, so that a refusal is too much.
        self.complete = True
        # Two in three cases are what a careful program writes; the others have something wrong.
        self.careless = rng.random() < 0.35

    def chance(self, share: float) -> bool:
        return self.rng.random() < share

    def slips(self, share: float) -> bool:
        """Whether a careless program does something that need not be read."""
        return self.careless and self.chance(share)

    def spoil(self, what: str) -> None:
        """Something that need not be read."""
        self.complete = False
        self.told.append(what)


class Writer(Case):
    """A case: the file that it draws, the options to read it with, and what must come of it."""

    def __init__(self, rng: random.Random) -> None:
        super().__init__(rng)
        self.expected = truth()
        self.kind = rng.choice(["extinction", "lwc", "lwc", "ql", "ql"])
        self.name = rng.choice(NAMES[self.kind])

    def write(self, path: Path) -> None:
        rng = self.rng
        format = rng.choice(["NETCDF4", "NETCDF4", "NETCDF3_64BIT_OFFSET", "NETCDF4_CLASSIC"])
        with netCDF4.Dataset(path, "w", format=format) as file:
            self.file = file
            self.dims = {letter: rng.choice(AXES[letter]) for letter in "xyz"}
            self.falls = {letter: self.chance(0.15) for letter in "xyz"}
            for letter in "xyz":
                self.axis(letter)
            self.extra()
            self.field()
            self.distract()

    # ---- axes

    def points(self, letter: str) -> np.ndarray:
        number = "xyz".index(letter)
        start = BASE if letter == "z" else 0.0
        return start + (np.arange(SHAPE[number]) + 0.5) * EDGES[number]

    def axis(self, letter: str) -> None:
        rng, name, file = self.rng, self.dims[letter], self.file
        points = self.points(letter)
        file.createDimension(name, len(points))
        if self.slips(0.03):
            self.spoil(f"{name} has no coordinate")
            return
        units = rng.choice(list(LENGTHS))
        factor = LENGTHS[units]
        stored = (points[::-1] if self.falls[letter] else points) * factor
        attributes: dict[str, Any] = {"units": units}
        what = rng.random() if self.careless else 1.0
        if what < 0.08:
            attributes = rng.choice([{}, {"units": ""}, {"units": " "}])
            self.spoil(f"{name} without units in {units}")
        elif what < 0.12:
            attributes = {"units": rng.choice(["K", "degrees_north", "level", "1", "hPa", "furlong", "s"])}
            self.spoil(f"{name} in {attributes['units']}")
        elif what < 0.2 and letter == "z":
            self.levels(name, points, attributes)
            return
        if self.chance(0.3):
            attributes["axis"] = letter.upper()
        if letter == "z" and self.chance(0.3):
            attributes["positive"] = "up"
        if letter == "z" and self.slips(0.05):
            attributes["positive"] = "down"
            self.spoil("positive down")
        if letter == "z" and self.slips(0.03):
            attributes["standard_name"] = rng.choice(["depth", "atmosphere_hybrid_height_coordinate", "air_pressure"])
            self.spoil(f"standard_name {attributes['standard_name']}")
        elif self.chance(0.2):
            horizontal = f"projection_{letter}_coordinate"
            attributes["standard_name"] = "height" if letter == "z" else horizontal
        if self.slips(0.04):
            index = rng.randrange(len(stored))
            stored = stored.copy()
            others = [np.nan, stored[0] if index else stored[-1], 1e36, -999.0]
            # Stretched layers are none of the mistakes.
            stored[index] = rng.choice(others if letter == "z" else [*others, stored[index] * 1.3])
            self.spoil(f"{name} has a wrong point")
        if self.chance(0.2):
            self.bounds(letter, name, factor, attributes)
        variable = file.createVariable(name, rng.choice(["f8", "f8", "f4"]), (name,))
        variable[:] = stored
        variable.setncatts(attributes)

    def levels(self, name: str, points: np.ndarray, attributes: dict[str, Any]) -> None:
        """Numbers or pressures along z, with heights in another variable or nowhere."""
        rng, file = self.rng, self.file
        numbers = np.arange(len(points)) + rng.choice([0, 1])
        what = rng.choice(["number", "number", "pressure", "sigma"])
        values = {"number": numbers, "pressure": 900.0 - 10.0 * numbers, "sigma": 0.9 - 0.01 * numbers}[what]
        variable = file.createVariable(name, "f8", (name,))
        variable[:] = values[::-1] if self.falls["z"] else values
        variable.setncatts({"number": {}, "pressure": {"units": "hPa"}, "sigma": {"long_name": "sigma"}}[what])
        if self.chance(0.3):
            variable.positive = rng.choice(["up", "down"])
        if self.chance(0.6) and name != "height":
            heights = file.createVariable("height", "f8", (name,))
            heights[:] = (points[::-1] if self.falls["z"] else points) * 1e3
            heights.setncatts({"units": "m", "standard_name": "height"})
        self.spoil(f"{name} holds {what}s")

    def bounds(self, letter: str, name: str, factor: float, attributes: dict[str, Any]) -> None:
        rng, number = self.rng, "xyz".index(letter)
        points = self.points(letter)
        pairs = np.column_stack([points - EDGES[number] / 2, points + EDGES[number] / 2])
        pairs = pairs[::-1] if self.falls[letter] else pairs
        own: dict[str, Any] = {}
        wrong = ["stale unit", "shifted", "missing", "gaps"] if self.careless else []
        what = rng.choice(["same", "same", "own unit", "reversed", *wrong])
        scale = factor
        if what == "own unit":
            own, scale = {"units": "m"}, 1e3
        elif what == "reversed":
            pairs = pairs[:, ::-1]
        elif what == "stale unit":
            scale = 1e3 if factor != 1e3 else 1.0
            self.spoil("stale bounds")
        elif what == "shifted":
            pairs = pairs + 2.5 * EDGES[number]
            self.spoil("shifted bounds")
        elif what == "missing":
            pairs[1, 0] = np.nan
            self.spoil("missing bounds")
        elif what == "gaps":
            pairs = pairs + np.array([0.1, -0.1]) * EDGES[number]
            self.spoil("bounds with gaps")
        if "nv" not in self.file.dimensions:
            self.file.createDimension("nv", 2)
        variable = self.file.createVariable(f"{name}_bnds", "f8", (name, "nv"))
        variable[:] = pairs * scale
        variable.setncatts(own)
        attributes["bounds"] = f"{name}_bnds"

    def extra(self) -> None:
        """Times and members."""
        rng, self.leading = self.rng, []  # type: ignore[var-annotated]
        if self.chance(0.3):
            count = rng.choice([1, 2, 3])
            name = rng.choice(["time", "Time", "t"])
            self.file.createDimension(name, count)
            if self.chance(0.6):
                variable = self.file.createVariable(name, "f8", (name,))
                variable[:] = np.arange(count)
                variable.units = "hours since 2020-01-01"
            self.leading.append((name, count, rng.choice([0, count - 1]), "time"))
        if self.chance(0.12):
            name, count = rng.choice(["member", "ensemble", "wavelength", "bin"]), rng.choice([1, 2, 4])
            self.file.createDimension(name, count)
            self.leading.append((name, count, rng.choice([0, count - 1]), "select"))
        for name, count, index, option in self.leading:
            if count == 1:
                continue
            if self.slips(0.15):
                self.spoil(f"{name} not chosen")
            elif option == "time":
                self.options["time"] = index
            else:
                self.options["select"] = {name: index}
        if not self.leading and self.slips(0.03):
            self.options["time"] = 0
            self.spoil("--time without a time")

    # ---- values

    def field(self) -> None:
        rng = self.rng
        values = self.expected
        if self.kind != "extinction":
            values = values * RADIUS / 1500.0
        if self.kind == "ql":
            values = values / AIR
        units = rng.choice(list(UNITS[self.kind]))
        stored = values * UNITS[self.kind][units]
        attributes: dict[str, Any] = {"units": units}
        what = rng.random() if self.careless else 1.0
        if what < 0.07:
            attributes = rng.choice([{}, {"units": ""}])
            self.spoil(f"{self.name} without units, in {units}")
        elif what < 0.11:
            attributes = {"units": rng.choice(["K", "m s-1", "kg m-2", "dBZ", "cm-3"])}
            self.spoil(f"{self.name} in {attributes['units']}")
        if self.chance(0.2):
            attributes["standard_name"] = STANDARD[self.kind]
        if self.slips(0.05):
            attributes["standard_name"] = "mass_concentration_of_rain_water_in_air"
            attributes["long_name"] = "rain water, or aerosol backscatter"
            self.spoil("says that it is rain")
        dims = [*"xyz"]
        if self.chance(0.7):
            dims = rng.choice([[*"zyx"], [*"yxz"], [*"xzy"], [*"yzx"]])
        turned = stored[tuple(slice(None, None, -1 if self.falls[letter] else 1) for letter in "xyz")]
        turned = turned.transpose(["xyz".index(letter) for letter in dims])
        clear = {letter: self.falls[letter] for letter in "xyz"}
        self.put(self.name, turned, [self.dims[letter] for letter in dims], attributes, dims, clear)
        if self.kind == "ql":
            self.air()
        if self.kind != "extinction":
            self.radius(dims)

    def put(
        self, name: str, values: np.ndarray, dims: list[str], attributes: dict[str, Any], letters: list[str], _: Any
    ) -> None:
        """The field, packed or not, with missing values or not, at one of the times and members."""
        rng = self.rng
        kind = rng.choice(["f8", "f4", "f4", "packed", "scaled"])
        values, missing = values.copy(), np.zeros(values.shape, bool)
        if self.slips(0.5):
            inside = self.chance(0.5)
            among = np.argwhere((values > 0) == inside)
            for place in rng.sample([tuple(place) for place in among], rng.choice([1, 3])):
                missing[place] = True
            self.missing(missing, letters, inside)
        number = {"f8": "f8", "f4": "f4", "packed": "i2", "scaled": "f4"}[kind]
        fill, how = self.fill(number, bool(missing.any()), float(values.max()))
        if kind == "packed":
            scale = values.max() / 30000.0
            stored = np.round(values / scale)
            attributes.update(scale_factor=scale, add_offset=0.0)
            if self.chance(0.3):
                stored, attributes["add_offset"] = stored - 100.0, 100.0 * scale
        elif kind == "scaled":
            scale = rng.choice([1, 2, np.int32(1), 0.5])
            stored = values / float(scale)
            attributes["scale_factor"] = scale
        else:
            stored = values
        stored = np.where(missing, fill, stored)
        full = [name for name, *_ in self.leading] + dims
        block = np.zeros([self.file.dimensions[name].size for name in full])
        block[...] = (0.7 * stored if kind != "packed" else np.where(missing, fill, np.round(0.7 * stored)))[
            (None,) * len(self.leading)
        ]
        block[tuple(index for _, _, index, _ in self.leading)] = stored
        keywords = {"fill_value": fill} if how == "_FillValue" else {"fill_value": False} if how == "none" else {}
        variable = self.file.createVariable(name, number, full, **keywords)
        variable.set_auto_maskandscale(False)
        variable[:] = block.astype(number)
        if how in ("missing_value", "FillValue", "missing", "nodata"):
            variable.setncattr(how, np.array(fill, number))
        elif how == "valid_range" and kind != "packed":
            variable.setncattr("valid_range", np.array([0.0, 10.0 * stored[~missing].max()], number))
        elif how == "valid_min":
            variable.setncattr("valid_min", np.array(stored[~missing].min() - abs(stored).max() * 1e-3, number))
        variable.setncatts(attributes)

    def fill(self, number: str, needed: bool, largest: float) -> tuple[Any, str]:
        """A value for missing ones, and how the file tells of it."""
        rng = self.rng
        if not needed:
            how = rng.choice(["_FillValue", "missing_value", "none", "default"])
            return (-9999 if how != "default" else DEFAULT_FILL[number]), how
        told = ["_FillValue", "missing_value", "FillValue", "missing", "default", "valid_range", "valid_min"]
        how = rng.choice([*told, "nan", "none"])
        if number == "i2":
            if how in ("nan", "valid_range"):
                how = "_FillValue"
            return {"default": DEFAULT_FILL["i2"], "valid_min": -32000}.get(how, -9999), how
        if how == "nan":
            return np.nan, "none"
        if how == "default":
            return DEFAULT_FILL[number], "default"
        return rng.choice([-999.0, -999.9, -9999.0, 1e20, 9.96921e36, -1e34] if how != "valid_min" else [-999.0]), how

    def missing(self, missing: np.ndarray, letters: list[str], inside: bool) -> None:
        """Missing values: refused, or called clear by the user."""
        self.told.append(f"missing {'in the cloud' if inside else 'in clear air'}")
        self.complete = False
        if self.chance(0.5):
            self.options["missing"] = "clear"
            absent = missing.transpose([letters.index(letter) for letter in "xyz"])
            absent = absent[tuple(slice(None, None, -1 if self.falls[letter] else 1) for letter in "xyz")]
            self.expected = np.where(absent, 0.0, self.expected)

    def air(self) -> None:
        rng, file = self.rng, self.file
        name = rng.choice(["rho", "RHO", "rhobf", "dn0"])
        dims, values = [self.dims["z"]], AIR[:: -1 if self.falls["z"] else 1]
        if self.chance(0.25):
            # Half levels, in whose middles the field's lie.
            file.createDimension("zm", SHAPE[2] + 1)
            faces = file.createVariable("zm", "f8", ("zm",))
            faces[:] = (BASE + np.arange(SHAPE[2] + 1) * EDGES[2]) * 1e3
            if not self.slips(0.2):
                faces.units = "m"
            else:
                self.spoil("half levels without units")
            dims, values = ["zm"], np.append(AIR, 2 * AIR[-1] - AIR[-2]) + (AIR[0] - AIR[1]) / 2
        for lead, count, _, option in self.leading:
            if option == "time" and self.chance(0.5):
                dims, values = [lead, *dims], np.broadcast_to(values, (count, len(values))).copy()
        values = values.copy()
        attributes: dict[str, Any] = {"units": rng.choice(["kg m-3", "kg/m^3", "kg m^-3"])}
        scale = 1.0
        what = rng.random() if self.careless else 1.0
        if what < 0.1:
            attributes, scale = {"units": "g m-3"}, 1e3
        elif what < 0.15:
            attributes, scale = {}, rng.choice([1.0, 1e3])
            self.spoil("air without units")
        elif what < 0.19:
            attributes = {"units": "mol m-3"}
            self.spoil("air in mol m-3")
        if self.slips(0.1):
            values[..., rng.randrange(values.shape[-1])] = rng.choice([-999.0, np.nan, 9.969209968386869e36])
            if self.chance(0.7):
                attributes["missing_value"] = -999.0
            self.spoil("air is missing at a level")
        if self.slips(0.05):
            attributes["long_name"] = "density of water vapour"
            self.spoil("air says that it is vapour")
        variable = file.createVariable(name, "f8", dims, fill_value=False)
        variable[:] = values * scale
        variable.setncatts(attributes)

    def radius(self, letters: list[str]) -> None:
        rng = self.rng
        if self.chance(0.4):
            self.options["effective_radius"] = RADIUS
            return
        units, factor = rng.choice([("um", 1.0), ("micron", 1.0), ("m", 1e-6), ("\u00b5m", 1.0), ("mm", 1e-3)])
        attributes = {"units": units}
        if self.slips(0.15):
            attributes = {}
            self.spoil(f"radius without units, in {units}")
        values = np.full([SHAPE["xyz".index(letter)] for letter in letters], RADIUS * factor)
        if self.slips(0.12):
            place = tuple(rng.randrange(count) for count in values.shape)
            values[place] = rng.choice([np.nan, 0.0, -1.0, 9.969209968386869e36])
            self.spoil("radius is missing in a voxel")
        name = rng.choice(["reff", "effective_radius", "re", "r_eff"])
        variable = self.file.createVariable(name, "f8", [self.dims[letter] for letter in letters], fill_value=False)
        variable[:] = values
        variable.setncatts(attributes)

    def distract(self) -> None:
        """Variables that are something else, by names that fields go by."""
        rng, file = self.rng, self.file
        dims = [self.dims[letter] for letter in "zyx"]
        taken = {name.lower() for name in file.variables}

        def add(name: str, value: Any, dims: list[str], **attributes: Any) -> None:
            if name.lower() not in taken:
                variable = file.createVariable(name, "f4", dims)
                variable[:] = value
                variable.setncatts(attributes)

        if self.chance(0.15):
            air = AIR[:: -1 if self.falls["z"] else 1, None, None] * np.ones((1, *SHAPE[1::-1]))
            add("density", air, dims, units="kg m-3", **rng.choice([{}, {"long_name": "density of air"}]))
        if self.chance(0.15):
            about = rng.choice([{}, {"long_name": "Reynolds number"}, {"units": "1"}])
            add("Re", rng.choice([100.0, 5e4]), [], **about)
        if self.chance(0.15):
            add("beta", 2e-11, dims, units=rng.choice(["m-1 s-1", "m-1 sr-1"]), long_name="something else")
        if self.chance(0.15):
            add("qr", 1e-3, dims, units="kg kg-1", long_name="rain water mixing ratio")
        if self.chance(0.1):
            add("ext", 0.05, dims, units="km-1", long_name="aerosol extinction coefficient")


def outcome(path: Path, writer: Writer) -> tuple[str, str]:
    """What became of a case, and why."""
    try:
        cloud = read_cloud(path, ReadingOptions(**writer.options))
    except CloudtomoError as error:
        return "refused", str(error)
    except Exception as error:  # a traceback
        return "wrong", f"{type(error).__name__}: {error}"
    wrong = _differs(writer.expected, cloud.extinction, cloud.grid)
    if not wrong and {"extinction", *"xyz"} <= set(_names(path)) and "missing" not in writer.options:
        try:
            grid, extinction = read_extinction(path)
        except CloudtomoError:
            return "right", ""
        wrong = _differs(writer.expected, extinction, grid)
    return ("wrong", wrong) if wrong else ("right", "")


def _names(path: Path) -> list[str]:
    with netCDF4.Dataset(path) as file:
        return list(file.variables)


def _differs(expected: np.ndarray, extinction: np.ndarray, grid: Any) -> str:
    if grid.shape != expected.shape:
        return f"shape {grid.shape}"
    if not np.allclose(grid.spacing, EDGES, rtol=1e-3) or not np.allclose(grid.origin, (0, 0, BASE), atol=1e-3):
        return f"spacing {grid.spacing}, origin {grid.origin}"
    if not np.allclose(extinction, expected, rtol=5e-3, atol=0.02):
        return f"optical mass {extinction.sum() * grid.voxel_volume:.4g}, not {expected.sum() * grid.voxel_volume:.4g}"
    return ""


def run_cases(about: str, writers: Any, outcome: Any) -> int:
    """Draws cases as the command line says, prints what is wrong, and counts; the exit status."""
    parser = argparse.ArgumentParser(description=about)
    parser.add_argument("--cases", type=int, default=2000)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--show", action="store_true", help="print every refusal")
    options = parser.parse_args()
    counts: collections.Counter[str] = collections.Counter()
    with tempfile.TemporaryDirectory() as temporary:
        path = Path(temporary) / "file.nc"
        for number in range(options.first, options.first + options.cases):
            writer = writers(random.Random(f"{options.seed} {number}"))
            path.unlink(missing_ok=True)
            writer.write(path)
            result, why = outcome(path, writer)
            complete = writer.complete
            counts[result if result != "refused" or not complete else "refused though all is said"] += 1
            if result == "wrong" or (result == "refused" and (complete or options.show)):
                print(f"case {number}: {result}: {why} | {', '.join(writer.told)} | {writer.options}", flush=True)
    print(", ".join(f"{counts[name]} {name}" for name in ("right", "refused", "refused though all is said", "wrong")))
    return 1 if counts["wrong"] else 0


if __name__ == "__main__":
    sys.exit(run_cases(__doc__.splitlines()[0], Writer, outcome))
