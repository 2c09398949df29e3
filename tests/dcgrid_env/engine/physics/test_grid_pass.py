"""The pass over the grid gives the bits of its parts, one after the other."""

import numpy as np
import pytest

from dcgrid_env import PowerFlowError
from dcgrid_env.engine.physics import dynamics, grid_pass
from dcgrid_env.engine.physics.actions import action_layout
from dcgrid_env.engine.physics.voltage_figures import voltage_figures
from dcgrid_env.engine.simulation import Simulation
from dcgrid_env.scenario.presets import make_scenario
from helpers.intervals import interval


def begun(n_env, scenario="ieee33-weak", **overrides):
    simulation = Simulation(make_scenario(scenario, **overrides), n_env)
    simulation.reset(list(range(n_env)))
    return simulation


@pytest.mark.parametrize("n_env", [1, 7, 131])
@pytest.mark.parametrize("scenario", ["ieee33-weak", "ieee123"])
def test_bits_of_the_parts(scenario, n_env):
    simulation = begun(n_env, scenario)
    s, rng = simulation.scenario, np.random.default_rng(0)
    for _ in range(3):
        now, action = simulation.now, rng.uniform(-1.2, 1.2, (n_env, action_layout(simulation.scenario).n))
        given = s, now.episode, now.step + 1, now.noise, now.p_ref_next_kw
        drawn, noise = interval(*given)
        state, grid = dynamics.step(s, now.state, action, drawn)
        simulation.step(action)
        after = simulation.now
        assert after.noise.tobytes() == noise.tobytes()
        assert after.state.map(np.ndarray.tobytes) == state.map(np.ndarray.tobytes)
        assert after.transition.loss_kw.tobytes() == grid.solution.loss_kw.tobytes()
        apart = voltage_figures(state.v_pu, 1, s.cost.band_pu)
        assert [a.tobytes() for a in after.transition.voltages] == [a.tobytes() for a in apart]


def test_an_environment_without_a_solution_keeps_its_voltages_and_their_figures():
    simulation = begun(3)
    now = simulation.now
    heavy = now.noise.copy()
    heavy[1] = 500.0
    simulation.go_on(now._replace(noise=heavy))
    transition = simulation.step(np.ones((3, action_layout(simulation.scenario).n)))
    assert transition.converged.tolist() == [True, False, True]
    assert transition.state.v_pu[1].tobytes() == now.state.v_pu[1].tobytes()
    assert transition.voltages.lowest_pu[1] == now.state.v_pu[1, 1:].min()
    assert transition.terminated.tolist() == [False, True, False]


def test_a_power_that_is_not_finite_is_named():
    simulation = begun(2)
    p_ref = simulation.now.p_ref_next_kw.copy()
    p_ref[1, 0] = np.nan
    simulation.go_on(simulation.now._replace(p_ref_next_kw=p_ref))
    with pytest.raises(PowerFlowError, match=r"p_kw of bus \d+ is nan"):
        simulation.step(np.zeros((2, action_layout(simulation.scenario).n)))


@pytest.mark.parametrize("overrides", [{"power_flow": "lindistflow"}, {"scenario": "ieee123-3ph"}])
def test_what_it_is_not_for(overrides):
    assert not grid_pass.fits(make_scenario(**({"scenario": "ieee33"} | overrides)))
