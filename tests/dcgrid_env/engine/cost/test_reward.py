"""The cost, term by term, against figures worked by hand; and that ending early never pays."""

import math
import pickle
from typing import Any

import numpy as np
import pytest
import torch

from dcgrid_env import CostWeights, Scenario, Solution, action_layout, distflow, make_scenario
from dcgrid_env.engine.cost import reward
from dcgrid_env.engine.cost.reward import charged, constraint, largest_costs, local_costs, team_costs, terms, total
from dcgrid_env.engine.physics.state import State
from dcgrid_env.engine.physics.voltage_figures import voltage_figures
from dcgrid_env.engine.simulation import Simulation, Transition
from dcgrid_env.scenario.costs.grid_terms import voltage_cost
from helpers.forms import FORMS
from helpers.riding import riding
from helpers.states import state_of, with_fields

Costs = terms(make_scenario("toy6")).kind

KINDS = ("l1", "l2", "bowl", "courant_beltrami", "bump")
EVERY = CostWeights(clock=2.0, step=50.0, loss=3.0)
LAST, NOT_LAST = np.array([True]), np.array([False])


def hand_made_state(**changes: Any) -> State:
    """One environment of toy6: a site of 2500 kW (2750 kVA) at bus 4, inverters of 1000 kVA at buses 3 and 5."""
    fields = {
        "v_pu": [1.3, 0.98, 1.0, 1.06, 0.93, 1.02],  # the substation's own does not count
        "v_last_pu": [0.7, 0.97, 1.03, 1.06, 0.95, 1.02],
        "v_agent_pu": [0.93, 1.06, 1.02],
        "v_agent_last_pu": [0.95, 1.06, 1.02],
        "restart": [0.0] * 5,
        "backlog_kws": [500.0],
        "class_backlog_kws": [500.0],
        "class_arrived_kw": [0.0],
        "class_served_kw": [0.0],
        "f_mhz": [810.0],
        "f_last_mhz": [1410.0],
        "arrived_kw": [0.0],
        "served_kw": [0.0],
        "p_kw": [1000.0, 0.0, 0.0],
        "q_kvar": [550.0, -500.0, 200.0],
        "q_limit_kvar": [825.0, 1000.0, 1000.0],
        **changes,
    }
    return state_of({name: np.array([values]) for name, values in fields.items()})


def solution_with_loss(loss_kw: float) -> Solution:
    feeder = make_scenario("toy6").feeder
    return distflow(feeder, np.zeros((1, 6)), np.zeros((1, 6)))._replace(loss_kw=np.array([loss_kw]))


def figures(costs: Any) -> dict[str, float]:
    return {name: float(np.asarray(value)[0]) for name, value in costs._asdict().items()}


def actions(scenario: Scenario, n_env: int, rng: np.random.Generator) -> np.ndarray:
    return rng.uniform(-1, 1, (n_env, action_layout(scenario).n))


def play(scenario: Scenario, n_env: int, action: Any, seed: int = 0) -> list[Transition]:
    """Transitions from the reset on; ``action(k)`` gives the k-th joint action."""
    simulation = Simulation(scenario, n_env)
    course = [simulation.reset(range(seed, seed + n_env))]
    course += [simulation.step(action(k)) for k in range(scenario.horizon)]
    return course


# --- a step's cost, worked by hand ---------------------------------------------------------------


def test_team_cost_worked_by_hand():
    # |V-1|: .02 0 .06 .07 .02, mean .034; beyond the band: .01 .02, mean .006; q: .2 .5 .2 of the ratings, mean .3.
    found = figures(team_costs(make_scenario("toy6"), hand_made_state(), solution_with_loss(125.0), NOT_LAST))
    assert found == pytest.approx(
        {
            "voltage": 100 * 0.034,
            "violation": 1000 * 0.006,
            "backlog": 0.3 * 500 / 2500,
            "effort": 0.02 * 0.3,
            "clock": 0.0,
            "step": 0.0,
            "loss": 0.0,
            "leftover": 0.0,
        },
        rel=1e-12,
    )


