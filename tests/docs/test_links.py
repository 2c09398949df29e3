"""Relative links of the documents point at files that are there."""

import re

import pytest

from helpers.places import ROOT

DOCUMENTS = sorted(path for pattern in ("*.md", "docs/**/*.md", "traces/*.md") for path in ROOT.glob(pattern))
LINK = re.compile(r"\]\(([^)#\s]+)(?:#[^)]*)?\)")
TOCTREE = re.compile(r"^:::\{toctree\}\n(.*?)^:::$", re.MULTILINE | re.DOTALL)
EXTERNAL = {
    "https://github.com/chennnnnyize/voltage-regulation-with-data-centers",
    "https://github.com/gpu2grid/openg2g",
}
"""Addresses that documents link to, each opened by hand before it was listed: no test needs the network."""
MADE = ("environments/", "api/")
"""Folders of docs/ whose pages are made when the site is built, which checks their links."""


def targets(path):
    """Return a document's links within the repository, without URLs and pages that the site generates."""
    found = [target for target in LINK.findall(path.read_text(encoding="utf-8")) if "://" not in target]
    return [target for target in found if not target.startswith(MADE)]


def listed(path):
    """Pages in the lists of the site's pages, those that are made and patterns left out."""
    blocks = TOCTREE.findall(path.read_text(encoding="utf-8"))
    lines = [line for block in blocks for line in block.splitlines() if line and not line.startswith(":")]
    names = [re.sub(r".*<(.*)>", r"\1", line) for line in lines]
    named = [name for name in names if "*" not in name and not name.startswith(MADE)]
    return [f"{name}.ipynb" if (path.parent / f"{name}.ipynb").exists() else f"{name}.md" for name in named]


@pytest.mark.parametrize("path", DOCUMENTS, ids=lambda path: path.relative_to(ROOT).as_posix())
def test_links_point_at_files(path):
    assert [target for target in (*targets(path), *listed(path)) if not (path.parent / target).exists()] == []


def test_external_links_are_those_that_were_opened():
    texts = [path.read_text(encoding="utf-8") for path in DOCUMENTS]
    assert {target for text in texts for target in LINK.findall(text) if "://" in target} == EXTERNAL


def test_every_page_can_be_reached_from_the_readme():
    reached, left = set(), [ROOT / "README.md"]
    while left:
        path = left.pop()
        if path.suffix == ".md" and path not in reached:
            reached.add(path)
            left += [(path.parent / target).resolve() for target in (*targets(path), *listed(path))]
    pages = set((ROOT / "docs").glob("*.md"))
    assert {path.name for path in pages - reached} == set()


def test_the_sidebar_is_short():
    """At most 30 entries; pages of detail are listed by the page above them."""
    blocks = TOCTREE.findall((ROOT / "docs" / "index.md").read_text(encoding="utf-8"))
    assert 20 <= sum(bool(line) and not line.startswith(":") for block in blocks for line in block.splitlines()) <= 30
