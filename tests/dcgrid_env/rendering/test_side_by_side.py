"""The figure of a run: its rows, the marks of events, and what it leaves out."""

import numpy as np
import pytest
from matplotlib.text import Text

from dcgrid_env import make_scenario, sag_times
from dcgrid_env.baselines import make_controller, rollout
from dcgrid_env.rendering import run_figure


def figure_of(scenario, *names):
    runs = {name: rollout(scenario, make_controller(name, scenario), [0]).series(0) for name in names}
    return runs, run_figure(scenario, runs, 0)


def labels(figure):
    return [ax.get_ylabel() for ax in figure.axes if ax.get_ylabel()]


def test_storages_have_a_row_with_a_curve_each():
    scenario = make_scenario("ieee33-weak-ups", horizon=40)
    runs, figure = figure_of(scenario, "peak-shaving")
    (axes,) = [ax for ax in figure.axes if ax.get_ylabel() == "stored (%)"]
    curves = [np.asarray(line.get_ydata()) for line in axes.get_lines()]
    energy_kwh = next(device for device in scenario.devices if device.kind == "storage").parameters.energy_kwh
    np.testing.assert_allclose(np.array(curves).T, 100.0 * runs["peak-shaving"].stored_kwh / energy_kwh)


def test_rows_in_which_nothing_changes_are_left_out():
    """Without control, clocks and backlogs are constant and no reactive power is injected."""
    scenario = make_scenario("toy6", horizon=20)
    assert labels(figure_of(scenario, "none")[1]) == ["voltage (p.u.)", "data centres (kW)"]
    changing = ["voltage (p.u.)", "data centres (kW)", "Q injected (kvar)", "GPU clock (MHz)", "backlog (kW s)"]
    assert labels(figure_of(scenario, "none", "droop")[1]) == changing


def test_the_power_row_shows_what_all_data_centres_draw():
    scenario = make_scenario("toy6", horizon=20)
    runs, figure = figure_of(scenario, "droop")
    drawn = next(line for line in figure.axes[1].get_lines() if line.get_label() == "drawn")
    workload = [device.input == "workload" for device in scenario.devices for _ in range(device.count)]
    np.testing.assert_allclose(np.asarray(drawn.get_ydata()), runs["droop"].p_kw[:, workload].sum(axis=1))


def test_relays_have_a_curve_each_in_half_bands_around_their_set_point():
    control = {"grid_control.regulator_settings": {"timer": "integrating", "offset_v": -2.0}}
    scenario = make_scenario("ieee34-3ph", horizon=90, **control)
    runs, figure = figure_of(scenario, "none")
    (axes,) = [ax for ax in figure.axes if ax.get_ylabel().startswith("relay deviation")]
    table = scenario.feeder.network.regulator
    target_v, half_band_v = np.array(table.vreg_v) - 2.0, 0.5 * np.array(table.band_v)
    relay_v = runs["none"].three_phase.equipment.regulators.relay_v
    curves = np.array([line.get_ydata() for line in axes.get_lines()])
    np.testing.assert_allclose(curves.T, (relay_v - target_v) / half_band_v, rtol=1e-12)
    assert (np.abs(curves) > 1.0).any()


def test_sags_and_trips_are_marked_at_their_times():
    scenario = make_scenario("ride-through", horizon=60)
    runs, figure = figure_of(scenario, "none")
    marked = {line.get_marker(): np.asarray(line.get_xdata()) for line in figure.axes[0].get_lines()}
    np.testing.assert_array_equal(marked["v"], sag_times(scenario, 0))
    share = runs["none"].devices[0].features[0].ups.share
    assert (np.flatnonzero((np.diff(share, axis=0) < 0.0).any(axis=1)) + 1.0).tolist() == marked["x"].tolist()
    assert "connected (%)" in labels(figure)


@pytest.mark.slow
def test_tap_changes_are_marked_and_counted_as_in_the_metrics():
    scenario = make_scenario("ride-through", horizon=60)
    runs, figure = figure_of(scenario, "none", "droop")
    for ax, run in zip(figure.axes, runs.values(), strict=False):
        (ticks,) = [line for line in ax.get_lines() if line.get_marker() == "|"]
        taps = run.three_phase.equipment.regulators.tap
        changed = np.flatnonzero(np.diff(taps, axis=0).any(axis=1)) + 1
        np.testing.assert_array_equal(ticks.get_xdata(), changed)
    metrics = [run.metrics() for run in runs.values()]
    trips = ", ".join(f"{own['ups_trips'] + own['inverter_trips']:.0f}" for own in metrics)
    changes = ", ".join(f"{own['tap_moves']:.0f}" for own in metrics)
    sags = len(sag_times(scenario, 0))
    caption = figure.get_supxlabel()
    assert f"(none, droop): sags {sags}, {sags}; trips {trips}; tap changes {changes}." in caption
    assert "tap change" in [text.get_text() for text in figure.findobj(Text)]


@pytest.mark.parametrize(("dt_s", "shown"), [(0.1, 10.0), (1.0, 300.0)])
@pytest.mark.slow
def test_of_an_episode_in_short_steps_ten_seconds_are_shown(dt_s, shown):
    """The largest change of the power drawn lies within them, so burnt power and ramps can be seen."""
    scenario = make_scenario("smoothing", horizon=300, dt_s=dt_s)
    runs, figure = figure_of(scenario, "smoothing")
    first, last = figure.axes[-1].get_xlim()
    assert last - first == pytest.approx(shown)
    largest = np.abs(np.diff(runs["smoothing"].p_kw.sum(axis=1))).argmax() * dt_s
    assert first <= largest <= last
    assert "burnt power (kW)" in labels(figure)
    (axes,) = [ax for ax in figure.axes if ax.get_ylabel() == "backlog (kW s)"]
    steps = slice(round(first / dt_s), round(last / dt_s) + 1)
    assert axes.get_ylim()[1] == pytest.approx(1.05 * max(runs["smoothing"].backlog_kws[steps].max(), 1.0))


def test_the_caption_says_what_j_is():
    figure = figure_of(make_scenario("toy6", horizon=4), "none")[1]
    (caption,) = [text for text in figure.findobj(Text) if text.get_text() == figure.get_supxlabel()]
    assert 0.0 < caption.get_window_extent().x0 < caption.get_window_extent().x1 < figure.bbox.x1
    assert "J: mean cost per step, lower is better" in figure.get_supxlabel()
    assert "Events" not in figure.get_supxlabel()
