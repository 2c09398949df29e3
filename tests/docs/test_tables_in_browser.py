"""Tables of the site in Chromium: their script sorts and filters the rows."""

import re
import shutil
import subprocess

import pytest

from docs.studies.publishing.site_tables import NONE
from helpers.places import ROOT

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(CHROMIUM is None, reason="no Chromium here; apt-get install chromium"),
]
ROWS = (("b", "0.5 (0.1 to 0.9)", "local"), ("a", "-12.0 (-13.0 to -11.0)", "all"), ("c", NONE, "local"))
HEAD = ("name", "score", "observes")


def after(actions, tmp_path):
    """First cells of the rows that are shown, and the number of rows that the page states, after some JavaScript."""
    script = (ROOT / "docs" / "static" / "tables.js").read_text(encoding="utf-8")
    body = "".join(f"<tr>{''.join(f'<td>{cell}</td>' for cell in row)}</tr>" for row in ROWS)
    head = "".join(f"<th>{name}</th>" for name in HEAD)
    table = f"<table class='sortable'><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"
    write = (
        "[...document.querySelectorAll('tbody tr')].filter((row) => !row.hidden).map((row) => row.cells[0].textContent)"
    )
    told = f"document.title = {write}.join('') + ' ' + document.querySelector('output').textContent;"
    page = tmp_path / "page.html"
    page.write_text(f"<meta charset='utf-8'>{table}<script>{script}\n{actions}\n{told}</script>", encoding="utf-8")
    command = [CHROMIUM, "--headless", "--no-sandbox", "--disable-gpu", "--dump-dom", page.as_uri()]
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=120)
    (title,) = re.findall("<title>(.*)</title>", done.stdout)
    return title


def click(column):
    return f"document.querySelectorAll('th button')[{column}].click();"


@pytest.mark.parametrize(
    ("actions", "shown"),
    [
        ("", "bac 3 of 3 rows"),
        (click(0), "abc 3 of 3 rows"),
        (click(0) * 2, "cba 3 of 3 rows"),
        (click(1), "abc 3 of 3 rows"),  # by number, and what has none comes last
        (click(1) * 2, "bac 3 of 3 rows"),
        (
            "const list = document.querySelector('select'); list.value = 'local';"
            "list.dispatchEvent(new Event('change', { bubbles: true }));",
            "bc 2 of 3 rows",
        ),
    ],
    ids=["as made", "text", "text, descending", "number", "number, descending", "filter"],
)
def test_readers_sort_and_filter(actions, shown, tmp_path):
    assert after(actions, tmp_path) == shown
