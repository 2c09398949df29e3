"""Episodes of a day: load, sun and requests follow the hour."""

import pickle

import numpy as np
import pytest

from dcgrid_env import TensorEnv, forecast, make_scenario
from dcgrid_env.baselines import NoControl, rollout
from dcgrid_env.engine.exogenous import episode
from dcgrid_env.engine.exogenous.trace_pool import trace_pool
from dcgrid_env.engine.simulation import Simulation
from dcgrid_env.traces import RowsOnDemand, load_share, rows_on_demand, sun_share

DAY = {"horizon": 1440, "dt_s": 60.0}


@pytest.mark.slow
def test_the_base_load_has_the_course_of_a_day():
    scenario = make_scenario(
        "ieee33", **{"background.start_hour": 0, "background.load_sigma": 0.0}, split="test", **DAY
    )
    found = forecast(scenario, 5).p_load_kw
    hours = np.arange(1, 1441) / 60.0
    np.testing.assert_allclose(found, load_share(hours)[:, None] * scenario.feeder.p_load_kw, rtol=1e-12)
    assert found[:, 5].min() < 0.57 * found[:, 5].max()


def test_capacitors_do_not_follow_the_day():
    scenario = make_scenario("ieee123", background={"start_hour": 4.5, "load_sigma": 0.0}, horizon=2)
    feeder = scenario.feeder
    wanted = 0.56 * feeder.q_load_kvar - feeder.capacitor_kvar
    np.testing.assert_allclose(forecast(scenario, 0).q_load_kvar[0], wanted, atol=1e-2)


@pytest.mark.slow
def test_the_sun_is_down_at_midnight_and_as_before_at_noon():
    scenario = make_scenario("mixed", **{"background.start_hour": 0}, split="test", **DAY)
    found = forecast(scenario, 0).p_inverter_kw
    hours = np.arange(1, 1441) / 60.0
    assert (found[(hours < 4.5) | (hours > 19.5)] == 0.0).all()
    cap = sun_share(hours)[:, None] * scenario.inverters.parameters.s_rated_kva
    assert (found <= cap + 1e-9).all()
    assert (found[(hours > 6) & (hours < 18)] > 0.0).all()
    noon, still = (forecast(make_scenario("mixed", background={"start_hour": h}, horizon=5), 0) for h in (12.0, None))
    np.testing.assert_allclose(noon.p_inverter_kw, still.p_inverter_kw, rtol=1e-5)


def test_a_schedule_of_ones_own_is_left_as_it_is():
    scenario = make_scenario("toy6", background={"start_hour": 0}, inverters={"injection": [0.5] * 6}, horizon=5)
    np.testing.assert_allclose(forecast(scenario, 0).p_inverter_kw, 500.0)


def test_short_episodes_stand_still_unless_an_hour_is_given():
    scenario = make_scenario("ieee33")
    assert not scenario.follows_day
    drawn = episode.draw(scenario, np.arange(3, dtype=np.uint64), np.zeros(3, np.uint64))
    assert drawn.begin_h.tolist() == [0.0] * 3
    assert make_scenario("ieee33", background={"start_hour": 0}).follows_day
    assert not make_scenario("ieee33", horizon=3600).follows_day
    assert make_scenario("ieee33", horizon=3601).follows_day


def test_long_episodes_draw_their_hour_and_given_ones_have_it():
    seeds = np.arange(200, dtype=np.uint64)
    for fields in ({"background.start_hour": "random"}, {"horizon": 61, "dt_s": 60.0}):
        drawn = episode.draw(make_scenario("toy6", **fields), seeds, np.zeros_like(seeds)).begin_h
        assert len(set(drawn.tolist())) == 200
        assert 0.0 <= drawn.min() < 1.0
        assert 23.0 < drawn.max() < 24.0
        assert abs(drawn.mean() - 12.0) < 1.5
    given = make_scenario("toy6", background={"start_hour": 6.5}, horizon=61, dt_s=60.0)
    assert episode.draw(given, seeds, np.zeros_like(seeds)).begin_h.tolist() == [6.5] * 200


