"""The named scenarios: every constant of the design's table."""

import math

import numpy as np
import pytest

from dcgrid_env import PRESETS, CostWeights, FeederError, Scenario, ScenarioError, load_feeder, make_scenario
from dcgrid_env.simulation import Simulation

# name: feeder, v0, sites, rating, s, q_max, buses, inverters, kvar each, trace, window, sigma, horizon
TABLE = {
    "toy6": ("toy6", 1.0, 1, 2500.0, 1.1, 0.33, (4,), (3, 5), 1000.0, "step", "start", 0.02, 100),
    "ieee123": (
        "ieee123", 1.04375, 5, 280.0, 1.1, 0.33, None, (2, 11, 40, 54, 87, 92, 103), 50.0, "inference", "random",
        0.05, 120,
    ),
    "ieee33-weak": (
        "ieee33", 1.05, 3, 1000.0, 1.02, 0.33, (18, 33, 25), (7, 14, 20, 30), 100.0, "inference", "random", 0.05, 120,
    ),
}  # fmt: skip


def test_every_preset_is_in_the_table():
    assert set(PRESETS) == set(TABLE)
    assert all(PRESETS.values())


@pytest.mark.parametrize("name", TABLE)
def test_constants_of_a_preset(name):
    feeder, v0, n, rating, s_share, q_share, buses, inverters, kvar, trace, window, sigma, horizon = TABLE[name]
    s = make_scenario(name)
    assert s.name == name
    assert s.feeder is load_feeder(feeder)
    assert s.v0_pu == v0
    assert (s.n_datacenters, s.p_rated_kw, s.datacenter_buses) == (n, rating, buses)
    assert (s.inverter_buses, s.inverter_s_kva, s.inverter_trace) == (inverters, kvar, None)
    assert (s.trace, s.trace_window) == (trace, window)
    assert (s.load_sigma, s.load_rho, s.horizon) == (sigma, 0.9, horizon)
    assert s.capacitors is True
    assert (s.idle_share, s.f_min_mhz, s.f_max_mhz) == (0.23, 210.0, 1410.0)
    assert (s.dt_s, s.power_flow, s.split, s.band_pu) == (1.0, "distflow", "train", 0.05)
    assert (s.voltage_cost, s.reward, s.observe, s.preview) == ("l1", "shared", "local", True)
    assert (s.voltage_noise_pu, s.measurement_delay) == (0.0, 0)
    assert s.weights == CostWeights(100.0, 1000.0, 0.3, 0.02, 9.0, 0.0, 0.0, 0.0)
    # What follows from them, in kW and kvar.
    np.testing.assert_allclose(s.datacenter.p_rated_kw, [rating] * n)
    np.testing.assert_allclose(s.datacenter.p_idle_kw, [0.23 * rating] * n)
    np.testing.assert_allclose(s.datacenter.s_rated_kva, [s_share * rating] * n)
    np.testing.assert_allclose(s.datacenter.q_max_kvar, [q_share * rating] * n)
    np.testing.assert_allclose(s.inverter.s_rated_kva, [kvar] * len(inverters))


def test_ieee123_is_regulated_and_compensated():
    s = make_scenario("ieee123")
    assert s.v0_pu == 1.0 + 7 * 0.00625  # tap +7 of a regulator of 32 steps over 10 %
    assert s.feeder.capacitor_kvar.sum() > 0
    assert s.feeder.n_bus == 123
    # 1 to 5 sites by option.
    for n in range(1, 6):
        assert make_scenario("ieee123", n_datacenters=n).n_agents == n + 7


def test_ieee33_weak_loses_the_band_at_peak_and_reactive_power_alone_cannot_keep_it():
    # Voltages under full sites: no control, all the reactive power there is, and the lowest clocks with it.
    from dcgrid_env import dynamics, episode

    s = make_scenario("ieee33-weak", load_sigma=0.0)
    zero = np.zeros(1, np.uint64)
    drawn = episode.draw(s, zero, zero)
    outside, _ = episode.exogenous(s, drawn, np.zeros(1, int), np.zeros((1, 33)), np.full((1, 3), 1000.0))
    start, solution = dynamics.initial_state(s, outside)
    assert solution.converged.all()
    lowest = {
        name: float(dynamics.step(s, start, np.array([[clock, q] * 3 + [q] * 4]), outside)[0].v_pu.min())
        for name, clock, q in (("nothing", 1.0, 0.0), ("reactive", 1.0, 1.0), ("both", -1.0, 1.0))
    }
    assert lowest["nothing"] < lowest["reactive"] < 0.95 < lowest["both"]


@pytest.mark.parametrize("name", PRESETS)
@pytest.mark.parametrize("split", ["train", "validation", "test"])
def test_every_preset_and_split_plays(name, split):
    simulation = Simulation(make_scenario(name, split=split, horizon=3), 2)
    simulation.reset([0, 1])
    n = 2 * simulation.scenario.n_datacenters + simulation.scenario.n_inverters
    transition = [simulation.step(np.zeros((2, n))) for _ in range(3)][-1]
    assert transition.truncated.all()
    assert np.isfinite(transition.reward).all()


def test_overrides_reach_the_scenario_and_leave_the_preset():
    s = make_scenario("toy6", horizon=5, feeder="ieee33", datacenter_buses=(18,), inverter_buses=(7, 14), v0_pu=1.05)
    assert s.horizon == 5
    assert s.feeder is load_feeder("ieee33")
    assert make_scenario("toy6").horizon == 100
    assert make_scenario("toy6").feeder.name == "toy6"


def test_a_scenario_is_taken_as_it_is():
    s = make_scenario("toy6")
    assert make_scenario(s) is s
    assert make_scenario(s, horizon=9).horizon == 9
    assert make_scenario(s, horizon=9).name == "toy6"


@pytest.mark.parametrize("name", ["ieee321", "", "IEEE123"])
def test_an_unknown_scenario_lists_those_there_are(name):
    with pytest.raises(ScenarioError, match=rf"unknown scenario '{name}'; there are toy6, ieee123, ieee33-weak$"):
        make_scenario(name)


def test_what_is_no_scenario_is_refused():
    wrong: object = {"name": "toy6"}
    with pytest.raises(ScenarioError, match=r"scenario is \{'name': 'toy6'\}; give a name \(toy6.*or a Scenario"):
        make_scenario(wrong)  # type: ignore[arg-type]


def test_an_unknown_override_lists_those_there_are():
    with pytest.raises(ScenarioError, match=r"'ieee123' has no field 'n_data_centers'.*n_datacenters.*horizon"):
        make_scenario("ieee123", n_data_centers=3)


def test_an_unknown_feeder_lists_those_there_are():
    with pytest.raises(FeederError, match=r"'ieee34'.*toy6.*ieee33"):
        make_scenario("toy6", feeder="ieee34")


@pytest.mark.parametrize("name", PRESETS)
def test_presets_are_made_anew_but_alike(name):
    one, two = make_scenario(name), make_scenario(name)
    assert isinstance(one, Scenario)
    assert one.feeder is two.feeder
    assert one.agents == two.agents
    assert math.isfinite(one.v0_pu)
