"""Tables on a terminal: no name is broken, whatever the width."""

import io

import pytest
from rich.console import Console

from dcgrid_env.core.text_table import Table, fit, folded, longest_piece

NAMES = ("none", "droop-q", "droop-one-step", "constant-q-tuned", "results/train/ieee33-weak-ppo-0", "mine.py:Ctrl")
TABLE = Table(
    "Score",
    ("mean over episodes", *NAMES),
    (
        ("unserved at the end, kW s", *(["1234.5"] * len(NAMES))),
        ("monotone, gain below the stability bound (safe)", *(["[0.91]*"] * len(NAMES))),
    ),
)


def shown(width, fixed=1):
    out = io.StringIO()
    Console(file=out, width=width).print(TABLE.rich(width, fixed))
    return out.getvalue()


def test_names_fold_behind_hyphens_and_slashes_and_between_words():
    assert folded("droop-one-step", 6) == "droop-\none-\nstep"
    assert folded("constant-q-tuned", 9) == "constant-\nq-tuned"
    assert folded("mean |V-1|, p.u.", 10) == "mean\n|V-1|,\np.u."
    assert folded("results/train/ieee33-weak-ppo-0", 18) == "results/train/\nieee33-weak-ppo-0"
    assert folded("scale-32", 3) == "scale-\n32"
    assert folded("undivided", 3) == "undivided"
    assert folded("droop-one-step", 14) == "droop-one-step"
    assert [longest_piece(text) for text in ("", "droop-one-step", "J but for waiting")] == [0, 6, 7]


@pytest.mark.parametrize("width", [40, 60, 80, 120, 200])
def test_every_piece_of_every_name_and_every_figure_stands_whole(width):
    printed = shown(width)
    assert max(map(len, printed.splitlines())) <= width
    words = set(printed.split())
    for name in NAMES:
        pieces = folded(name, 1).split("\n")
        spans = {"".join(pieces[i:k]) for i in range(len(pieces)) for k in range(i + 1, len(pieces) + 1)}
        first, last = pieces[0], pieces[-1]
        assert any(word in spans and word.startswith(first) for word in words)
        assert any(word in spans and word.endswith(last) for word in words)
    assert printed.count("1234.5") == printed.count("[0.91]*") == len(NAMES)
    assert printed.count("Score") == 1


def test_what_does_not_fit_goes_below_under_the_rows_names():
    wide, narrow = shown(200), shown(80)
    assert wide.count("unserved") == 1
    assert narrow.count("unserved") > 1
    parts = fit(TABLE.header, TABLE.rows, 80)
    assert [part.columns[0] for part in parts] == [0] * len(parts)
    assert [i for part in parts for i in part.columns[1:]] == [1, 2, 3, 4, 5, 6]
    for part in parts:
        assert 1 + sum(width + 2 for width in part.widths) <= 80


def test_headings_stand_unfolded_where_there_is_room():
    assert "results/train/ieee33-weak-ppo-0" in shown(200)
    (part,) = fit(("a", "droop-one-step", "droop-one-step"), [("x", "1.0", "1.0")], 30)
    assert part.widths == (1, 14, 8)


def test_as_many_first_columns_as_asked_for_stand_in_every_part():
    parts = fit(("row", "unit", *NAMES), [("J", "p.u.", *["1.0"] * len(NAMES))], 40, fixed=2)
    assert len(parts) > 1
    assert all(part.columns[:2] == (0, 1) for part in parts)


def test_a_table_of_names_alone_is_one_part():
    assert [part.columns for part in fit(("a",), [("x",)], 20)] == [(0,)]
