"""Faults: lost equipment draws and injects no power at the drawn times, and work continues."""

import math

import numpy as np
import pytest

from dcgrid_env import DcgridVectorEnv, Fault, Recorder, ScenarioError, field_names, forecast, make_scenario
from dcgrid_env.engine.exogenous import episode
from dcgrid_env.engine.simulation import Simulation


def played(scenario, n_env, seed=0):
    """A batch driven at random clocks and reactive setpoints; the recorder of its episodes."""
    rng = np.random.default_rng(seed)
    env = DcgridVectorEnv(n_env, scenario)
    env.reset(seed=0)
    recorder = Recorder(scenario, env.transition)
    while not recorder.over:
        env.step(rng.uniform(-1, 1, env.action_space.shape).astype(np.float32))
        recorder.add(env.transition)
    return recorder


def test_a_lost_inverter_is_gone_for_good():
    scenario = make_scenario(
        "ieee33", inverters={"injection": "pv"}, faults=(Fault(("inv_2",), (10.0, 20.0)),), horizon=40
    )
    at = scenario.agents.index("inv_2")
    recorder = played(scenario, 8)
    begins = set()
    for env_index in range(8):
        p, q = recorder.series(env_index).p_kw[:, at], recorder.series(env_index).q_kvar[:, at]
        first = int(np.flatnonzero(p == 0.0)[0])
        assert 10 <= first <= 20
        assert (p[:first] < 0.0).all()
        assert not p[first:].any()
        assert not q[first:].any()
        begins.add(first)
    assert len(begins) > 2


def test_a_tripped_data_centre_goes_on_with_its_work_and_returns():
    fault = Fault(("datacenter",), (5.0, 10.0), (10.0, 15.0))
    scenario = make_scenario("ieee33-weak", faults=(fault,), horizon=40)
    recorder, calm = played(scenario, 6), played(scenario.replace(faults=()), 6)
    struck = set()
    for env_index in range(6):
        with_fault, without = recorder.series(env_index), calm.series(env_index)
        away = with_fault.p_kw[:, :3] == 0.0
        assert (away.any(axis=0)).sum() == 1
        site = int(np.argmax(away.any(axis=0)))
        steps = np.flatnonzero(away[:, site])
        assert 10 <= len(steps) <= 15
        assert 5 <= steps[0] <= 10
        assert (np.diff(steps) == 1).all()
        # The work is the same as without the fault, and so is the draw at all other times.
        np.testing.assert_allclose(with_fault.served_kw, without.served_kw)
        np.testing.assert_allclose(with_fault.backlog_kws, without.backlog_kws)
        np.testing.assert_allclose(with_fault.p_kw[:, :3][~away], without.p_kw[:, :3][~away])
        # Relieved of it, the feeder stands higher at the site's bus.
        bus = scenario.feeder.index((18, 33, 25)[site])
        relieved = with_fault.v_pu[1 + steps, bus] - without.v_pu[1 + steps, bus]
        assert relieved.max() > 0.01
        struck.add(site)
    assert len(struck) > 1


def test_a_lost_capacitor_injects_nothing():
    scenario = make_scenario("ieee123", faults=(Fault(("capacitor",), (3.0, 3.0)),), horizon=8)
    kvar = scenario.feeder.capacitor_kvar
    lost_kvar = set()
    for seed in range(12):
        known, calm = forecast(scenario, seed), forecast(scenario.replace(faults=()), seed)
        more = known.q_load_kvar - calm.q_load_kvar
        assert not more[:3].any()
        bus = int(np.argmax(more[3]))
        np.testing.assert_allclose(more[3:, bus], kvar[bus])
        assert np.count_nonzero(more[3:]) == 5
        assert (known.available == 1.0).all()
        lost_kvar.add(float(kvar[bus]))
    assert len(lost_kvar) > 1


def test_what_is_lost_has_no_reactive_limit_and_is_seen_to_have_none():
    faults = (Fault(("inv_2",), (4.0, 4.0), (3.0, 3.0)), Fault(("dc_1",), (6.0, 6.0), (2.0, 2.0)))
    scenario = make_scenario("ieee33-weak", faults=faults, horizon=12)
    at = {agent: scenario.agents.index(agent) for agent in ("inv_2", "dc_1")}
    names = [(agent, name) for agent, own in field_names(scenario).items() for name in own]
    simulation = Simulation(scenario, 2)
    simulation.reset([0, 1])
    for step in range(1, 13):
        found = simulation.step(np.full((2, 10), 0.3))
        for agent, gone in (("inv_2", 5 <= step < 8), ("dc_1", 7 <= step < 9)):
            limit_kvar = found.state.q_limit_kvar[:, at[agent]]
            assert ((limit_kvar == 0.0) == gone).all()
            seen = found.observation[:, names.index((agent, "q_limit"))]
            np.testing.assert_allclose(seen, limit_kvar / scenario.q_scale_kvar[at[agent]], rtol=1e-6)


