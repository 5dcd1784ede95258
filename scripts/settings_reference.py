"""Writes docs/reference/settings.md, the reference of every settings key. Run it when a key or its meaning changed."""

from pathlib import Path

from cloudtomo_cl.settings.reference_page import page

PAGE = Path(__file__).resolve().parents[1] / "docs" / "reference" / "settings.md"

if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
    print(PAGE)
