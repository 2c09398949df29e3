"""Set points that follow the hour of the day."""

from typing import Any

import numpy as np
import torch

from dcgrid_env import TensorEnv
from dcgrid_env.baselines.equipment_agents import at_rest
from dcgrid_env.engine.simulation import Simulation
from helpers.three_phase import ieee13

QUIET = {"datacenters.p_rated_kw": 1.0, "trace": "step", "workload.window": "start", "background.load_sigma": 0.0}


def scheduled(start_hour: Any, schedule: Any, **overrides: Any) -> Any:
    control = {"regulator_settings": {"timer": "reset", "offset_v": {"reg1": schedule}}}
    return ieee13().replace(**QUIET, grid_control=control, background={"start_hour": start_hour}, **overrides)


def play(scenario, seeds, steps):
    simulation = Simulation(scenario, len(seeds))
    transitions: list[Any] = [simulation.reset(seeds)]
    for _ in range(steps):
        transitions.append(simulation.step(np.tile(at_rest(scenario), (len(seeds), 1))))
    return np.array([t.state.three_phase.equipment.regulators.tap for t in transitions])


def test_taps_follow_an_entry_after_the_delay():
    """The entry of six o'clock applies from second 30 on, and a tap needs 15 s out of band: the interval of step 46."""
    taps = play(scheduled(6.0 - 30.0 / 3600.0, [[0.0, 0.0], [6.0, 3.0]], horizon=60), [0], 60)[:, 0]
    moved = np.flatnonzero(np.diff(taps, axis=0).any(1)) + 1
    assert moved[0] == 46
    assert set(np.diff(moved)) <= {2}
    assert (taps[-1] - taps[0] >= 2.0).all()


def test_each_row_settles_at_the_entry_of_its_hour():
    scenario = scheduled("random", [[0.0, -4.0], [12.0, 4.0]])
    together = play(scenario, list(range(6)), 2)
    alone = [play(scenario, [seed], 2)[:, 0] for seed in range(6)]
    np.testing.assert_array_equal(together, np.stack(alone, axis=1))
    first = np.sort(together[0, :, 0])
    assert first[-1] - first[0] >= 8.0  # 8 V are ten taps
    constant = scheduled(13.0, 4.0)
    np.testing.assert_array_equal(play(scheduled(13.0, [[0.0, -4.0], [12.0, 4.0]]), [0], 20), play(constant, [0], 20))


def test_tensors_follow_the_same_schedule():
    scenario = scheduled(6.0 - 10.0 / 3600.0, [[0.0, 0.0], [6.0, 3.0]], horizon=40)
    env: Any = TensorEnv(scenario, like=torch.zeros(1, dtype=torch.float64))
    env.reset([0, 0])
    joint = torch.tensor(np.tile(at_rest(scenario), (2, 1)))
    taps = [env.step(joint).state.three_phase.equipment.regulators.tap.numpy() for _ in range(40)]
    np.testing.assert_array_equal(taps, play(scenario, [0, 0], 40)[1:])
