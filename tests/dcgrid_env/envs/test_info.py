"""Contents of ``info``: NumPy scalars of constant type, the benchmark's J, and the requested amount of detail."""

import dataclasses
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode, SyncVectorEnv

import dcgrid_env
from dcgrid_env import DcgridEnv, DcgridVectorEnv, Recorder, load_feeder, make_scenario, parallel_env
from dcgrid_env.traces import PowerTrace

COSTS = {"cost", "J"} | {
    f"cost_{name}" for name in ("voltage", "violation", "backlog", "effort", "clock", "step", "loss", "leftover")
}
STEP = PowerTrace(np.array([0.0, 10.0, 200.0]), np.array([0.2, 1.0, 1.0]))
OF_STEPS = {
    "cost", "J", "reward_vector", "tap_moves", "capacitor_switchings", "ups_trips", "ups_lost_kw", "inverter_trips",
}  # fmt: skip
"""Keys of what was charged or happened in a step, in addition to the cost terms."""
OVERLOADED = {"datacenters.p_rated_kw": 6000.0, "horizon": 40, "trace": (STEP,), "workload.window": "start"}
"""The power flow has no solution from step 10 on."""


def cost_terms(info):
    return {name for name in info if name.startswith("cost_")}


def played(env, actions):
    """All infos of an episode; actions may be more than its steps."""
    infos = [env.reset(seed=3)[1]]
    for action in actions:
        *_, terminated, truncated, info = env.step(action)
        infos.append(info)
        if terminated or truncated:
            return infos
    raise AssertionError("the episode did not end")


@pytest.mark.parametrize("extra", [{"horizon": 25}, OVERLOADED], ids=["horizon", "collapse"])
@pytest.mark.parametrize("scenario", ["ieee33-weak", "ieee123"])
def test_the_last_j_is_the_benchmarks_own(scenario, extra):
    if scenario == "ieee123" and extra is OVERLOADED:
        extra = OVERLOADED | {"datacenters.p_rated_kw": 30000.0}
    s = make_scenario(scenario, **extra)
    env, batch = DcgridEnv(s), DcgridVectorEnv(2, s)
    actions = np.random.default_rng(0).uniform(-1.0, 1.0, (s.horizon, *(env.action_space.shape or ())))
    actions[:, : 2 * s.datacenters.count : 2] = np.abs(actions[:, : 2 * s.datacenters.count : 2])
    infos = played(env, actions)
    batch.reset(seed=[3, 3])
    recorder, of_batch = Recorder(s, batch.transition), {}
    for t, action in enumerate(actions[: len(infos) - 1], 1):
        *_, of_batch = batch.step(np.stack((action, action)))
        recorder.add(batch.transition)
        found = of_batch.get("final_info", of_batch)
        assert found["J"].tolist() == [infos[t]["J"]] * 2
        paid = [sum(info[name] for name in COSTS - {"cost", "J"}) for info in infos[1 : t + 1]]
        assert infos[t]["J"] == pytest.approx(sum(paid) / s.horizon, rel=1e-12, abs=1e-12)
    assert (len(infos) - 1 < s.horizon) == (s.horizon == 40)
    assert recorder.over
    assert infos[-1]["J"] == pytest.approx(recorder.metrics()[0]["J"], abs=1e-12, rel=1e-12)
    assert not (COSTS & infos[0].keys())
    assert not of_batch["_J"].any()  # the episodes that begin have no step yet


def test_j_begins_at_nothing_and_is_saved():
    env = DcgridEnv("toy6")
    env.reset(seed=0)
    assert env.transition.j_so_far.tolist() == [0.0]
    for _ in range(5):
        env.step(np.zeros(4))
    saved, wanted = env.save(), env.step(np.ones(4))[-1]["J"]
    env.reset()
    env.step(np.zeros(4))
    env.restore(saved)
    assert env.step(np.ones(4))[-1]["J"] == wanted > 0.0
    batch = DcgridVectorEnv(2, "toy6")
    batch.reset(seed=0)
    *_, before = batch.step(np.zeros((2, 4)))
    _, after = batch.reset(options={"reset_mask": np.array([True, False])})
    assert batch.transition.j_so_far.tolist() == [0.0, before["J"][1]]
    assert "J" not in after


