"""Difference rewards against complete power flows with another action, and against the other form of the kernel."""

from typing import Any

import numpy as np
import pytest

from dcgrid_env import Scenario, action_layout, make_scenario
from dcgrid_env.engine import simulation as simulations
from dcgrid_env.engine.cost import difference
from dcgrid_env.engine.family_simulation import simulation as simulation_of
from dcgrid_env.engine.simulation import Simulation, Transition, difference_scale
from dcgrid_env.grid.per_unit import S_BASE_KVA
from dcgrid_env.scenario.costs import difference_reward
from helpers.forms import each_preset

N_ENV = 3


def after_some_steps(scenario: Scenario, steps: int = 4) -> tuple[Simulation, np.ndarray]:
    """A simulation within an episode, and random actions for its next step, with little reactive power."""
    simulation = simulation_of(scenario, N_ENV)
    simulation.reset(range(N_ENV))
    rng, layout = np.random.default_rng(1), action_layout(scenario)
    widest = np.where(layout.is_channel("q"), 0.3, 1.0)
    for _ in range(steps):
        simulation.step(rng.uniform(-widest, widest, (N_ENV, layout.n)))
    return simulation, rng.uniform(-widest, widest, (N_ENV, layout.n))


def vector_of(transition: Transition) -> np.ndarray:
    """The difference reward of each entry of the joint action."""
    assert transition.reward_vector is not None
    return transition.reward_vector


def priced(simulation: Simulation) -> np.ndarray:
    """The team's cost of the last step with work that is left at the end of the episode charged at once, (row,)."""
    scenario, transition = simulation.scenario, simulation.transition
    params, kinds = difference.parameters(scenario, transition.cost_j), scenario.devices
    waiting = [
        price * kinds[i].amount(amount, params.devices[i], transition.state.devices[i]).sum(-1)
        for i, prices in enumerate(difference._prices(scenario))
        for amount, price in prices
    ]
    grid = [getattr(transition.costs, name) for name in difference_reward.COMPARED if hasattr(transition.costs, name)]
    return np.sum(grid, axis=0) + np.sum(np.broadcast_arrays(*waiting), axis=0)


