"""The glossary points at files that are there, and has each term once."""

import re

from dcgrid_env.rendering.replay_terms import TERMS
from helpers.places import ROOT

TEXT = (ROOT / "docs" / "glossary.md").read_text(encoding="utf-8")


def test_files_of_the_glossary_are_there():
    paths = re.findall(r"`((?:dcgrid_env|baselines|agents|traces)/[^`]*)`", TEXT)
    assert len(paths) > 20
    assert [path for path in paths if not (ROOT / path).exists()] == []


def test_the_replay_explains_words_in_sentences_of_the_glossary():
    text = " ".join(TEXT.replace("`", "").split())
    assert [word for word, meaning in TERMS.items() if f".** {meaning}" not in text] == []


def test_each_term_is_defined_once():
    terms = [
        term.casefold() for head in re.findall(r"^\*\*([^*]+)\.\*\*", TEXT, re.MULTILINE) for term in head.split(", ")
    ]
    assert len(terms) > 60
    assert sorted(terms) == sorted(set(terms))
