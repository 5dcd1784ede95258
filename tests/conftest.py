"""What the tests share."""

import numpy as np
import pytest

from cloudtomo_cl.commands import modelled
from cloudtomo_cl.opencl.device import choose_device


@pytest.fixture(scope="session")
def device():
    """The first device, or what CLOUDTOMO_DEVICE names."""
    return choose_device()


@pytest.fixture
def random():
    """Random numbers that are the same in every run and for every test."""
    return np.random.default_rng(20240611)


@pytest.fixture(autouse=True, scope="session")
def quick_reports():
    """A reconstruction's report has images of millions of paths, which no test looks at closely."""
    patch = pytest.MonkeyPatch()
    patch.setattr(modelled, "PATHS", 3e4)
    patch.setattr(modelled, "FEWEST_SAMPLES", 16)
    yield
    patch.undo()
