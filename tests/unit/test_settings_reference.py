"""The reference page says what the code does, and explains every key."""

from pathlib import Path

from cloudtomo_cl.settings.reference_page import page, undocumented

PAGE = Path(__file__).parents[2] / "docs" / "reference" / "settings.md"


def test_the_page_is_up_to_date():
    assert PAGE.read_text(encoding="utf-8") == page(), "settings changed: run `python scripts/settings_reference.py`"


def test_every_key_is_explained():
    assert not undocumented(), "write what these keys mean, with units, under Attributes in the docstrings"


def test_a_row_has_allowed_values_default_and_unit():
    section = page().partition("**`PerspectiveView`**")[2]
    row = next(line for line in section.splitlines() if line.startswith("| `field_of_view`"))
    assert row == "| `field_of_view` | number above 0, below 180 | required | degrees, across the image's width |"
