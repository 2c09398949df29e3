"""Cost and metrics of a miss of a utility's request: worked by hand, and the same in every interface."""

from typing import Any

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium.utils.env_checker import check_env
from hypothesis import given
from hypothesis import strategies as st
from pettingzoo.test import parallel_api_test

from dcgrid_env import (
    METRICS,
    DcgridEnv,
    DcgridVectorEnv,
    Recorder,
    Scenario,
    StreamingRecorder,
    TensorEnv,
    action_layout,
    field_names,
    make_scenario,
    parallel_env,
)
from dcgrid_env.engine.cost.reward import constraint, largest_costs
from dcgrid_env.engine.family_simulation import simulation
from dcgrid_env.engine.simulation import Transition
from dcgrid_env.scenario.costs.load_requests import columns, missed, missed_share, request_figures, sites_share

TARGETS = [
    {"value_share": 0.3, "begin_s": 3, "ramp_s": 2, "duration_s": 4},
    {"kind": "target", "value_share": [0.4, 0.6], "begin_s": 8, "duration_s": 4},
]
WEIGHT = 2.0


def asking(name: str = "ieee33-weak", **overrides: Any) -> Scenario:
    request = {"targets": TARGETS, "notice_s": 4.0}
    return make_scenario(name, horizon=14, grid_request=request, weights={"grid_request": WEIGHT}, **overrides)


def play(scenario: Scenario, n_env: int = 2, seed: int = 0) -> list[Transition]:
    rng = np.random.default_rng(seed)
    envs, n = simulation(scenario, n_env), action_layout(scenario).n
    envs.reset(range(n_env))
    return [envs.transition] + [envs.step(rng.uniform(-1, 1, (n_env, n))) for _ in range(scenario.horizon)]


@pytest.mark.parametrize("name", ["ieee33-weak", "fault", "ieee13-3ph", "zero-shot"])
def test_what_is_charged_is_the_distance_from_the_request(name):
    scenario = asking(name)
    rated_kw, n = scenario.site_rated_kw.sum(), scenario.n_sites
    course = play(scenario)
    for t in course[1:]:
        request = columns(t.state.request)
        draw = t.state.p_kw[:, :n].sum(1) / rated_kw
        short = np.maximum(draw - request.upper, 0.0) + np.maximum(request.lower - draw, 0.0)
        np.testing.assert_allclose(t.costs.grid_request, WEIGHT * short, rtol=1e-9, atol=1e-12)
        np.testing.assert_array_equal(constraint(scenario, t.costs), t.costs.violation + t.costs.grid_request)
    assert sum(t.costs.grid_request.sum() for t in course) > 0.0
    assert course[0].costs.grid_request.sum() == 0.0


def test_without_a_weight_a_request_is_observed_and_not_charged():
    plain = make_scenario("ieee33-weak", horizon=14)
    free = asking().replace(weights={"grid_request": 0.0})
    for t, other in zip(play(plain), play(free), strict=True):
        np.testing.assert_array_equal(t.cost_j, other.cost_j)
        np.testing.assert_array_equal(t.state.v_pu, other.state.v_pu)
        assert t.state.request is None
        assert "grid_request" not in other.costs._fields
        assert other.observation.shape[1] == t.observation.shape[1] + 7 * plain.n_sites


def test_sites_alone_observe_requests():
    scenario = asking()
    names = field_names(scenario)
    beginnings = ("request_", "coming_")
    assert sum(name.startswith(beginnings) for name in names["dc_0"]) == 7
    assert not any(name.startswith(beginnings) for name in names["inv_0"])
    flat = [(agent, name) for agent, fields in names.items() for name in fields]
    for t in play(scenario):
        request = columns(t.state.request)
        expected = {
            "request_draw": sites_share(scenario, t.state.p_kw),
            "request_lower": request.lower_next,
            "request_upper": request.upper_next,
            "request_left": request.left,
            "request_wait": request.wait,
            "coming_lower": request.lower_announced,
            "coming_upper": request.upper_announced,
        }
        for agent in ("dc_0", "dc_2"):
            for name, values in expected.items():
                np.testing.assert_allclose(t.observation[:, flat.index((agent, name))], values, atol=1e-6)


def test_a_bound_on_the_charge():
    scenario = asking()
    assert largest_costs(scenario).grid_request == WEIGHT
    assert max(t.costs.grid_request.max() for t in play(scenario)) <= WEIGHT


def test_local_rewards_charge_every_agent_the_team_s_miss():
    local = asking(reward="local")
    free = local.replace(weights={"grid_request": 0.0})
    for t, other in zip(play(local)[1:], play(free)[1:], strict=True):
        lost = other.reward - t.reward
        np.testing.assert_allclose(lost, np.repeat(t.costs.grid_request[:, None], 7, axis=1), atol=1e-9)


shares = st.floats(-0.5, 1.5)


@given(shares, shares, shares, shares)
def test_a_miss_is_the_distance_from_a_range(draw, other, a, b):
    lower, upper = sorted((a, b))
    found = float(missed_share(np.array(draw), np.array(lower), np.array(upper)))
    assert found == pytest.approx(abs(draw - np.clip(draw, lower, upper)), abs=1e-12)
    moved = float(missed_share(np.array(other), np.array(lower), np.array(upper)))
    assert abs(found - moved) <= abs(draw - other) + 1e-12


