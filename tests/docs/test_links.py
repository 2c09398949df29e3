"""Relative links of the documents point at files that are there."""

import re

import pytest

from helpers.places import ROOT

DOCUMENTS = sorted(path for pattern in ("*.md", "docs/**/*.md", "traces/*.md") for path in ROOT.glob(pattern))
LINK = re.compile(r"\]\(([^)#\s]+)(?:#[^)]*)?\)")


def targets(path):
    """What a document links to within the repository; a URL is no such thing."""
    return [target for target in LINK.findall(path.read_text(encoding="utf-8")) if "://" not in target]


@pytest.mark.parametrize("path", DOCUMENTS, ids=lambda path: path.relative_to(ROOT).as_posix())
def test_links_point_at_files(path):
    assert [target for target in targets(path) if not (path.parent / target).exists()] == []


def test_every_page_can_be_reached_from_the_readme():
    reached, left = set(), [ROOT / "README.md"]
    while left:
        path = left.pop()
        if path.suffix == ".md" and path not in reached:
            reached.add(path)
            left += [(path.parent / target).resolve() for target in targets(path)]
    pages = set((ROOT / "docs").glob("*.md"))
    assert {path.name for path in pages - reached} == set()
