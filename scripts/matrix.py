"""Runs tests with several Pythons, with the oldest and the newest dependencies that setup.cfg allows.

    python scripts/matrix.py                                         # 3.10 lowest, 3.13 newest, all tests
    python scripts/matrix.py --python 3.10 3.11 3.12 3.13 --dependencies lowest newest -- tests/unit
    python scripts/matrix.py --only 3.10-lowest -- tests/unit tests/kernels/test_walk.py

Interpreters are looked for on the PATH, among pyenv's, and by `uv python` if uv is there; what is not found is
said and left out. The environments are runs/matrix/3.10-lowest, ...; they are made anew when setup.cfg changes.
The oldest dependencies are resolved by uv, which is installed into runs/matrix/tools if it is not on the PATH.
The exit status is 1 if tests fail, and 2 if there was nothing to run.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

TOP = Path(__file__).resolve().parents[1]
PLACE = TOP / "runs" / "matrix"
EXTRAS = "test,mie"
DEFAULT = ("3.10-lowest", "3.13-newest")
CHOICES = ("lowest", "newest")


def version_of(python: Path | str) -> str | None:
    """Its version as 3.10; None if it does not run, as pyenv's shims of versions that are not chosen."""
    code = "import sys; print('%d.%d' % sys.version_info[:2])"
    try:
        done = subprocess.run([str(python), "-c", code], capture_output=True, text=True, timeout=60)
    except OSError:
        return None
    return done.stdout.strip() if done.returncode == 0 else None


def candidates(version: str) -> Iterator[Path | str]:
    """Where an interpreter of a version may be."""
    for name in (f"python{version}", "python3", "python"):
        found = shutil.which(name)
        if found:
            yield found
    pyenv = Path(os.environ.get("PYENV_ROOT", Path.home() / ".pyenv")) / "versions"
    yield from sorted(pyenv.glob(f"{version}.*/bin/python"), reverse=True)
    uv = shutil.which("uv")
    if uv:
        command = [uv, "python", "find", "--no-python-downloads", version]
        done = subprocess.run(command, capture_output=True, text=True)
        if done.returncode == 0:
            yield done.stdout.strip()


def interpreter(version: str) -> str | None:
    return next((str(found) for found in candidates(version) if version_of(found) == version), None)


def uv_program() -> str:
    """uv, which alone resolves to the oldest dependencies."""
    found = shutil.which("uv")
    if found:
        return found
    tools = PLACE / "tools"
    if not (tools / "bin" / "uv").exists():
        subprocess.run([sys.executable, "-m", "venv", str(tools)], check=True)
        subprocess.run([str(tools / "bin" / "python"), "-m", "pip", "install", "--quiet", "uv"], check=True)
    return str(tools / "bin" / "uv")


def environment(name: str, python: str) -> Path:
    """The interpreter of an environment with this checkout and its dependencies; made if it is not as it should be."""
    folder = PLACE / name
    inside = folder / "bin" / "python"
    wanted = hashlib.sha256(b"".join((TOP / file).read_bytes() for file in ("setup.cfg", "pyproject.toml"))).hexdigest()
    mark = folder / "installed"
    if mark.exists() and mark.read_text() == wanted:
        return inside
    print(f"{name}: installing ...", flush=True)
    shutil.rmtree(folder, ignore_errors=True)
    subprocess.run([python, "-m", "venv", str(folder)], check=True)
    what = ["-e", f"{TOP}[{EXTRAS}]"]
    if name.endswith("lowest"):
        command = [uv_program(), "pip", "install", "--quiet", "--python", str(inside), "--resolution", "lowest-direct"]
    else:
        command = [str(inside), "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
    subprocess.run([*command, *what], check=True)
    mark.write_text(wanted)
    return inside


def run(name: str, python: str, arguments: list[str]) -> bool:
    """Whether the tests pass."""
    inside = environment(name, python)
    print(f"{name}: pytest {' '.join(arguments)}", flush=True)
    # What the environment has, not what the caller's shell adds.
    clean = {key: value for key, value in os.environ.items() if key not in ("PYTHONPATH", "VIRTUAL_ENV")}
    command = [str(inside), "-m", "pytest", "-p", "no:cacheprovider", *arguments]
    return subprocess.run(command, cwd=TOP, env=clean).returncode == 0


def wanted(options: argparse.Namespace) -> list[str]:
    """Names of environments: VERSION-lowest, VERSION-newest."""
    if options.only:
        return list(options.only)
    if options.python:
        return [f"{version}-{choice}" for version in options.python for choice in options.dependencies]
    return list(DEFAULT)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--python", nargs="+", help="versions, as 3.10")
    parser.add_argument("--dependencies", nargs="+", choices=CHOICES, default=CHOICES, help="of each version")
    parser.add_argument("--only", nargs="+", help="environments by name, as 3.10-lowest")
    parser.add_argument("tests", nargs="*", help="after --: arguments of pytest (default: all tests)")
    options = parser.parse_args()
    outcomes = {}
    for name in wanted(options):
        version, _, choice = name.partition("-")
        if choice not in CHOICES:
            parser.error(f"{name}: environments are named VERSION-lowest or VERSION-newest")
        python = interpreter(version)
        if python is None:
            outcomes[name] = f"left out: no Python {version} on the PATH, in pyenv or by uv"
            continue
        try:
            outcomes[name] = "passed" if run(name, python, options.tests) else "FAILED"
        except subprocess.CalledProcessError as error:
            outcomes[name] = f"FAILED to install: {error.cmd[0]} ended with {error.returncode}"
    for name, outcome in outcomes.items():
        print(f"{name}: {outcome}")
    if any(outcome.startswith("FAILED") for outcome in outcomes.values()):
        return 1
    return 0 if "passed" in outcomes.values() else 2


if __name__ == "__main__":
    sys.exit(main())
