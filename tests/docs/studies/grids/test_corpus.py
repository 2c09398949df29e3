"""Public collections of grids: none that was equal to its program's solution differs, and the page has the table."""

import math

import pytest

from dcgrid_env import FeederError
from docs.studies.grids import corpus
from docs.studies.grids.corpus import Grid, Outcome, outcome


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")  # pandas', pandapower's and PYPOWER's
@pytest.mark.parametrize("name", corpus.CORPORA)
def test_grids_that_were_equal_to_their_program_are_equal(name):
    if absent := corpus.missing(name):
        pytest.skip(f"{absent} is missing (extras test and corpus)")
    verdicts = {row.grid: row for row in corpus.measured(name)}
    before = [row.grid for row in corpus.stored() if row.corpus == name and row.verdict == "equal"]
    assert before
    lost = [verdicts.get(grid, f"{grid} is no longer in the corpus") for grid in before]
    assert [row for row in lost if not isinstance(row, Outcome) or row.verdict != "equal"] == []


def test_page_has_the_summary_of_the_table():
    text = corpus.PAGE.read_text(encoding="utf-8")
    rows = corpus.stored()
    assert corpus.page_with(corpus.summary(rows), text) == text
    assert corpus.table_text(rows) == corpus.TABLE.read_text(encoding="utf-8")
    assert {row.corpus for row in rows} == set(corpus.CORPORA)
    assert sum(row.corpus.startswith("simbench") and row.verdict == "equal" for row in rows) >= 60


def refuse():
    raise FeederError("cannot be represented")


def stop():
    raise corpus.NoSolutionError("no solution")


@pytest.mark.parametrize(
    ("differences", "verdict", "reason"),
    [
        (lambda: {"a": 1e-9, "b": 1e-6}, "equal", ""),
        (lambda: {"a": 1e-9, "b": 1.1e-6}, "differs", "at b"),
        (lambda: {"a": math.inf, "b": 0.0}, "differs", "at a"),
        (lambda: {"a": 0.0, "b": math.nan}, "differs", "at b"),
        (refuse, "refused", "cannot be represented"),
        (stop, "no solution", "no solution"),
    ],
)
def test_verdict_of_a_grid(differences, verdict, reason):
    found = outcome("corpus", Grid("grid", differences))
    assert (found.verdict, found.reason) == (verdict, reason)


def test_load_that_the_import_misses_is_a_difference(monkeypatch):
    pandapower = pytest.importorskip("pandapower")
    from pandapower.networks import simple_four_bus_system

    read = corpus.read_pandapower

    def read_without_a_load(net, **options):
        pandapower.toolbox.drop_elements(net, "load", [0])
        return read(net, **options)

    assert max(corpus.differences_from_pandapower(simple_four_bus_system).values()) < 1e-6
    monkeypatch.setattr(corpus, "read_pandapower", read_without_a_load)
    assert max(corpus.differences_from_pandapower(simple_four_bus_system).values()) > 1e-4