def test_leftover_work_is_charged_at_the_last_step_alone():
    scenario, solution = make_scenario("toy6"), solution_with_loss(0.0)
    costs = team_costs(scenario, hand_made_state(), solution, LAST)
    assert figures(costs)["leftover"] == pytest.approx(9 * 500 / 2500)
    assert float(total(costs)[0]) == pytest.approx(3.4 + 6.0 + 0.06 + 0.006 + 1.8)
    assert float(total(team_costs(scenario, hand_made_state(), solution, NOT_LAST))[0]) == pytest.approx(9.466)
    # As if it waited 30 seconds more.
    assert CostWeights().leftover == pytest.approx(30 * CostWeights().backlog)


def test_terms_at_weight_zero_show_once_they_are_weighted():
    scenario = make_scenario("toy6", weights=EVERY)
    found = figures(team_costs(scenario, hand_made_state(), solution_with_loss(125.0), NOT_LAST))
    assert found["clock"] == pytest.approx(2.0 * 600 / 1200)
    assert found["step"] == pytest.approx(50.0 * (0.01 + 0.03 + 0.02) / 5)
    assert found["loss"] == pytest.approx(3.0 * 125 / (2500 + 600))
    assert found["voltage"] == pytest.approx(3.4)


def test_every_weight_scales_its_own_term_and_no_other():
    state, solution = hand_made_state(), solution_with_loss(125.0)
    base = CostWeights(*[1.0] * 8)
    one = figures(team_costs(make_scenario("toy6", weights=base), state, solution, LAST))
    assert all(value > 0 for value in one.values())
    for name in Costs._fields:
        scenario = make_scenario("toy6", weights=base._replace(**{name: 3.0}))
        found = figures(team_costs(scenario, state, solution, LAST))
        assert found == pytest.approx({**one, name: 3.0 * one[name]})
        local = local_costs(scenario, state, solution, LAST)
        plain = local_costs(make_scenario("toy6", weights=base), state, solution, LAST)
        for field in Costs._fields:
            factor = 3.0 if field == name else 1.0
            np.testing.assert_allclose(getattr(local, field), factor * getattr(plain, field), err_msg=field)


def test_several_sites_and_environments():
    scenario = make_scenario(
        "ieee33-weak", datacenters={"p_rated_kw": (1000.0, 500.0, 500.0)}, weights=CostWeights(clock=1.0)
    )
    n_env, n_bus = 2, 33
    v = np.full((n_env, n_bus), 1.01)
    v[1] = 0.90
    agents = np.array([[102.0, 51.0, 0.0, 100.0, 0.0, 0.0, 50.0]] * n_env)  # of 1020, 510, 510, 100 x 4
    state = with_fields(
        hand_made_state(),
        v_pu=v,
        v_last_pu=v,
        backlog_kws=np.array([[100.0, 200.0, 700.0], [0.0, 0.0, 0.0]]),
        f_mhz=np.array([[210.0, 1410.0, 810.0]] * n_env),
        f_last_mhz=np.array([[1410.0, 1410.0, 1410.0]] * n_env),
        q_kvar=agents * np.array([[1.0], [-2.0]]),
    )
    quiet = distflow(scenario.feeder, np.zeros((n_env, n_bus)), np.zeros((n_env, n_bus)))
    costs = team_costs(scenario, state, quiet, np.array([True, False]))
    np.testing.assert_allclose(costs.voltage, [1.0, 10.0])
    np.testing.assert_allclose(costs.violation, [0.0, 50.0], atol=1e-9)
    np.testing.assert_allclose(costs.backlog, [0.3 * 1000 / 2000, 0.0])
    np.testing.assert_allclose(costs.effort, [0.02 * 1.7 / 7, 0.02 * 3.4 / 7])
    np.testing.assert_allclose(costs.clock, [1.5 / 3, 1.5 / 3])
    np.testing.assert_allclose(costs.leftover, [9.0 * 0.5, 0.0])


