"""Drawing episodes: the same seed gives the same, splits share nothing, windows lie within their rows."""

import numpy as np
import pytest

from dcgrid_env import PRESETS, PrefillDecodeDvfs, Scenario, ScenarioError, make_scenario
from dcgrid_env.baselines import NoControl, rollout
from dcgrid_env.engine.exogenous import episode
from dcgrid_env.engine.exogenous.trace_pool import sun_rows, trace_pool, window_steps
from dcgrid_env.engine.simulation import Simulation
from dcgrid_env.traces import SPLITS, PowerTrace, Site, Tenant, TraceError, generate_sites
from helpers.forms import each_preset
from helpers.intervals import interval


def draw(scenario: Scenario, seeds: range | list[int], number: int = 0) -> episode.Episode:
    seed = np.array(seeds, np.uint64)
    return episode.draw(scenario, seed, np.full(len(seed), number, np.uint64))


def recording(values: list[float] | np.ndarray, name: str = "recording", dt_s: float = 1.0) -> PowerTrace:
    time_s = dt_s * np.arange(len(values) + 1)
    return PowerTrace(time_s, np.append(values, values[-1]), name)


def actions(scenario: Scenario, n_env: int, seed: int = 0) -> np.ndarray:
    n = 2 * scenario.datacenters.count + scenario.inverters.count
    return np.random.default_rng(seed).uniform(-1, 1, (n_env, n))


# --- the same seed, the same episode -------------------------------------------------------------


DAYS = [pytest.param(p, marks=pytest.mark.slow) if p == "ieee123-3ph-day" else p for p in PRESETS]
"""Presets; the rows of trace of a day take long to make."""


@pytest.mark.parametrize("name", DAYS)
def test_same_seed_same_episode_in_any_environment(name):
    scenario = make_scenario(name).member(0)
    together = draw(scenario, range(50))
    again = draw(make_scenario(name).member(0), range(50))
    for field in ("key", "buses", "start", "sun", "fault"):
        np.testing.assert_array_equal(getattr(together, field), getattr(again, field))
    for seed in (0, 17, 49):
        alone = draw(scenario, [seed])
        assert alone.key[0] == together.key[seed]
        assert alone.buses[0].tolist() == together.buses[seed].tolist()
        assert alone.start[0].tolist() == together.start[seed].tolist()
        assert alone.sun[0] == together.sun[seed]
        assert alone.fault[0].tolist() == together.fault[seed].tolist()
        assert alone.placed.r[0].tolist() == together.placed.r[seed].tolist()


def test_another_seed_or_the_next_episode_is_another():
    scenario = make_scenario("ieee123")
    first, following = draw(scenario, range(40)), draw(scenario, range(40), number=1)
    assert len(np.unique(np.concatenate((first.key, following.key)))) == 80
    assert len({tuple(row) for row in np.concatenate((first.buses, following.buses)).tolist()}) == 80
    assert len({tuple(row) for row in np.concatenate((first.start, following.start)).tolist()}) == 80


def test_the_noise_of_an_episode_is_its_keys_alone():
    scenario = make_scenario("ieee33-weak")
    drawn, quiet = draw(scenario, [3, 4, 5]), np.zeros((3, 33))
    step = np.array([0, 4, 9])
    outside, noise = interval(scenario, drawn, step, quiet + 1.0)
    for env_index in range(3):
        alone = draw(scenario, [3 + env_index])
        at = step[env_index : env_index + 1]
        single, single_noise = interval(scenario, alone, at, quiet[:1] + 1.0)
        for a, b in zip(single[:4], outside[:4], strict=True):
            np.testing.assert_array_equal(a[0], b[env_index])
        np.testing.assert_array_equal(single_noise[0], noise[env_index])


def test_a_large_batch_spread_over_threads_draws_the_same_noise(monkeypatch):
    monkeypatch.setenv("DCGRID_NUM_THREADS", "2")
    scenario, n_env = make_scenario("ieee33-weak"), 301
    drawn, z, step = draw(scenario, range(n_env)), np.ones((n_env, 33)), np.arange(n_env) % 5
    outside, noise = interval(scenario, drawn, step, z)
    for env_index in (0, 1, 149, 150, 151, 300):
        alone, at = draw(scenario, [env_index]), step[env_index : env_index + 1]
        single, single_noise = interval(scenario, alone, at, z[:1])
        np.testing.assert_array_equal(single_noise[0], noise[env_index])
        np.testing.assert_array_equal(single.p_load_kw[0], outside.p_load_kw[env_index])
        np.testing.assert_array_equal(single.q_load_kvar[0], outside.q_load_kvar[env_index])


