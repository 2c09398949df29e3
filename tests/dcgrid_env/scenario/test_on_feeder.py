"""What is chosen for a feeder that has no scenario."""

import dataclasses

import numpy as np
import pytest

from dcgrid_env import FEEDERS, ScenarioError, ThreePhaseFeeder, load_feeder, parallel_env
from dcgrid_env.scenario.on_feeder import base_load_kw, scenario_on
from dcgrid_env.scenario.placement import free_load_buses


@pytest.mark.parametrize("name", FEEDERS)
def test_every_feeder_that_ships_can_be_stepped_with_what_is_chosen(name):
    feeder = load_feeder(name)
    made = scenario_on(feeder)
    env = parallel_env(made)
    env.reset(seed=0)
    _, rewards, *_ = env.step({agent: env.action_space(agent).sample() * 0.0 for agent in env.agents})
    assert np.isfinite(list(rewards.values())).all()
    assert made.source_voltage_pu == feeder.v0_pu
    assert made.power_flow == ("sweep" if isinstance(feeder, ThreePhaseFeeder) else "distflow")


@pytest.mark.parametrize("name", FEEDERS)
def test_sizes_follow_the_load_and_sites_find_a_bus(name):
    feeder = load_feeder(name)
    made = scenario_on(feeder)
    load_kw = base_load_kw(feeder)
    assert made.datacenters.parameters.p_rated_kw.sum() == pytest.approx(0.4 * load_kw, rel=0.05)
    assert made.inverters.parameters.s_rated_kva.sum() == pytest.approx(0.1 * load_kw, rel=0.05)
    assert 1 <= made.datacenters.count <= min(5, len(made.candidates))
    assert 1 <= made.inverters.count <= 7
    if isinstance(feeder, ThreePhaseFeeder):
        assert {feeder.bus_phases[i] for i in made.candidates} == {"abc"}


def test_the_paper_s_feeder_gets_the_paper_s_sizes():
    made = scenario_on(load_feeder("ieee123"))
    assert (made.datacenters.count, made.datacenters.parameters.p_rated_kw[0]) == (5, 280.0)
    assert (made.inverters.count, made.inverters.parameters.s_rated_kva[0]) == (7, 50.0)


def test_a_feeder_without_a_load_says_what_to_do():
    feeder = load_feeder("toy6")
    bare = dataclasses.replace(feeder, p_load_kw=np.zeros(feeder.n_bus))
    with pytest.raises(ScenarioError, match="feeder 'toy6' has no load bus where a data centre could be drawn; name"):
        scenario_on(bare)


def test_sites_may_stand_at_any_three_phase_bus_if_all_loads_are_on_one_phase():
    network = load_feeder("ieee13-3ph").network
    table = network.phase_load
    single = [i for i, bus in enumerate(table.bus) if bus in ("652", "611", "645")]
    assert len(single) == 3
    given = {f.name: getattr(table, f.name) for f in dataclasses.fields(table)}
    columns = {name: tuple(values[i] for i in single) for name, values in given.items() if values}
    loads = dataclasses.replace(table, **columns)
    feeder = ThreePhaseFeeder.from_network(dataclasses.replace(network, phase_load=loads))
    drawn = {feeder.bus_phases[bus] for bus in free_load_buses(feeder, (scenario_on(feeder).datacenters,))}
    assert drawn == {"abc"}


def test_inverters_leave_buses_to_the_sites_and_spread():
    feeder = load_feeder("ieee33")
    made = scenario_on(feeder)
    at = [feeder.index(bus) for bus in made.inverters.buses]
    assert at == sorted(set(at))
    assert max(np.diff(at)) <= feeder.n_bus / 4


def test_named_buses_ends_and_spread_ones_are_each_device_s_own():
    feeder = load_feeder("ieee33")
    made = scenario_on(feeder, "2 x 500 kW at ends + 1 MW at 25", "2 x 300 kvar at ends + 3 x 100 kVA")
    assert made.datacenters.buses == ("18", "33", "25")
    assert made.datacenters.p_rated_kw == (500.0, 500.0, 1000.0)
    assert made.inverters.s_rated_kva == (300.0, 300.0, 100.0, 100.0, 100.0)
    assert len({*(made.datacenters.buses or ()), *made.inverters.buses}) == 8
    assert made.inverters.buses[:2] == ("17", "32")  # before which the data centres stand
    assert scenario_on(feeder, "none", "1 Mvar at 18").n_agents == 1
    assert scenario_on(feeder, "3 x 1 MW", "none").agents == ("dc_0", "dc_1", "dc_2")


def test_data_centres_at_the_ends_of_a_three_phase_feeder_have_three_phases():
    feeder = load_feeder("ieee34-3ph")
    made = scenario_on(feeder, "4 x 100 kW at ends", "4 x 50 kvar at ends")
    assert {feeder.bus_phases[feeder.index(bus)] for bus in made.datacenters.buses or ()} == {"abc"}
    assert {len(feeder.bus_phases[feeder.index(bus)]) for bus in made.inverters.buses} == {1, 3}


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("1 MW at 181", None), "datacenters: feeder 'ieee33' has no bus '181'; it has 18, 11 and 31 more"),
        ((None, "1 kvar at x"), "inverters: feeder 'ieee33' has no bus 'x'; it has 2, 3, 4 and 30 more"),
        (("1 MW at 1", None), "datacenters: bus '1' is the substation, where the source is; name another"),
        (("1 MW at 18", "1 kvar at 18"), "inverters: bus '18' is named twice; give each device a bus of its own"),
        (
            ("9 x 1 MW at ends", None),
            "9 are to stand at ends, but feeder 'ieee33' has 4 ends without a device; ask",
        ),
        ((None, "30 x 1 kvar"), "30 are to stand spread, but feeder 'ieee33' has 27 load buses left for them; ask"),
        (("40 x 1 MW", None), "datacenters.count is 40; only 32 load buses have no device"),
        (("none", "none"), "devices are none, hence there is no agent"),
    ],
)
def test_what_a_feeder_has_no_room_for_is_refused(words, message):
    with pytest.raises(ScenarioError) as refused:
        scenario_on(load_feeder("ieee33"), *words)
    assert message in str(refused.value)