def test_kinds_and_ids_are_drawn_from_together():
    scenario = make_scenario("ieee123", faults=(Fault(("inv_0", "capacitor"), (0.0, 0.0)),))
    seeds = np.arange(200, dtype=np.uint64)
    struck = np.unique(episode.draw(scenario, seeds, 0 * seeds).fault[:, 0, 0])
    n_capacitors = np.count_nonzero(scenario.feeder.capacitor_kvar)
    assert len(struck) == 1 + n_capacitors
    assert struck[0] == scenario.agents.index("inv_0")


def test_times_are_in_seconds_whatever_the_step():
    fault = Fault(("inverter",), (2.0, 2.0), (3.0, 3.0))
    for dt_s, expected in ((1.0, [1, 3, 6]), (0.5, [1, 5, 11]), (2.0, [1, 2, 4])):
        scenario = make_scenario("ieee33", faults=(fault,), dt_s=dt_s)
        begin, end = episode.draw(scenario, np.zeros(1, np.uint64), np.zeros(1, np.uint64)).fault[0, 0, 1:]
        assert [1, begin, end] == expected


def test_ranges_longer_than_the_episode_are_drawn_before_they_are_cut():
    """Of beginnings even in 10 to 1000 s, one in 25 falls into 50 s; so do the ends of faults as long."""
    seeds = np.arange(4000, dtype=np.uint64)
    scenario = make_scenario("ieee33", horizon=50, faults=(Fault(("inverter",), (10.0, 1000.0)),))
    begins = episode.draw(scenario, seeds, 0 * seeds).fault[:, 0, 1]
    assert 0.03 < np.mean(begins <= 50) < 0.055
    scenario = make_scenario("ieee33", horizon=50, faults=(Fault(("inverter",), (0.0, 0.0), (10.0, 1000.0)),))
    ends = episode.draw(scenario, seeds, 0 * seeds).fault[:, 0, 2]
    assert 0.03 < np.mean(ends <= 50) < 0.055


def test_target_beginning_and_length_are_drawn_independently():
    seeds = np.arange(4000, dtype=np.uint64)
    scenario = make_scenario("ieee33", faults=(Fault(("inverter",), (0.0, 5.0), (0.0, 5.0)),))
    target, begin, end = episode.draw(scenario, seeds, 0 * seeds).fault[:, 0].T
    for one, other in ((target, begin), (target, end - begin), (begin, end - begin)):
        pairs = np.unique(np.stack((one, other)), axis=1, return_counts=True)[1]
        assert len(pairs) == 36  # six inverters, six beginnings, six lengths
        assert np.abs(pairs - 4000 / 36).max() < 5 * np.sqrt(4000 / 36)


def test_a_fault_survives_saving_a_masked_reset_and_the_clock_law():
    scenario = make_scenario("fault", horizon=30)
    simulation = Simulation(scenario, 3)
    simulation.reset([0, 1, 2])
    actions = np.random.default_rng(0).uniform(-1, 1, (30, 3, 17))
    for action in actions[:10]:
        simulation.step(action)
    saved = simulation.now
    rest = [simulation.step(action).state for action in actions[10:]]
    simulation.restore(saved)
    for action, state in zip(actions[10:], rest, strict=True):
        np.testing.assert_array_equal(simulation.step(action).state.v_pu, state.v_pu)
    kept = simulation.now.episode.fault[[0, 2]].tolist()
    simulation.reset([None, 7, None], mask=np.array([False, True, False]))
    assert simulation.now.episode.fault[[0, 2]].tolist() == kept
    alone = episode.draw(scenario, np.array([7], np.uint64), np.zeros(1, np.uint64))
    assert simulation.now.episode.fault[1].tolist() == alone.fault[0].tolist()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"among": "inverter", "begin_s": (1.0, 2.0)}, "give a tuple of datacenter, inverter, .*capacitor"),
        ({"among": (), "begin_s": (1.0, 2.0)}, "among is "),
        ({"among": ("inverter",), "begin_s": (3.0, 2.0)}, r"begin_s is \(3.0, 2.0\)"),
        ({"among": ("inverter",), "begin_s": (1.0, math.inf)}, "begin_s is"),
        ({"among": ("inverter",), "begin_s": (math.nan, 2.0)}, "begin_s is"),
        ({"among": ("inverter",), "begin_s": (1.0, 2.0), "duration_s": (5.0, math.inf)}, "two finite times"),
    ],
)
def test_faults_that_cannot_be(arguments, message):
    with pytest.raises(ValueError, match=message):
        Fault(**arguments)


@pytest.mark.parametrize(
    ("faults", "message"),
    [
        (
            (Fault(("transformer",), (1.0, 2.0)),),
            "among is 'transformer'; choose datacenter, inverter, capacitor or",
        ),
        ((Fault(("capacitor",), (1.0, 2.0)),), r"among is \('capacitor',\); there is none of these"),
        (("inverter",), "give a list of Fault"),
    ],
)
def test_scenarios_that_cannot_have_them(faults, message):
    with pytest.raises(ScenarioError, match=message):
        make_scenario("ieee33", faults=faults)
