"""The reference page says what the code does, and explains every key."""

from pathlib import Path

from cloudtomo_cl.settings_reference import page, undocumented

PAGE = Path(__file__).parents[2] / "docs" / "settings.md"


def test_the_page_is_up_to_date():
    assert PAGE.read_text(encoding="utf-8") == page(), "settings changed: run `python scripts/settings_reference.py`"


def test_every_key_is_explained():
    assert not undocumented(), "write what these keys mean, with units, under Attributes in the docstrings"


def test_a_row_has_allowed_values_default_and_unit():
    rows = [line for line in page().splitlines() if line.startswith("| `irradiance`")]
    allowed = "number at least 1e-12, at most 1e+12"
    assert rows == [f"| `irradiance` | {allowed} | `1.0` | on a plane normal to the beam, W m^-2 |"]