def test_metrics_worked_by_hand():
    # Two steps without a request, then a cap of 0.5, and a target of 0.4 in the last step; three sites of 1 MW.
    scenario = asking()
    p_kw = np.zeros((5, 7))
    p_kw[:, :3] = np.array([[0.9, 0.9, 0.505, 0.8, 0.3]]).T * 1000.0
    request = np.zeros((5, 9))
    request[:, 1], request[:, 2] = [1.0, 1.0, 0.5, 0.5, 0.4], [0.9, 0.9, 0.9, 0.9, 0.1]
    request[4, 0] = 0.4
    figures, n = request_figures(scenario, p_kw, request)
    assert n == 3
    assert figures == pytest.approx(
        {
            "grid_request_compliance_pct": 100.0 / 3.0,
            "grid_request_asked_kwh": 3000.0 / 3600.0 * (0.4 + 0.4 + 0.3),
            "grid_request_delivered_kwh": 3000.0 / 3600.0 * (0.395 + 0.1 + 0.2),
            "grid_request_missed_max_kw": 900.0,
        }
    )
    assert set(figures) <= set(METRICS)


def test_metrics_of_parts_are_those_of_the_whole():
    scenario, course = asking(), play(asking())
    whole, parts = Recorder(scenario, course[0]), StreamingRecorder(scenario, course[0], part_steps=3)
    for t in course[1:]:
        whole.add(t)
        parts.add(t)
    for one, other in zip(whole.metrics(), parts.metrics(), strict=True):
        assert list(one) == list(other)
        assert one == pytest.approx(other, rel=1e-9)
        assert one["grid_request_asked_kwh"] > one["grid_request_delivered_kwh"] >= 0.0
        assert 0.0 < one["grid_request_compliance_pct"] < 100.0


def test_info_has_the_request_and_its_miss():
    env = DcgridEnv(asking())
    _, info = env.reset(seed=1)
    assert (info["grid_request_lower_kw"], info["grid_request_upper_kw"]) == (0.0, 3000.0)
    for _ in range(5):
        info = env.step(np.ones(10, np.float32))[4]
    assert info["grid_request_upper_kw"] == pytest.approx(900.0)
    assert info["grid_request_missed_kw"] == pytest.approx(info["cost_grid_request"] / WEIGHT * 3000.0)


# --- every interface -------------------------------------------------------------------------------


def test_all_interfaces_charge_the_same():
    scenario = asking()
    single, agents = DcgridEnv(scenario), parallel_env(scenario)
    many: Any = gymnasium.make_vec("dcgrid/IEEE33Weak-v0", num_envs=2, autoreset_mode="disabled", scenario=scenario)
    tensors = TensorEnv(scenario, like=torch.empty(0, dtype=torch.float64))
    for env in (single, agents, many):
        env.reset(seed=5)
    tensors.reset([5])
    for action in np.random.default_rng(3).uniform(-1, 1, (14, 10)).astype(np.float32):
        observation, _, _, _, info = single.step(action)
        infos = many.step(np.stack([action, action]))[4]
        cuts = np.split(action, np.cumsum([2, 2, 2, 1, 1, 1]))
        infos_of_agents = agents.step(dict(zip(agents.possible_agents, cuts, strict=True)))[4]
        done = tensors.step(torch.tensor(action[None], dtype=torch.float64))
        assert infos["cost_grid_request"][0] == info["cost_grid_request"]
        assert infos_of_agents["inv_0"]["cost_grid_request"] == info["cost_grid_request"]
        assert float(done.costs.grid_request[0]) == pytest.approx(info["cost_grid_request"], abs=1e-9)
        np.testing.assert_allclose(done.observation[0], observation, atol=1e-5)


@pytest.mark.slow
def test_the_cost_has_a_derivative_by_the_clocks():
    scenario = asking(trace="training")
    env = TensorEnv(scenario, like=torch.empty(0, dtype=torch.float64))
    clocks = torch.tensor(action_layout(scenario).is_channel("clock").astype(float))

    def charged(x: torch.Tensor) -> torch.Tensor:
        env.reset([2])
        return torch.stack([env.step((0.3 + x) * clocks[None]).costs.grid_request for _ in range(12)]).sum()

    x = torch.zeros((), dtype=torch.float64, requires_grad=True)
    charged(x).backward()
    assert x.grad is not None
    with torch.no_grad():
        near = (charged(x + 1e-6) - charged(x - 1e-6)) / 2e-6
    assert float(x.grad) != 0.0
    assert float(x.grad) == pytest.approx(float(near), rel=1e-4)


def test_a_restored_episode_goes_on_with_its_requests():
    scenario = asking()
    env: Any = DcgridVectorEnv(scenario=scenario, num_envs=3, autoreset_mode="disabled")
    env.reset(seed=4)
    actions = np.random.default_rng(0).uniform(-1, 1, (14, *env.action_space.shape)).astype(np.float32)
    for action in actions[:6]:
        env.step(action)
    saved = env.save()
    first = [env.step(action) for action in actions[6:]]
    env.restore(saved)
    for action, before in zip(actions[6:], first, strict=True):
        now = env.step(action)
        np.testing.assert_array_equal(now[0], before[0])
        np.testing.assert_array_equal(now[4]["cost_grid_request"], before[4]["cost_grid_request"])


def test_checkers_accept_environments_with_requests():
    check_env(DcgridEnv(asking()), skip_render_check=True)
    parallel_api_test(parallel_env(asking()), num_cycles=30)


def test_a_state_without_a_request_is_refused():
    scenario = make_scenario("ieee33-weak", horizon=3)
    with pytest.raises(ValueError, match=r"has no request of a utility; give it grid_request.targets"):
        missed(scenario, play(scenario)[-1].state)
