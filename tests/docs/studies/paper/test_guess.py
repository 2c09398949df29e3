"""Guesses of the settings that the paper does not state, and how close they come to Table I."""

import pytest

from dcgrid_env.apps.reproduction import table1
from dcgrid_env.apps.reproduction.paper import TABLE_ONE
from dcgrid_env.apps.reproduction.study_runs import Law
from docs.studies.paper.guess import (
    COLUMNS,
    VALUES,
    Guess,
    cells,
    distance,
    figures,
    law_of,
    scenario_of,
)


@pytest.mark.slow
def test_the_default_guess_is_the_study(few):
    for row in cells(few, Guess()):
        run = few.run(few.setting.scenario(row["n_datacenters"]), Law(k_p_mw_per_pu=row["k_p"]))
        assert row["deviation_pu"] == table1.figures(run)["deviation_mean_pu"]
        assert row["delay_s"] == table1.figures(run)["delay_mean_s"]


@pytest.mark.slow
def test_each_setting_of_a_guess_is_heeded(few):
    def figures_of(guess):
        return figures(few.run(scenario_of(few, guess, 5), law_of(guess, 20.0)), guess)

    own = figures_of(Guess())
    for name, values in VALUES.items():
        other = next(value for value in values if value != getattr(Guess(), name))
        assert figures_of(Guess(**{name: other})) != own, name


def test_distance_is_the_mean_absolute_error():
    rows = [
        {"n_datacenters": n, "k_p": k_p, "deviation_pu": cell.deviation_pu + 0.001, "delay_s": cell.delay_s - 0.5}
        for (n, k_p), cell in TABLE_ONE.items()
    ]
    found = distance(rows)
    assert found.deviation_pu == pytest.approx(0.001)
    assert found.delay_s == pytest.approx(0.5)
    means = [sum(cell[i] for cell in TABLE_ONE.values()) / 15 for i in (0, 2)]
    assert found.total == pytest.approx(0.001 / means[0] + 0.5 / means[1])


def test_what_was_found_lies_in_what_was_searched():
    assert all(getattr(COLUMNS["found"], name) in values for name, values in VALUES.items())
    assert COLUMNS["found"].site_kw == Guess().site_kw
