"""The table of `cloudtomo validate`: what passes, I3RC's files, the command's exit status and output."""

import csv
from dataclasses import replace

import numpy as np
import pytest

from cloudtomo_cl import validation
from cloudtomo_cl.commands.cli import main
from cloudtomo_cl.errors import DataError
from cloudtomo_cl.files import i3rc
from cloudtomo_cl.validation import Row, compare_columns

ROW = Row("a slab", "R", "somebody", published=0.5, value=0.5, standard_error=1e-4, photons=1000)


@pytest.mark.parametrize(
    "value, standard_error, published_error, passed",
    [
        (0.5014, 1e-5, 0.0, True),  # within 0.3 %
        (0.5016, 1e-5, 0.0, False),
        (0.5029, 1e-3, 0.0, True),  # within 3 standard errors
        (0.5031, 1e-3, 0.0, False),
        (0.5031, 1e-3, 1e-3, True),  # within 3 of both together
        (np.nan, 1e-3, 0.0, False),
    ],
)
def test_means_pass_within_a_share_or_standard_errors(value, standard_error, published_error, passed):
    row = replace(ROW, value=value, standard_error=standard_error, published_error=published_error)
    assert row.passed == passed


@pytest.mark.parametrize("value, passed", [(0.0149, True), (0.0165, True), (0.0181, False)])
def test_columns_pass_within_their_share(value, passed):
    assert replace(ROW, published=0.0, value=value, standard_error=1e-3, columns=True).passed == passed


def test_rounding_is_not_told_in_standard_errors():
    assert np.isnan(replace(ROW, value=0.5 + 1e-8, standard_error=1e-9).standard_errors)


def test_noise_is_no_difference_of_columns(random):
    truth, noise = random.uniform(0.2, 0.6, (100, 100)), 0.05
    noisy = truth + noise * random.standard_normal(truth.shape)
    errors = np.full(truth.shape, noise)
    rows = [compare_columns(ROW, noisy + shift, errors, truth) for shift in (0.0, np.where(truth > 0.4, 0.02, -0.02))]
    scale = truth.mean()
    # The standard error of the mean square is 0.05^2 sqrt(2) / 100 = 3.5e-5.
    assert rows[0].value < np.sqrt(4 * 3.5e-5) / scale and rows[0].standard_error > 0
    assert abs(rows[1].value - 0.02 / scale) < 4 * rows[1].standard_error < 0.02


def test_blocks_average_out_noise_of_the_consensus_but_no_difference(random):
    truth = np.kron(random.uniform(0.2, 0.6, (32, 32)), np.ones((4, 4)))
    consensus = truth + 0.02 * random.standard_normal(truth.shape)
    zero = np.zeros(truth.shape)
    shift = np.kron(np.where(random.random((32, 32)) < 0.5, 0.02, -0.02), np.ones((4, 4)))
    single, blocks, shifted = (
        compare_columns(ROW, value, zero, consensus, block)
        for value, block in ((truth, 1), (truth, 4), (truth + shift, 4))
    )
    # Relative errors of standard deviations of 16384 and of 1024 numbers: 0.6 and 2.2 %.
    assert single.value * truth.mean() == pytest.approx(0.02, rel=0.03)
    assert blocks.value * truth.mean() == pytest.approx(0.02 / 4, rel=0.1)
    assert shifted.value * truth.mean() == pytest.approx(np.hypot(0.02, 0.02 / 4), rel=0.1)
    assert "1024 blocks of 4 x 4" in blocks.quantity


def test_every_case_has_a_name_of_its_own():
    names = [case.name for case in validation.cases()]
    assert len(set(names)) == len(names) >= 17


def write_consensus(folder, text):
    (folder / "i3rc").mkdir(exist_ok=True)
    (folder / "i3rc" / "I3RC_cons_res_case1_exp1_R.txt").write_text(text)
    return folder / "i3rc"


def test_consensus_is_read_along_x(tmp_path):
    files = write_consensus(tmp_path, "\n".join(f"  {n / 100:.5E}" for n in range(32)))
    np.testing.assert_allclose(i3rc.read_consensus(files, 1, 1, "R"), np.arange(32)[:, None] / 100)


