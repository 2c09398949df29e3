"""The leaderboard's table, made from the reports in docs/leaderboard when the site is built."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from docs.studies.publishing.leaderboard import FOLDER, all_listed, tables

if TYPE_CHECKING:
    from sphinx.application import Sphinx

PAGE = "leaderboard"


def add_table(app: Sphinx, docname: str, source: list[str]) -> None:
    """Put the table behind the text of the page."""
    if docname == PAGE:
        for path in FOLDER.glob("*/*.json"):
            app.env.note_dependency(str(path))
        source[0] = f"{source[0].rstrip()}\n\n{tables(all_listed((FOLDER,)))}"


def setup(app: Sphinx) -> dict[str, Any]:
    """Connect the function that adds the table."""
    app.connect("source-read", add_table)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
