"""Checkpoints: all that a reconstruction needs to go on as if it had never been stopped.

Random numbers need no state: they are a function of seed, iteration, view, pixel and sample
(docs/reference/random-numbers.md). A checkpoint keeps the solver's state, the mask, stage, iteration and history;
and the run's identity (settings and digests of its data), so that nobody goes on with other settings.
"""

from __future__ import annotations

import hashlib
import json
import os
import time
import zipfile
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError

from cloudtomo_cl.arguments import PATH, require_kinds
from cloudtomo_cl.errors import DataError
from cloudtomo_cl.files.whole import written_whole
from cloudtomo_cl.inversion.mixture_file import read_mixtures
from cloudtomo_cl.inversion.priors import PatchPrior
from cloudtomo_cl.inversion.stages import Stage
from cloudtomo_cl.parallel.ranks import ALONE, Ranks
from cloudtomo_cl.scene.measurements import Measurements
from cloudtomo_cl.scene.scene import Scene

FORMAT = 9
_DIGEST = "sha256:"
# Lists with more entries than this are kept as a digest.
_LONG = 32
# Time between checkpoints is at least this many times the time that writing one takes.
_LEAST_WORK = 20.0


@dataclass(frozen=True, eq=False)
class Checkpoint:
    """A reconstruction between two iterations.

    Attributes
    ----------
    identity : settings and digests of data that the run was started with, from `identity_of`
    device : name of the device that it ran on
    stage : number of the stage, counted from 0
    iterations : number of iterations done in this stage
    seconds : time since the start of the run
    stage_ends : ends of the stages before this one, seconds since the start of the run
    history : fields of every iteration's record
    state : arrays of the solver's state, and the mask
    """

    identity: dict[str, Any]
    device: str
    stage: int
    iterations: int
    seconds: float
    stage_ends: list[float]
    history: list[dict[str, Any]]
    state: dict[str, np.ndarray]

    def __repr__(self) -> str:
        where = f"stage {self.stage + 1}, {self.iterations} iterations of it, {self.seconds:.0f} s"
        return f"Checkpoint({where}, on {self.device}, state: {', '.join(self.state)})"

    @property
    def mask(self) -> np.ndarray:
        """Which voxels may hold cloud: bool, shape of the finest grid."""
        return self.state["mask"].astype(bool)

    @property
    def solver_state(self) -> dict[str, np.ndarray]:
        """The arrays of the solver's state, for `solvers.state.restored`."""
        return {name: array for name, array in self.state.items() if name != "mask"}

    def check(self, identity: dict[str, Any]) -> None:
        """Raises DataError, which names every key that differs, if a run has another identity."""
        differences = _differences(self.identity, json.loads(json.dumps(identity)))
        if differences:
            raise DataError(
                "the checkpoint is of another run:\n  "
                + "\n  ".join(differences)
                + "\ngo on with the settings and files that it was started with, or start a new run"
            )

    def write(self, path: str | os.PathLike[str]) -> None:
        """Writes an .npz file: whole, or the file that was there before stays.

        Raises
        ------
        DataError : the file cannot be written
        """
        header = {name: value for name, value in vars(self).items() if name != "state"}
        digests = {name: _digest(array) for name, array in self.state.items()}
        text = json.dumps({"format": FORMAT, "digests": digests, **header}).encode()
        # The format of np.savez, which on a full disk leaves an archive open that fails once more when collected.
        with written_whole(path) as partial, zipfile.ZipFile(partial, "w") as archive:
            for name, array in {"header": np.frombuffer(text, np.uint8), **self.state}.items():
                with archive.open(f"{name}.npy", "w", force_zip64=True) as file:
                    np.lib.format.write_array(file, np.asarray(array), allow_pickle=False)


class _Header(BaseModel):
    """What a file holds besides arrays; pydantic checks the ranges of its numbers."""

    model_config = ConfigDict(extra="forbid", strict=True)

    format: int
    digests: dict[str, str]
    identity: dict[str, Any]
    device: str
    stage: Annotated[int, Field(ge=0)]
    iterations: Annotated[int, Field(ge=0)]
    seconds: Annotated[float, Field(ge=0, allow_inf_nan=False)]
    stage_ends: list[float]
    history: list[dict[str, Any]]


