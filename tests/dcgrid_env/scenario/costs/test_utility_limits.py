"""Limits on ramps and on steps of the voltage: what is charged, worked by hand, and the same in every interface."""

from typing import Any

import gymnasium
import numpy as np
import pytest
import torch

from dcgrid_env import Scenario, ScenarioError, TensorEnv, make_scenario, parallel_env, scenario_hash
from dcgrid_env.engine.cost.reward import constraint, largest_costs
from dcgrid_env.engine.simulation import Simulation, Transition
from dcgrid_env.scenario.costs.utility_limits import ramp_steps, sites
from helpers.forms import FORMS

WEIGHTS = {"ramp_excess": 2.0, "voltage_step_excess": 3.0}
LIMITS = {
    "cost.ramp_limit_kw_per_s": 20.0,
    "cost.ramp_window_s": 3.0,
    "cost.voltage_step_limit_pu": 1e-4,
    "weights": WEIGHTS,
}


def limited(name: str = "ieee33-weak", **overrides: Any) -> Scenario:
    return make_scenario(name, **{"horizon": 12, **LIMITS}).replace(**overrides)


def play(scenario: Scenario, n_env: int = 2, seed: int = 0) -> list[Transition]:
    rng = np.random.default_rng(seed)
    simulation = Simulation(scenario, n_env)
    n = simulation.reset(range(n_env)).state.q_kvar.shape[1] + scenario.datacenters.count
    return [simulation.transition] + [simulation.step(rng.uniform(-1, 1, (n_env, n))) for _ in range(scenario.horizon)]


def reckoned(scenario: Scenario, course: list[Transition], step: int, env_index: int) -> tuple[float, float]:
    """Weighted terms of a step, site by site and node by node."""
    window = round((scenario.cost.ramp_window_s or scenario.dt_s) / scenario.dt_s)
    now, begin = (course[max(at, 0)].state.p_kw[env_index] for at in (step, step - window))
    n = scenario.datacenters.count
    ramps = [abs(now[i] - begin[i]) / (window * scenario.dt_s) for i in range(n)]
    at = scenario.feeder.load_nodes
    changes = np.abs(course[step].state.v_pu[env_index, at] - course[step - 1].state.v_pu[env_index, at])
    ramp_excess = [max(ramp / scenario.cost.ramp_limit_kw_per_s - 1.0, 0.0) for ramp in ramps]
    step_excess = [max(change / scenario.cost.voltage_step_limit_pu - 1.0, 0.0) for change in changes]
    return 2.0 * sum(ramp_excess) / n, 3.0 * sum(step_excess) / len(step_excess)


@pytest.mark.parametrize("dt_s", [1.0, 0.1])
@pytest.mark.parametrize("window_s", [None, 3.0])
@pytest.mark.parametrize("name", ["ieee33-weak", "ieee34-3ph"])
def test_what_is_charged_is_the_excess_as_a_share_of_the_limit(name, window_s, dt_s):
    horizon = 40 if dt_s < 1.0 else 12
    scenario = limited(name, cost={"ramp_limit_kw_per_s": 1.0, "ramp_window_s": window_s}, dt_s=dt_s, horizon=horizon)
    course = play(scenario)
    for step in range(1, len(course)):
        for env_index in (0, 1):
            found = [float(getattr(course[step].costs, term)[env_index]) for term in WEIGHTS]
            assert found == pytest.approx(reckoned(scenario, course, step, env_index), rel=1e-9, abs=1e-12)
            parts = float(course[step].costs.violation[env_index]) + sum(found)
            assert constraint(scenario, course[step].costs)[env_index] == pytest.approx(parts)
            assert course[step].cost_j[env_index] == pytest.approx(
                sum(float(term[env_index]) for term in course[step].costs)
            )
    assert all(max(getattr(t.costs, term).max() for t in course) > 0.0 for term in WEIGHTS)