@pytest.mark.parametrize("band", [0.02, 0.05, 0.1])
def test_violation_begins_at_the_band(band):
    scenario = make_scenario("toy6", cost={"band_pu": band})
    for excess in (-0.01, 0.0, 0.01):
        for side in (1.0, -1.0):
            state = hand_made_state(v_pu=[1.0, 1.0 + side * (band + excess), 1.0, 1.0, 1.0, 1.0])
            found = figures(team_costs(scenario, state, solution_with_loss(0.0), NOT_LAST))
            assert found["violation"] == pytest.approx(1000 * max(excess, 0.0) / 5, abs=1e-9)
            assert found["voltage"] == pytest.approx(100 * (band + excess) / 5)


def test_the_rating_that_reactive_power_is_a_share_of():
    # A data centre's is s, not q_max; an inverter's is its limit at zero active power, whatever it injects.
    scenario = make_scenario(
        "toy6", datacenters={"s_rated_share": 1.2, "q_max_share": 0.5}, inverters={"s_rated_kva": (400.0, 800.0)}
    )
    state = hand_made_state(q_kvar=[300.0, 100.0, -400.0], q_limit_kvar=[1.0, 100.0, 400.0])
    found = figures(team_costs(scenario, state, solution_with_loss(0.0), NOT_LAST))
    assert found["effort"] == pytest.approx(0.02 * (0.1 + 0.25 + 0.5) / 3)


def test_no_datacenter_has_no_backlog_to_pay_for():
    scenario = make_scenario("toy6", n_datacenters=0, datacenters={"buses": ()})
    course = play(scenario, 2, lambda k: np.ones((2, 2)))
    for transition in course:
        assert np.all(transition.costs.backlog == 0.0)
        assert np.all(transition.costs.leftover == 0.0)
        assert np.isfinite(transition.reward).all()


def test_local_costs_worked_by_hand():
    scenario = make_scenario("toy6", weights=EVERY)
    costs = local_costs(scenario, hand_made_state(), solution_with_loss(125.0), LAST)
    wanted = {
        "voltage": [7.0, 6.0, 2.0],
        "violation": [20.0, 10.0, 0.0],
        "backlog": [0.06, 0.0, 0.0],
        "effort": [0.02 * 0.2, 0.02 * 0.5, 0.02 * 0.2],
        "clock": [1.0, 0.0, 0.0],
        "step": [1.0, 0.0, 0.0],
        "loss": [3.0 * 125 / 3100] * 3,
        "leftover": [1.8, 0.0, 0.0],
    }
    for name, values in wanted.items():
        np.testing.assert_allclose(getattr(costs, name), [values], rtol=1e-9, atol=1e-9, err_msg=name)
    none_left = local_costs(scenario, hand_made_state(), solution_with_loss(125.0), NOT_LAST)
    assert np.all(none_left.leftover == 0.0)


def test_local_backlog_is_a_share_of_the_own_rating():
    scenario = make_scenario("ieee33-weak", datacenters={"p_rated_kw": (1000.0, 500.0, 250.0)})
    state = with_fields(
        hand_made_state(),
        v_pu=np.ones((1, 33)), v_agent_pu=np.ones((1, 7)), v_agent_last_pu=np.ones((1, 7)), q_kvar=np.zeros((1, 7)),
        backlog_kws=np.array([[100.0, 100.0, 100.0]]), f_mhz=np.full((1, 3), 1410.0),
        f_last_mhz=np.full((1, 3), 1410.0),
    )  # fmt: skip
    costs = local_costs(scenario, state, solution_with_loss(0.0), LAST)
    np.testing.assert_allclose(costs.backlog, [[0.03, 0.06, 0.12, 0, 0, 0, 0]])
    np.testing.assert_allclose(costs.leftover, [[0.9, 1.8, 3.6, 0, 0, 0, 0]])