@pytest.mark.slow
def test_sites_that_follow_the_day_are_at_the_episodes_hour():
    scenario = make_scenario(
        "toy6", trace="code", workload={"window": "random"}, background={"start_hour": 20.25}, horizon=30, dt_s=60.0
    )
    drawn = episode.draw(scenario, np.arange(4, dtype=np.uint64), np.zeros(4, np.uint64))
    pool = trace_pool(scenario)
    assert isinstance(pool, RowsOnDemand)
    assert pool.begin_h is not None
    row, start = np.divmod(drawn.start, pool.p_share.shape[1])
    hour = (pool.begin_h[row] + start / 60.0) % 24.0
    assert ((hour - 20.25) % 24.0 <= 1.0 + 1e-9).all()
    assert len(np.unique(hour)) > 1
    assert np.isfinite(episode.p_ref_kw(scenario, drawn, np.full(4, 31))).all()


def test_a_snapshot_goes_on_where_its_rows_have_not_been_made():
    def fresh():
        return Simulation(
            make_scenario("ieee33-weak", name="mine", horizon=70, dt_s=60.0, background={"start_hour": 3.0}), 1
        )

    first = fresh()
    first.reset([0])
    action = np.zeros((1, 10))
    saved = first.now
    wanted = [first.step(action).observation for _ in range(70)]
    other = fresh()
    # Made anew, as in another process; the same scenario would share its rows.
    rows_on_demand.cache_clear()
    other.scenario = pickle.loads(pickle.dumps(other.scenario))
    pool = trace_pool(other.scenario)
    assert np.isnan(pool.p_share).all()
    other.restore(saved)
    found = [other.step(action).observation for _ in range(70)]
    np.testing.assert_array_equal(found, wanted)


@pytest.mark.parametrize("name", ["mixed", "ieee123"])
@pytest.mark.slow
def test_a_batch_a_tensor_environment_and_a_forecast_have_the_same_day(name):
    scenario = make_scenario(name, horizon=130, dt_s=60.0, split="test", weights={"leftover": 0.0})
    recorder = rollout(scenario, NoControl(), range(3))
    env = TensorEnv(scenario, like=np.zeros(0))
    env.reset(range(3))
    top = np.zeros((3, 2 * scenario.datacenters.count + scenario.inverters.count))
    top[:, 0 : 2 * scenario.datacenters.count : 2] = 1.0
    cost = sum(env.step(top).cost_j for _ in range(130))
    np.testing.assert_allclose(recorder.costs(), cost / 130, rtol=1e-9)
    np.testing.assert_allclose(recorder.series(1).v_pu[-1], env.state.v_pu[1], rtol=1e-9)


@pytest.mark.slow
def test_a_day_of_minutes_runs_to_its_end_under_control():
    found = rollout(make_scenario("mixed", split="test", **DAY), NoControl(), range(2)).metrics()
    assert [figures["steps"] for figures in found] == [1440.0] * 2
    assert all(np.isfinite(list(figures.values())).all() for figures in found)
    assert len({figures["J"] for figures in found}) == 2


def test_a_short_episode_makes_short_rows_that_begin_at_its_hour():
    scenario = make_scenario("toy6", trace="code", background={"start_hour": "random"}, horizon=30)
    pool = trace_pool(scenario)
    assert isinstance(pool, RowsOnDemand)
    assert pool.begin_h is not None
    # An hour until the window may begin, one in which it begins, 32 steps of trace and one for rounding.
    assert pool.p_share.shape[1] == 3600 + 3600 + 32 + 1
    seeds = np.arange(200, dtype=np.uint64)
    key = episode.random.keys(np.uint64(1), seeds, np.zeros_like(seeds))
    begin_h = episode._begin_h(scenario, key)
    row, start = np.divmod(episode._windows(scenario, key, begin_h), pool.p_share.shape[1])
    late_h = (pool.begin_h[row] + start / 3600.0 - begin_h[:, None]) % 24.0
    assert ((late_h <= 1.0) | (late_h > 24.0 - 1.0 / 3600.0)).all()
    assert set(pool.begin_h[row].ravel()) == set(range(24))
    assert (start + 32 < pool.p_share.shape[1]).all()
