"""Every generated trace has windows enough for hundreds of episodes, however long they are."""

import numpy as np
import pytest

from dcgrid_env import make_scenario
from dcgrid_env.engine.exogenous import episode
from dcgrid_env.engine.exogenous.trace_pool import LEAST_WINDOWS, ROWS, sun_rows, trace_pool, window_steps
from dcgrid_env.traces import TRACE_SOURCES, RowsOnDemand, TraceRows

DAY = [{"horizon": 86400}, {"horizon": 1440, "dt_s": 60.0}, {"horizon": 96, "dt_s": 900.0}, {"horizon": 3600}]


def windows(scenario):
    """How many windows one site can draw."""
    pool = trace_pool(scenario)
    rows, steps = pool.p_share.shape
    return rows * ((pool.spare_steps if isinstance(pool, RowsOnDemand) else steps - window_steps(scenario)) + 1)


@pytest.mark.parametrize("source", TRACE_SOURCES)
@pytest.mark.parametrize("length", DAY, ids=str)
def test_long_episodes_have_windows_enough(source, length):
    scenario = make_scenario("ieee33-weak", trace=source, split="test", **length)
    assert windows(scenario) >= LEAST_WINDOWS
    pool = trace_pool(scenario)
    assert isinstance(pool, RowsOnDemand)
    follows = 86400.0 if pool.begin_h is not None and scenario.follows_day else 0.0
    last = pool.spare_steps + follows / scenario.dt_s
    assert pool.p_share.shape[1] >= last + window_steps(scenario)


@pytest.mark.parametrize("source", ["inference", "step", "llama3-70b"])
def test_short_episodes_draw_from_a_day_of_hours_as_ever(source):
    scenario = make_scenario("ieee33-weak", trace=source, split="validation")
    assert windows(scenario) == ROWS * (3600 - 122 + 1) == 83_496
    assert isinstance(trace_pool(scenario), TraceRows)


@pytest.mark.slow
def test_the_number_of_sites_is_kept():
    scenario = make_scenario("scale-32", horizon=61, dt_s=60.0)
    assert len(trace_pool(scenario).p_share) == 32
    drawn = episode.draw(scenario, np.arange(2, dtype=np.uint64), np.zeros(2, np.uint64))
    rows = drawn.start // trace_pool(scenario).p_share.shape[1]
    assert all(len(set(env_index)) == 32 for env_index in rows.tolist())


@pytest.mark.parametrize("length", [*DAY, {}], ids=str)
def test_seeds_beyond_the_published_draw_other_windows(length):
    scenario = make_scenario("mixed", trace="inference", split="test", **length)
    seeds = np.arange(400, dtype=np.uint64)
    # What is drawn, but for making the rows.
    key = episode.random.keys(np.uint64(1), seeds, np.zeros_like(seeds))
    begin_h = episode._begin_h(scenario, key)
    drawn = episode._windows(scenario, key, begin_h).tolist()
    assert len({tuple(windows) for windows in drawn}) == 400


@pytest.mark.parametrize("length", DAY[1:], ids=str)
@pytest.mark.slow
def test_pv_has_windows_enough(length):
    scenario = make_scenario("mixed", split="test", **length)
    rows, steps = sun_rows(scenario).shape
    assert rows * (steps - scenario.horizon) >= LEAST_WINDOWS


def test_short_episodes_of_pv_draw_from_hours_as_ever():
    assert sun_rows(make_scenario("mixed")).shape == (24, 3600)
