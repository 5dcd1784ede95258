"""The command line: what `cloudtomo` understands, and its exit status. Each command is a module beside this one.

A command has HELP (a line), DESCRIPTION, EXAMPLES, `add_arguments(parser)`, and `run`, which takes the options as
keywords and returns an exit status, or None for 0.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from types import ModuleType
from typing import Any

from cloudtomo_cl.commands import cloud, devices, flux, init, mie, prior, ranks, reconstruct, render, report, validate
from cloudtomo_cl.commands.stopping import StopRequest, exit_status, listening
from cloudtomo_cl.commands.streams import forgiving
from cloudtomo_cl.errors import CloudtomoError, DeviceError, Interrupted, printable

# Tells how a command ends: a text, and the error that it is of.
Tell = Callable[[str, BaseException | None], None]

EXIT_ERROR = 2
EXIT_INTERRUPTED = 130

COMMANDS: dict[str, ModuleType] = {
    module.__name__.rpartition(".")[2]: module
    for module in (devices, cloud, init, mie, prior, render, flux, reconstruct, report, validate)
}

# Those whose work ranks of MPI share; of others the first rank does all.
_SHARED = ("devices", "render", "flux", "reconstruct", "validate")

DESCRIPTION = """\
3-D cloud extinction from images taken from several directions.

Lengths are in km, extinction in km^-1, angles in degrees, radiance in W m^-2 sr^-1.
x runs east, y north, z up; the ground is z = 0."""

_SHELLS = ("bash", "zsh", "tcsh")

EPILOG = """\
a whole example:
  cloudtomo cloud --generate cumulus --output cloud.nc
  cloudtomo init render --cloud cloud.nc
  cloudtomo render scene.toml --output images.nc --png previews
  cloudtomo init reconstruct --truth cloud.nc
  cloudtomo reconstruct run.toml --seed 2 --output run --set run.time_limit=600
  cloudtomo report run

`cloudtomo COMMAND --help` explains a command and its files."""


def parser() -> argparse.ArgumentParser:
    """Commands and options."""
    form = argparse.RawDescriptionHelpFormatter
    top = argparse.ArgumentParser(prog="cloudtomo", description=DESCRIPTION, epilog=EPILOG, formatter_class=form)
    top.add_argument("--version", action=_Version)
    top.add_argument(
        "--print-completion", choices=_SHELLS, metavar="SHELL", action=_Completion,
        help=f"print a script that completes commands and options in {', '.join(_SHELLS)}, and exit",
    )  # fmt: skip
    commands = top.add_subparsers(title="commands", metavar="COMMAND", dest="command", required=True)
    for name, module in COMMANDS.items():
        texts = {"help": module.HELP, "description": module.DESCRIPTION, "epilog": module.EXAMPLES}
        module.add_arguments(commands.add_parser(name, formatter_class=form, **texts))
    return top


class _Completion(argparse.Action):
    """Prints what a shell needs to complete words; by shtab, which is imported only then."""

    def __init__(self, option_strings: Sequence[str], dest: str, **options: Any) -> None:
        super().__init__(option_strings, argparse.SUPPRESS, default=argparse.SUPPRESS, **options)

    def __call__(self, form: argparse.ArgumentParser, _: Any, shell: Any, __: str | None = None) -> None:
        import shtab

        print(shtab.complete(parser(), shell=shell))
        form.exit()


class _Version(argparse.Action):
    """Looks the version up only when asked: importlib.metadata is slow to import."""

    def __init__(self, option_strings: Sequence[str], dest: str) -> None:
        nothing = argparse.SUPPRESS
        super().__init__(option_strings, nothing, default=nothing, nargs=0, help="print the version and exit")

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> None:
        from cloudtomo_cl.versions import version_of

        print(f"cloudtomo {version_of()}")
        parser.exit()


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs a command; returns the exit status."""
    for stream in (sys.stdout, sys.stderr):
        # A terminal that has no ± shows another sign for it, and does not end the command after its work.
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="backslashreplace")
    with forgiving("cloudtomo"):
        with ranks.silent_but_first():
            options = vars(parser().parse_args(arguments))
        command = options.pop("command")
        with without_display():
            try:
                return ranks.run_shared(lambda tell: _run(command, options, tell), command in _SHARED)
            except CloudtomoError as error:
                with ranks.silent_but_first():
                    return _ended(command, error, EXIT_ERROR)


def _run(command: str, options: dict[str, Any], tell: Tell) -> int:
    stop = StopRequest()
    try:
        with listening(f"cloudtomo {command}") as stop:
            status = COMMANDS[command].run(**options) or 0
        if stop.signal_number is None:
            return status
        return _ended(command, "all was done when it was interrupted", exit_status(stop.signal_number), tell)
    except Interrupted as interrupted:
        return _ended(command, interrupted, interrupted.status, tell)
    except DeviceError as error:
        if stop.signal_number is None:
            return _ended(command, error, EXIT_ERROR, tell)
        # Ctrl-C reaches a driver's compiler, too, which then fails.
        return _ended(command, f"interrupted: {error}", exit_status(stop.signal_number), tell)
    except CloudtomoError as error:
        return _ended(command, error, EXIT_ERROR, tell)
    except MemoryError as error:
        return _ended(command, f"not enough memory ({error}): choose fewer pixels or voxels", EXIT_ERROR, tell)
    except OSError as error:
        # A disk or a network drive that fails between the places that look for it.
        return _ended(command, f"{error}: check the disk, permissions and the space left", EXIT_ERROR, tell)
    except KeyboardInterrupt:
        return _ended(command, "interrupted", EXIT_INTERRUPTED, tell)


@contextmanager
def without_display() -> Iterator[None]:
    """Figures go into files: what a notebook or a desktop has chosen for its own may not even be installed here."""
    name = "MPLBACKEND"
    before = os.environ.get(name)
    os.environ[name] = "agg"
    try:
        yield
    finally:
        if before is None:
            del os.environ[name]
        else:
            os.environ[name] = before


def _to_standard_error(text: str, _: BaseException | None) -> None:
    print(text, file=sys.stderr)


def _ended(command: str, reason: str | CloudtomoError, status: int, tell: Tell = _to_standard_error) -> int:
    """The status, with its reason on standard error."""
    tell(printable(f"cloudtomo {command}: {reason}"), None if isinstance(reason, str) else reason)
    return status


if __name__ == "__main__":
    sys.exit(main())