def test_a_ramp_over_a_window_worked_by_hand():
    # toy6's site stands at its idle 575 kW and takes 2500 kW from t = 20 s on: 1925 kW within a step.
    scenario = make_scenario(
        "toy6", horizon=30, cost={"ramp_limit_kw_per_s": 100.0, "ramp_window_s": 5.0}, weights={"ramp_excess": 1.0}
    )
    simulation = Simulation(scenario, 1)
    simulation.reset([0])
    course: list[Any] = [simulation.step(np.array([[1.0, 0, 0, 0]])) for _ in range(30)]
    found = [float(t.costs.ramp_excess[0]) for t in course]
    assert found == pytest.approx(
        [0.0] * 19 + [1925 / 5 / 100 - 1.0] * 5 + [0.0] * 6, abs=0.02
    )  # it is not quite still


def test_a_window_of_one_step_is_the_default():
    one, default = (play(limited(cost={"ramp_window_s": window_s})) for window_s in (1.0, None))
    assert [t.cost_j.tolist() for t in one] == [t.cost_j.tolist() for t in default]
    assert ramp_steps(limited(cost={"ramp_window_s": None}, dt_s=0.1)) == 1


@pytest.mark.parametrize("name", FORMS)
def test_without_a_weight_nothing_is_kept_charged_or_shown(name):
    plain = make_scenario(name, horizon=4)
    only_limits = plain.replace(cost={"ramp_limit_kw_per_s": 20.0, "voltage_step_limit_pu": 0.02})
    for t, other in zip(play(plain), play(only_limits), strict=True):
        assert t.costs._fields == other.costs._fields
        assert not set(WEIGHTS) & set(t.costs._fields)
        assert other.state.p_window_kw is None
        np.testing.assert_array_equal(t.cost_j, other.cost_j)
        assert constraint(plain, t.costs) is t.costs.violation


def test_limits_show_in_the_hash_and_their_absence_does_not():
    plain = make_scenario("ieee33-weak")
    hashes = {scenario_hash(plain.replace(**change)) for change in (
        {}, {"cost.ramp_limit_kw_per_s": 20.0}, {"cost.ramp_limit_kw_per_s": 20.0, "cost.ramp_window_s": 3.0},
        {"cost.voltage_step_limit_pu": 0.02}, LIMITS,
    )}  # fmt: skip
    assert len(hashes) == 5
    assert scenario_hash(
        plain.replace(cost={"ramp_limit_kw_per_s": None}, weights={"ramp_excess": 0.0})
    ) == scenario_hash(plain)


def test_local_rewards_charge_each_site_for_its_own_ramp_and_each_agent_for_its_own_voltage():
    free, charged = (
        play(limited(reward="local", weights=weights)) for weights in (dict.fromkeys(WEIGHTS, 0.0), WEIGHTS)
    )
    scenario = limited()
    assert sites(scenario) == slice(0, 3)
    for step in range(1, len(charged)):
        t, begin = charged[step], charged[max(step - 3, 0)].state.p_kw
        wanted = np.zeros_like(t.reward)
        wanted[:, :3] += 2.0 * np.maximum(np.abs(t.state.p_kw - begin)[:, :3] / 3.0 / 20.0 - 1.0, 0.0)
        wanted += 3.0 * np.maximum(np.abs(t.state.v_agent_pu - t.state.v_agent_last_pu) / 1e-4 - 1.0, 0.0)
        np.testing.assert_allclose(free[step].reward - t.reward, wanted, rtol=1e-9, atol=1e-9)


