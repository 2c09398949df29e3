"""The figure of an episode that is too long for a line through every step."""

import numpy as np
import pytest

from dcgrid_env import make_scenario
from dcgrid_env.baselines import Droop, NoControl, rollout, streaming_rollout
from dcgrid_env.rendering import Envelope, envelope, long_figure, run_figure, side_by_side
from helpers.storages import toy6_storage


@pytest.fixture
def few(monkeypatch):
    monkeypatch.setattr(envelope, "INTERVALS", 8)
    monkeypatch.setattr(envelope, "LINE_POINTS", 4)


def test_intervals_hold_every_peak_and_mean(few):
    scenario = make_scenario("ieee33-weak", split="test", horizon=100)
    found = Envelope(scenario, env_index=1)
    recorder = streaming_rollout(scenario, Droop(), [0, 1], [found])
    own = rollout(scenario, Droop(), [0, 1]).series(1)
    assert found.steps_each == 13
    np.testing.assert_allclose(found.t_s, [6.5, 19.5, 32.5, 45.5, 58.5, 71.5, 84.5, 95.5])
    v, f = own.v_pu[1:, scenario.feeder.load_nodes], own.f_mhz
    cut = [slice(13 * i, min(13 * i + 13, 100)) for i in range(8)]
    spread, clocks = found.spread("v"), found.curves("f_mhz")
    assert clocks is not None
    np.testing.assert_array_equal(spread.low, [v[c].min() for c in cut])
    np.testing.assert_array_equal(spread.high, [v[c].max() for c in cut])
    np.testing.assert_allclose(spread.quartiles, [np.percentile(v[c], (25, 50, 75)) for c in cut])
    np.testing.assert_array_equal(clocks.high, [f[c].max(axis=0) for c in cut])
    np.testing.assert_allclose(clocks.mean, [f[c].mean(axis=0) for c in cut])
    assert found.lowest.v_pu == v.min()
    step, column = np.unravel_index(v.argmin(), v.shape)
    assert (found.lowest.at_s, found.lowest.node) == (step + 1.0, scenario.feeder.bus_ids[1 + column])
    assert found.cost == pytest.approx(recorder.metrics()[1]["J"])


def test_parts_of_any_length_give_the_same_intervals(few):
    scenario = make_scenario("toy6", split="test")
    series = rollout(scenario, NoControl(), [0]).series(0)
    whole, parts = Envelope.from_series(series), Envelope(scenario)
    recorder = rollout(scenario, NoControl(), [0])
    transitions = recorder._transitions
    for begin in range(0, 100, 7):
        parts.add([type(series)(scenario, transitions[begin : begin + 8], 0)], begin)
    np.testing.assert_array_equal(parts.spread("v").low, whole.spread("v").low)
    one, other = parts.curves("backlog_kws"), whole.curves("backlog_kws")
    assert one is not None
    assert other is not None
    np.testing.assert_array_equal(one.high, other.high)
    np.testing.assert_array_equal(parts.t_s, whole.t_s)


@pytest.mark.parametrize("scenario", ["ieee33-weak", "ieee13-3ph", "storage"])
def test_a_long_run_is_drawn_with_all_its_rows(few, monkeypatch, scenario):
    s = toy6_storage(60) if scenario == "storage" else make_scenario(scenario, split="test", horizon=60)
    monkeypatch.setattr(side_by_side, "MOST_STEPS", 50)
    series = {name: rollout(s, law, [0]).series(0) for name, law in (("none", NoControl()), ("droop", Droop()))}
    figure = run_figure(s, series, 0)
    labels = [ax.get_ylabel() for ax in figure.axes if ax.get_ylabel()]
    assert {"drawn by sites (kW)", "GPU clock (MHz)", "backlog (kW s)"} <= set(labels)
    assert ("phase a (p.u.)" if scenario == "ieee13-3ph" else "voltage (p.u.)") in labels
    assert ("stored (%)" in labels) == (scenario == "storage")
    assert "lines: means of every" in figure.get_suptitle()
    assert any("lowest: " in text.get_text() for ax in figure.axes for text in ax.texts)


@pytest.mark.parametrize(
    ("steps", "dt_s", "unit", "mark"),
    [(86_400, 1.0, "h", 3.0), (1440, 60.0, "h", 3.0), (604_800, 1.0, "days", 1.0), (6001, 0.1, "min", 2.0)],
)
def test_time_is_in_a_unit_that_reads_well(steps, dt_s, unit, mark, monkeypatch):
    monkeypatch.setattr(side_by_side, "MOST_STEPS", 0)
    s = make_scenario("toy6").replace(horizon=steps, dt_s=dt_s)
    few_steps = rollout(make_scenario("toy6").replace(horizon=3, dt_s=dt_s), NoControl(), [0])
    empty = Envelope(s)
    empty.add([few_steps.series(0)], 0)
    time = long_figure(s, {"none": empty}, 0).axes[-1]
    assert time.get_xlabel() == f"time since the reset ({unit})"
    assert np.diff(time.get_xticks())[0] == pytest.approx(mark)