@pytest.mark.parametrize("kind", KINDS)
def test_torch_counts_the_same_costs(kind):
    scenario = make_scenario("toy6", weights=EVERY, cost={"voltage": kind})
    state, solution = hand_made_state(), solution_with_loss(125.0)
    tensors = state.map(torch.tensor)
    solution_t = Solution(*map(torch.tensor, solution))
    for last in (True, False):
        for cost in (team_costs, local_costs):
            a = cost(scenario, state, solution, np.array([last]))
            b = cost(scenario, tensors, solution_t, torch.tensor([last]))
            for x, y in zip(a, b, strict=True):
                np.testing.assert_allclose(y.numpy(), x, rtol=1e-12, atol=1e-15)


# --- the five voltage costs ----------------------------------------------------------------------

# exp(-0.125) / (0.1 sqrt(2 pi)) is a normal density half a standard deviation out.
BOWL_AT_0, BOWL_AT_EDGE = 0.04 - 0.039894228040143274, 0.04 - 0.03520653267642995
POINTS = {
    "l1": {0.0: 0.0, 0.02: 0.02, 0.05: 0.05, 0.07: 0.07, 1.0: 1.0},
    "bowl": {0.0: BOWL_AT_0, 0.05: BOWL_AT_EDGE, 0.06: 0.025, 0.1: 0.105, 1.0: 1.905},
    "courant_beltrami": {0.0: 0.0, 0.02: 0.0, 0.05: 0.0, 0.07: 4e-4, 0.15: 0.01, 1.0: 0.9025},
    # 1 - 0.5^4 = 15/16; 1 - 0.9^4 = 0.3439.
    "bump": {0.0: 0.0, 0.1: math.exp(-1 / 0.3439), 0.5: math.exp(-16 / 15), 1.0: math.exp(-1), 1.5: math.exp(-16 / 15),
             2.0: 0.0, 2.5: 0.0},
}  # fmt: skip


@pytest.mark.parametrize(("kind", "points"), POINTS.items(), ids=POINTS)
def test_voltage_cost_at_some_points(kind, points):
    found = voltage_cost(kind, np.array(list(points)), 0.05)
    np.testing.assert_allclose(found, list(points.values()), rtol=1e-12, atol=1e-17)
    tensors = voltage_cost(kind, torch.tensor(list(points), dtype=torch.float64), 0.05)
    np.testing.assert_allclose(tensors.numpy(), found, rtol=1e-12, atol=1e-17)


def test_a_voltage_cost_that_is_none_is_refused():
    with pytest.raises(ValueError, match="voltage cost 'l3' is none of l1, l2, bowl, courant_beltrami, bump"):
        voltage_cost("l3", np.zeros(3), 0.05)


def test_the_total_is_the_sum_of_all_terms():
    assert total(Costs(*(2.0**i for i in range(len(Costs._fields))))) == 2.0 ** len(Costs._fields) - 1.0


def test_l2_is_a_square():
    found = voltage_cost("l2", np.array([0.0, 0.01, 0.02, 0.1, 1.0]), 0.05)
    assert found[0] == 0.0
    np.testing.assert_allclose(found / found[1], [0.0, 1.0, 4.0, 100.0, 10000.0])


@pytest.mark.parametrize("kind", KINDS)
def test_voltage_cost_is_continuous_positive_and_grows(kind):
    deviation = np.linspace(0.0, 1.0, 20001)
    cost = voltage_cost(kind, deviation, 0.05)
    assert np.all(cost >= 0.0)
    assert np.all(np.diff(cost) >= 0.0)
    jump = np.abs(np.diff(cost)).max()
    if kind == "bowl":  # as published: its two pieces miss each other by 2e-4 at the band's edge
        assert jump == pytest.approx(0.005 - BOWL_AT_EDGE, abs=1.1e-4)
        jump = np.delete(np.abs(np.diff(cost)), 1000).max()
    assert jump < 2.5e-4
    # By itself it takes no side: the feeder's cost above 1 is that below it.
    scenario = make_scenario("toy6", cost={"voltage": kind})
    above, below = (
        figures(team_costs(scenario, hand_made_state(v_pu=[1.0] + [1.0 + d] * 5), solution_with_loss(0.0), LAST))
        for d in (0.04, -0.04)
    )
    assert above["voltage"] == pytest.approx(below["voltage"])
    assert above["voltage"] == pytest.approx(100 * float(voltage_cost(kind, np.array([0.04]), 0.05)[0]))


