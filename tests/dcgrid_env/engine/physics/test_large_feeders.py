"""Feeders too large for matrices over all pairs of buses: rows that are those of the matrices, and warnings."""

import dataclasses
import warnings

import numpy as np
import pytest

import dcgrid_env
from dcgrid_env import Feeder, FeederError, ThreePhaseFeeder, sensitivity
from dcgrid_env.engine.physics import connections
from dcgrid_env.envs.base import HugeObservationWarning
from dcgrid_env.powerflow import distflow, linearise, sensitivity_by
from dcgrid_env.rendering.bus_positions import positions
from dcgrid_env.scenario.on_feeder import scenario_on
from docs.studies.speed.synthetic_feeders import balanced_feeder, three_phase_feeder

LARGE = 3000


@pytest.fixture(scope="module")
def large():
    return balanced_feeder(LARGE)


def test_columns_by_some_buses_are_those_of_the_matrices(feeder_with_ratio):
    feeder, buses = feeder_with_ratio, [0, 1, 7, 30, 7]
    for rows, matrix in zip(sensitivity_by(feeder, buses), sensitivity(feeder), strict=True):
        np.testing.assert_allclose(rows, matrix[:, buses].T, rtol=1e-12, atol=1e-15)


@pytest.fixture
def feeder_with_ratio():
    feeder = dcgrid_env.load_feeder("ieee33")
    ratio = np.linspace(1.0, 1.1, feeder.n_bus)
    return dataclasses.replace(feeder, voltage_ratio=ratio)


@pytest.mark.parametrize("with_ratio", [False, True])
def test_what_agents_and_controllers_know_is_the_same_without_matrices(monkeypatch, feeder_with_ratio, with_ratio):
    feeder = feeder_with_ratio if with_ratio else dcgrid_env.load_feeder("ieee33")
    scenario = scenario_on(feeder).replace(sensing={"r_model_share": 0.9})
    buses = np.array([np.arange(1, scenario.n_agents + 1), np.arange(3, scenario.n_agents + 3)])
    names = ("sensitivity_to_agents", "sensitivity_between_agents", "between_agents")

    def known():
        return [np.asarray(getattr(connections, name)(scenario, buses)) for name in names]

    dense = known()
    to_agents, between, apart = dense
    for matrix, own in zip(sensitivity(scenario.model), to_agents, strict=True):
        np.testing.assert_allclose(own[1, 2], matrix[:, buses[1, 2]], rtol=1e-12, atol=1e-15)
    for matrix, own in zip(sensitivity(feeder), between, strict=True):
        assert own[0, 1, 4] == pytest.approx(matrix[buses[0, 1], buses[0, 4]], rel=1e-12)
    np.testing.assert_allclose(apart, np.swapaxes(apart, 1, 2), atol=1e-9)
    monkeypatch.setattr(connections, "DENSE_MOST", 10)
    for one, other in zip(dense, known(), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-9)


def test_rows_of_a_three_phase_feeder_are_those_of_its_matrices(monkeypatch):
    feeder = three_phase_feeder(200)
    chosen = scenario_on(feeder)
    scenario = chosen.replace(
        datacenters={"buses": [feeder.bus_ids[i] for i in chosen.candidates[: chosen.datacenters.count]]}
    )
    some = linearise(feeder, feeder.p_load_kw, feeder.q_load_kvar, nodes=[5, 17])
    every = linearise(feeder, feeder.p_load_kw, feeder.q_load_kvar)
    np.testing.assert_allclose(some.by_p_pu_per_mw, every.by_p_pu_per_mw[[5, 17]], rtol=1e-7, atol=1e-9)
    dense = connections.own_distance(scenario)
    monkeypatch.setattr(connections, "DENSE_MOST", 10)
    rows = connections.own_distance(scenario.replace(name="again"))
    buses = [bus for device in scenario.devices for bus in (device.buses or ())[: device.count]]
    may_stand = [scenario.feeder.index(bus) for bus in buses]
    at = np.arange(scenario.n_agents), may_stand
    np.testing.assert_allclose(rows[at], dense[at], rtol=1e-7)
    assert (rows[at] > 0.0).all()


