"""Some of the malformed inputs of scripts/fuzz.py."""

import importlib.util
from pathlib import Path

import pytest

from cloudtomo_cl.commands import fluxes, modelled, reconstruction, rendering, reporting
from cloudtomo_cl.report import plots

SCRIPT = Path(__file__).parents[2] / "scripts" / "fuzz.py"


@pytest.fixture
def bench(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(SCRIPT.parent)
    spec = importlib.util.spec_from_file_location("fuzz", SCRIPT)
    fuzz = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(fuzz)
    # What the bench puts in their place is taken back afterwards.
    places = [(module, "choose_device") for module in (fluxes, reconstruction, rendering)]
    for module, name in [*places, (reconstruction, "make_report"), (modelled, "PATHS"), (plots, "save_figures")]:
        monkeypatch.setattr(module, name, getattr(module, name))
    monkeypatch.setattr(reporting, "plots", plots)  # where the bench puts its own
    return fuzz.Bench(tmp_path)


def test_malformed_inputs_get_a_message_and_leave_nothing(bench):
    results = [bench.run(7, number) for number in range(50)]
    assert not [result for result in results if result["wrong"]]
    assert {0, 2} == {result["status"] for result in results}
