"""What is said of a name that does not exist, and hints for installing extras, which work from a clone."""

import re
import subprocess
import tomllib
from pathlib import Path

import pytest

from dcgrid_env.core.suggestions import from_clone, unknown
from helpers.places import ROOT

EXTRAS = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
NAMES = ("toy6", "ieee33", "ieee33-weak", "ieee123", "ieee123-3ph")


@pytest.mark.parametrize(
    ("name", "near"),
    [
        ("ieee13-3ph", "did you mean ieee123-3ph, ieee33 or ieee123? "),  # three at most, the nearest first
        ("TOY6", "did you mean toy6? "),
        ("nothing", ""),
        ("", ""),
        (None, ""),
        (7, ""),
        ("x" * 100_000, ""),
    ],
)
def test_up_to_three_similar_names_and_where_all_are_listed(name, near):
    assert unknown("scenario", name, NAMES, "see the list") == f"no scenario {name!r}; {near}see the list"


def test_the_last_word_of_a_name_is_compared():
    said = unknown("command", "shwo", ["dcgrid traces show", "dcgrid run"], "see the list")
    assert said == "no command 'shwo'; did you mean dcgrid traces show? see the list"


def sources():
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    for path in filter(None, listed.split("\0")):
        if path.endswith((".py", ".md", ".toml", ".ipynb")) and path != Path(__file__).relative_to(ROOT).as_posix():
            yield path, (ROOT / path).read_text()


@pytest.mark.parametrize("extra", ["agents", "frameworks", "record", "bench", "video", "opendss"])
def test_the_hint_names_an_extra_that_there_is(extra):
    assert extra in EXTRAS
    assert from_clone(extra).endswith(f"pip install -e '.[{extra}]'")


@pytest.mark.skipif(not (ROOT / ".git").exists(), reason="not a clone: git does not say which files there are")
def test_no_hint_asks_a_registry_and_every_extra_named_is_there():
    named = set()
    for path, text in sources():
        assert not re.search(r"pip install [^\n`]*dcgrid[-_]env", text), path
        for extras in re.findall(r"pip install [^\n`]*?\.\[([\w,]+)\]", text):
            named |= set(extras.split(","))
        named |= set(re.findall(r"from_clone\(['\"](\w+)['\"]\)", text))
    assert named <= set(EXTRAS)
    assert {"agents", "test", "bench", "record", "frameworks", "video", "dev"} <= named
