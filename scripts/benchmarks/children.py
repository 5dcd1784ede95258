"""Measurements that need a process of their own: other settings, other libraries, its peak of memory."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

_SCRIPTS = Path(__file__).resolve().parents[1]


class ChildFailed(Exception):
    """The process ended in an error; its last line says which."""


def child(file: str, name: str, *numbers: int, environment: dict[str, str] | None = None) -> dict[str, float]:
    """What a function of a file of this package returns in a new process: numbers by their names.

    Raises
    ------
    ChildFailed : it raised, or crashed
    """
    call = f"{file}.{name}({', '.join(map(str, numbers))})"
    code = f"import json; from benchmarks import {file}; print(json.dumps({call}))"
    paths = os.pathsep.join(filter(None, [str(_SCRIPTS), os.environ.get("PYTHONPATH", "")]))
    variables = {**os.environ, "PYTHONPATH": paths, "OPENBLAS_NUM_THREADS": "1", **(environment or {})}
    command = [sys.executable, "-W", "ignore", "-c", code]
    process = subprocess.run(command, env=variables, capture_output=True, text=True)
    if process.returncode:
        text = process.stderr.strip().splitlines()
        raise ChildFailed(text[-1] if text else f"{call} ended with status {process.returncode}")
    return json.loads(process.stdout.splitlines()[-1])
