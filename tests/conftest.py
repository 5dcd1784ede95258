"""What the tests share."""

from io import BytesIO
from types import SimpleNamespace

import numpy as np
import pytest

from cloudtomo_cl.commands import modelled, reporting
from cloudtomo_cl.files.whole import written_whole
from cloudtomo_cl.opencl.devices import choose_device
from cloudtomo_cl.report import plots


@pytest.fixture(scope="session")
def device():
    """The first device, or what CLOUDTOMO_DEVICE names."""
    return choose_device()


@pytest.fixture
def random():
    """Random numbers that are the same in every run and for every test."""
    return np.random.default_rng(20240611)


def save_coarsely(folder, figures):
    """In place of `plots.save_figures`: coarse pictures that are not laid out, and the same again as .pdf."""
    folder.mkdir(parents=True, exist_ok=True)
    paths = []
    for name, figure in figures.items():
        figure.set_layout_engine("none")
        drawn = BytesIO()
        figure.savefig(drawn, dpi=20, format="png")
        for suffix in ("png", "pdf"):
            paths.append(folder / f"{name}.{suffix}")
            with written_whole(paths[-1]) as partial:
                partial.write_bytes(drawn.getvalue())
    return paths


@pytest.fixture(autouse=True, scope="session")
def quick_reports():
    """A reconstruction's report has images of millions of paths and figures that take seconds, which no test looks at
    closely but those of plots, and the one that asks for `whole_figures`."""
    patch = pytest.MonkeyPatch()
    patch.setattr(modelled, "PATHS", 3e4)
    patch.setattr(modelled, "FEWEST_SAMPLES", 16)
    patch.setattr(reporting, "plots", SimpleNamespace(run_figures=plots.run_figures, save_figures=save_coarsely))
    yield
    patch.undo()


@pytest.fixture
def whole_figures(monkeypatch):
    """A report's figures as users get them."""
    monkeypatch.setattr(reporting, "plots", plots)
