"""What is said of a name that does not exist."""

import pytest

from dcgrid_env.core.suggestions import unknown

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
