"""What importing the package does, and does not."""

import logging
import subprocess
import sys

import pytest

import cloudtomo_cl


@pytest.mark.parametrize("module", ["numpy", "pydantic", "pyopencl", "xarray", "matplotlib", "scipy"])
def test_importing_the_package_waits_for_no_other(module):
    code = f"import sys, cloudtomo_cl; sys.exit({module!r} in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], timeout=60).returncode == 0


@pytest.mark.parametrize("name", cloudtomo_cl.__all__)
def test_public_names_are_there(name):
    assert getattr(cloudtomo_cl, name) is not None and name in dir(cloudtomo_cl)


def test_the_package_leaves_messages_to_its_user():
    assert cloudtomo_cl.reconstruct  # what has messages is imported
    handlers = logging.getLogger("cloudtomo_cl").handlers
    assert handlers and all(isinstance(handler, logging.NullHandler) for handler in handlers)