def test_an_environment_without_a_seed_goes_through_its_seeds_episodes_in_turn():
    scenario = make_scenario("ieee123", horizon=3)
    simulation = Simulation(scenario, 2)
    simulation.reset([7, 8])
    for number in (0, 1, 2):
        now = simulation.now.episode
        for env_index, seed in enumerate((7, 8)):
            wanted = draw(scenario, [seed], number)
            assert now.key[env_index] == wanted.key[0]
            assert now.buses[env_index].tolist() == wanted.buses[0].tolist()
        simulation.reset([None, None])
    # Seeded again, it begins with the first.
    simulation.reset([None, 8])
    assert simulation.now.episode.key.tolist() == [draw(scenario, [7], 4).key[0], draw(scenario, [8]).key[0]]


# --- placement -----------------------------------------------------------------------------------


def test_placements_are_distinct_candidates_and_reach_all_of_them():
    scenario = make_scenario("ieee123")
    feeder = scenario.feeder
    drawn = draw(scenario, range(2000))
    at = drawn.buses[:, :5]
    assert all(len(set(row)) == 5 for row in at.tolist())
    candidates = {
        i for i, load in enumerate(feeder.p_load_kw) if load > 0 and feeder.bus_ids[i] not in scenario.inverters.buses
    } - {0}
    assert set(at.ravel().tolist()) == candidates
    # Each as often as the others: 10,000 draws over the candidates.
    count = np.bincount(at.ravel(), minlength=feeder.n_bus)[sorted(candidates)]
    mean = at.size / len(candidates)
    assert np.abs(count - mean).max() < 5 * np.sqrt(mean)
    # And each slot on its own: slots are not sorted by bus.
    for slot in range(5):
        assert set(at[:, slot].tolist()) == candidates
    fixed = [feeder.index(bus) for bus in scenario.inverters.buses]
    assert np.all(drawn.buses[:, 5:] == fixed)


@pytest.mark.parametrize(("name", "dc", "inv"), [("toy6", "4", "3 5"), ("ieee33-weak", "18 33 25", "7 14 20 30")])
def test_fixed_placements(name, dc, inv):
    scenario = make_scenario(name)
    drawn = draw(scenario, range(4))
    ids = [[scenario.feeder.bus_ids[i] for i in row] for row in drawn.buses]
    assert ids == [[*dc.split(), *inv.split()]] * 4


def test_nodes_are_flat_positions():
    scenario = make_scenario("ieee123")
    drawn = draw(scenario, range(3))
    assert drawn.placed.nodes.shape == (3, 12, 1)
    flat = np.arange(3 * 123).reshape(3, 123)
    for env_index in range(3):
        assert drawn.placed.nodes[env_index, :, 0].tolist() == flat[env_index, drawn.buses[env_index]].tolist()


@pytest.mark.parametrize("n", range(11))
def test_any_number_of_datacenters(n):
    scenario = make_scenario("ieee123", n_datacenters=n, horizon=3)
    simulation = Simulation(scenario, 4)
    first = simulation.reset(range(4))
    buses = simulation.now.episode.buses
    assert buses.shape == (4, n + 7)
    assert all(len(set(row)) == n + 7 for row in buses.tolist())
    last = [simulation.step(actions(scenario, 4)) for _ in range(3)][-1]
    assert last.truncated.all()
    assert np.isfinite(last.observation).all()
    assert np.isfinite(last.reward).all()
    assert first.observation.shape == (4, 9 * n + 7 * 7)


def test_more_datacenters_than_buses_is_refused():
    free = len(make_scenario("ieee123").candidates)
    assert make_scenario("ieee123", n_datacenters=free).datacenters.count == free
    with pytest.raises(ScenarioError, match=rf"datacenters.count is {free + 1}.*{free} load buses"):
        make_scenario("ieee123", n_datacenters=free + 1)


# --- splits --------------------------------------------------------------------------------------


