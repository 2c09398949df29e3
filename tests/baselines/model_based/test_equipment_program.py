"""Hindsight where regulators and capacitor banks are agents: their positions are planned, priced and replayed."""

from typing import Any

import numpy as np
import pytest

from dcgrid_env import Fault, forecast
from dcgrid_env.baselines import Droop, NoControl, rollout
from dcgrid_env.baselines.model_based.episode_program import EpisodeProgram
from dcgrid_env.baselines.model_based.equipment_program import EquipmentProgram
from dcgrid_env.baselines.model_based.hindsight import hindsight, replay
from helpers.three_phase import ieee13

AGENTS = {"grid_control.regulators": "agent", "grid_control.capacitors": "agent"}
BY_MINUTES = {"dt_s": 60.0, "background.start_hour": 6.0, "horizon": 30, "inverters.injection": "pv"}


def followed(kind, scenario, **more):
    program = kind(scenario, forecast(scenario, 0), False, **more)
    program.follow(replay(scenario, program.actions(), 0))
    return program


def equipment_of(found):
    phases: Any = found.recorder.series(0).three_phase
    return phases.equipment


@pytest.mark.parametrize("cost", [{}, {"reference": "profile", "profile_band_pu": 0.004}])
@pytest.mark.parametrize("dt_s", [1.0, 60.0])
def test_with_positions_at_rest_it_is_the_program_of_the_episode(dt_s, cost):
    faults = (Fault(("dc_0", "inv_1"), (2.0, 2.0), (3.0, 3.0)),)
    scenario = ieee13().replace(dt_s=dt_s, horizon=8, faults=faults, cost=cost)
    optimum, _ = followed(EpisodeProgram, scenario.replace(grid_control={"regulators": "fixed"})).solve()
    program = followed(EquipmentProgram, scenario.replace(**AGENTS))
    program.round()
    bound, actions = program.solve()
    assert bound == pytest.approx(optimum, rel=5e-6)
    cost = replay(scenario.replace(**AGENTS), actions, 0).metrics()[0]["J"]
    assert cost == pytest.approx(optimum, rel=2e-3)


@pytest.mark.slow
def test_plans_cost_less_than_laws_and_more_than_the_bound():
    scenario = ieee13().replace(**AGENTS, **BY_MINUTES, weights={"switching": 1.0})
    found = hindsight(scenario, 0)
    laws = [rollout(scenario, law, [0]).costs()[0] for law in (NoControl(), Droop(k_q_mvar_per_pu_s=0.005))]
    assert found.bound < found.J < 0.9 * min(laws)
    regulators, banks = equipment_of(found)
    assert (regulators.tap == np.rint(regulators.tap)).all()
    assert regulators.moves[-1].sum() >= 3.0
    # Positions as the action asks for them, at the price that the reward has.
    costs = found.recorder.metrics()[0]
    moves = regulators.moves[-1].sum() + banks.switchings[-1].sum()
    assert costs["cost_switching"] == pytest.approx(moves / 5.0 / scenario.horizon)
    # No plan with the taps where the tables have them is better, and no dearer one below the bound.
    fixed = hindsight(
        scenario.replace(grid_control={"regulators": "fixed", "capacitors": "fixed"}, weights={"switching": 0.0}), 0
    )
    assert found.bound < fixed.bound
    dear = hindsight(scenario.replace(weights={"switching": 1e4}), 0)
    assert equipment_of(dear).regulators.moves.sum() == 0.0
    assert pytest.approx(fixed.J, rel=1e-4) == dear.J


def test_positions_keep_their_range_and_the_speed_of_their_drive():
    scenario = ieee13().replace(grid_control={"regulators": "agent"}, horizon=12, split="validation")
    program = followed(EquipmentProgram, scenario)
    program.solve()
    taps = np.concatenate((scenario.feeder.base_tap[None], program.position))
    assert np.abs(taps).max() <= 16.0
    assert 0.49 < np.abs(np.diff(taps, axis=0)).max() <= 0.5 + 1e-4  # a tap in two seconds


def test_a_bank_that_is_lost_is_planned_as_lost():
    faults = (Fault(("capacitor",), begin_s=(3.0, 3.0), duration_s=(6.0, 6.0)),)
    scenario = ieee13().replace(grid_control={"capacitors": "agent", "regulators": "fixed"}, faults=faults)
    found = hindsight(scenario, 0)
    assert found.bound < found.J * (1.0 + 1e-4)
    assert rollout(scenario, Droop(), [0]).costs()[0] > found.J


def test_what_acts_by_itself_is_followed_but_its_moves_are_not_priced():
    scenario = ieee13().replace(grid_control={"capacitors": "agent"}, horizon=10)
    assert rollout(scenario, Droop(), [0]).costs()[0] > hindsight(scenario, 0).J
    with pytest.raises(ValueError, match=r"prices the moves of agents alone; make all other equipment fixed"):
        hindsight(scenario.replace(weights={"switching": 1.0}), 0)
    fixed = {"regulators": "fixed", "capacitors": "fixed"}
    with pytest.raises(ValueError, match="hindsight does not price switching"):
        hindsight(scenario.replace(grid_control=fixed, weights={"switching": 1.0}), 0)


def test_a_band_that_cannot_be_kept_is_said():
    scenario = ieee13().replace(**AGENTS, horizon=3, **{"cost.band_pu": 0.0005})
    with pytest.raises(ValueError, match=r"has no solution: no optimum .* keep_band may ask for what cannot be"):
        hindsight(scenario, 0, keep_band=True)
