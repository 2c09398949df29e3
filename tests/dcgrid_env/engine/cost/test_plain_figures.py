"""The compiled costs and observations of plain scenarios have the bits of those that go term by term."""

from types import SimpleNamespace

import numpy as np
import pytest

from dcgrid_env.engine.cost import observation, plain_figures, reward
from dcgrid_env.engine.exogenous import episode
from dcgrid_env.engine.physics.actions import action_layout
from dcgrid_env.engine.simulation import Simulation
from dcgrid_env.scenario.presets import make_scenario


@pytest.mark.parametrize("n_env", [1, 5])
@pytest.mark.parametrize("sensing", [{}, {"sensing.noise_pu": 0.01, "sensing.delay_steps": 2}])
def test_bits_of_the_terms(n_env, sensing):
    scenario = make_scenario("ieee13-3ph", dt_s=20.0, horizon=6, weights={"clock": 0.5, "switching": 2.0}, **sensing)
    assert plain_figures.fits(scenario)
    simulation, rng = Simulation(scenario, n_env), np.random.default_rng(0)
    simulation.reset(list(range(n_env)))
    for _ in range(6):
        simulation.step(rng.uniform(-1.2, 1.2, (n_env, action_layout(scenario).n)))
        now, t = simulation.now, simulation.transition
        solution = SimpleNamespace(loss_kw=t.loss_kw)
        costs = reward.team_costs(scenario, now.state, solution, t.truncated, t.voltages)
        assert t.costs._fields == costs._fields
        assert [term.tobytes() for term in t.costs] == [term.tobytes() for term in costs]
        assert t.cost_j.tobytes() == reward.total(costs).tobytes()
        coming = episode.given_next(scenario, now.episode, now.step, now.p_ref_next_kw)
        measured = now.measured[1], now.measured[0]
        seen = observation.observe_within_bounds(scenario, now.state, now.episode.placed, coming, *measured)
        assert t.observation.tobytes() == seen.tobytes()


@pytest.mark.parametrize(
    ("preset", "overrides"),
    [
        ("ieee33", {}),
        ("ride-through", {}),
        ("ieee13-3ph", {"weights": {"unbalance": 1.0}}),
        ("ieee13-3ph", {"cost.voltage": "l2"}),
        ("ieee13-3ph", {"reward": "local"}),
        ("ieee13-3ph", {"observe": "feeder"}),
        ("ieee13-3ph", {"sensing.regulator": True}),
    ],
)
def test_scenarios_that_do_not_fit(preset, overrides):
    assert not plain_figures.fits(make_scenario(preset, **overrides))