@pytest.mark.parametrize("kind", KINDS)
def test_voltage_cost_has_finite_derivatives(kind):
    deviation = torch.tensor([0.0, 1e-16, 1e-3, 0.05, 0.3, 1.0, 2.0], dtype=torch.float64, requires_grad=True)
    voltage_cost(kind, deviation, 0.05).sum().backward()
    assert deviation.grad is not None
    assert torch.isfinite(deviation.grad).all()


# --- an episode's ----------------------------------------------------------------------------------


@pytest.mark.parametrize("dt_s", [1.0, 5.0])
@pytest.mark.parametrize("name", FORMS)
def test_costs_of_an_episode_add_up_to_the_cost_of_the_definition(name, dt_s):
    scenario = make_scenario(name, horizon=25, dt_s=dt_s)
    rng = np.random.default_rng(0)
    course = play(scenario, 4, lambda k: actions(scenario, 4, rng))[1:]
    horizon = scenario.horizon
    for env_index in range(4):
        c = []
        for t in course:
            deviation = [abs(v - 1.0) for v in t.state.v_pu[env_index, 1:]]
            effort = [
                abs(q) / s
                for q, s in zip(
                    t.state.q_kvar[env_index],
                    [*scenario.datacenters.parameters.s_rated_kva, *scenario.inverters.parameters.s_rated_kva],
                    strict=True,
                )
            ]
            c.append(
                100 * np.mean(deviation)
                + 1000 * np.mean([max(d - 0.05, 0.0) for d in deviation])
                + 0.3 * sum(t.state.backlog_kws[env_index]) / sum(scenario.datacenters.parameters.p_rated_kw)
                + 0.02 * np.mean(effort)
            )
        left = sum(course[-1].state.backlog_kws[env_index]) / sum(scenario.datacenters.parameters.p_rated_kw)
        j = sum(c) / horizon + 9 * left / horizon
        assert sum(t.cost_j[env_index] for t in course) == pytest.approx(j * horizon)
        assert sum(t.reward[env_index] for t in course) == pytest.approx(-j * horizon)
        assert sum(float(value[env_index]) for t in course for value in t.costs) == pytest.approx(j * horizon)
    assert course[-1].costs.leftover.max() > 0
    assert all(np.all(t.costs.leftover == 0.0) for t in course[:-1])
    assert [t.truncated.all() for t in course] == [False] * 24 + [True]
    assert not any(t.terminated.any() for t in course)


def test_local_rewards_are_each_agents_own():
    scenario = make_scenario("ieee33-weak", horizon=6, reward="local")
    rng = np.random.default_rng(1)
    course = play(scenario, 3, lambda k: actions(scenario, 3, rng))[1:]
    s_rated = np.concatenate((scenario.datacenters.parameters.s_rated_kva, scenario.inverters.parameters.s_rated_kva))
    for k, t in enumerate(course):
        deviation = np.abs(t.state.v_agent_pu - 1.0)
        wanted = 100 * deviation + 1000 * np.maximum(deviation - 0.05, 0.0) + 0.02 * np.abs(t.state.q_kvar) / s_rated
        wanted[:, :3] += (0.3 + 9 * (k == 5)) * t.state.backlog_kws / 1000.0
        assert t.reward.shape == (3, 7)
        np.testing.assert_allclose(t.reward, -wanted, rtol=1e-12)
        # The team's cost is kept beside it.
        assert t.cost_j.shape == (3,)
        np.testing.assert_allclose(t.cost_j, sum(t.costs))