def test_an_environment_on_a_large_feeder_makes_no_matrix(large):
    scenario = scenario_on(large).replace(horizon=3, observe="neighbours")
    env = dcgrid_env.parallel_env(scenario)
    env.reset(seed=0)
    for _ in range(3):
        observations, *_ = env.step({a: env.action_space(a).sample() for a in env.agents})
        assert all(np.isfinite(values).all() for values in observations.values())
    assert "path" not in vars(large)
    largest = max(a.nbytes for a in _arrays(vars(scenario)) + _arrays(vars(large)))
    assert largest < 200 * 8 * LARGE


def _arrays(values):
    found = []
    for value in values.values() if isinstance(values, dict) else values:
        if isinstance(value, np.ndarray):
            found.append(value)
        elif isinstance(value, dict | tuple | list):
            found += _arrays(value)
    return found


def test_an_observation_of_every_voltage_warns_where_there_are_very_many(large):
    scenario = scenario_on(large).replace(horizon=3)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        env = dcgrid_env.parallel_env(scenario)
        env.reset(seed=0)
        dcgrid_env.parallel_env("toy6", observe="feeder").reset(seed=0)
    with pytest.warns(HugeObservationWarning, match=r"state\(\) holds the voltages of 2,999 nodes; take what you"):
        env.state()
    with pytest.warns(HugeObservationWarning, match="observe is 'feeder'.* 2,999 nodes; 'local' or 'neighbours' does"):
        dcgrid_env.parallel_env(scenario.replace(observe="feeder"))


@pytest.mark.slow
def test_a_chain_of_many_buses_is_read_solved_and_drawn(tmp_path):
    chain = balanced_feeder(5_000, chain=True)
    solution = distflow(chain, chain.p_load_kw, chain.q_load_kvar)
    assert solution.converged
    assert solution.v_pu.argmin() == 4_999
    chain.to_csv(tmp_path)
    assert Feeder.from_csv(tmp_path).parent.tobytes() == chain.parent.tobytes()
    xy = positions(chain)
    assert len(np.unique(xy, axis=0)) == chain.n_bus
    known = xy.copy()
    known[1000:2400] = np.nan
    drawn = positions(dataclasses.replace(chain, x=known[:, 0], y=known[:, 1]))
    assert np.isfinite(drawn).all()
    assert len(np.unique(drawn, axis=0)) == chain.n_bus


def test_a_message_lists_no_thousands_of_buses(large):
    tables = {"name": "large", "base_kv": 1.0, "substation": 0, "v0_pu": 1.0}
    n = LARGE
    columns = {"p_load_kw": [0.0] * n, "q_load_kvar": [0.0] * n, "r_ohm": [1.0] * (n - 1), "x_ohm": [1.0] * (n - 1)}
    line = {"from_bus": range(n - 1), "to_bus": range(1, n)}
    cases = (
        (line | {"bus_ids": [7] * n}, "duplicate bus 7"),
        (line | {"bus_ids": range(n), "substation": "here"}, r"not among its buses \['0', .*\(3,000 in all\)"),
        (
            {"bus_ids": range(n), "from_bus": range(1, n), "to_bus": [*range(2, n), 1]},
            r"more than one root: .*\(2,999 in all\)",
        ),
    )
    for given, said in cases:
        with pytest.raises(FeederError, match=said) as raised:
            Feeder.from_tables(**{**tables, **columns, **given})  # pyright: ignore[reportArgumentType]
        assert len(str(raised.value)) < 2000
    with pytest.raises(FeederError, match=r"has no bus 'x'; its buses are \['0', .*\(3,000 in all\)"):
        large.index("x")


@pytest.mark.slow
def test_a_three_phase_feeder_of_8500_nodes_runs():
    feeder = three_phase_feeder(8500)
    assert isinstance(feeder, ThreePhaseFeeder)
    chosen = scenario_on(feeder)
    sites = [feeder.bus_ids[i] for i in chosen.candidates[: chosen.datacenters.count]]
    env = dcgrid_env.parallel_env(chosen.replace(datacenters={"buses": sites}, horizon=2))
    env.reset(seed=0)
    _, rewards, *_ = env.step({a: env.action_space(a).sample() for a in env.agents})
    assert all(np.isfinite(list(rewards.values())))
