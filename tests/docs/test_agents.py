"""docs/training.md's table of the policies that ship is what their cards say."""

import runpy
from pathlib import Path

DOCS = Path(__file__).parents[2] / "docs"


def test_the_table_is_of_the_cards():
    table = runpy.run_path(str(DOCS / "agents.py"))["table"]()
    assert table in (DOCS / "training.md").read_text(encoding="utf-8")
