"""Figures of episodes that come in parts against those of whole ones."""

import numpy as np
import pytest

from dcgrid_env import (
    WHOLE_COURSE_BYTES,
    Recorder,
    Storages,
    StreamingRecorder,
    action_layout,
    course_bytes,
    make_scenario,
)
from dcgrid_env.devices.datacenter.lateness import lateness
from dcgrid_env.devices.datacenter.streaming_lateness import StreamingLateness
from dcgrid_env.engine.cost import flicker
from dcgrid_env.engine.simulation import Simulation
from dcgrid_env.traces import PowerTrace
from helpers.riding import ride_through_34
from helpers.storages import toy6_storage

SHORT = {"horizon": 50, "split": "test"}


def both(scenario, n_env=2, part_steps=17, sinks=()):
    """A recorder of whole courses and one of parts on the same episodes under random actions."""
    simulation = Simulation(scenario, n_env)
    begun = simulation.reset(range(3, 3 + n_env))
    whole, parts = Recorder(scenario, begun), StreamingRecorder(scenario, begun, sinks, part_steps)
    rng, n = np.random.default_rng(0), len(action_layout(scenario).names)
    while not whole.over:
        transition = simulation.step(rng.uniform(-1.0, 1.0, (n_env, n)))
        whole.add(transition)
        parts.add(transition)
    return whole, parts


def check_alike(whole, parts, rel=1e-9):
    np.testing.assert_allclose(parts.costs(), whole.costs(), rtol=1e-12)
    for one, other in zip(whole.metrics(), parts.metrics(), strict=True):
        assert other == pytest.approx(one, rel=rel, abs=1e-9)


@pytest.mark.parametrize(
    "name", ["toy6", "ieee33-weak", "training", "fault", "ieee13-3ph", "ieee33-weak-ups", "bursty", "mixed"]
)
def test_figures_are_those_of_whole_episodes(name):
    check_alike(*both(make_scenario(name, **SHORT)))


def test_lateness_is_that_of_whole_episodes_but_for_rounding():
    check_alike(*both(make_scenario("routing", **SHORT)), rel=1e-6)


@pytest.mark.parametrize("by_deadline", [True, False])
def test_lateness_does_not_depend_on_the_parts(by_deadline):
    rng, slack = np.random.default_rng(0), (1, 6)
    arrived = rng.uniform(0.0, 100.0, (120, 3)) * (rng.random((120, 3)) < 0.7)
    moved, served = arrived * rng.uniform(0.0, 1.0, (120, 3)), rng.uniform(0.0, 72.0, (120, 3))
    whole = lateness(arrived, moved, served, slack, 0.4, by_deadline, 2.0)
    assert 5.0 < whole["deferrable_in_time_pct"] < 95.0
    for part_steps in (1, 7, 120):
        parts = StreamingLateness(slack, 0.4, by_deadline, 2.0)
        for at in range(0, 120, part_steps):
            parts.add(*(work[at : at + part_steps] for work in (arrived, moved, served)))
        assert parts.figures() == pytest.approx(whole, rel=2e-6)  # a rounding is added in each step


def test_inverters_and_sites_that_leave_and_equipment_that_acts():
    check_alike(*both(ride_through_34(horizon=50)))


def test_limits_on_ramps_over_several_steps_and_on_changes_of_voltage():
    limits = {"cost.ramp_limit_kw_per_s": 0.5, "cost.ramp_window_s": 7.0, "cost.voltage_step_limit_pu": 1e-4}
    whole, parts = both(make_scenario("ieee33-weak", **limits, **SHORT), part_steps=5)  # less than the window
    assert whole.metrics()[0]["ramp_excess_pct"] > 0.0
    check_alike(whole, parts)


def test_an_environment_that_ends_in_voltage_collapse_counts_to_its_end_alone():
    jumps = np.random.default_rng(0).random(3000) < 0.08
    trace = PowerTrace(np.arange(3000.0), np.where(jumps, 1.0, 0.2), name="jumps")
    heavy = {
        "datacenters.p_rated_kw": 9000.0,
        "n_datacenters": 1,
        "datacenters.buses": (18,),
        "horizon": 12,
        "trace": (trace,),
    }
    whole, parts = both(make_scenario("ieee33-weak", **heavy), n_env=8, part_steps=4)
    assert len({figures["steps"] for figures in whole.metrics()}) > 1
    check_alike(whole, parts)


def test_the_last_part_may_be_of_any_length_and_one_part_is_the_whole():
    scenario = make_scenario("toy6", **SHORT)
    for part_steps in (1, 49, 50, 51):
        check_alike(*both(scenario, part_steps=part_steps))


def test_flicker_of_parts_is_that_of_the_whole(monkeypatch):
    rng = np.random.default_rng(1)
    v_pu = 1.0 + 0.004 * rng.standard_normal((1500, 3)).cumsum(axis=0) / 20.0
    monkeypatch.setattr(flicker, "INTERVAL_S", 60.0)
    whole = flicker.severity(v_pu, 0.1)
    for cut in (7, 600, 1500):
        meter = flicker.StreamingFlicker(0.1)
        for begin in range(0, 1500, cut):
            meter.add(v_pu[begin : begin + cut])
        assert meter.largest() == pytest.approx(whole.max(), rel=1e-12)


class _Sink:
    def __init__(self):
        self.calls = []

    def add(self, parts, first_step):
        self.calls.append((first_step, [None if part is None else len(part.cost_j) for part in parts]))


def test_sinks_are_given_every_step_once_and_in_order():
    sink = _Sink()
    both(make_scenario("toy6", **SHORT), sinks=(sink,))
    assert sink.calls == [(0, [17, 17]), (17, [17, 17]), (34, [16, 16])]


def test_nothing_is_said_of_an_episode_that_goes_on():
    simulation = Simulation(make_scenario("toy6", **SHORT), 1)
    recorder = StreamingRecorder(simulation.scenario, simulation.reset([0]))
    recorder.add(simulation.step(np.zeros((1, 4))))
    with pytest.raises(ValueError, match="metrics of an episode that has not ended"):
        recorder.metrics()
    with pytest.raises(ValueError, match="costs of an episode that has not ended"):
        recorder.costs()


@pytest.mark.slow
def test_what_a_course_takes_grows_with_steps_and_environments_and_a_day_is_too_long():
    scenario = make_scenario("ieee33-weak", split="test")
    one, eight = course_bytes(scenario, [0]), course_bytes(scenario, range(8))
    assert one < eight < 8 * one < WHOLE_COURSE_BYTES
    day = course_bytes(scenario.replace(horizon=86_400), [0])
    assert day == pytest.approx(720 * one, rel=1e-3)
    assert day > WHOLE_COURSE_BYTES


def test_a_device_that_says_nothing_has_its_course_kept_whole(monkeypatch):
    storage = toy6_storage(50)
    spread = lambda self, history, dt_s, requests: {"spread_kwh": float(history.stored_kwh.std())}  # noqa: E731
    monkeypatch.setattr(Storages, "metrics", spread)
    whole, parts = both(storage)
    assert whole.metrics()[0]["spread_kwh"] > 0.0
    check_alike(whole, parts)