def test_largest_costs_bound_what_is_charged_and_collapse_is_charged_with_them():
    scenario = limited(cost={"ramp_window_s": None})
    bound: Any = largest_costs(scenario)
    assert bound.ramp_excess == pytest.approx(2.0 * (1000.0 / 1.0 / 20.0 - 1.0))
    assert bound.voltage_step_excess == pytest.approx(3.0 * (1e4 - 1.0))
    for t in play(scenario):
        assert all((getattr(t.costs, term) <= getattr(bound, term)).all() for term in WEIGHTS)
    lost = make_scenario(
        "toy6",
        datacenters={"p_rated_kw": 25_000.0},
        horizon=30,
        cost={"ramp_limit_kw_per_s": 100.0},
        weights={"ramp_excess": 1.0},
    )
    simulation = Simulation(lost, 1)
    simulation.reset([0])
    last: Any = [simulation.step(np.array([[1.0, 0, 0, 0]])) for _ in range(20)][-1]
    assert last.terminated[0]
    assert last.costs.ramp_excess[0] == pytest.approx(11 * (25_000.0 / 100.0 - 1.0))


# --- every interface -------------------------------------------------------------------------------


def test_all_interfaces_charge_the_same():
    scenario = limited()
    rng = np.random.default_rng(3)
    actions = rng.uniform(-1, 1, (12, 10)).astype(np.float32)
    single: Any = gymnasium.make("dcgrid/IEEE33Weak-v0", **{"horizon": 12, **LIMITS})
    many: Any = gymnasium.make_vec("dcgrid/IEEE33Weak-v0", num_envs=2, autoreset_mode="disabled", scenario=scenario)
    agents = parallel_env(scenario)
    tensors = TensorEnv(scenario, like=torch.empty(0, dtype=torch.float64))
    single.reset(seed=5)
    many.reset(seed=5)
    agents.reset(seed=5)
    tensors.reset([5])
    for action in actions:
        info = single.step(action)[4]
        infos = many.step(np.stack([action, action]))[4]
        cuts = np.split(action, np.cumsum([2, 2, 2, 1, 1, 1])) if len(agents.agents) == 7 else []
        infos_of_agents = agents.step(dict(zip(agents.possible_agents, cuts, strict=True)))[4]
        done = tensors.step(torch.tensor(action[None], dtype=torch.float64))
        for name in (*(f"cost_{term}" for term in WEIGHTS), "cost"):
            assert infos[name][0] == info[name]
            assert infos_of_agents["inv_0"][name] == info[name]
        for term in WEIGHTS:
            assert float(getattr(done.costs, term)[0]) == pytest.approx(info[f"cost_{term}"], rel=1e-6, abs=1e-6)
        assert info["cost"] == pytest.approx(info["cost_violation"] + sum(info[f"cost_{term}"] for term in WEIGHTS))
    single.close()
    many.close()


def test_a_saved_environment_goes_on_with_the_same_ramps_and_a_new_episode_forgets_its_own():
    scenario = limited(horizon=6)
    rng = np.random.default_rng(4)
    actions = rng.uniform(-1, 1, (8, 3, 10))
    simulation = Simulation(scenario, 3)
    simulation.reset([0, 1, 2])
    for action in actions[:3]:
        simulation.step(action)
    saved = simulation.now
    once = [simulation.step(action).cost_j for action in actions[3:6]]
    simulation.restore(saved)
    np.testing.assert_array_equal(once, [simulation.step(action).cost_j for action in actions[3:6]])
    begun = simulation.reset([7, None, None], np.array([True, False, False]))
    fresh = Simulation(scenario, 1)
    fresh.reset([7])
    assert begun.state.p_window_kw is not None
    assert all((draws[0] == begun.state.p_kw[0]).all() for draws in begun.state.p_window_kw)
    np.testing.assert_array_equal(simulation.step(actions[6]).cost_j[:1], fresh.step(actions[6, :1]).cost_j)