def run_digests(rows, length):
    """A hash of every run of so many values of each row: a polynomial in its bits, modulo 2^64."""
    bits = np.ascontiguousarray(rows).view(np.uint64)
    runs = bits.shape[1] - length + 1
    digest = np.zeros((len(bits), runs), np.uint64)
    for i in range(length):
        own = bits[:, i : i + runs]
        # The bits of a round number end in zeros, which a product would keep: mix them first.
        digest = digest * np.uint64(0x9E3779B97F4A7C15) + (
            (own ^ (own >> np.uint64(32))) * np.uint64(0xD6E8FEB86659FD93)
        )
    return digest


@pytest.mark.parametrize("name", each_preset(("toy6", "ieee123", "mixed", "fault", "zero-shot")))
def test_splits_share_no_window_and_no_key(name):
    pools = {split: trace_pool(make_scenario(name, split=split)).p_share for split in SPLITS}
    keys = {split: draw(make_scenario(name, split=split).member(0), range(500)).key for split in SPLITS}
    assert len(np.unique(np.concatenate(list(keys.values())))) == 1500
    rows = [row for pool in pools.values() for row in pool]
    window = window_steps(make_scenario(name))
    # The step of toy6 is the same in all; what tells its rows apart is the idle part, which every episode begins with.
    heads = [tuple(row[:window]) for row in rows]
    assert len(set(heads)) == len(rows) == 3 * (12 if make_scenario(name).follows_day else 24)
    if make_scenario(name).workload.window == "random":
        # No window of one split is one of another: no run of 30 steps comes twice, anywhere in any row.
        digests = [digest for pool in pools.values() for digest in np.unique(run_digests(pool, 30))]
        assert len(np.unique(digests)) == len(digests)


def test_splits_of_recordings_share_no_sample():
    trace = recording(np.arange(1, 1001) / 1000.0)
    pools = {split: trace_pool(make_scenario("ieee123", trace=(trace,), split=split, horizon=20)) for split in SPLITS}
    values = [set(pool.p_share.ravel().tolist()) for pool in pools.values()]
    assert [len(v) for v in values] == [600, 200, 200]
    assert len(set.union(*values)) == 1000


# --- windows -------------------------------------------------------------------------------------


@pytest.mark.parametrize("dt_s", [1.0, 0.5, 0.1])
def test_windows_lie_within_distinct_rows(dt_s):
    scenario = make_scenario("ieee123", dt_s=dt_s, horizon=50)
    pool = trace_pool(scenario).p_share
    assert pool.shape[1] == round(3600 / dt_s)
    start = draw(scenario, range(3000)).start
    row, offset = np.divmod(start, pool.shape[1])
    assert row.min() >= 0
    assert row.max() < len(pool)
    assert all(len(set(r)) == 5 for r in row.tolist())
    assert set(row.ravel().tolist()) == set(range(len(pool)))
    room = pool.shape[1] - 52
    assert offset.min() >= 0
    assert offset.max() <= room
    assert offset.min() < 0.01 * room
    assert offset.max() > 0.99 * room
    np.testing.assert_allclose(np.quantile(offset / room, [0.25, 0.5, 0.75]), [0.25, 0.5, 0.75], atol=0.02)


def test_last_window_of_a_row_is_reached_but_not_passed():
    # Rows of 12 steps and an episode that needs 12 or 11 of them: one place, or two.
    trace = recording(np.linspace(0.1, 1.0, 20))
    for horizon, places in ((10, {0}), (9, {0, 1}), (7, {0, 1, 2, 3})):
        scenario = make_scenario("toy6", trace=(trace,), workload={"window": "random"}, horizon=horizon)
        assert trace_pool(scenario).p_share.shape == (1, 12)
        assert set(draw(scenario, range(300)).start.ravel().tolist()) == places


def test_p_ref_is_the_rows_power_times_the_rating():
    scenario = make_scenario("ieee123", horizon=30, datacenters={"p_rated_kw": (100.0, 200.0, 300.0, 400.0, 500.0)})
    pool = trace_pool(scenario).p_share
    drawn = draw(scenario, [1, 2])
    row, offset = np.divmod(drawn.start, pool.shape[1])
    for step in (0, 1, 31):
        p_ref = episode.p_ref_kw(scenario, drawn, np.array([step, 5]))
        for site, rated in enumerate((100.0, 200.0, 300.0, 400.0, 500.0)):
            assert p_ref[0, site] == pool[row[0, site], offset[0, site] + step] * rated
            assert p_ref[1, site] == pool[row[1, site], offset[1, site] + 5] * rated