@pytest.mark.parametrize("scenario", dcgrid_env.PRESETS)
def test_figures_are_numpy_scalars_of_constant_type(scenario):
    env, many = DcgridEnv(scenario, horizon=3), parallel_env(scenario, horizon=3)
    actions = [env.action_space.sample() for _ in range(3)]
    infos = played(env, actions)
    parts = [{agent: many.action_space(agent).sample() for agent in many.possible_agents} for _ in range(3)]
    each = [many.reset(seed=0)[1], *(many.step(part)[-1] for part in parts)]
    for course in (infos, *([info[agent] for info in each] for agent in many.possible_agents)):
        for name, value in course[1].items():
            assert isinstance(value, np.generic), name
            wanted = np.float64
            if name.startswith("bus"):  # numbers where every bus has one
                wanted = np.int64 if all(bus.isdigit() for bus in env.scenario.feeder.bus_ids) else np.str_
            assert all(type(info[name]) is wanted and np.shape(info[name]) == () for info in course[1:]), name
        assert len({tuple(info) for info in course[1:]}) == 1
        of_steps = OF_STEPS | cost_terms(course[1])
        assert tuple(course[0]) == tuple(name for name in course[1] if name not in of_steps)
        assert all(type(value) is type(course[1][name]) for name, value in course[0].items())


def test_names_of_buses_that_are_no_numbers():
    toy = load_feeder("toy6")
    names = {bus: f"bus {bus}" for bus in toy.bus_ids}
    feeder = dataclasses.replace(toy, bus_ids=tuple(names.values()))
    s = make_scenario("toy6")
    s = s.replace(
        feeder=feeder,
        datacenters={"buses": tuple(names[str(b)] for b in s.datacenters.buses or ())},
        inverters={"buses": tuple(names[str(b)] for b in s.inverters.buses)},
    )
    _, info = DcgridEnv(s).reset(seed=0)
    assert (info["bus_dc_0"], type(info["bus_dc_0"])) == ("bus 4", np.str_)


def test_a_loop_of_gymnasiums_makes_arrays_of_them():
    one = SyncVectorEnv([lambda: DcgridEnv("toy6", horizon=2)] * 2, autoreset_mode=AutoresetMode.SAME_STEP)
    for found in (one.reset(seed=0)[1], *(one.step(np.zeros((2, 4), np.float32))[-1] for _ in range(3))):
        assert {value.dtype.kind for name, value in found.items() if name not in ("final_obs", "final_info")} <= {
            "f", "i", "b"
        }  # fmt: skip


@pytest.mark.parametrize(("level", "keys"), [("none", set()), ("costs", COSTS)])
def test_less_where_less_is_asked_for(level, keys):
    full, slim = (gymnasium.make("dcgrid/Toy6-v0", horizon=2, info=each) for each in ("full", level))
    batch = gymnasium.make_vec("dcgrid/Toy6-v0", num_envs=2, horizon=2, info=level)
    many, turns = parallel_env("toy6", info=level, max_cycles=2), dcgrid_env.env("toy6", info=level, max_cycles=2)
    actions = np.random.default_rng(0).uniform(-1.0, 1.0, (2, 4)).astype(np.float32)
    for wanted, found in zip(played(full, actions), played(slim, actions), strict=True):
        assert found == {name: wanted[name] for name in wanted if name in keys}
        assert found.keys() in (keys, set())
    infos = [many.reset(seed=0)[1], many.step({a: many.action_space(a).sample() for a in many.agents})[-1]]
    assert all(set(info) == (keys if step else set()) for step, each in enumerate(infos) for info in each.values())
    infos[1]["dc_0"]["mine"] = 1  # each agent has a dict of its own
    assert "mine" not in infos[1]["inv_0"]
    turns.reset(seed=0)
    assert turns.last()[-1] == {}
    masked = keys | {f"_{key}" for key in keys}
    assert batch.reset(seed=0)[1] == {}
    assert set(batch.step(np.stack((actions[0], actions[0])))[-1]) == masked
    *_, infos = batch.step(np.stack((actions[1], actions[1])))
    assert set(infos) == masked | {"final_obs", "_final_obs", "final_info", "_final_info"}
    assert set(infos["final_info"]) == masked
    assert infos["final_obs"][1].shape == batch.single_observation_space.shape


def test_a_level_that_is_none_is_refused():
    makers: tuple[Any, ...] = (DcgridEnv, parallel_env, lambda *args, **kwargs: DcgridVectorEnv(1, *args, **kwargs))
    for make in makers:
        with pytest.raises(ValueError, match="info is 'much'; choose one of none, costs, full"):
            make("toy6", info="much")
