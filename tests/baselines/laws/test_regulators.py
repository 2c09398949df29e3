"""Laws that drive regulators: a step after the banks' own control, whose relays they observe; ``none`` not at all."""

import dataclasses
from typing import Any

import numpy as np
import pytest

from dcgrid_env import DcgridVectorEnv, ThreePhaseFeeder, parallel_env
from dcgrid_env.baselines import Droop, NoControl, make_controller, rollout
from dcgrid_env.baselines.laws.stability import largest_stable
from helpers.three_phase import ieee13, ieee123

HEAVY = {"datacenters.p_rated_kw": 1500.0, "trace": "step", "workload.window": "start", "background.load_sigma": 0.0}
"""Two sites that draw some 2.3 MW more from second 20 on, so that regulators have to move."""


def taps_of(scenario, law):
    phases: Any = rollout(scenario, law, [0]).series(0).three_phase
    return phases.equipment.regulators.tap


def twins(scenario):
    """A scenario whose regulators a control moves, and one where they are agents; both begin at the settled taps."""
    env: Any = DcgridVectorEnv(1, scenario)
    env.reset(seed=[0])
    tap = env.transition.state.three_phase.equipment.regulators.tap[0]
    network = scenario.feeder.network
    table = dataclasses.replace(network.regulator, tap=tuple(map(int, tap)))
    settled = ThreePhaseFeeder.from_network(dataclasses.replace(network, regulator=table))
    return scenario.replace(feeder=settled), scenario.replace(feeder=settled, grid_control={"regulators": "agent"})


@pytest.mark.parametrize(
    "scenario",
    [
        ieee13().replace(**HEAVY, horizon=60),
        ieee123().replace(
            dt_s=60.0,
            horizon=120,
            background={"start_hour": 5.0},
            datacenters={"buses": ("18", "47", "66", "76", "101")},
        ),
    ],
    ids=["by seconds", "many banks by minutes"],
)
def test_taps_are_those_of_the_own_control_a_step_later(scenario):
    controlled, agents = twins(scenario)
    wanted = taps_of(controlled, Droop(k_q_mvar_per_pu_s=0.01))
    assert np.abs(np.diff(wanted, axis=0)).sum() >= 3.0
    np.testing.assert_array_equal(taps_of(agents, Droop(k_q_mvar_per_pu_s=0.01))[1:], wanted[:-1])


@pytest.mark.filterwarnings("ignore::dcgrid_env.agents.UnseenScenarioWarning")
@pytest.mark.parametrize("controller", ["feedback", "ieee13-3ph-cem"])
def test_controllers_of_the_other_agents_act_whoever_moves_the_taps(controller):
    """One with a model, also where switching has a price, and a policy."""
    weights = {"switching": 10.0} if controller == "ieee13-3ph-cem" else {}
    controlled, agents = twins(ieee13().replace(**HEAVY, horizon=60, weights=weights))
    other = agents.replace(weights={"switching": 10.0})
    runs = [rollout(scenario, make_controller(controller), [0]).series(0) for scenario in (controlled, other)]
    phases: Any = [run.three_phase for run in runs]
    moves = np.diff(phases[0].equipment.regulators.tap, axis=0).any(axis=1)
    assert moves.any()
    np.testing.assert_array_equal(phases[0].equipment.regulators.tap[:-1], phases[1].equipment.regulators.tap[1:])
    until = slice(moves.argmax())  # the first tap
    np.testing.assert_array_equal(runs[0].q_kvar[until], runs[1].q_kvar[until, : controlled.n_agents])


def test_no_control_leaves_taps_and_every_law_capacitors_at_rest():
    scenario = ieee13().replace(
        **HEAVY, horizon=40, **{"grid_control.regulators": "agent", "grid_control.capacitors": "agent"}
    )
    assert (taps_of(scenario, NoControl()) == scenario.feeder.base_tap).all()
    phases: Any = rollout(scenario, make_controller("droop-q"), [0]).series(0).three_phase
    assert np.abs(np.diff(phases.equipment.regulators.tap, axis=0)).sum() >= 3.0
    assert (phases.equipment.banks.on == 1.0).all()


def test_agents_one_by_one_are_told_what_they_are_together():
    scenario = ieee13().replace(
        **HEAVY, horizon=40, **{"grid_control.regulators": "agent"}, **{"sensing.preview": False}
    )
    env, law = parallel_env(scenario), make_controller("volt-var")
    observations, _ = env.reset(seed=0)
    law.reset(scenario)
    taps = []
    while env.agents:
        observations, *_, infos = env.step(law.act(observations))
        taps.append([infos["dc_0"][f"tap_{name}"] for name in ("reg1", "reg2", "reg3")])
    np.testing.assert_array_equal(taps, taps_of(scenario, make_controller("volt-var"))[1:])


def test_regulators_have_no_part_in_the_bound_of_the_reactive_gain():
    plain, agents = ieee13(), ieee13().replace(grid_control={"regulators": "agent", "capacitors": "agent"})
    assert largest_stable(agents, k_p_mw_per_pu=0.0) == largest_stable(plain, k_p_mw_per_pu=0.0)
