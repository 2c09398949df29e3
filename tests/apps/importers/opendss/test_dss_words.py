"""A line is split as OpenDSS splits it, and what could be read in two ways is refused."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dcgrid_env.apps.importers.opendss.dss_words import CLOSING, Word, words_of


@pytest.mark.parametrize(("line", "words"), [
    ("New Line.a bus1=x.1.2", [("", "New"), ("", "Line.a"), ("bus1", "x.1.2")]),
    ("~ kv = 4.16,  kw=3 ! a=b", [("", "~"), ("kv", "4.16"), ("kw", "3")]),
    ("set a=(1 2 | 3), b=[x=1]", [("", "set"), ("a", "1 2 | 3"), ("b", "x=1")]),
    ('redirect "a b.dss" // more', [("", "redirect"), ("", "a b.dss")]),
    ("edit x bank= kw=2", None),
    ("edit x bank=, kw=2", [("", "edit"), ("", "x"), ("bank", ""), ("kw", "2")]),
])  # fmt: skip
def test_lines_worked_by_hand(line, words):
    if words is None:
        with pytest.raises(ValueError, match="= without a name"):
            words_of(line)
    else:
        assert [(word.name, word.text) for word in words_of(line)] == words


@pytest.mark.parametrize(("line", "said"), [
    ("new x kw=((1 2) usermodel=y)", "stands within"),
    ('new x "kw"=3', "stands in quotes"),
    ("new x kw=(1 2", "not closed"),
    ("redirect @lastexportfile", "variable of OpenDSS"),
    ("new x file=@a", "variable of OpenDSS"),
    ("new\x00x", "control character"),
    ("= 3", "without a name"),
])  # fmt: skip
def test_what_could_be_read_in_two_ways_is_refused(line, said):
    with pytest.raises(ValueError, match=said):
        words_of(line)


NAME = st.text("abcXYZ0_.%-", min_size=1, max_size=8).filter(lambda name: "//" not in name)


@st.composite
def a_word(draw):
    quote = draw(st.sampled_from(["", *CLOSING]))
    inside = "ab1. ,|=!/" if quote else "ab1."
    text = draw(st.text(inside, min_size=0 if quote else 1, max_size=12))
    return Word(draw(st.one_of(st.just(""), NAME)), text, quote)


@given(st.lists(a_word(), max_size=6))
@pytest.mark.slow
def test_words_that_are_written_are_read_again(words):
    assert words_of(" ".join(map(str, words))) == words


@given(st.text("ab=,()[]{}\"'!/. \t|~", max_size=20))
def test_opendss_reads_the_words_that_are_written_as_they_were_read(line):
    dss = pytest.importorskip("opendssdirect", reason="OpenDSSDirect.py is not installed (extra opendss)")
    try:
        words = words_of(line)
    except ValueError:
        return
    parser = dss.dss.Parser
    parser.CmdString(" ".join(map(str, words)))
    assert [(parser.NextParam(), parser.StrValue()) for _ in words] == [(word.name, word.text) for word in words]
    assert (parser.NextParam(), parser.StrValue()) == ("", "")