@pytest.mark.parametrize("dt_s", [1.0, 0.5, 0.1])
def test_steps_take_the_trace_in_turn(dt_s):
    scenario = make_scenario("ieee33-weak", dt_s=dt_s, horizon=6)
    simulation = Simulation(scenario, 3)
    simulation.reset(range(3))
    pool, rated, idle = trace_pool(scenario).p_share, 1000.0, 230.0
    start = simulation.now.episode.start
    for step in range(7):
        if step:
            simulation.step(actions(scenario, 3, step))
        now = pool.ravel()[start + step] * rated
        following = pool.ravel()[start + step + 1] * rated
        np.testing.assert_allclose(simulation.now.state.arrived_kw, np.maximum(now - idle, 0.0), atol=1e-9)
        np.testing.assert_allclose(simulation.now.p_ref_next_kw, following, atol=1e-9)
    assert simulation.transition.truncated.all()


@pytest.mark.parametrize(("dt_s", "horizon"), [(1.0, 40), (0.5, 60), (0.1, 250), (2.0, 20)])
def test_toy6_idles_until_20_s_and_is_full_from_there(dt_s, horizon):
    scenario = make_scenario("toy6", dt_s=dt_s, horizon=horizon)
    simulation = Simulation(scenario, 1)
    simulation.reset([0])
    full = np.zeros((1, 4))
    full[:, 0] = 1.0
    for step in range(1, horizon + 1):
        p = simulation.step(full).state.p_kw[0, 0]
        if step * dt_s < 20.0 - 1e-9:
            assert 0.97 * 575.0 - 1e-9 <= p <= 575.0 + 1e-9
        else:
            assert p == pytest.approx(2500.0)


def test_load_noise_keeps_its_correlation_in_seconds_for_any_dt():
    # 0.9 over a second: 0.9^0.1 over a tenth, whose tenth power it is again.
    found = {}
    for dt_s in (1.0, 0.1, 5.0):
        scenario = make_scenario("ieee33-weak", dt_s=dt_s, horizon=20, background={"load_rho": 0.9})
        n_env = 400
        drawn, z = draw(scenario, range(n_env)), np.zeros((n_env, 33))
        course = []
        for step in range(5):
            at = np.full(n_env, step)
            z = interval(scenario, drawn, at, z)[1]
            course.append(z)
        found[dt_s] = np.corrcoef(np.ravel(course[1:]), np.ravel(course[:-1]))[0, 1]
    assert found == pytest.approx({1.0: 0.9, 0.1: 0.9**0.1, 5.0: 0.9**5}, abs=0.02)


def test_loads_are_the_feeders_own_times_the_noise_less_capacitors():
    on, off = make_scenario("ieee123"), make_scenario("ieee123", background={"capacitors": False})
    feeder = on.feeder
    assert feeder.capacitor_kvar.sum() > 0
    step = np.array([0, 0])
    outside = {}
    for scenario in (on, off):
        drawn = draw(scenario, [7, 8])
        p_ref = episode.p_ref_kw(scenario, drawn, step)
        outside[scenario], z = interval(scenario, drawn, step, np.zeros((2, 123)), p_ref)
        np.testing.assert_allclose(outside[scenario].p_load_kw, feeder.p_load_kw * (1 + 0.05 * z), rtol=1e-13)
    base = feeder.q_load_kvar * (1 + 0.05 * z)
    np.testing.assert_allclose(outside[off].q_load_kvar, base, rtol=1e-13)
    np.testing.assert_allclose(outside[on].q_load_kvar, base - feeder.capacitor_kvar, rtol=1e-13, atol=1e-12)


# --- sites in step -------------------------------------------------------------------------------


def test_sites_take_the_first_ones_window_as_often_as_asked():
    n_env = 4000
    apart, half, together = (
        draw(make_scenario("ieee123", workload={"site_correlation": c}), range(n_env)).start for c in (0.0, 0.5, 1.0)
    )
    np.testing.assert_array_equal(together, np.repeat(apart[:, :1], 5, axis=1))
    follows = half == half[:, :1]
    np.testing.assert_array_equal(half, np.where(follows, apart[:, :1], apart))
    np.testing.assert_allclose(follows[:, 1:].mean(axis=0), 0.5, atol=5 * 0.5 / np.sqrt(n_env))
    # Each site on its own: 4 of them, as a binomial.
    counts = np.bincount(follows[:, 1:].sum(axis=1), minlength=5) / n_env
    np.testing.assert_allclose(counts, np.array([1, 4, 6, 4, 1]) / 16, atol=0.03)
    # And each as in any company.
    alone = draw(make_scenario("ieee123", workload={"site_correlation": 0.5}), [17])
    assert alone.start[0].tolist() == half[17].tolist()