# --- collapse --------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", FORMS)
def test_largest_costs_bound_every_step(name, kind):
    weights = CostWeights(clock=1.0, step=1.0, loss=1.0)
    scenario = make_scenario(name, cost={"voltage": kind}, weights=weights, horizon=30)
    bound = largest_costs(scenario)
    rng = np.random.default_rng(2)
    n_env = 12

    def adverse(k: int) -> np.ndarray:
        action = actions(scenario, n_env, rng)
        action[:4] = np.sign(action[:4])  # from end to end
        action[4:8] = -1.0  # queue everything, absorb everything
        return action

    course = play(scenario, n_env, adverse)[1:]
    for t in course:
        assert t.converged.all()
        for field in Costs._fields:
            assert np.all(getattr(t.costs, field) <= getattr(bound, field)), field
        local = local_costs(scenario, t.state, solution_with_loss(0.0)._replace(loss_kw=t.loss_kw), t.truncated)
        for field in Costs._fields:
            assert np.all(getattr(local, field) <= getattr(bound, field)), field
    assert all(getattr(bound, field) > 0 for field in Costs._fields)


def test_largest_costs_worked_by_hand():
    scenario = make_scenario("toy6", weights=EVERY, horizon=40, dt_s=2.0)
    bound = largest_costs(scenario)
    # A voltage of 0 or 2, 0.77 of the rating queued for 80 s, everything else at its end.
    assert bound == pytest.approx(Costs(100.0, 950.0, 0.3 * 0.77 * 80, 0.02, 2.0, 50.0, 6.0, 9 * 0.77 * 80))


@pytest.mark.parametrize(
    ("kind", "largest"),
    [("l1", 1.0), ("l2", 1.0), ("bowl", 1.905), ("courant_beltrami", 0.95**2), ("bump", math.exp(-1))],
)
def test_the_largest_voltage_cost_is_that_of_no_voltage(kind, largest):
    scenario = make_scenario("toy6", cost={"voltage": kind})
    assert largest_costs(scenario).voltage == pytest.approx(100.0 * largest)
    grid = voltage_cost(kind, np.linspace(0.0, 1.0, 1001), scenario.cost.band_pu)
    assert largest_costs(scenario).voltage == 100.0 * grid.max()


def test_a_boost_may_queue_and_lose_more():
    plain, wide = (
        largest_costs(make_scenario("toy6", weights=EVERY, horizon=40, datacenters={"boost_share": b}))
        for b in (1.0, 1.3)
    )
    assert wide.backlog == pytest.approx(plain.backlog * 1.07 / 0.77)
    assert wide.leftover == pytest.approx(plain.leftover * 1.07 / 0.77)
    assert wide.loss == pytest.approx(plain.loss * 1.3)
    same = ("voltage", "violation", "effort", "clock", "step")
    assert [getattr(wide, name) for name in same] == [getattr(plain, name) for name in same]


def test_the_largest_backlog_is_reached():
    # Full load and a clock that serves next to nothing.
    scenario = make_scenario("toy6", datacenters={"f_min_mhz": 1e-6}, horizon=60)
    bound = largest_costs(scenario)
    simulation = Simulation(scenario, 1)
    simulation.reset([0])
    last = None
    for _ in range(60):
        last = simulation.step(np.array([[-1.0, 0.0, 0.0, 0.0]]))
    assert last is not None
    # Full from t = 20 s on: 41 of the 60 steps.
    assert last.costs.backlog[0] == pytest.approx(bound.backlog * 41 / 60, rel=1e-6)
    assert last.costs.leftover[0] == pytest.approx(bound.leftover * 41 / 60, rel=1e-6)


