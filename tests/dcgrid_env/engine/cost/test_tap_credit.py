"""Payment for taps that relays will make, and the choice of these taps."""

from typing import Any

import numpy as np
import pytest

from dcgrid_env import acting_relays, action_layout, make_scenario
from dcgrid_env.engine import simulation as simulations
from dcgrid_env.engine.cost.difference import charges, rest_action
from dcgrid_env.engine.cost.tap_credit import TapTargets
from dcgrid_env.engine.cost.tap_targets import _least_cost
from dcgrid_env.engine.physics.connections import agent_nodes
from dcgrid_env.engine.simulation import Simulation, difference_scale, tap_targets

N_ENV = 2


def paid(scenario, targets, monkeypatch):
    """Simulation after a step with a little reactive power, its action and its difference rewards, as costs."""
    monkeypatch.setattr(simulations, "tap_targets", lambda _: targets)
    simulation = Simulation(scenario, N_ENV)
    simulation.reset(range(N_ENV))
    before, layout = simulation.now, action_layout(scenario)
    action = np.tile(rest_action(scenario), (N_ENV, 1))
    action[:, layout.is_channel("q")] = 0.1
    action[0, layout.is_channel("clock")] = -0.5
    vector = simulation.step(action).reward_vector
    assert vector is not None
    return simulation, before, action, vector * difference_scale(scenario)


@pytest.mark.slow
def test_a_timer_is_paid_its_share_of_the_tap_by_hand(monkeypatch):
    """Against the relay volts of a complete power flow with the default in each entry."""
    cost = {"default_action": "rest"}
    scenario = make_scenario("ieee13-3ph", reward="difference", cost=cost)
    relays, found = acting_relays(scenario), tap_targets(scenario)
    assert relays is not None
    assert found is not None
    row = int(found.rows[0])
    by_p, by_q = (np.ascontiguousarray(by[:, :1]) for by in (found.by_p, found.by_q))
    one = TapTargets(found.rows[:1], found.direction[:1], np.array([0.5]), 3.0, by_p, by_q)
    simulation, before, action, with_taps = paid(scenario, one, monkeypatch)
    *_, without = paid(scenario, None, monkeypatch)
    settings = relays.settings

    def worth(state: Any):
        regulators = state.three_phase.equipment.regulators
        off_v = -one.direction[0] * (regulators.relay_v[:, row] - settings.target_v[row])
        x = (off_v / settings.half_band_v[row] - 1.2) / 0.8
        return (0.5 * (scenario.horizon - 1) - 3.0) / settings.delay_s[row] * np.exp(np.minimum(x, 0.0))

    now = worth(simulation.transition.state)
    exact = np.empty_like(action)
    for entry in range(action.shape[1]):
        simulation.restore(before)
        changed = action.copy()
        changed[:, entry] = rest_action(scenario)[entry]
        exact[:, entry] = now - worth(simulation.step(changed).state)
    assert np.abs(exact).max() > 0.01
    np.testing.assert_allclose(with_taps - without, exact, atol=0.1 * np.abs(exact).max())


@pytest.mark.slow
def test_a_tap_that_does_not_save_its_price_is_not_paid(monkeypatch):
    scenario = make_scenario("ieee13-3ph", reward="difference")
    found = tap_targets(scenario)
    assert found is not None
    *_, without = paid(scenario, None, monkeypatch)
    *_, paid_little = paid(scenario, found._replace(saving=0.0 * found.saving + 0.01, price=2.0), monkeypatch)
    np.testing.assert_array_equal(paid_little, without)


def test_the_least_cost_by_hand():
    """Without reactive power it is the cost itself; with one agent, the least over a fine grid."""
    scenario = make_scenario("ieee13-3ph", reward="difference")
    simulation = Simulation(scenario, N_ENV)
    begun = simulation.reset(range(N_ENV))
    weight, judged = charges(scenario).voltage, scenario.feeder.load_slice
    rng = np.random.default_rng(0)
    moved_pu = rng.normal(0.0, 0.01, begun.state.v_pu[:, judged].shape[1])
    v_pu = begun.state.v_pu[:, judged] + moved_pu
    nodes = agent_nodes(scenario, begun.buses)
    by_q = rng.uniform(0.0, 1e-4, (*nodes.shape[:2], len(moved_pu)))
    state = begun.state._replace(q_limit_kvar=0.0 * begun.state.q_limit_kvar)
    cost = weight * np.abs(v_pu - 1.0).sum(-1).mean()
    assert _least_cost(scenario, state, by_q, moved_pu) == pytest.approx(cost, rel=1e-9)
    state.q_limit_kvar[:, 1] = 150.0
    q = np.linspace(-150.0, 150.0, 3001)[:, None] - begun.state.q_kvar[0, 1]
    by_hand = [weight * np.abs(v + q * by[1] - 1.0).sum(-1).min() for v, by in zip(v_pu, by_q, strict=True)]
    assert _least_cost(scenario, state, by_q, moved_pu) == pytest.approx(np.mean(by_hand), rel=1e-4)


@pytest.mark.slow
def test_useful_taps_of_ieee123():
    """Three regulators one tap down, as MPC and a search over whole episodes make them."""
    targets = tap_targets(make_scenario("ieee123-3ph", reward="difference"))
    assert targets is not None
    assert targets.rows.tolist() == [0, 3, 6]
    assert targets.direction.tolist() == [-1.0, -1.0, -1.0]
    assert targets.price == pytest.approx(10.0 / 7.0)
    assert (targets.saving * 120 > targets.price).all()


def test_where_no_tap_is_paid():
    for name, fields in (
        ("ieee33-weak", {}),
        ("ieee123-3ph", {"grid_control": {"regulators": "fixed"}}),
        ("ieee13-3ph", {"cost": {"voltage": "bowl"}}),
    ):
        assert tap_targets(make_scenario(name, reward="difference", **fields)) is None


def test_a_tap_beyond_the_last_one_is_not_useful():
    assert tap_targets(make_scenario("ieee13-3ph", source_voltage_pu=0.9)) is None  # all stand at the highest tap
