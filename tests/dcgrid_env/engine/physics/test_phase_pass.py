"""The passes around a three-phase power flow give the bits of the general path."""

from typing import Any

import numpy as np
import pytest

from dcgrid_env import PowerFlowError
from dcgrid_env.engine.physics import dynamics, phase_pass
from dcgrid_env.engine.physics.actions import action_layout
from dcgrid_env.engine.simulation import Simulation
from dcgrid_env.scenario.presets import make_scenario
from helpers.intervals import interval

SCHEDULED = {"offset_v": {"reg1": ((6.0, -2.0), (20.0, 1.0))}}


def begun(preset, **overrides):
    simulation = Simulation(make_scenario(preset, split="test", **overrides), 1)
    simulation.reset([0])
    return simulation, action_layout(simulation.scenario).n


@pytest.mark.parametrize("timer", ["reset", "integrating"])
def test_bits_of_the_general_path(timer):
    simulation, n = begun("ieee13-3ph", dt_s=10.0, **{"grid_control.regulator_settings": {"timer": timer}})
    s, rng, moved = simulation.scenario, np.random.default_rng(0), []
    assert phase_pass.fits(s)
    for _ in range(12):
        now, action = simulation.now, rng.uniform(-1.2, 1.2, (1, n))
        drawn, noise = interval(s, now.episode, now.step + 1, now.noise, now.p_ref_next_kw)
        state, grid = dynamics.step(s, now.state, action, drawn)
        simulation.step(action)
        after = simulation.now
        assert after.noise.tobytes() == noise.tobytes()
        assert after.state.map(np.ndarray.tobytes) == state.map(np.ndarray.tobytes)
        assert after.transition.loss_kw.tobytes() == grid.solution.loss_kw.tobytes()
        phases: Any = state.three_phase
        moved.append(phases.equipment.regulators.moved.sum())
    assert 0 < np.count_nonzero(moved) < len(moved)


def test_an_environment_without_a_solution_keeps_its_voltages():
    simulation, n = begun("ieee13-3ph")
    now = simulation.now
    simulation.go_on(now._replace(noise=np.full_like(now.noise, 1e5)))
    transition = simulation.step(np.ones((1, n)))
    assert not transition.converged[0]
    assert transition.state.v_pu.tobytes() == now.state.v_pu.tobytes()


def test_a_power_that_is_not_finite_is_named():
    simulation, n = begun("ieee13-3ph")
    simulation.go_on(simulation.now._replace(p_ref_next_kw=np.full_like(simulation.now.p_ref_next_kw, np.nan)))
    with pytest.raises(PowerFlowError, match=r"p_kw of the device leg of phase a at bus \d+ is nan"):
        simulation.step(np.zeros((1, n)))


@pytest.mark.parametrize(
    ("preset", "overrides"),
    [
        ("ieee33", {}),
        ("ieee123-3ph-day", {}),
        ("ieee13-3ph", {"grid_control.capacitors": "controlled"}),
        ("ieee13-3ph", {"grid_control.regulators": "agent"}),
        ("ieee13-3ph", {"background.capacitors": False}),
        (
            "ieee13-3ph",
            {"background.start_hour": 0.0, "grid_control.regulator_settings": {"offset_v": {"reg1": ((6.0, -2.0),)}}},
        ),
    ],
)
def test_scenarios_that_do_not_fit(preset, overrides):
    assert not phase_pass.fits(make_scenario(preset, **overrides))