@pytest.mark.parametrize("shape", [(3,), (3, 7)])
def test_charged_keeps_sound_environments_and_charges_the_rest_for_all_that_remains(shape):
    scenario = make_scenario("ieee33-weak", horizon=10, weights=EVERY)
    rng = np.random.default_rng(0)
    costs = Costs(*(rng.random(shape) for _ in Costs._fields))
    step, converged = np.array([4, 4, 10]), np.array([True, False, False])
    found = charged(scenario, costs, step, converged)
    bound = largest_costs(scenario)
    for field in Costs._fields:
        a, b, most = getattr(found, field), getattr(costs, field), getattr(bound, field)
        assert a.shape == shape
        np.testing.assert_array_equal(a[0], b[0])
        # Steps 4 to 10 are seven; the leftover is due once.
        np.testing.assert_allclose(a[1], most * (1 if field == "leftover" else 7))
        np.testing.assert_allclose(a[2], most)
    assert charged(scenario, costs, step, np.array([True, True, True])) == costs
    tensors = charged(scenario, Costs(*map(torch.tensor, costs)), torch.tensor(step), torch.tensor(converged))
    for a, b in zip(found, tensors, strict=True):
        np.testing.assert_allclose(b.numpy(), a, rtol=1e-7)


def test_a_collapse_is_charged_the_terms_of_devices_too_and_those_of_the_end_once():
    rule: dict[str, Any] = {"datacenters.ride_through": {"curve": "itic", "trip_weight": 2.0, "away_weight": 3.0}}
    scenario = riding(horizon=10, **rule)
    bound, fields = largest_costs(scenario), terms(scenario).kind._fields
    assert (bound.trips, bound.away, bound.recharge) == pytest.approx((2.0, 3.0, 9.0 * 300.0))
    assert bound.inverter_trips == 0.0
    found = charged(scenario, terms(scenario).kind(*[np.zeros(1)] * len(fields)), np.array([4]), np.array([False]))
    for name in fields:
        steps = 1 if name in ("leftover", "recharge") else 7
        assert getattr(found, name) == pytest.approx(steps * getattr(bound, name)), name


@pytest.mark.parametrize(("optional", "others"), [({}, []), ({"ramp_excess": 1.0}, ["ramp_excess"])])
@pytest.mark.parametrize("rides", [False, True])
def test_the_constraint_is_the_sum_of_its_terms(optional, others, rides):
    limits: dict[str, Any] = {"weights": optional, "cost.ramp_limit_kw_per_s": 10.0}
    scenario = riding(**limits) if rides else make_scenario("ieee33-weak", **limits)
    names = terms(scenario).kind._fields
    costs = terms(scenario).kind(*2.0 ** np.arange(len(names)))
    expected = {"violation", *others, *(["trips", "inverter_trips"] if rides else [])}
    assert constraint(scenario, costs) == sum(getattr(costs, name) for name in expected)


@pytest.mark.parametrize(
    "cost", [*({"voltage": kind} for kind in KINDS), {"reference": "profile", "profile_pu": 1.02}], ids=str
)
def test_figures_of_the_voltages_that_are_given_change_no_cost(cost):
    scenario = make_scenario("toy6", cost=cost)
    state, solution = hand_made_state(), solution_with_loss(0.0)
    given = voltage_figures(state.v_pu, scenario.feeder.load_slice.start, scenario.cost.band_pu)
    found = figures(team_costs(scenario, state, solution, NOT_LAST, given))
    assert found == pytest.approx(figures(team_costs(scenario, state, solution, NOT_LAST)), rel=1e-12)
    assert found["voltage"] > 0.0


def test_costs_survive_a_pickle():
    costs = Costs(*np.arange(8.0)[:, None])
    again = pickle.loads(pickle.dumps(costs))
    assert type(again) is type(costs)
    assert again == costs


def test_effort_of_a_single_converter_is_its_own():
    scenario = make_scenario("toy6", inverters={"buses": (), "s_rated_kva": 100.0})
    state = play(scenario, 1, lambda k: np.array([[1.0, 0.5]]))[-1].state
    costs = team_costs(scenario, state, solution_with_loss(0.0), NOT_LAST)
    assert costs.effort[0] == pytest.approx(0.02 * abs(state.q_kvar[0, 0]) / 2750.0)
    assert costs.effort[0] > 0.0


