"""Named errors: each says what is wrong, where, and what to do."""

from __future__ import annotations

from typing import Any


class CloudtomoError(Exception):
    """Base of this package's errors; the command line shows its text and exits with 2."""


class DeviceError(CloudtomoError):
    """No such device, or a device that failed."""


class BuildError(DeviceError):
    """A kernel did not build; the text has device, options and log."""


class SettingsError(CloudtomoError):
    """A key of the settings is missing, misspelt or out of range."""


class InvalidSettingError(SettingsError, ValueError):
    """An argument of a settings class is missing, misspelt or out of range; the text has a line for each.

    Attributes
    ----------
    details : what pydantic says of each, see its `ValidationError.errors`
    """

    def __init__(self, text: str, details: list[Any] | None = None) -> None:
        super().__init__(text)
        self.details = details or []


class DataError(CloudtomoError):
    """A file or an array does not hold what it must."""


class InvalidArgumentError(DataError, TypeError):
    """An argument of a function is of another kind than the function takes, for instance a name in place of images."""


class RecoveryWarning(RuntimeWarning):
    """What to know of a recovery before it starts, of images, memory or prior, although nothing of it is refused."""


class TransportError(CloudtomoError):
    """A rendered radiance or a gradient is not finite."""


class AuditError(TransportError):
    """The energy of a run of paths does not add up: the device computes wrongly, or paths were lost."""


class Interrupted(CloudtomoError):
    """Somebody asked a run to stop, and it did, with all it had on the disk; the command line exits with `status`."""

    def __init__(self, text: str, status: int) -> None:
        super().__init__(text)
        self.status = status


class MissingPackageError(CloudtomoError):
    """A package is not installed that only this needs; the text says how to install it."""


# Control characters, of which a terminal makes colours, titles and worse; the end of a line and the tab stay.
_CONTROLS = {code: f"\\x{code:02x}" for code in (*range(9), *range(11, 32), 127, *range(128, 160))}


def printable(text: str) -> str:
    """A text that a terminal shows and does not obey: control characters, as files may have them, are spelt out."""
    return text.translate(_CONTROLS)
