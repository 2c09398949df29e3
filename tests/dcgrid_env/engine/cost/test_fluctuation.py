"""Flicker, swings, ramps and steps of the voltage as metrics of an episode."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dcgrid_env import Scenario, make_scenario
from dcgrid_env.baselines import NoControl, rollout
from dcgrid_env.engine.cost.flicker import short_term_flicker
from dcgrid_env.engine.cost.fluctuation import StreamingFluctuation, shows_flicker, swing, worst_flicker
from helpers.three_phase import ieee13

TENTHS: dict[str, Any] = {"dt_s": 0.1, "horizon": 6000}


@pytest.fixture(scope="module")
def training():
    """A training episode of 600 s in which nothing is done."""
    return rollout(make_scenario("training", horizon=6000), NoControl(), [0]).series(0)


@pytest.mark.slow
def test_pst_max_is_that_of_the_node_that_flickers_most(training):
    pst = short_term_flicker(training.v_pu[1:, 1:], 0.1)[0]
    worst = training.worst_flicker()
    assert training.metrics()["pst_max"] == worst.pst == pst.max()
    assert worst.pst > 1.0  # training jobs on a weak feeder are seen in lamps
    assert worst.node == training.scenario.feeder.bus_ids[1 + pst.argmax()] == "18"
    assert worst.begin_s == 0.0
    assert training.worst_flicker("230V-50Hz").pst > worst.pst


@pytest.mark.slow
def test_the_swing_of_training_jobs_lies_mostly_in_the_band(training):
    own_kw = training.p_kw[:, :3]
    band = swing(own_kw, 0.1)
    metrics = training.metrics()
    assert metrics["swing_share_max_pct"] == pytest.approx(100.0 * band.share.max())
    assert metrics["swing_rms_max_pct"] == pytest.approx(100.0 * band.rms_kw.max() / 600.0)
    assert 50.0 < metrics["swing_share_max_pct"] <= 100.0
    assert 0.0 < metrics["swing_rms_max_pct"] < 38.5  # half of the way from idle to the rating, at most


def test_of_several_intervals_and_phases_the_worst_is_named():
    scenario = ieee13().replace(dt_s=0.1, horizon=12_000)
    v_pu = np.ones((12_000, scenario.feeder.n_node))
    node = scenario.feeder.node_ids.index("671.b")
    v_pu[7000:, node] += 0.01 * (np.arange(5000) // 8 % 2)
    found = worst_flicker(scenario, v_pu)
    assert (found.node, found.begin_s) == ("671.b", 600.0)
    assert found.pst == short_term_flicker(v_pu[:, node], 0.1)[1] > 0.5


@pytest.mark.parametrize(
    ("overrides", "shown"),
    [
        (TENTHS, True),
        ({"dt_s": 0.05, "horizon": 12_000}, True),
        ({"dt_s": 0.1, "horizon": 5999}, False),
        ({"dt_s": 0.2, "horizon": 6000}, False),
        ({"dt_s": 1.0, "horizon": 600}, False),
    ],
)
def test_steps_of_a_tenth_of_a_second_for_600_s_show_flicker(overrides, shown):
    assert shows_flicker(make_scenario("toy6", **overrides)) == shown


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        ({"dt_s": 0.2, "horizon": 6000}, "flicker: dt_s is 0.2; give samples at most 0.1 s apart"),
        ({"dt_s": 0.1, "horizon": 20}, "flicker: horizon is 20; give an episode of at least 6000 steps, 600 s"),
    ],
)
def test_asked_for_where_it_cannot_be_had_is_one_clear_error(overrides, message):
    series = rollout(make_scenario("toy6", **{**overrides, "horizon": 20}), NoControl(), [0]).series(0)
    assert "pst_max" not in series.metrics()
    with pytest.raises(ValueError, match=message):
        series.worst_flicker()


def test_an_episode_that_ends_early_has_its_figures_all_the_same():
    scenario = make_scenario(
        "toy6", **{"datacenters.p_rated_kw": 25_000.0}, **TENTHS
    )  # whose load cannot be carried from t = 20 s on
    metrics = rollout(scenario, NoControl(), [0]).metrics()[0]
    assert metrics["steps"] < 400
    assert 0.0 < metrics["pst_max"] < np.inf
    assert np.isfinite(list(metrics.values())).all()


def test_without_sites_there_is_no_swing():
    scenario = make_scenario("toy6", n_datacenters=0, **{"datacenters.buses": None}, **TENTHS)
    n_node, n_agent = scenario.feeder.n_node, scenario.n_agents
    whole = StreamingFluctuation(scenario)
    whole.add(np.ones((6001, n_node)), np.ones((6001, n_agent)))
    assert whole.figures() == {"pst_max": 0.0, "swing_share_max_pct": 0.0, "swing_rms_max_pct": 0.0}


# --- swings ------------------------------------------------------------------------------------------


def test_a_sine_lies_in_its_band_alone():
    t_s = 0.1 * np.arange(6000)
    p_kw = 500.0 + 40.0 * np.sin(2.0 * np.pi * 0.5 * t_s) + 30.0 * np.sin(2.0 * np.pi * 0.05 * t_s)
    band = swing(p_kw[:, None], 0.1)
    assert band.share[0] == pytest.approx(1600.0 / 2500.0)
    assert band.rms_kw[0] == pytest.approx(40.0 / np.sqrt(2.0))
    assert swing(p_kw[:, None], 0.1, (0.6, 5.0)).share[0] == pytest.approx(0.0, abs=1e-12)
    assert swing(np.full((6000, 2), 3e5 / 7.0), 0.1).share.tolist() == [0.0, 0.0]


@given(seed=st.integers(0, 999), n=st.integers(20, 300), cut_hz=st.floats(0.3, 4.0), scale=st.floats(1e-3, 1e3))
@settings(max_examples=25, deadline=None)
def test_bands_beside_each_other_add_up_and_the_scale_does_not_matter(seed, n, cut_hz, scale):
    p_kw = np.random.default_rng(seed).standard_normal((n, 2)) + 5.0
    least = 0.5 / (n * 0.1)
    low, high, whole = (swing(p_kw, 0.1, band) for band in ((least, cut_hz), (cut_hz + 1e-6, 5.0), (least, 5.0)))
    np.testing.assert_allclose(low.share + high.share, whole.share)
    np.testing.assert_allclose(whole.share, 1.0)
    np.testing.assert_allclose(whole.rms_kw, p_kw.std(axis=0))
    np.testing.assert_allclose(swing(scale * p_kw, 0.1, (least, cut_hz)).share, low.share)


@pytest.mark.parametrize("band_hz", [(0.0, 1.0), (2.0, 1.0), (6.0, 20.0)])
def test_a_band_that_cannot_be_shown_is_refused(band_hz):
    with pytest.raises(ValueError, match=r"swing: band_hz is .*; give two rising frequencies above 0 Hz, one below 5"):
        swing(np.ones((100, 1)), 0.1, band_hz)


# --- ramps and steps of the voltage -----------------------------------------------------------------


def limited(**overrides: Any) -> Scenario:
    return make_scenario("ieee33-weak", **{"horizon": 15, "cost.ramp_limit_kw_per_s": 2.0}).replace(**overrides)


@pytest.mark.parametrize("window_s", [1.0, 4.0])
def test_figures_of_ramps_are_what_would_be_charged(window_s):
    weights = {"ramp_excess": 1.0, "voltage_step_excess": 1.0}
    scenario = limited(cost={"ramp_window_s": window_s, "voltage_step_limit_pu": 1e-4}, weights=weights)
    for metrics in rollout(scenario, NoControl(), range(2)).metrics():
        assert metrics["ramp_excess_pct"] == pytest.approx(100.0 * metrics["cost_ramp_excess"])
        assert metrics["voltage_step_excess_pct"] == pytest.approx(100.0 * metrics["cost_voltage_step_excess"])
        assert metrics["ramp_max_kw_per_s"] > 2.0
        assert metrics["voltage_step_max_pu"] > 1e-4


def test_figures_of_ramps_take_a_limit_and_no_weight():
    metrics = rollout(limited(), NoControl(), [0]).metrics()[0]
    assert metrics["ramp_excess_pct"] > 0.0
    assert not {"cost_ramp_excess", "voltage_step_max_pu"} & set(metrics)
    assert not any(
        name.startswith("ramp")
        for name in rollout(limited(cost={"ramp_limit_kw_per_s": None}), NoControl(), [0]).metrics()[0]
    )