def read_checkpoint(path: str | os.PathLike[str]) -> Checkpoint:
    """Reads what `Checkpoint.write` wrote. No code is run: pickles are refused.

    Raises
    ------
    DataError : no such file, damaged or cut short, or written by another version
    """
    require_kinds("read_checkpoint", path=(path, PATH))
    path = Path(path)
    if not path.is_file():
        raise DataError(f"{path}: no such file: there is no checkpoint to go on from")
    try:
        with np.load(path, allow_pickle=False) as file:
            state = {name: file[name] for name in file.files}
        text = bytes(state.pop("header"))
        found = json.loads(text)["format"]
        checkpoint = _checked(text, state) if found == FORMAT else None
    except Exception as error:  # a damaged file may raise anything
        if isinstance(error, ValidationError):
            first = error.errors()[0]
            error = ValueError(f"{'.'.join(map(str, first['loc']))}: {first['msg']}")
        elif isinstance(error, ValueError) and "allow_pickle" in str(error):
            error = ValueError("no .npz, or with pickles, which are never read")
        reason = getattr(error, "strerror", None) or str(error) or type(error).__name__
        raise DataError(f"{path}: is no checkpoint, or damaged or cut short ({reason}): start a new run") from None
    if checkpoint is None:
        raise DataError(f"{path}: has format {found}, this version reads {FORMAT}: go on with the version that made it")
    return checkpoint


def _checked(text: bytes, state: dict[str, np.ndarray]) -> Checkpoint:
    """The checkpoint of a header and arrays; raises ValueError if they do not belong together."""
    header = _Header.model_validate_json(text)
    digests = header.digests
    wrong = [name for name in {*digests, *state} if name not in state or digests.get(name) != _digest(state[name])]
    if wrong or "mask" not in state:
        raise ValueError(f"{', '.join(sorted(wrong)) or 'mask'} is missing or not what was written")
    done = sum(row.get("stage") == header.stage for row in header.history)
    if done != header.iterations:
        raise ValueError(f"its history has {done} iterations of stage {header.stage}, it says {header.iterations}")
    return Checkpoint(**header.model_dump(exclude={"format", "digests"}), state=state)


def identity_of(
    scene: Scene,
    measurements: Measurements,
    stages: Sequence[Stage],
    prior: Any,
    solver: Any,
    mask: np.ndarray,
    truth: np.ndarray | None,
    seed: int,
) -> dict[str, Any]:
    """All that decides the bits of a reconstruction, in the types of JSON: settings, and digests of arrays.

    The number of iterations of the last stage is left out: a run that has not settled may go on with more. A prior's
    file counts by its mixtures, not by its name: it may move, but must hold the same mixtures.

    Raises
    ------
    DataError : the prior's file holds no mixtures
    """

    def settings(value: Any, *without: str) -> Any:
        return _shortened(TypeAdapter(type(value)).dump_python(value, mode="json", exclude={*without}))

    return {
        "seed": seed,
        "scene": settings(scene),
        "stage": [*map(settings, stages[:-1]), settings(stages[-1], "iterations")],
        "prior": _of_prior(prior),
        "solver": _of_object(solver, "iterations"),
        "view": [settings(view) for view in measurements.views],
        "images": [_digest(image) for image in measurements.images],
        "standard_errors": [_digest(error) for error in measurements.standard_errors],
        "calibration_errors": [*measurements.calibration_errors],
        "pointing_errors": [*measurements.pointing_errors],
        "position_errors": [*measurements.position_errors],
        "mask": _digest(mask),
        "truth": None if truth is None else _digest(np.asarray(truth, np.float64)),
    }


def _of_prior(prior: Any) -> Any:
    found = _of_object(prior)
    if isinstance(prior, PatchPrior) and prior.file is not None:
        return {**found, "file": _DIGEST + read_mixtures(prior.file).digest}
    return found


