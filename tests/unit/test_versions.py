"""Versions of packages, installed or not."""

from importlib.metadata import version

from cloudtomo_cl.versions import version_of


def test_a_version_is_that_of_the_installed_package():
    assert version_of("numpy") == version("numpy")


def test_a_package_that_is_not_installed_has_none():
    assert version_of("no-such-package") == "not installed"