@pytest.mark.parametrize("n", [0, 1])
def test_correlation_needs_no_other_site(n):
    scenario = make_scenario(
        "toy6", n_datacenters=n, datacenters={"buses": (4,) * n}, workload={"site_correlation": 1.0}
    )
    assert draw(scenario, range(3)).start.shape == (3, n)


# --- composition of the work, and boost ------------------------------------------------------------


def test_composition_is_the_rows_own():
    scenario = make_scenario("ieee33-weak", datacenters={"clock_law": PrefillDecodeDvfs()}, trace="mixed", horizon=30)
    pool, drawn = trace_pool(scenario), draw(scenario, [1, 2])
    assert pool.compute_share is not None
    row, offset = np.divmod(drawn.start, pool.p_share.shape[1])
    found = episode.compute_share(scenario, drawn, np.array([3, 31]))
    assert found is not None
    for env_index, step in enumerate((3, 31)):
        wanted = [pool.compute_share[row[env_index, i], offset[env_index, i] + step] for i in range(3)]
        assert found[env_index].tolist() == wanted
    assert episode.compute_share(make_scenario("ieee33-weak"), drawn, np.array([3, 31])) is None


def test_recordings_have_the_scenarios_composition():
    trace = recording(np.linspace(0.3, 1.0, 100))
    scenario = make_scenario(
        "toy6", datacenters={"clock_law": PrefillDecodeDvfs()}, trace=trace, horizon=5, workload={"compute_share": 0.25}
    )
    simulation = Simulation(scenario, 2)
    simulation.reset([0, 1])
    for _ in range(5):
        state = simulation.step(actions(scenario, 2)).state
        np.testing.assert_allclose(state.class_arrived_kw, state.arrived_kw[..., None] * [0.25, 0.75])


@pytest.mark.slow
def test_boost_reaches_the_traces():
    plain, boosted = (
        trace_pool(make_scenario("ieee123", trace="training", datacenters={"boost_share": b})).p_share
        for b in (1.0, 1.3)
    )
    assert plain.max() <= 1.0 < boosted.max() <= 1.3
    trace = recording(np.linspace(0.1, 1.0, 300))
    pool = trace_pool(make_scenario("ieee123", trace=trace, datacenters={"boost_share": 1.2}, split="test", horizon=20))
    assert pool.p_share.max() == pytest.approx(1.2)


def test_whole_recordings_for_each_split():
    traces = tuple(recording(np.full(50, level), str(level)) for level in (1.0, 2.0, 3.0))
    with pytest.raises(TraceError, match=r"needs at least 3 recordings.*got 2"):
        Simulation(make_scenario("toy6", trace=traces[:2], workload={"recording_split": "recording"}, horizon=20), 1)
    for split in SPLITS:
        scenario = make_scenario(
            "toy6", trace=traces, workload={"recording_split": "recording"}, split=split, horizon=45
        )
        assert trace_pool(scenario).p_share.shape == (1, 50)
    with pytest.raises(TraceError, match="shorter episode"):
        Simulation(make_scenario("toy6", trace=traces, horizon=45), 1)


# --- recordings and schedules --------------------------------------------------------------------


def test_recordings_are_scaled_to_the_rating():
    one = recording(np.tile([10.0, 20.0, 40.0], 50), "one")  # kW, its peak 40
    two = recording(np.full(150, 7.0), "two")
    scenario = make_scenario(
        "ieee33-weak", trace=(one, two), horizon=5, datacenters={"p_rated_kw": (100.0, 200.0, 300.0)}
    )
    simulation = Simulation(scenario, 20)
    simulation.reset(range(20))
    seen = [simulation.now.p_ref_next_kw]
    for _ in range(5):
        simulation.step(np.ones((20, 10)))
        seen.append(simulation.now.p_ref_next_kw)
    seen = np.array(seen)
    for site, rated in enumerate((100.0, 200.0, 300.0)):
        assert set(np.round(seen[..., site] / rated, 12).ravel()) == {0.25, 0.5, 1.0}
    # Two recordings and three sites: the third shares the first one's row, if not its window.
    rows = simulation.now.episode.start // trace_pool(scenario).p_share.shape[1]
    assert np.all(rows[:, 0] != rows[:, 1])
    assert np.all(rows[:, 0] == rows[:, 2])