def _of_object(value: Any, *without: str) -> Any:
    """The settings of a prior or solver of this package; for a user's object its class and `repr`."""
    if hasattr(type(value), "__pydantic_fields__"):
        return _shortened(TypeAdapter(type(value)).dump_python(value, mode="json", exclude={*without}))
    text = repr(value)
    # Python's default representation has the object's address in it, which another run would not have.
    named = "" if text.endswith(f" at {hex(id(value))}>") else text
    return [f"{type(value).__module__}.{type(value).__qualname__}", named]


def _shortened(value: Any) -> Any:
    """Settings with a digest in place of long lists: tables of phase functions, directions of rays."""
    if isinstance(value, dict):
        return {name: _shortened(inner) for name, inner in value.items()}
    if isinstance(value, (list, tuple)):
        if len(value) > _LONG:
            return _DIGEST + hashlib.sha256(json.dumps(value).encode()).hexdigest()
        return [_shortened(inner) for inner in value]
    return value


def _digest(array: np.ndarray) -> str:
    return _DIGEST + hashlib.sha256(np.ascontiguousarray(array).data).hexdigest()


def _differences(old: Any, new: Any, key: str = "") -> list[str]:
    """One line for each key whose values differ."""
    if isinstance(old, dict) and isinstance(new, dict):
        lines = []
        for name in [*old, *(name for name in new if name not in old)]:
            lines += _differences(old.get(name), new.get(name), f"{key}.{name}" if key else name)
        return lines
    if isinstance(old, list) and isinstance(new, list) and len(old) == len(new):
        return [line for index, pair in enumerate(zip(old, new)) for line in _differences(*pair, f"{key}[{index}]")]
    if old == new:
        return []
    if isinstance(old, str) and isinstance(new, str) and old.startswith(_DIGEST) and new.startswith(_DIGEST):
        return [f"{key} holds other numbers than the checkpoint's"]
    return [f"{key} is {_shown(new)}, the checkpoint's is {_shown(old)}"]


def _shown(value: Any) -> str:
    if isinstance(value, str) and value.startswith(_DIGEST):
        return "given"
    text = "not given" if value is None else json.dumps(value)
    return text if len(text) <= 60 else f"{text[:57]}..."


class Checkpoints:
    """Takes checkpoints at intervals, and hands them to a file or to a function.

    Parameters
    ----------
    target : path, function that takes a `Checkpoint`, or None
    interval : seconds between checkpoints; more, where writing one takes more than 5 % of it
    ranks : ranks, of which the first decides and writes; what it writes does not depend on their number
    """

    def __init__(
        self,
        target: str | os.PathLike[str] | Callable[[Checkpoint], None] | None,
        interval: float,
        ranks: Ranks = ALONE,
    ) -> None:
        self._target = target
        self._ranks = ranks
        self._interval = interval
        self._due = -np.inf
        self._last: tuple[int, int] | None = None

    def take(self, now: bool, stage: int, iterations: int, make: Callable[[], Checkpoint]) -> None:
        """Takes the checkpoint that `make` makes, if it is due or `now` is true; never the same one twice."""
        if self._target is None or self._last == (stage, iterations):
            return
        start = time.monotonic()
        if not now and not self._ranks.first(start >= self._due):
            return
        checkpoint = make()
        self._ranks.together(lambda: self._hand_over(checkpoint))
        end = time.monotonic()
        self._due = end + max(self._interval, _LEAST_WORK * (end - start))
        self._last = (stage, iterations)

    def _hand_over(self, checkpoint: Checkpoint) -> None:
        if not self._ranks.is_first:
            return
        if callable(self._target):
            self._target(checkpoint)
        elif self._target is not None:
            checkpoint.write(self._target)


def rows(history: Sequence[Any]) -> list[dict[str, Any]]:
    """Records of iterations as a checkpoint holds them."""
    return [asdict(record) for record in history]
