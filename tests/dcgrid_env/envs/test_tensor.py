"""Episodes as tensors: those of the other environments, with derivatives."""

import subprocess
import sys

import numpy as np
import pytest
import torch

from dcgrid_env import DcgridVectorEnv, TensorEnv, action_layout, make_scenario
from dcgrid_env.engine.cost.observation import joint_bounds
from dcgrid_env.powerflow.balanced.distflow import TOLERANCE_KVA
from dcgrid_env.traces import PowerTrace
from helpers.forms import VARIANTS, variant_of
from helpers.states import fields_of

# Kind of array, then how far an observation, in bands, and a step's cost may be from the environment's, which observes
# in float32 and counts in float64. float32 knows a voltage to some 1e-7 p.u. and charges up to 1000 for each beyond.
KINDS = {
    "numpy": (np.empty(0), 2e-7, 1e-12),
    "float64": (torch.empty(0, dtype=torch.float64), 2e-7, 1e-12),
    "float32": (torch.empty(0), 2e-4, 2e-3),
}


def as_kind(array, like):
    return array.astype(like.dtype) if isinstance(like, np.ndarray) else torch.tensor(array, dtype=like.dtype)


def actions(scenario, n_env, seed=0):
    n = action_layout(scenario).n
    return np.random.default_rng(seed).uniform(-1.0, 1.0, (scenario.horizon, n_env, n)).astype(np.float32)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("form", VARIANTS)
def test_episodes_are_those_of_the_environment(form, kind):
    (like, seen_off, cost_off), scenario, n_env = KINDS[kind], variant_of(form), 5
    ours, theirs = TensorEnv(scenario, like=like), DcgridVectorEnv(n_env, scenario)
    low, high = joint_bounds(scenario)

    def assert_seen(found, expected):
        assert found.dtype == like.dtype
        np.testing.assert_allclose(np.clip(np.asarray(found), low, high), expected, rtol=1e-6, atol=seen_off)

    assert_seen(ours.reset(range(7, 7 + n_env)), theirs.reset(seed=7)[0])
    for k, action in enumerate(actions(scenario, n_env)):
        found = ours.step(as_kind(action, like))
        seen, rewards, _, truncated, infos = theirs.step(action)
        assert truncated.all() == ours.over == (k == scenario.horizon - 1)
        assert_seen(found.observation, np.stack(infos["final_obs"]) if ours.over else seen)
        np.testing.assert_allclose(np.asarray(found.cost_j), -rewards, rtol=0.0, atol=cost_off)
        info = infos["final_info"] if ours.over else infos
        for term in ("voltage", "violation", "backlog", "leftover"):
            np.testing.assert_allclose(
                np.asarray(getattr(found.costs, term)), info[f"cost_{term}"], rtol=0.0, atol=cost_off
            )


@pytest.mark.parametrize("kind", KINDS)
def test_a_collapse_is_charged_once_and_spoils_nothing(kind):
    # The site's full load, from t = 20 s on, is more than the feeder carries; only environment 1 asks for it.
    like, _, _ = KINDS[kind]
    scenario = make_scenario("toy6", datacenters={"p_rated_kw": 25_000.0}, horizon=24)
    ours, theirs = TensorEnv(scenario, like=like), DcgridVectorEnv(3, scenario)
    ours.reset([4, 5, 6])
    theirs.reset(seed=4)
    action = np.array([[-1.0, 0.1, 0, 0], [1.0, 0.1, 0, 0], [-1.0, 0.1, 0, 0]], np.float32)
    given, gone, costs = [], False, []
    for _ in range(scenario.horizon):
        given.append(as_kind(action, like))
        if not isinstance(like, np.ndarray):
            given[-1].requires_grad_()
        found = ours.step(given[-1])
        _, rewards, terminated, *_ = theirs.step(action)
        costs.append(found.cost_j)
        cost_j = np.asarray(found.cost_j if isinstance(like, np.ndarray) else found.cost_j.detach())
        np.testing.assert_allclose(cost_j[[0, 2]], -rewards[[0, 2]], rtol=1e-4)
        assert cost_j[1] == (0.0 if gone else pytest.approx(-rewards[1], rel=1e-4))
        if terminated[1]:
            gone = True
            assert cost_j[1] > 1000.0
        assert bool((found.observation == found.observation).all())
        assert not terminated[[0, 2]].any()
    assert gone
    if not isinstance(like, np.ndarray):
        torch.stack(costs).sum().backward()
        slopes = torch.stack([one.grad for one in given])  # pyright: ignore
        assert bool(torch.isfinite(slopes).all())
        assert slopes[:, [0, 2]].any()
        assert slopes[:18, 1].any()  # what was paid before the collapse
        assert not slopes[19:, 1].any()  # what is charged for it is a constant