@pytest.mark.parametrize("text", ["0.1 0.2", "x" * 40, " ".join(["-0.1"] * 32), " ".join(["nan"] * 32)])
def test_a_damaged_consensus_is_refused(tmp_path, text):
    files = write_consensus(tmp_path, text)
    with pytest.raises(DataError, match=r"I3RC_cons_res_case1_exp1_R\.txt"):
        i3rc.read_consensus(files, 1, 1, "R")


def test_data_may_come_from_the_environment(tmp_path, monkeypatch):
    monkeypatch.delenv("CLOUDTOMO_DATA", raising=False)
    assert i3rc.folder(None) is None
    write_consensus(tmp_path, "")
    monkeypatch.setenv("CLOUDTOMO_DATA", str(tmp_path))
    assert i3rc.folder(None) == tmp_path / "i3rc"
    monkeypatch.setenv("CLOUDTOMO_DATA", str(tmp_path / "absent"))
    with pytest.raises(DataError, match="CLOUDTOMO_DATA"):
        i3rc.folder(None)


# --- the command ------------------------------------------------------------------------

FAILING = replace(ROW, quantity="T", value=0.6)


@pytest.fixture
def computed(monkeypatch):
    """Replaces the computing: every case has a line that passes, and one more where `computed` has one."""
    more = []
    monkeypatch.delenv("CLOUDTOMO_DATA", raising=False)
    monkeypatch.setattr(validation, "run", lambda case, *_: [replace(ROW, experiment=case.name), *more])
    return more


def test_numbers_that_agree_exit_with_0(computed, capsys):
    assert main(["validate", "--quick"]) == 0
    text = capsys.readouterr().out
    assert "I3RC step cloud, exp 4" in text and "need --data" in text and "FAIL" not in text


def test_numbers_that_differ_exit_with_1(computed, capsys):
    computed.append(FAILING)
    assert main(["validate", "--only", "energy", "--quiet"]) == 1
    captured = capsys.readouterr()
    assert captured.out == "" and "failed: a slab, T, somebody, 0.50000, 0.60000" in captured.err


@pytest.mark.parametrize(
    "arguments, message",
    [
        ("--data absent", "absent/i3rc: no such folder; --data must name"),
        ("--only nothing-like-it", "no case has this in its name"),
        ("--output table.txt", "must end in .csv or .md"),
        ("--output absent/table.md", "make it first"),
        ("--device no-such-device", "no OpenCL device"),
    ],
)
def test_users_mistakes_exit_with_2(computed, capsys, tmp_path, monkeypatch, arguments, message):
    monkeypatch.chdir(tmp_path)
    assert main(["validate", *arguments.split()]) == 2
    assert message in capsys.readouterr().err and not list(tmp_path.iterdir())


@pytest.mark.parametrize("photons", ["ten", "-5", "nan", "1e20"])
def test_photons_must_be_a_number(photons, capsys):
    with pytest.raises(SystemExit) as exit_:
        main(["validate", f"--photons={photons}"])
    assert exit_.value.code == 2 and "is no number of photons from" in capsys.readouterr().err


def test_table_as_csv_has_the_numbers(computed, tmp_path):
    computed.append(FAILING)
    path = tmp_path / "table.csv"
    assert main(["validate", "--only", "energy", "--quiet", "--output", str(path)]) == 1
    lines = [line for line in path.read_text().splitlines() if not line.startswith("#")]
    first, second = csv.DictReader(lines)
    assert first["passed"] == "True" and second["passed"] == "False"
    assert float(second["difference"]) == pytest.approx(0.2) and float(second["standard_errors"]) == pytest.approx(1000)


def test_table_as_markdown_has_equal_columns(computed, tmp_path):
    path = tmp_path / "table.md"
    computed.append(replace(ROW, published=0.0, value=0.01, columns=True))
    assert main(["validate", "--only", "energy", "--quiet", "--output", str(path)]) == 0
    table = [line for line in path.read_text().splitlines() if line.startswith("|")]
    assert len({line.count("|") for line in table}) == 1 and "r.m.s." in path.read_text()


def test_an_older_table_is_kept(computed, tmp_path, capsys):
    path = tmp_path / "table.md"
    path.write_text("older")
    assert main(["validate", "--output", str(path)]) == 2
    assert path.read_text() == "older" and "--overwrite" in capsys.readouterr().err