def test_the_cost_has_a_derivative_by_every_action_in_the_window():
    scenario = limited("toy6", cost={"ramp_limit_kw_per_s": 10.0, "ramp_window_s": 2.0}, horizon=30)
    env = TensorEnv(scenario, like=torch.empty(0, dtype=torch.float64))

    def cost(clock: torch.Tensor) -> torch.Tensor:
        env.reset([0])
        charged = []
        for step in range(24):
            action = torch.zeros((1, 4), dtype=torch.float64)
            action[:, 0] = 1.0
            if step >= 20:  # full load: the clock sets the draw
                action = torch.cat((clock[step - 20].reshape(1, 1), action[:, 1:]), dim=1)
            charged.append(env.step(action).costs)
        return sum(c.ramp_excess[0] + c.voltage_step_excess[0] for c in charged)  # pyright: ignore

    clock = torch.tensor([0.3, -0.4, 0.1, 0.2], dtype=torch.float64, requires_grad=True)
    (slope,) = torch.autograd.grad(cost(clock), clock)
    assert (slope != 0.0).all()
    for i in range(4):
        moved = torch.zeros(4, dtype=torch.float64)
        moved[i] = 1e-4
        with torch.no_grad():
            numeric = (cost(clock + moved) - cost(clock - moved)) / 2e-4
        assert float(slope[i]) == pytest.approx(float(numeric), rel=1e-3)


def test_a_cut_stops_the_derivative_by_draws_before_it():
    env = TensorEnv(limited("toy6", cost={"ramp_window_s": 2.0}), like=torch.empty(0, dtype=torch.float64))
    env.reset([0])
    env.step(torch.zeros((1, 4), dtype=torch.float64, requires_grad=True))
    env.cut()
    assert not env.step(torch.zeros((1, 4), dtype=torch.float64)).cost_j.requires_grad


# --- bad input ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        ({"cost.ramp_limit_kw_per_s": 0.0}, "cost.ramp_limit_kw_per_s is 0.0; give a finite number in .*, or None"),
        ({"cost.ramp_limit_kw_per_s": "fast"}, "cost.ramp_limit_kw_per_s is 'fast'; give a finite number in"),
        ({"cost.voltage_step_limit_pu": -0.02}, "cost.voltage_step_limit_pu is -0.02; give a finite number in"),
        (
            {"cost.voltage_step_limit_pu": float("nan")},
            "cost.voltage_step_limit_pu is nan; give a finite number in",
        ),
        ({"weights": {"ramp_excess": 2.0}}, "cost.weights.ramp_excess is 2.0; give ramp_limit_kw_per_s too"),
        (
            {"weights": {"voltage_step_excess": 2.0}},
            "cost.weights.voltage_step_excess is 2.0; give voltage_step_limit_pu",
        ),
        ({"cost.ramp_window_s": 5.0}, "cost.ramp_window_s is 5.0; give ramp_limit_kw_per_s too, or leave it out"),
        (
            {"cost.ramp_limit_kw_per_s": 5.0, "cost.ramp_window_s": 2.5},
            "cost.ramp_window_s is 2.5; give a whole number of steps of 1 s, 10,000 of them at most",
        ),
        (
            {"cost.ramp_limit_kw_per_s": 5.0, "cost.ramp_window_s": 0.1},
            "cost.ramp_window_s is 0.1; give a whole number of steps",
        ),
        (
            {"cost.ramp_limit_kw_per_s": 5.0, "cost.ramp_window_s": 10_001.0},
            "cost.ramp_window_s is 10001.0; give a whole number of steps",
        ),
        (
            {"cost.ramp_limit_kw_per_s": 5.0, "n_datacenters": 0, "datacenters.buses": None},
            "it out: the scenario has no data",
        ),
    ],
)
def test_a_limit_that_cannot_be_is_one_clear_error(overrides, message):
    with pytest.raises(ScenarioError, match=f"scenario 'ieee33-weak': .*{message}"):
        make_scenario("ieee33-weak", **overrides)


def test_controllers_with_a_model_say_that_they_do_not_price_limits():
    from dcgrid_env.baselines import make_controller, rollout

    scenario = limited(observe="feeder")
    with pytest.raises(ValueError, match=r"weights\.ramp_excess is 2, which it does not minimise; set it to 0"):
        rollout(scenario, make_controller("feedback", scenario), [0])
