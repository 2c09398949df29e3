"""Controllers that know a three-phase feeder, and hindsight: slopes across phases, taps that move, capacitors lost."""

from typing import Any

import numpy as np
import pytest

from dcgrid_env import (
    Fault,
    acting_relays,
    forecast,
    make_scenario,
    sensitivity_between_agents,
    sensitivity_to_agents,
)
from dcgrid_env.baselines import make_controller, rollout
from dcgrid_env.baselines.laws.stability import placements, spectral_radius
from dcgrid_env.baselines.model_based.episode_program import EpisodeProgram
from dcgrid_env.baselines.model_based.hindsight import STEADY_SHARES, _settled, hindsight, replay
from dcgrid_env.baselines.model_based.relay_rows import RelayRows
from dcgrid_env.engine.physics.acting_relays import BankControl
from helpers.three_phase import SCENARIOS, ieee13, ieee34, ieee123


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


def _program(scenario):
    return EpisodeProgram(scenario, forecast(scenario, 0), keep_band=False, same_taps=True)


def test_hindsight_is_the_best_of_the_courses_of_taps():
    scenario = ieee34().replace(horizon=40)
    found, program = [], _program(scenario)
    for share in STEADY_SHARES:
        program.begin(share)
        program.follow(replay(scenario, program.actions(), 0))
        wanted = program.taps
        solved = _settled(program, 0, 6, 2e-5)
        taps = _regulators(solved).tap
        if abs(solved.gap) < 1e-4 * solved.J:
            np.testing.assert_array_equal(taps, wanted)  # regulators followed the course that the program was told
        found.append((solved.J, int(np.abs(np.diff(wanted, axis=0)).sum())))
    assert sum(moves > 0 for _, moves in found) >= 3
    best = hindsight(scenario, 0)
    assert min(found)[0] == pytest.approx(best.J, rel=1e-6)
    assert min(cost(scenario, law) for law in ("none", "droop", "mpc-one-step")) > best.J


def _regulators(found):
    three_phase: Any = found.recorder.series(0).three_phase
    return three_phase.equipment.regulators


def test_taps_that_stay_wait_out_of_band_for_less_than_their_delay():
    scenario = ieee123().replace(horizon=35)
    relays = acting_relays(scenario)
    assert relays is not None
    assert relays.steps.tolist() == [15, 30, 30, 30, 30, 30, 30]
    assert relays.further_steps.tolist() == [2] * 7
    program = _program(scenario)
    kept = _settled(program, 0, 6, 2e-5)
    regulators = _regulators(kept)
    np.testing.assert_array_equal(regulators.tap, program.taps)
    assert (regulators.tap == regulators.tap[0]).all(axis=0).sum() >= 6
    low, high = relays.rest_volts(regulators.tap)
    out = (regulators.relay_v < low) | (regulators.relay_v > high)
    assert 0.5 < out.mean(axis=0).max() < 1.0  # it pays to be out of band nearly always
    assert abs(kept.gap) < 2e-3 * kept.J


@pytest.mark.parametrize(
    ("taps", "demands"),
    [
        ([0] * 9, "....i..."),  # in band once in five steps
        ([0, 0, 0, 0, 0, 0, 0, 1, 1], "iuuuuui."),  # too little for five steps, in band before and after
        ([0, -1, -2, -2, -2, -2, -2, -2, -2], "di....i."),  # too much between taps of a sequence
    ],
)
def test_what_a_course_of_taps_demands_of_a_relay(taps, demands):
    relays = acting_relays(ieee13())
    assert relays is not None
    one = relays._replace(rows=relays.rows[:1], steps=np.array([5]), further_steps=np.array([2]))
    course = np.zeros((9, 3))
    course[:, 0] = taps
    low, high = RelayRows(one, 8).demands(course)
    is_in = np.isfinite(low[:, 0]) & np.isfinite(high[:, 0])
    found = np.where(is_in, "i", np.where(np.isfinite(high[:, 0]), "u", np.where(np.isfinite(low[:, 0]), "d", ".")))
    assert "".join(found) == demands


@pytest.mark.parametrize("seed", range(40))
def test_volts_that_meet_the_demands_make_the_control_follow_the_course(seed):
    relays = acting_relays(ieee13())
    assert relays is not None
    rng, steps = np.random.default_rng(seed), 80
    tap = np.zeros((1 + steps, 3))
    for regulator, start in enumerate(rng.integers(15, 60, 3)):
        for k in range(int(rng.integers(0, 4))):
            tap[1 + start + 2 * k :, regulator] += 1 if seed % 2 else -1
    low, high = RelayRows(relays, steps).demands(tap)
    middle = np.broadcast_to(relays.settings.target_v[relays.rows], low.shape)
    volts = np.where(
        np.isfinite(high) & np.isinf(low), high - 0.01, np.where(np.isfinite(low) & np.isinf(high), low + 0.01, middle)
    )
    control, found = BankControl(relays, 1.0), [tap[0]]
    measured = [middle[0], *volts]
    for step in range(steps):
        found.append(control.taps(found[-1][None], measured[step][None])[0])
    np.testing.assert_array_equal(found, tap)


def test_relays_that_act_are_those_with_a_control_of_their_own():
    scenario = ieee13()
    assert acting_relays(scenario.replace(grid_control={"regulators": "fixed"})) is None
    assert acting_relays(make_scenario("toy6")) is None
    relays = acting_relays(scenario.replace(dt_s=60.0))
    assert relays is not None
    assert relays.steps.tolist() == [1, 1, 1]
    low, high = relays.rest_volts(np.array([[16.0, 0.0, -16.0]]))
    assert np.isneginf(low).tolist() == [[True, False, False]]
    assert np.isposinf(high).tolist() == [[False, False, True]]
    np.testing.assert_allclose((low + high)[0, 1], 2.0 * 122.0)


def test_hindsight_knows_of_a_lost_capacitor():
    scenario = ieee13().replace(faults=(Fault(("capacitor",), begin_s=(3.0, 3.0), duration_s=(6.0, 6.0)),))
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