def test_copies_have_the_same_episode():
    scenario = make_scenario("robust", split="train", horizon=6)
    like = torch.empty(0, dtype=torch.float64)
    few, many = TensorEnv(scenario, like=like), TensorEnv(scenario, like=like)
    seeds, given = [3, 9], torch.tensor(actions(scenario, 6), dtype=torch.float64)
    seen = few.reset(seeds, copies=3)
    assert torch.equal(seen, many.reset(seeds * 3))
    assert torch.equal(seen[:2], seen[2:4])
    for action in given:
        one, other = few.step(action), many.step(action)
        assert torch.equal(one.observation, other.observation)
        assert torch.equal(one.cost_j, other.cost_j)
        assert not torch.equal(one.cost_j[:2], one.cost_j[2:4])  # each copy is driven by its own actions


def test_a_reset_begins_anew():
    env = TensorEnv("ieee123", like=np.empty(0), horizon=3)
    first = env.reset([1, 5])
    for action in actions(env.scenario, 2):
        env.step(action.astype(float))
    np.testing.assert_array_equal(env.reset(np.array([1, 5])), first)
    assert not env.over
    assert not np.array_equal(env.reset([2, 5])[0], first[0])


# --- derivatives ----------------------------------------------------------------------------------------------------


def j_of(scenario, given, seeds):
    env = TensorEnv(scenario, like=torch.empty(0, dtype=torch.float64))
    env.reset(seeds)
    return torch.stack([env.step(action).cost_j for action in given]).sum(0).mean() / scenario.horizon


@pytest.mark.parametrize("form", ["toy6", "noise and delay", "faults", "pv", "two work classes"])
def test_the_derivative_of_j_fits_finite_differences(form, monkeypatch):
    monkeypatch.setitem(TOLERANCE_KVA, 8, 1e-9)  # far below the differences
    scenario, seeds, rng = variant_of(form).replace(horizon=12), [2, 3], np.random.default_rng(1)
    given = torch.tensor(0.9 * actions(scenario, 2, seed=2), dtype=torch.float64, requires_grad=True)
    (slope,) = torch.autograd.grad(j_of(scenario, given, seeds), given)
    assert slope[0].any()  # the first action matters at the end
    for _ in range(4):
        way = torch.tensor(rng.normal(size=tuple(given.shape)))
        step = 1e-6 * way
        above, below = (float(j_of(scenario, (given + s).detach(), seeds)) for s in (step, -step))
        assert float((slope * way).sum()) == pytest.approx((above - below) / 2e-6, rel=2e-4, abs=1e-7)


def test_cut_stops_derivatives():
    busy = PowerTrace(np.array([0.0, 200.0]), np.array([1.0, 1.0]))
    scenario = make_scenario(
        "robust", horizon=5, trace=(busy,), workload={"window": "start"}
    )  # measured two steps late
    env = TensorEnv(scenario, like=torch.empty(0, dtype=torch.float64))
    given = torch.tensor(actions(scenario, 2), dtype=torch.float64)
    given[..., 0:8:2] = -0.9  # so slow that work is left over
    env.reset([0, 1])
    own = given[0].clone().requires_grad_()
    env.step(own)
    kept = env.step(given[1])
    assert kept.cost_j.requires_grad
    env.cut()
    for action in given[2:]:
        after = env.step(action)
        assert not any(a.requires_grad for a in (after.cost_j, after.observation, *fields_of(after.state).values()))
    (slope,) = torch.autograd.grad(kept.cost_j.sum(), own)  # what came before the cut still has its own
    assert slope.any()


# --- what is refused ------------------------------------------------------------------------------------------------


def test_stepping_before_the_beginning_or_after_the_end():
    env = TensorEnv("toy6", like=np.empty(0), horizon=1)
    assert env.over
    with pytest.raises(RuntimeError, match=r"over or have not begun; call reset\(\)"):
        env.step(np.zeros((1, 4)))
    env.reset([0])
    env.step(np.zeros((1, 4)))
    assert env.over
    with pytest.raises(RuntimeError, match=r"over or have not begun; call reset\(\)"):
        env.step(np.zeros((1, 4)))


@pytest.mark.parametrize(("seeds", "copies"), [([], 1), ([0], 0), ([0, 1], -1)])
def test_no_episodes(seeds, copies):
    with pytest.raises(ValueError, match=f"{len(seeds)} seeds and {copies} copies; give at least 1 of each"):
        TensorEnv("toy6", like=np.empty(0)).reset(seeds, copies)