def test_recordings_are_averaged_onto_dt():
    trace = PowerTrace([0.0, 0.5, 1.0, 2.0, 10.0], [0.0, 8.0, 2.0, 4.0, 4.0])  # mean over 1 s: 4, 2, 4, 4, ..
    scenario = make_scenario("toy6", trace=(trace,), horizon=3)
    simulation = Simulation(scenario, 1)
    simulation.reset([0])
    p_ref = [2500.0 * share for share in (0.5, 0.25, 0.5, 0.5)]
    found = [episode.p_ref_kw(scenario, simulation.now.episode, np.array([k]))[0, 0] for k in range(4)]
    assert found == pytest.approx(p_ref)


@pytest.mark.parametrize(("seconds", "fits"), [(203, True), (199, False), (50, False)])
def test_a_recording_shorter_than_the_episode_is_a_clear_error(seconds, fits):
    # The training split is 60 % of it, and 120 actions need 122 s.
    trace = recording(np.linspace(0.5, 1.0, seconds), "mine")
    scenario = make_scenario("ieee123", trace=(trace,))
    if fits:
        assert Simulation(scenario, 1).reset([0]).observation.shape[0] == 1
        return
    with pytest.raises(TraceError, match=rf"'mine' lasts {seconds} s.*train.*122 s.*shorter episode"):
        Simulation(scenario, 1).reset([0])


def test_a_long_episode_gets_generated_rows_as_long_as_it_needs():
    scenario = make_scenario("toy6", horizon=4000)
    assert trace_pool(scenario).p_share.shape[1] >= window_steps(scenario) == 4002


def test_unknown_trace_source_lists_those_that_exist():
    with pytest.raises(ScenarioError, match=r"'nuclear'; `dcgrid list traces` lists all"):
        make_scenario("ieee123", trace="nuclear")


def test_inverter_schedule_is_injected():
    trace = recording([0.2, 0.4, 0.8, 1.0, 1.0, 0.5, 0.3, 0.1, 0.1, 0.1, 0.1], "sun")
    scenario = make_scenario("toy6", inverters={"injection": trace, "s_rated_kva": (1000.0, 500.0)}, horizon=8)
    simulation = Simulation(scenario, 2)
    simulation.reset([0, 1])
    shares = [0.2, 0.4, 0.8, 1.0, 1.0, 0.5, 0.3, 0.1, 0.1]
    for step, share in enumerate(shares):
        if step:
            simulation.step(np.ones((2, 4)))
        state = simulation.now.state
        np.testing.assert_allclose(state.p_kw[:, 1:], [[-1000.0 * share, -500.0 * share]] * 2)
        left = np.sqrt(1.0 - share**2)
        np.testing.assert_allclose(state.q_limit_kvar[:, 1:], [[1000.0 * left, 500.0 * left]] * 2, atol=1e-9)
        if step:
            np.testing.assert_allclose(state.q_kvar[:, 1:], state.q_limit_kvar[:, 1:])
    assert simulation.transition.truncated.all()


def test_without_a_schedule_inverters_inject_nothing():
    scenario = make_scenario("ieee33", inverters={"injection": None}, horizon=4)
    drawn = draw(scenario, range(20))
    assert not drawn.sun.any()
    step = np.full(20, 4)
    outside, _ = interval(scenario, drawn, step, np.zeros((20, 33)))
    assert outside.p_inverter_kw.shape == (20, scenario.inverters.count)
    assert not outside.p_inverter_kw.any()


def test_unusable_inverter_schedules_are_refused_before_the_first_episode():
    with pytest.raises(ScenarioError, match=r"inverters.injection rises to 30.*scaled_to"):
        make_scenario("toy6", inverters={"injection": recording([10.0, 30.0, 20.0], "kilowatts")})
    short = make_scenario("toy6", inverters={"injection": recording([0.1, 0.2, 0.3], "short")})
    with pytest.raises(TraceError, match="short"):
        Simulation(short, 1)
    with pytest.raises(ScenarioError, match=r"inverters\.injection is 'sun'; give 'pv', a PowerTrace"):
        make_scenario("toy6", inverters={"injection": "sun"})


