"""A check of scenarios whose answer is known, and the batch search behind it."""

import time

import numpy as np
import pytest

from dcgrid_env import ThreePhaseFeeder, load_feeder, make_scenario, scenario_on
from dcgrid_env.baselines import NoControl, rollout
from dcgrid_env.baselines.model_based.hindsight import hindsight
from dcgrid_env.baselines.sanity.batch_search import fitted
from dcgrid_env.baselines.sanity.scenario_check import check_scenario
from dcgrid_env.baselines.sanity.verdicts import BARE, CONSTANT, DROOP, HINDSIGHT, NO_CONTROL, PAPER, PINNED
from dcgrid_env.baselines.tuning.search import tune
from dcgrid_env.grid.network import Network, NodeTable, PhaseLineTable, PhaseLoadTable, SourceTable

SHORT = {"split": "validation", "horizon": 20}


@pytest.mark.slow
@pytest.mark.parametrize("law", ["droop", "constant-q"])
def test_the_batch_search_comes_close_to_the_finer_one(law):
    scenario = make_scenario("toy6", **SHORT)
    found = fitted(law, scenario, range(2), time.monotonic() + 60.0)
    assert pytest.approx(rollout(scenario, found.controller, range(2)).costs().mean(), rel=1e-6) == found.J
    assert 1.02 * tune(law, [scenario], 2).score >= found.J


def test_a_search_without_time_is_no_worse_than_where_it_begins():
    scenario = make_scenario("ieee33-weak", **SHORT)
    none = rollout(scenario, NoControl(), range(2)).costs().mean()
    assert none >= fitted("constant-q", scenario, range(2), 0.0).J


@pytest.mark.slow
def test_who_reaches_what_is_in_order_and_hindsight_is_the_least():
    scenario, stages = make_scenario("ieee33-weak", **SHORT), []
    check = check_scenario(scenario, episodes=2, seconds=30.0, on_stage=stages.append)
    reached = check.figures.reached
    j = {name: one.mean("J") for name, one in reached.items()}
    assert j[HINDSIGHT] <= min(j[DROOP], j[CONSTANT]) + 1e-6
    assert max(j[DROOP], j[CONSTANT]) < j[NO_CONTROL]
    assert j[DROOP] <= j[PAPER] + 1e-6
    assert j[PINNED] >= j[HINDSIGHT] - 1e-6
    assert j[BARE] < j[NO_CONTROL]
    assert reached[HINDSIGHT].metrics["J"][1] == pytest.approx(hindsight(scenario, 1).J, rel=2e-3)
    assert stages == [HINDSIGHT, PINNED, NO_CONTROL, DROOP, CONSTANT]
    assert check.figures.lowest_bus in ("18", "33")
    table = check.table
    assert table.header == ("mean over episodes", NO_CONTROL, PAPER, DROOP, CONSTANT, HINDSIGHT)
    assert table.rows[-1] == ("episodes", "2", "2", "2", "2", "2")


def test_without_time_all_columns_are_of_the_one_episode_of_hindsight():
    check = check_scenario(make_scenario("toy6", **SHORT), episodes=3, seconds=1e-6)
    assert check.table.rows[-1] == ("episodes", "1", "1", "1", "1", "1")
    assert "the first 1 of 3 episodes" in str(check.verdicts[-1])
    assert PINNED not in check.figures.reached


@pytest.mark.slow
def test_a_feeder_where_nothing_can_be_done_is_not_worth_learning():
    scenario = make_scenario("ieee33", **{"datacenters.p_rated_kw": 0.1}, **{"inverters.s_rated_kva": 0.1}, **SHORT)
    check = check_scenario(scenario, episodes=2, seconds=20.0)
    assert not check.is_worth_learning
    assert any(str(verdict).startswith("nothing to gain: hindsight is within") for verdict in check.verdicts)


@pytest.mark.slow
def test_a_scenario_that_hindsight_refuses_is_judged_without_it():
    check = check_scenario(make_scenario("toy6", **{"cost.voltage": "l2"}, **SHORT), episodes=2, seconds=10.0)
    assert HINDSIGHT not in check.figures.reached
    assert "l1 voltage cost only" in check.figures.refused
    assert np.isfinite(check.figures.largest_k_q)


def test_only_what_hindsight_refuses_is_reported_as_not_known(monkeypatch):
    def broken(*_args, **_more):
        raise ValueError("cannot reshape array of size 0 into shape (0)")

    monkeypatch.setattr("dcgrid_env.baselines.sanity.scenario_check.hindsight", broken)
    with pytest.raises(ValueError, match="cannot reshape"):
        check_scenario(make_scenario("toy6", **SHORT), episodes=1, seconds=1e-6)


@pytest.mark.parametrize(("given", "message"), [({"episodes": 0}, "episodes is 0"), ({"seconds": 0.0}, "seconds 0")])
def test_settings_that_cannot_be_are_refused(given, message):
    with pytest.raises(ValueError, match=message):
        check_scenario(make_scenario("toy6"), **given)


@pytest.mark.slow
@pytest.mark.parametrize("feeder", ["toy6", "three phases"])
@pytest.mark.parametrize(("datacenters", "inverters"), [("1 x 100 kW at {}", "none"), ("none", "1 x 50 kvar at {}")])
def test_hindsight_is_known_without_inverters_data_centres_or_equipment(feeder, datacenters, inverters):
    made, bus = (load_feeder("toy6"), "4") if feeder == "toy6" else (pair_of_buses(), "r")
    scenario = scenario_on(made, datacenters.format(bus), inverters.format(bus)).replace(**SHORT)
    check = check_scenario(scenario, episodes=1, seconds=1.0)
    reached = check.figures.reached
    assert not check.figures.refused
    assert (
        reached[HINDSIGHT].mean("J")
        <= min(reached[name].mean("J") for name in (NO_CONTROL, PAPER, DROOP, CONSTANT)) + 1e-3
    )
    assert not any("more than 0 kvar" in str(verdict) for verdict in check.verdicts)


def pair_of_buses():
    """A three-phase line to one load, without regulators and capacitor banks."""
    diagonal = tuple(tuple(0.3 if i == j else 0.0 for j in range(3)) for i in range(3))
    matrix, zero = (diagonal,), (tuple((0.0,) * 3 for _ in range(3)),)
    load = ("wye",), ("PQ",), (7.2,), ((500.0,) * 3,), ((150.0,) * 3,), (0.5,), (1.5,), (0.4,), ((),)
    network = Network(
        name="pair",
        source=SourceTable(("s",), (12.47,), (1.0,), (0.0,), zero, zero),
        node=NodeTable(["s"] * 3 + ["r"] * 3, [1, 2, 3] * 2, [0.0] * 6, [0.0] * 6, base_kv_ln=[7.2] * 6),
        phase_line=PhaseLineTable(("l",), ("s",), ("r",), ("abc",), (1000.0,), matrix, matrix, zero),
        phase_load=PhaseLoadTable(("d",), ("r",), *load),
    )
    return ThreePhaseFeeder.from_network(network)
