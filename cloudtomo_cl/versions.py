"""Versions of installed packages, this one's among them."""

from __future__ import annotations

from importlib.metadata import PackageNotFoundError, version

PACKAGE = "cloudtomo-cl"


def version_of(package: str = PACKAGE) -> str:
    """What is installed; "not installed" where nothing is known: a checkout that is run as it lies there, too."""
    try:
        return version(package)
    except PackageNotFoundError:
        return "not installed"