def test_storage_follows_a_schedule_that_may_charge():
    scenario = make_scenario("toy6", inverters={"injection": [-0.5, -1.0, 0.0, 0.6]}, horizon=3)
    simulation = Simulation(scenario, 1)
    simulation.reset([0])
    for share, left in ((-0.5, 0.75**0.5), (-1.0, 0.0), (0.0, 1.0), (0.6, 0.8)):
        state = simulation.now.state
        assert state.p_kw[0, 1:].tolist() == [-1000.0 * share] * 2
        np.testing.assert_allclose(state.q_limit_kvar[0, 1:], 1000.0 * left)
        if not simulation.now.over.any():
            simulation.step(np.ones((1, 4)))
    with pytest.raises(ScenarioError, match=r"inverters\.injection has 3 shares; give 4 numbers from -1 to 1"):
        make_scenario("toy6", inverters={"injection": (0.0, 0.0, 0.0)}, horizon=3)
    with pytest.raises(ScenarioError, match=r"1\.5 among them"):
        make_scenario("toy6", inverters={"injection": (0.0, 0.0, 1.5, 0.0)}, horizon=3)


def test_together_is_another_row_at_the_same_time():
    scenario = make_scenario("ieee33-weak", workload={"window": "together"})
    drawn = episode.draw(scenario, np.arange(50, dtype=np.uint64), np.zeros(50, np.uint64))
    row, start = np.divmod(drawn.start, trace_pool(scenario).p_share.shape[1])
    assert (start == start[:, :1]).all()
    assert len(np.unique(start[:, 0])) > 40
    assert all(len(set(rows)) == 3 for rows in row.tolist())


def test_sites_generated_side_by_side_stay_so_together():
    site = Site("H100", 16, (Tenant("code", "llama3-70b", 1.0, 0.2),), daily_swing=0.0)
    sites = generate_sites(3, 900.0, 7, site, correlation=1.0)
    scenario = make_scenario("ieee33-weak", trace=tuple(sites), workload={"window": "together"}, horizon=100)
    seeds = np.arange(20, dtype=np.uint64)
    drawn = episode.draw(scenario, seeds, np.zeros_like(seeds))
    course = np.array([episode.p_ref_kw(scenario, drawn, np.full(20, k)) for k in range(100)])
    for env_index in range(20):
        assert np.corrcoef(course[:, env_index].T).min() > 0.95


def test_the_sun_of_an_episode_begins_anywhere_in_its_row():
    scenario = make_scenario("ieee33", inverters={"injection": "pv"}, horizon=3579)
    length = sun_rows(scenario).shape[1]
    begins = draw(scenario, range(1000)).sun % length
    # The last of its 3580 seconds is the row's last at the latest.
    assert np.unique(begins).tolist() == list(range(length - 3579))


@pytest.mark.slow
def test_a_period_of_full_load_asks_for_the_rating_and_changes_nothing_else():
    plain = make_scenario("ieee33-weak", trace="chat", horizon=20, dt_s=0.5)
    full = plain.replace(workload={"full_load_s": (2.0, 4.0)})
    drawn = draw(plain, range(3))
    asked, without = (np.array([episode.p_ref_kw(s, drawn, np.full(3, k)) for k in range(22)]) for s in (full, plain))
    inside = (np.arange(22) > 4) & (np.arange(22) <= 8)  # steps that end after 2 s and until 4 s
    np.testing.assert_array_equal(asked[~inside], without[~inside])
    np.testing.assert_array_equal(asked[inside], np.maximum(without[inside], plain.site_rated_kw))
    assert (without[inside] < plain.site_rated_kw).any()
    course, before = (rollout(s, NoControl(), [0]).series(0) for s in (full, plain))
    assert course.metrics()["unserved_kws"] == 0.0
    np.testing.assert_allclose(course.p_kw[5, : plain.datacenters.count], plain.site_rated_kw)
    assert "ttft_mean_s" in before.metrics()
    assert "ttft_mean_s" not in course.metrics()  # no request stands for that work


@pytest.mark.parametrize("period", [(4.0, 2.0), (1.0,), (0.0, float("nan")), (-1.0, 2.0), "all"])
def test_a_period_that_is_none_is_refused(period):
    with pytest.raises(ScenarioError, match=r"workload.full_load_s is .*; give its begin and its end"):
        make_scenario("toy6", workload={"full_load_s": period})
