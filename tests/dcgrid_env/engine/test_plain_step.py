"""The compiled step gives the bits of the parts, one after the other, on all scenarios that it accepts."""

from typing import Any

import numpy as np
import pytest

from dcgrid_env import make_scenario
from dcgrid_env.devices import DataCenters, Inverters
from dcgrid_env.engine import plain_step
from dcgrid_env.engine.physics.actions import action_layout
from dcgrid_env.engine.simulation import Simulation

PLAIN = (
    "toy6", "ieee123", "ieee33-weak", "ieee33", "das69", "khodr141", "bursty", "sync", "training", "mixed",
    "wrong-model", "scale-32",
)  # fmt: skip


def assert_same_bits(one: Any, other: Any, path: str = "") -> None:
    """Equal kinds, shapes and bytes all the way down."""
    assert type(one) is type(other), path
    if isinstance(one, np.ndarray):
        assert (one.dtype, one.shape, one.tobytes()) == (other.dtype, other.shape, other.tobytes()), path
    elif isinstance(one, tuple):
        for i, (a, b) in enumerate(zip(one, other, strict=True)):
            assert_same_bits(a, b, f"{path}.{getattr(one, '_fields', range(len(one)))[i]}")


def assert_steps_alike(scenario: Any, n_env: int, steps: int) -> None:
    """The compiled step and the parts, on the same episodes and actions beyond the bounds too."""
    compiled, apart = Simulation(scenario, n_env), Simulation(scenario, n_env)
    apart._is_plain = False
    rng = np.random.default_rng(0)
    for simulation in (compiled, apart):
        simulation.reset(list(range(n_env)))
    for _ in range(steps):
        action = rng.uniform(-1.2, 1.2, (n_env, action_layout(scenario).n))
        for simulation in (compiled, apart):
            simulation.step(action)
        assert_same_bits(compiled.now[1:], apart.now[1:])


@pytest.mark.parametrize("name", PLAIN)
def test_bits_of_the_parts(name):
    scenario = make_scenario(name, horizon=3)
    assert plain_step.fits(scenario, 1)
    assert_steps_alike(scenario, 1, 3)


@pytest.mark.parametrize(
    "overrides",
    [
        {"reward": "difference"},
        {"cost": {"weights": {"clock": 3.0, "effort": 0.5, "backlog": 0.0, "leftover": 2.0}}},
        {"devices": (DataCenters(count=9, p_rated_kw=60.0, s_rated_share=1.2, q_max_share=0.5, f_min_mhz=900.0),)},
        {"devices": (
            DataCenters(count=1, p_rated_kw=600.0, s_rated_share=1.2, q_max_share=0.5, boost_share=1.2),
            Inverters(buses=(18, 33), s_rated_kva=(400.0, 300.0), injection="pv"),
        )},
        {"sensing": {"preview": False}, "source_voltage_pu": 1.04, "cost": {"band_pu": 0.02}},
    ],
    ids=["difference", "weights", "no inverters", "boost and sun", "band"],
)  # fmt: skip
def test_bits_of_the_parts_with_other_settings(overrides):
    scenario = make_scenario("ieee33-weak", horizon=3, **overrides)
    assert plain_step.fits(scenario, 4)
    assert_steps_alike(scenario, 4, 3)


@pytest.mark.parametrize(
    "overrides",
    [
        {"sensing": {"noise_pu": 0.001}},
        {"sensing": {"delay_steps": 1}},
        {"observe": "neighbours"},
        {"reward": "local"},
        {"cost": {"voltage": "l2"}},
        {"cost": {"weights": {"loss": 1.0}}},
        {"power_flow": "lindistflow"},
        {"scenario": "fault"},
        {"scenario": "ieee13-3ph"},
        {"scenario": "smoothing"},
    ],
)
def test_what_is_not_plain_takes_the_other_way(overrides):
    assert not plain_step.fits(make_scenario(**({"scenario": "ieee33-weak"} | overrides)), 1)


def test_many_environments_take_the_other_way():
    scenario = make_scenario("ieee33-weak")
    assert plain_step.fits(scenario, plain_step.FEW)
    assert not plain_step.fits(scenario, plain_step.FEW + 1)


def test_environments_of_which_one_has_no_solution():
    """All take the other way in that step, with the same results for those that go on."""
    scenario = make_scenario("ieee33-weak", horizon=8)
    one, three = Simulation(scenario, 1), Simulation(scenario, 3)
    one.reset([0])
    three.reset([0, 1, 2])
    heavy = three.now.noise.copy()
    heavy[1] = 500.0
    three.go_on(three.now._replace(noise=heavy))
    action = np.ones((3, action_layout(scenario).n))
    alone, together = one.step(action[:1]), three.step(action)
    assert together.converged.tolist() == [True, False, True]
    assert together.observation[0].tobytes() == alone.observation[0].tobytes()
    assert together.cost_j[0] == alone.cost_j[0]
    assert together.cost_j[1] > 100.0
    versions = len(plain_step._step_rows.signatures)
    three.reset([None] * 3, mask=together.terminated)
    three.step(action)
    one.step(action[:1])
    assert three.transition.observation[0].tobytes() == one.transition.observation[0].tobytes()
    assert len(plain_step._step_rows.signatures) == versions