def weak_site(**overrides: Any) -> Scenario:
    """The site's full load, from t = 20 s on, is more than the feeder carries; throttled it has a solution."""
    return make_scenario("toy6", **{"datacenters.p_rated_kw": 25_000.0}, horizon=30).replace(**overrides)


def test_a_collapsed_environment_is_terminated_and_charged_once():
    scenario = weak_site()
    simulation = Simulation(scenario, 2)
    simulation.reset([0, 0])
    action = np.zeros((2, 4))
    action[0, 0], action[1, 0] = 1.0, -1.0
    t = simulation.transition
    for step in range(1, 21):
        t = simulation.step(action)
        assert t.terminated.tolist() == [step == 20, False]
        assert t.truncated.tolist() == [False, False]
        assert np.isfinite(t.observation).all()
    bound = largest_costs(scenario)
    *each, leftover = bound
    assert t.converged.tolist() == [False, True]
    assert t.cost_j[0] == pytest.approx(11 * sum(each) + leftover)  # steps 20 to 30
    assert t.reward[0] == -t.cost_j[0]
    assert t.cost_j[0] == pytest.approx(sum(float(c[0]) for c in t.costs))
    assert t.cost_j[1] == pytest.approx(float(total(team_costs(scenario, t.state, solution_for(t), t.truncated))[1]))


def solution_for(t: Transition) -> Solution:
    return solution_with_loss(0.0)._replace(loss_kw=t.loss_kw, converged=t.converged)


def test_collapse_at_the_last_step_terminates_and_does_not_truncate():
    scenario = weak_site().replace(horizon=20)
    course = play(scenario, 1, lambda k: np.array([[1.0, 0.0, 0.0, 0.0]]))
    assert course[-1].terminated[0]
    assert not course[-1].truncated[0]
    assert course[-1].cost_j[0] == pytest.approx(sum(largest_costs(scenario)))


@pytest.mark.parametrize("reward_scope", ["shared", "local"])
@pytest.mark.parametrize("kind", KINDS)
def test_ending_early_never_pays(kind, reward_scope):
    # The same 19 steps, then one environment collapses and the others go on to the end as badly as they can.
    scenario = weak_site(cost={"voltage": kind}, reward=reward_scope)
    n_env, rng = 8, np.random.default_rng(3)
    paid, over = np.zeros((n_env, scenario.n_agents)), np.zeros(n_env, dtype=bool)
    simulation = Simulation(scenario, n_env)
    simulation.reset([5] * n_env)
    ended = []
    for step in range(1, 31):
        action = np.tile([[-1.0, 0.0, -1.0, -1.0]], (n_env, 1))
        if step == 20:
            action[0, 0] = 1.0
        if step >= 20:
            action[1:, 2:] = rng.choice([-1.0, 1.0], (n_env - 1, 2))
        t = simulation.step(action)
        share = t.reward if reward_scope == "local" else t.reward[:, None]
        paid += np.where(over[:, None], 0.0, share)
        over |= t.terminated | t.truncated
        ended.append(t.terminated.copy())
    assert [int(e[0]) for e in ended[:20]] == [0] * 19 + [1]
    assert not np.any([e[1:] for e in ended])
    assert over.all()
    assert np.all(paid[0] < paid[1:].min(axis=0))


def test_the_earlier_the_dearer():
    scenario = make_scenario("ieee123")
    none = Costs(*(np.zeros(120) for _ in Costs._fields))
    due = total(charged(scenario, none, np.arange(1, 121), np.zeros(120, dtype=bool)))
    assert np.all(np.diff(due) < 0)
    # And even the last is dearer than any single step that is solved, with what it may leave behind.
    assert due[-1] == pytest.approx(sum(largest_costs(scenario)))


def test_reset_is_not_charged_to_the_episode():
    scenario = make_scenario("ieee33-weak", horizon=3)
    course = play(scenario, 2, lambda k: np.zeros((2, 10)))
    assert not course[0].terminated.any()
    assert not course[0].truncated.any()
    assert reward.total(course[0].costs).shape == (2,)
    assert np.all(course[0].costs.leftover == 0.0)
