"""The files of the Intercomparison of 3D Radiation Codes (I3RC): consensus results and inputs.

They are not part of this project. A folder DIR holds them as they were distributed, in DIR/i3rc:
`I3RC_cons_res_case1_*.txt` and `I3RC_cons_res_case3_*.txt` (consensus_result_case1.tar and
consensus_result_case3.tar), and the Landsat cloud's `scene43.tau.128x128` and
`scene43.dz.128x128`.

Source: Cahalan et al. 2005, "The I3RC: Bringing Together the Most Advanced Radiative Transfer
Tools for Cloudy Atmospheres", Bull. Amer. Meteor. Soc. 86.
"""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from cloudtomo_cl.errors import DataError

ENVIRONMENT_VARIABLE = "CLOUDTOMO_DATA"

_SHAPES = {1: (1, 32), 3: (128, 128)}


def folder(data: Path | None) -> Path | None:
    """The folder with I3RC's files, or None if neither `data` nor the environment names one.

    Parameters
    ----------
    data : the folder that has i3rc in it; by default the environment variable CLOUDTOMO_DATA

    Raises
    ------
    DataError : it has no folder i3rc
    """
    named = str(data) if data is not None else os.environ.get(ENVIRONMENT_VARIABLE)
    if not named:
        return None
    found = Path(named) / "i3rc"
    if not found.is_dir():
        whence = "--data" if data is not None else ENVIRONMENT_VARIABLE
        raise DataError(f"{found}: no such folder; {whence} must name the one with i3rc, I3RC's files, in it")
    return found


def read_consensus(files: Path, case: int, experiment: int, quantity: str) -> np.ndarray:
    """The consensus of the participants, column by column.

    Parameters
    ----------
    files : the folder with I3RC's files
    case : 1, the step cloud, or 3, the Landsat cloud
    experiment : 1 to 4
    quantity : R, T, A (fluxes over the incident one), Iu (nadir), Id (zenith, at the bottom),
        I601, I602 (60 degrees, azimuth 0 and 180); radiances are pi L / (mu0 F0)

    Returns
    -------
    shape (32, 1) or (128, 128), [x, y]: a line of a Landsat file is a row of columns along x,
    and its lines follow each other along y, as in the files of the cloud itself

    Raises
    ------
    DataError : the file cannot be read, or does not hold that many numbers
    """
    name = f"I3RC_cons_res_case{case}_exp{experiment}_{quantity}.txt"
    return _read(files / name, _SHAPES[case]).T


def _read(path: Path, shape: tuple[int, int]) -> np.ndarray:
    """Numbers of a text file, [line, number in the line]."""
    try:
        values = np.array(path.read_text().split(), dtype=float)
    except (OSError, ValueError) as error:
        raise DataError(f"{path}: cannot be read as numbers ({error}): get I3RC's files again") from None
    if values.size != shape[0] * shape[1] or not np.all(np.isfinite(values) & (values >= 0)):
        raise DataError(
            f"{path}: holds {values.size} numbers; it must be {shape[0] * shape[1]}, finite and not negative"
        )
    return values.reshape(shape)
