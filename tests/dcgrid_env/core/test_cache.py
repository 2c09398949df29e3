"""Answers live and die with what they are about."""

import gc
import pickle
import subprocess
import sys
import weakref
from pathlib import Path

import numpy as np
import pytest

from dcgrid_env import DcgridVectorEnv, Feeder, Scenario, distflow, make_scenario
from dcgrid_env.core.cache import cached_on_owner


class Owner:
    pass


def test_an_answer_is_computed_once_for_each_owner_and_argument():
    asked = []

    @cached_on_owner
    def answer(owner: Owner, by: int = 0) -> int:
        asked.append((owner, by))
        return len(asked)

    one, two = Owner(), Owner()
    assert [answer(one), answer(one), answer(one, 1), answer(two), answer(one, 1)] == [1, 1, 2, 3, 2]
    assert asked == [(one, 0), (one, 1), (two, 0)]


def test_functions_of_the_same_name_do_not_share_answers():
    def counted(value):
        @cached_on_owner
        def answer(owner: Owner) -> int:
            return value

        return answer

    owner = Owner()
    assert [counted(1)(owner), counted(2)(owner)] == [1, 2]


@pytest.mark.slow
def test_an_answer_dies_with_its_owner():
    class Answer:
        pass

    @cached_on_owner
    def answer(owner: Owner) -> Answer:
        return Answer()

    owner = Owner()
    found = weakref.ref(answer(owner))
    assert found() is not None
    del owner
    gc.collect()
    assert found() is None


def long_feeder(n_bus: int, seed: int = 0) -> Feeder:
    """A random feeder of many buses with small loads."""
    rng = np.random.default_rng(seed)
    buses = list(range(n_bus))
    parents = [int(rng.integers(max(0, i - 40), i)) for i in buses[1:]]
    z = 0.002 * rng.uniform(0.5, 1.5, (2, n_bus - 1))
    return Feeder.from_tables(
        name=f"random-{seed}",
        base_kv=12.47,
        substation=0,
        v0_pu=1.0,
        bus_ids=buses,
        p_load_kw=[0.0] + [0.5] * (n_bus - 1),
        q_load_kvar=[0.0] + [0.2] * (n_bus - 1),
        from_bus=parents,
        to_bus=buses[1:],
        r_ohm=z[0].tolist(),
        x_ohm=z[1].tolist(),
    )


def scenario_on(feeder: Feeder, **fields) -> Scenario:
    own = {"datacenters.buses": None, "n_datacenters": 3, "inverters.buses": (5, 50, 99), "inverters.s_rated_kva": 50.0}
    return make_scenario("ieee33", name="random", feeder=feeder, **{"datacenters.p_rated_kw": 50.0}, **own).replace(
        **fields
    )


def run(scenario: Scenario) -> None:
    env = DcgridVectorEnv(1, scenario)
    env.reset(seed=0)
    env.step(np.zeros((1, 9), np.float32))
    env.close()


@pytest.mark.parametrize("observe", ["local", "neighbours"])
@pytest.mark.slow
def test_a_scenario_and_its_feeder_are_freed_when_nobody_holds_them(observe):
    feeder = long_feeder(120)
    scenario = scenario_on(feeder, observe=observe, sensing={"r_model_share": 0.9})
    run(scenario)
    held = [weakref.ref(thing) for thing in (scenario, feeder, scenario.model)]
    del scenario, feeder
    gc.collect()
    assert [thing() for thing in held] == [None] * 3


@pytest.mark.slow
def test_200_scenarios_of_2000_buses_take_flat_memory():
    """A separate process has its own memory peak; each scenario would take 30 MiB and more if it were kept alive."""
    code = f"""
import dataclasses, resource, sys
sys.path.insert(0, {str(Path(__file__).parent)!r})
from test_cache import long_feeder, run, scenario_on
first, peak = long_feeder(2000), []
for k in range(200):
    run(scenario_on(dataclasses.replace(first, r_ohm=(1.0 + 0.001 * k) * first.r_ohm)))
    peak.append(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
print(peak[20], peak[-1])
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    early_kib, late_kib = map(int, done.stdout.split())
    assert late_kib - early_kib < 30 * 1024


def test_a_pickle_holds_the_fields_alone():
    scenario = scenario_on(long_feeder(120), observe="neighbours")
    fresh = len(pickle.dumps(scenario))
    run(scenario)
    load = scenario.feeder.p_load_kw[None]
    distflow(scenario.feeder, load, 0.0 * load)
    again = pickle.loads(pickle.dumps(scenario))
    assert len(pickle.dumps(scenario)) == fresh
    assert again.difference(scenario) is None
    run(again)