@pytest.mark.parametrize("seeds", [None, 5, "01", [1.5], [True], [-1], [None], [[0, 1]], np.array([0.5])])
def test_seeds_that_are_no_whole_numbers(seeds):
    with pytest.raises(ValueError, match=r"seeds? is .*; give .*whole number"):
        TensorEnv("toy6", like=np.empty(0)).reset(seeds)


@pytest.mark.parametrize("copies", [1.5, True, None, "2"])
def test_copies_that_are_no_whole_number(copies):
    with pytest.raises(ValueError, match=r"copies is .*; give a whole number of at least 1"):
        TensorEnv("toy6", like=np.empty(0)).reset([0], copies)


@pytest.mark.parametrize("kind", KINDS)
def test_actions_of_another_kind_or_shape(kind):
    like = KINDS[kind][0]
    env = TensorEnv("toy6", like=like)
    env.reset([0, 1])
    good = as_kind(np.zeros((2, 4)), like)
    tensor = torch.zeros((2, 4), dtype=torch.float32 if like.dtype == torch.float64 else torch.float64)
    for action in (None, 0.0, [[0.0] * 4] * 2, tensor, good > 0, good + 0j, np.ma.masked_array(np.zeros((2, 4)), True)):
        with pytest.raises(ValueError, match=r"the action is .*; it must be as like is, a (tensor|NumPy array) of"):
            env.step(action)
    for action in (good[0], good[:1], good[:, :3]):
        with pytest.raises(ValueError, match=r"the action has shape \(.*\); it must be \(2, 4\)"):
            env.step(action)
    assert env.step_number == 0
    env.step(torch.nn.Parameter(good) if isinstance(good, torch.Tensor) else good)


@pytest.mark.parametrize("kind", KINDS)
def test_an_action_that_is_not_finite_is_named_and_the_episode_goes_on(kind):
    like = KINDS[kind][0]
    env = TensorEnv("toy6", like=like)
    env.reset([0, 1])
    good = np.zeros((2, 4))
    bad = good.copy()
    bad[1, 3] = np.nan
    with pytest.raises(ValueError, match="the action of environment 1 is nan at 3; give finite numbers"):
        env.step(as_kind(bad, like))
    first = env.step(as_kind(good, like))
    env.reset([0, 1])
    np.testing.assert_array_equal(first.cost_j, env.step(as_kind(good, like)).cost_j)


@pytest.mark.parametrize(
    "like", [np.empty(0, int), torch.empty(0, dtype=torch.float16), [0.0], torch.float32, "float32", np.float64(0.0)]
)
def test_arrays_of_another_kind(like):
    with pytest.raises(ValueError, match="give an array of float32 or float64"):
        TensorEnv("toy6", like=like)


@pytest.mark.slow
def test_numpy_episodes_need_no_torch():
    program = (
        "import sys, numpy as np, dcgrid_env as d\n"
        "env = d.TensorEnv('toy6', like=np.empty(0), horizon=2); assert not {'torch', 'numba'} & set(sys.modules)\n"
        "env.reset([0]); env.step(np.zeros((1, 4))); assert 'torch' not in sys.modules"
    )
    subprocess.run([sys.executable, "-W", "error", "-c", program], check=True, timeout=120)


def test_torch_runs_on_one_thread_and_its_setting_stays(monkeypatch):
    seen = {"step": [], "backward": []}
    env = TensorEnv("toy6", like=torch.empty(0))
    before = torch.get_num_threads()
    torch.set_num_threads(3)
    try:
        env.reset([0, 1])
        observe = TensorEnv._observe
        monkeypatch.setattr(TensorEnv, "_observe", lambda e: seen["step"].append(torch.get_num_threads()) or observe(e))
        action = torch.zeros((2, action_layout(env.scenario).n), requires_grad=True)
        action.register_hook(lambda grad: seen["backward"].append(torch.get_num_threads()))
        cost = torch.stack([env.step(action).cost_j.sum() for _ in range(3)]).sum()
        assert torch.get_num_threads() == 3
        cost.backward()
        assert torch.get_num_threads() == 3
        assert seen == {"step": [1, 1, 1], "backward": [1]}
        with pytest.raises(ValueError, match="action"):
            env.step(torch.zeros(1))
        assert torch.get_num_threads() == 3
        env.reset([0, 1])
        action.register_hook(lambda grad: grad[:, :1])  # of another shape: an error behind the power flow's derivative
        with pytest.raises(RuntimeError, match="changed the size"):
            env.step(action).cost_j.sum().backward()
        assert torch.get_num_threads() == 3
    finally:
        torch.set_num_threads(before)
