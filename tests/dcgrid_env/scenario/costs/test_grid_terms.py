"""The records of the grid's cost terms: default weights, flags, bounds and divisors; team and agents on one step."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from dcgrid_env import CostWeights, make_scenario
from dcgrid_env.engine.cost.reward import charged_terms, end_costs, largest_costs, local_costs, team_costs, terms
from dcgrid_env.engine.physics.actions import action_layout
from dcgrid_env.engine.simulation import Simulation
from dcgrid_env.scenario.costs.grid_terms import TERMS, mean_unbalance
from helpers.three_phase import ieee13


def named(flag):
    return [term.name for term in TERMS if getattr(term, flag)]


def test_flags_of_the_terms():
    assert {term.name: term.weight for term in TERMS if term.weight} == {
        "voltage": 100.0,
        "violation": 1000.0,
        "backlog": 0.3,
        "effort": 0.02,
        "leftover": 9.0,
    }
    optional = {"ramp_excess", "voltage_step_excess", "overload", "grid_request"}
    assert {"violation", *optional} <= set(named("is_constraint"))
    assert named("is_modelled") == ["voltage", "violation", "backlog", "effort", "leftover"]
    assert optional.isdisjoint(named("is_always_listed"))
    assert CostWeights()._asdict() == {term.name: term.weight for term in TERMS}


@pytest.mark.parametrize(
    ("factors", "charged"), [([[0.5, 2.0, 0.1]], (0.25 + 1.0 + 0.01) / 3), ([[0.5]], 0.25), ([[]], 0.0)]
)
def test_unbalance_is_squared_and_counts_as_one_at_most(factors, charged):
    step: Any = SimpleNamespace(state=SimpleNamespace(three_phase=SimpleNamespace(unbalance=np.array(factors))))
    assert mean_unbalance(step) == pytest.approx(charged)


def test_largest_amounts_worked_by_hand():
    weights = dict.fromkeys(("voltage", "violation", "effort", "step", "loss"), 1.0)
    scenario = make_scenario("toy6", weights=weights, **{"cost.band_pu": 0.03, "datacenters.boost_share": 1.2})
    largest = largest_costs(scenario)._asdict()
    assert {name: largest[name] for name in weights} == pytest.approx(
        {"voltage": 1.0, "violation": 0.97, "effort": 1.0, "step": 1.0, "loss": 2.4}
    )


@pytest.mark.parametrize("three_phases", [False, True])
def test_terms_of_agents_and_of_the_team_on_a_played_step(three_phases):
    """Two rows, of which one ends. Sums over agents of what only agents cause are the team's, by their scales."""
    weights = {"step": 7.0, "loss": 3.0, "clock": 2.0, "ramp_excess": 1.0}
    limits = {"cost.ramp_limit_kw_per_s": 1.0, "cost.reward": "local"}
    base = ieee13() if three_phases else make_scenario("ieee33-weak", datacenters={"p_rated_kw": (900.0, 300.0, 100.0)})
    scenario = base.replace(horizon=9, weights=weights | ({"unbalance": 5.0} if three_phases else {}), **limits)
    simulation = Simulation(scenario, 2)
    transition = simulation.reset([0, 1])
    for k in range(9):
        transition = simulation.step(np.full((2, action_layout(scenario).n), 0.3 if k % 2 else -0.7))
    sites, p_rated = scenario.datacenters.count, scenario.datacenters.parameters.p_rated_kw
    waits = np.array([[40.0, 30.0, 20.0], [500.0, 0.0, 60.0]])[:, :sites]
    state = transition.state
    state = state._replace(devices=(state.devices[0]._replace(backlog_kws=waits), *state.devices[1:]))
    n, last = len(scenario.agents), np.array([True, False])
    solution = SimpleNamespace(loss_kw=np.array([30.0, 60.0]))
    team, own = (costs(scenario, state, solution, last)._asdict() for costs in (team_costs, local_costs))
    np.testing.assert_allclose(own["backlog"], np.pad(0.3 * waits / p_rated, ((0, 0), (0, n - sites))))
    np.testing.assert_allclose(own["leftover"][0], 30.0 * own["backlog"][0])
    np.testing.assert_allclose(team["backlog"], 0.3 * waits.sum(1) / p_rated.sum())
    np.testing.assert_allclose(team["leftover"], [9.0 * waits[0].sum() / p_rated.sum(), 0.0])
    assert not own["leftover"][1].any()
    np.testing.assert_allclose(team["effort"], own["effort"].mean(1))
    np.testing.assert_allclose(team["clock"], own["clock"].sum(1) / sites)
    np.testing.assert_allclose(team["ramp_excess"], own["ramp_excess"].sum(1) / sites)
    assert not own["ramp_excess"][:, sites:].any()
    assert own["ramp_excess"][:, :sites].any()
    for name in ("loss", "unbalance") if three_phases else ("loss",):
        np.testing.assert_array_equal(own[name], np.repeat(team[name][:, None], n, axis=1))
    assert team["loss"][1] == pytest.approx(2.0 * team["loss"][0])
    assert set(own) == set(team) == set(terms(scenario).kind._fields)
    unweighted = set(own) - {term.name for term, _ in charged_terms(scenario)} - {"backlog", "leftover", "clock"}
    assert all(not own[name].any() and not team[name].any() for name in unweighted)
    due = end_costs(scenario, state)
    assert list(due) == ["leftover"]
    np.testing.assert_allclose(due["leftover"], 9.0 * waits.sum(1) / p_rated.sum())
