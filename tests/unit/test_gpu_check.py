"""The command that checks a GPU: what goes wrong is a row that says so, and the rest goes on."""

import sys
from pathlib import Path

import numpy as np
import pytest

SCRIPTS = Path(__file__).parents[2] / "scripts"


@pytest.fixture(scope="module")
def gpu():
    """The package beside the script."""
    sys.path.insert(0, str(SCRIPTS))
    try:
        import gpu.compared
        import gpu.parts
        import gpu.registration
        import gpu.rows
        import gpu_check

        gpu.check = gpu_check
        yield gpu
    finally:
        sys.path.remove(str(SCRIPTS))


FIRST = 'from gpu.rows import Row\ndef rows(quick):\n    yield Row("x", "before", 1.5, "s")\n'
ENDS = {
    "raises": '    raise ValueError("no such thing")\n',
    "crashes": "    import os\n    os.abort()\n",
    "hangs": "    import time\n    time.sleep(60)\n",
    "babbles": '    print("compiling", "@row", flush=True)\n    import sys\n    print("x" * 99999, file=sys.stderr)\n',
}


@pytest.mark.parametrize(
    "end, said", [("raises", "no such thing"), ("crashes", "status -6"), ("hangs", "ended after its 3 s")]
)
def test_a_part_that_fails_says_so_after_what_it_has_found(gpu, tmp_path, end, said):
    found = [*run(gpu, tmp_path, end)]
    assert [row.what for row in found] == ["before", "failed", "seconds"]
    assert said in found[1].note and found[1].holds is False


def test_what_a_driver_prints_is_no_row(gpu, tmp_path):
    assert [row.what for row in run(gpu, tmp_path, "babbles")] == ["before", "seconds"]


def run(gpu, folder, end):
    """The rows of a part that ends so."""
    (folder / "ends.py").write_text(FIRST + ENDS[end])
    part = gpu.parts.Part("ends", 3 if end == "hangs" else 60, 60)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PYTHONPATH", str(folder))
        yield from gpu.parts.rows("x", part, False, {})


def test_nvidias_library_is_registered_where_it_is_not(gpu, tmp_path, monkeypatch):
    registered, library, mine = tmp_path / "vendors", tmp_path / "driver" / "libnvidia-opencl.so.1", tmp_path / "mine"
    for folder in (registered, library.parent, mine):
        folder.mkdir()
    library.touch()
    (registered / "pocl.icd").write_text("libpocl.so\n")
    monkeypatch.setenv("OCL_ICD_VENDORS", str(registered))
    monkeypatch.setattr(gpu.registration, "_FOLDERS", (str(tmp_path),))
    variables = gpu.registration.environment(mine)
    assert variables["OCL_ICD_VENDORS"] == str(mine)
    assert variables["LD_LIBRARY_PATH"].startswith(str(library.parent))
    assert sorted(file.name for file in mine.iterdir()) == ["nvidia.icd", "pocl.icd"]
    assert (mine / "nvidia.icd").read_text() == f"{library}\n"
    (registered / "nvidia.icd").write_text("libnvidia-opencl.so.1\n")
    assert gpu.registration.environment(mine) == {}


def test_other_bits_are_counted_and_small_differences_hold(gpu):
    expected = np.linspace(1, 2, 1000).astype(np.float32)
    found = expected.copy()
    found[7] *= 1 + 1e-6
    row = gpu.compared.differences("image", [found], [expected])
    assert row.value == 0.999 and row.holds
    assert "largest relative difference 9.5e-07" in row.note
    found[:200] *= 2
    assert gpu.compared.differences("image", [found], [expected]).holds is False
    assert gpu.compared.differences("image", [found[1:]], [expected]).holds is False


def test_speeds_are_set_beside_the_cpus(gpu):
    Row = gpu.rows.Row
    found = [
        Row("speed", "render", 100.0, "paths/s"), Row("speed of the CPU", "render", 4.0, "paths/s"),
        Row("speed", "replay", 100.0, "paths/s"),
    ]  # fmt: skip
    assert [(row.what, row.value) for row in gpu.check.beside_the_cpu(found)] == [("render: times the CPU's", 25.0)]