@pytest.mark.parametrize(
    ("name", "tolerance", "steps"),
    [
        ("ieee33-weak", 0.3, 4),
        ("fault", 0.1, 4),
        ("mixed", 0.15, 4),
        ("ieee33-weak-ups", 0.4, 4),
        ("routing", 0.3, 4),
        ("load-target", 0.3, 60),  # within a request
        ("ride-through", 0.3, 240),  # sites that have disconnected may return
        ("ieee13-3ph", 0.3, 4),
    ],
)
def test_it_is_the_change_of_cost_with_another_power_flow(
    name: str, tolerance: float, steps: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each entry against a complete step with the default in its place.

    The difference is the error of the linear sensitivities. Coming taps are tested in test_tap_credit.py.
    """
    monkeypatch.setattr(simulations, "tap_targets", lambda _: None)
    scenario = make_scenario(name, reward="difference", cost={"default_action": "rest"})
    simulation, action = after_some_steps(scenario, steps)
    if scenario.cost.weights.grid_request:
        assert simulation.transition.costs.grid_request.min() > 0.0
    before, layout = simulation.now, action_layout(scenario)
    simulation.step(action)
    cost, vector = priced(simulation), vector_of(simulation.transition)
    saved, exact = vector * difference_scale(scenario), np.empty_like(vector)
    for entry in range(layout.n):
        simulation.restore(before)
        changed = action.copy()
        changed[:, entry] = difference.rest_action(scenario)[entry]
        simulation.step(changed)
        exact[:, entry] = priced(simulation) - cost
    for channel in dict.fromkeys(name for _, name in layout.names):
        of = layout.is_channel(channel)
        assert np.abs(exact[:, of]).max() > 0.0 or channel == "route"
        np.testing.assert_allclose(saved[:, of], exact[:, of], atol=tolerance * max(np.abs(exact[:, of]).max(), 1e-9))


@pytest.mark.parametrize("default", ["previous", "rest", "droop"])
def test_the_default_action_is_paid_nothing(default: str) -> None:
    scenario = make_scenario("ieee33-weak", reward="difference", cost={"default_action": default})
    simulation, _ = after_some_steps(scenario)
    now = simulation.now
    setpoints = difference.default_setpoints(scenario, now.state, now.p_ref_next_kw)
    params = difference.parameters(scenario, setpoints)
    transition = simulation.step((setpoints - params.middle) / params.half_range)
    np.testing.assert_allclose(vector_of(transition), 0.0, atol=1e-12)


def test_the_droop_as_default_is_the_law_by_hand() -> None:
    gains = (2.0, 5.0, 0.3)
    cost = {"default_action": "droop", "default_gains": gains}
    scenario = make_scenario("ieee33-weak", reward="difference", cost=cost)
    simulation, _ = after_some_steps(scenario)
    state, p_ref = simulation.now.state, simulation.now.p_ref_next_kw
    setpoints = difference.default_setpoints(scenario, state, p_ref)
    site, v = scenario.datacenters, state.v_agent_pu[0, 0]
    p_kw = p_ref[0, 0] + 2000.0 * (v - 1.0) + 0.3 * state.backlog_kws[0, 0]
    idle = site.parameters.p_idle_kw[0]
    f_mhz = 1410.0 * (p_kw - idle) / (site.parameters.p_rated_kw[0] - idle)
    assert setpoints[0, 0] == pytest.approx(np.clip(f_mhz, 210.0, 1410.0), rel=1e-12)
    assert setpoints[0, 1] == pytest.approx(state.q_kvar[0, 0] - 5000.0 * (v - 1.0), rel=1e-12)


def test_an_injection_by_hand() -> None:
    """On toy6 a kvar raises the voltages by the reactances that its path shares with theirs, over the voltage."""
    scenario = make_scenario("toy6", reward="difference", cost={"default_action": "rest"})
    simulation, action = after_some_steps(scenario, steps=0)
    action[:] = difference.rest_action(scenario)
    action[:, 2] = 0.5  # the inverter at bus 4 of 1..6
    transition = simulation.step(action)
    state, feeder = transition.state, scenario.feeder
    node = int(simulation.now.episode.buses[0, 1])
    x_pu = (feeder.path * feeder.x_pu) @ feeder.path[node]
    v, q = state.v_pu[0, 1:], state.q_kvar[0, 1]
    without = v - x_pu[1:] * q / S_BASE_KVA / v
    cost = [
        100.0 * np.abs(u - 1.0).mean() + 1000.0 * np.maximum(np.abs(u - 1.0) - 0.05, 0.0).mean() for u in (without, v)
    ]
    effort = 0.02 / 3 * q / scenario.inverters.converter_kva[0]
    saved = (vector_of(transition) * difference_scale(scenario))[0, 2]
    assert q > 0.0
    assert saved == pytest.approx(cost[0] - cost[1] - effort, rel=1e-9)


@pytest.mark.parametrize(
    ("name", "fields"),
    [
        ("ieee33-weak", {}),
        ("mixed", {"cost": {"reference": "profile"}}),
        ("routing", {}),
        ("ieee13-3ph", {}),
        ("ieee13-3ph", {"datacenters": {"buses": None}}),  # other nodes in each environment
    ],
)
def test_kernel_and_arrays_agree(name: str, fields: dict[str, Any], monkeypatch: pytest.MonkeyPatch) -> None:
    """Without the payment for taps, which only the kernel has."""
    monkeypatch.setattr(simulations, "tap_targets", lambda _: None)
    simulation, action = after_some_steps(make_scenario(name, reward="difference", **fields))
    before = simulation.now
    compiled = vector_of(simulation.step(action))
    monkeypatch.setattr(difference, "has_kernel", lambda _: False)
    simulation.go_on(before)
    np.testing.assert_allclose(vector_of(simulation.step(action)), compiled, rtol=1e-9, atol=1e-11)


def test_other_forms_of_the_voltage_cost_and_two_work_classes() -> None:
    for changes in ({"cost": {"voltage": "bowl"}}, {"datacenters": {"clock_law": "prefill-decode"}, "trace": "mixed"}):
        simulation, action = after_some_steps(make_scenario("ieee33-weak", reward="difference", **changes))
        vector = vector_of(simulation.step(action))
        assert np.isfinite(vector).all()
        assert (vector != 0.0).any(axis=0)[action_layout(simulation.scenario).reactive].all()


def test_a_site_that_a_fault_has_disconnected_is_paid_only_for_its_work() -> None:
    scenario = make_scenario("fault", reward="difference")
    simulation, _ = after_some_steps(scenario, steps=0)
    rng = np.random.default_rng(0)
    for _ in range(scenario.horizon):
        transition = simulation.step(rng.uniform(-1.0, 1.0, (N_ENV, action_layout(scenario).n)))
        lost = (transition.state.q_limit_kvar == 0.0) & (transition.state.p_kw == 0.0)
        if lost.any():
            break
    else:
        pytest.fail("no fault")
    reactive = action_layout(scenario).reactive
    np.testing.assert_array_equal(vector_of(transition)[:, reactive][lost], 0.0)


def test_without_a_solution_every_entry_is_charged_the_teams_cost() -> None:
    scenario = make_scenario("ieee33-weak", reward="difference", datacenters={"p_rated_kw": 60_000.0})
    simulation, action = after_some_steps(scenario, steps=0)
    while not (transition := simulation.step(0.0 * action + 1.0)).terminated.any():
        assert not transition.truncated.any()
    over = transition.terminated
    assert (vector_of(transition)[over] == -transition.cost_j[over, None]).all()
    assert np.isfinite(transition.reward).all()


@pytest.mark.parametrize("name", each_preset())
def test_every_preset_has_it_or_a_reason(name: str) -> None:
    try:
        scenario = make_scenario(name, reward="difference")
    except ValueError as error:
        message = str(error)
        assert message.startswith(f"scenario {name!r}: cost.reward is 'difference', which")
        assert "\n" not in message
        assert "use reward='shared' or 'local'" in message
        return
    simulation, action = after_some_steps(scenario, steps=1)
    transition = simulation.step(action)
    assert transition.reward.shape == (N_ENV, scenario.n_agents)
    assert np.isfinite(transition.reward).all()
    assert (difference_scale(scenario) > 0.0).all()
