"""Controllers that know a three-phase feeder, and hindsight: slopes across phases, taps that move, capacitors lost."""

import numpy as np
import pytest

from dcgrid_env import (
    Fault,
    forecast,
    sensitivity_between_agents,
    sensitivity_to_agents,
)
from dcgrid_env.baselines import make_controller, rollout
from dcgrid_env.baselines.laws.stability import placements, spectral_radius
from dcgrid_env.baselines.model_based.hindsight import hindsight
from helpers.three_phase import SCENARIOS, ieee13


def cost(scenario, name):
    controller = make_controller(name)
    observe = getattr(controller, "observe", scenario.sensing.observe)
    return rollout(scenario.replace(observe=observe), controller, [0]).metrics()[0]["J"]


@pytest.mark.parametrize("name", SCENARIOS)
def test_the_more_is_known_the_less_it_costs(name):
    scenario = SCENARIOS[name]().replace(grid_control={"regulators": "fixed"})
    best = hindsight(scenario, 0)
    costs = [cost(scenario, controller) for controller in ("none", "inverters", "mpc-one-step")]
    assert min(costs[:2]) > costs[2] > best.J - 1e-3
    assert abs(best.gap) < 1e-4 * best.J


def test_hindsight_knows_of_a_lost_capacitor():
    faults = (Fault(("capacitor",), begin_s=(3.0, 3.0), duration_s=(6.0, 6.0)),)
    scenario = ieee13().replace(faults=faults, grid_control={"regulators": "fixed"})
    on = forecast(scenario, 0).capacitor_on
    assert on is not None
    assert on.shape == (20, 2)
    assert on.sum(axis=1).tolist() == [2.0] * 3 + [1.0] * 6 + [2.0] * 11
    found = hindsight(scenario, 0)
    assert abs(found.gap) < 1e-4 * found.J


@pytest.mark.parametrize("controller", ["mpc", "feedback"])
def test_what_is_not_minimised_is_refused(controller):
    scenario = ieee13().replace(weights={"unbalance": 5.0}, observe="feeder")
    with pytest.raises(ValueError, match=r"weights.unbalance is 5, which it does not minimise; set it to 0"):
        make_controller(controller).reset(scenario)
    with pytest.raises(ValueError, match="hindsight does not price unbalance; set its weight to 0"):
        hindsight(scenario, 0)


@pytest.mark.parametrize("name", SCENARIOS)
def test_sensitivities_of_agents_agree_with_each_other(name):
    scenario = SCENARIOS[name]()
    feeder = scenario.feeder
    buses = np.array([[feeder.index(bus) for bus in placements(scenario, 1)[0]]])
    of_nodes, of_agents = sensitivity_to_agents(scenario, buses), sensitivity_between_agents(scenario, buses)
    for to_nodes, between in zip(of_nodes, of_agents, strict=True):
        assert to_nodes.shape == (1, scenario.n_agents, feeder.n_node)
        for agent, bus in enumerate(buses[0]):
            seen = to_nodes[0][:, list(feeder.nodes_at(bus))].mean(-1)
            np.testing.assert_allclose(between[0, agent], seen, rtol=1e-12)
        assert (np.diagonal(between[0]) > 0).all()


def test_the_stable_gain_is_that_of_the_sensitivities():
    scenario = ieee13()
    buses = placements(scenario, 1)[0]
    _, x = sensitivity_between_agents(scenario, np.array([[scenario.feeder.index(bus) for bus in buses]]))
    bound = 2.0 / np.abs(np.linalg.eigvals(x[0])).max()
    assert spectral_radius(scenario, buses, 0.0, 0.99 * bound) <= 1.0
    assert spectral_radius(scenario, buses, 0.0, 1.01 * bound) > 1.0
