"""Leave one scenario out."""

from dcgrid_env.agents.algorithms.analytic import Analytic
from docs.studies.learning import generalise


def test_each_is_left_out_once_and_never_trained_on(tmp_path):
    names = ["ieee33", "das69", "ieee123"]
    runs = generalise.configs(Analytic, names, {"vary": 2}, 2, tmp_path)
    assert list(runs) == names
    for left_out, every in runs.items():
        assert [one.seed for one in every] == [0, 1]
        for one in every:
            assert set(one.scenario.split(",")) == set(names) - {left_out}
            assert one.vary == 2
    assert len({one.out for every in runs.values() for one in every}) == 6


def test_a_failed_run_is_a_row_beside_what_was_made_for_the_scenario(tmp_path):
    runs = generalise.configs(Analytic, ["toy6", "ieee33"], {}, 1, tmp_path)
    found = generalise.generalise(2, runs, {every[0].out: "diverged" for every in runs.values()})
    made = generalise.table(2, found)
    assert [row[:4] for row in made.rows] == [("toy6", "ieee33", "failed", "–"), ("ieee33", "toy6", "failed", "–")]
    assert 0.5 < float(made.rows[1][5]) <= 1.0  # the best constant nearly solves ieee33
    assert made.notes == ("toy6: diverged", "ieee33: diverged")
    assert {len(row) for row in made.rows} == {len(made.header)}
