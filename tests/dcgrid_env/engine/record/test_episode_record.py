"""An episode's figures against the same ones reckoned bus by bus and step by step."""

import math
from collections.abc import Iterable, Mapping
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from dcgrid_env import PrefillDecodeDvfs, Recorder, Scenario, make_scenario
from dcgrid_env.devices.datacenter.request_delay import RequestDelays
from dcgrid_env.engine.cost.reward import terms
from dcgrid_env.engine.exogenous import episode
from dcgrid_env.engine.record import episode_record
from dcgrid_env.engine.record.episode_record import Series
from dcgrid_env.engine.simulation import Simulation, Transition
from dcgrid_env.traces import RequestTimes, TraceRows
from helpers.forms import FORMS

Costs = terms(make_scenario("toy6")).kind


def record(scenario: Scenario, n_env: int, action: Any, steps: int | None = None) -> tuple[Recorder, list[Transition]]:
    simulation = Simulation(scenario, n_env)
    course = [simulation.reset(range(n_env))]
    recorder = Recorder(scenario, course[0])
    for k in range(scenario.horizon if steps is None else steps):
        course.append(simulation.step(action(k)))
        recorder.add(course[-1])
    return recorder, course


def random_action(scenario: Scenario, n_env: int, seed: int = 0) -> Any:
    rng = np.random.default_rng(seed)
    return lambda k: rng.uniform(-1, 1, (n_env, 2 * scenario.datacenters.count + scenario.inverters.count))


def only(names: Iterable[str], metrics: Mapping[str, float]) -> dict[str, float]:
    """Return some metrics; those that were added later are not computed by hand here."""
    return {name: metrics[name] for name in names}


def reckoned(scenario: Scenario, course: list[Transition], env_index: int) -> dict[str, float]:
    """The module's table, one figure after another, in plain Python."""
    steps = course[1:]
    v = [[float(x) for x in t.state.v_pu[env_index][1:]] for t in course]
    deviation = [abs(x - 1.0) for row in v[1:] for x in row]
    n, n_bus = len(deviation), scenario.feeder.n_bus - 1
    mean = sum(deviation) / n
    ever = sum(any(abs(row[bus] - 1.0) > scenario.cost.band_pu for row in v[1:]) for bus in range(n_bus))
    moves = [abs(b - a) for before, after in pairwise(v) for a, b in zip(before, after, strict=True)]
    ratings = [*scenario.datacenters.parameters.s_rated_kva, *scenario.inverters.parameters.s_rated_kva]
    effort = [abs(q) / s for t in steps for q, s in zip(t.state.q_kvar[env_index], ratings, strict=True)]
    clocks = [f / scenario.datacenters.f_max_mhz for t in steps for f in t.state.f_mhz[env_index]]
    loss = [float(t.loss_kw[env_index]) for t in steps]
    # Work, parcel by parcel, each work class of a site in its own queue.
    waits: list[tuple[float, float]] = []
    unserved = 0.0
    for own in range(scenario.datacenters.count * scenario.work_classes):
        queue: list[list[float]] = []
        for k, t in enumerate(steps):
            queue.append([k, float(t.state.class_arrived_kw[env_index].flat[own]) * scenario.dt_s])
            budget = float(t.state.class_served_kw[env_index].flat[own]) * scenario.dt_s
            while queue and budget > 1e-9:
                taken = min(budget, queue[0][1])
                waits.append(((k - queue[0][0]) * scenario.dt_s, taken))
                budget, queue[0][1] = budget - taken, queue[0][1] - taken
                if queue[0][1] <= 1e-9:
                    queue.pop(0)
        waits += [((len(steps) - k) * scenario.dt_s, kws) for k, kws in queue]
        unserved += sum(kws for _, kws in queue)
    work = sum(kws for _, kws in waits)

    def percentile(share: float) -> float:
        so_far = 0.0
        for wait, kws in sorted(waits):
            so_far += kws
            if so_far >= share * work - 1e-7 * work:
                return wait
        return 0.0

    return {
        "J": sum(float(t.cost_j[env_index]) for t in steps) / scenario.horizon,
        **{
            f"cost_{name}": sum(float(getattr(t.costs, name)[env_index]) for t in steps) / scenario.horizon
            for name in Costs._fields
        },
        "voltage_deviation_mean_pu": mean,
        "voltage_deviation_std_pu": math.sqrt(sum((d - mean) ** 2 for d in deviation) / n),
        "outside_bus_seconds_pct": 100 * sum(d > scenario.cost.band_pu for d in deviation) / n,
        "outside_buses_pct": 100 * ever / n_bus,
        "voltage_min_pu": min(min(row) for row in v[1:]),
        "voltage_max_pu": max(max(row) for row in v[1:]),
        "voltage_step_mean_pu": sum(moves) / len(moves),
        "delay_mean_s": sum(wait * kws for wait, kws in waits) / work if work else 0.0,
        "delay_p50_s": percentile(0.50),
        "delay_p95_s": percentile(0.95),
        "delay_p99_s": percentile(0.99),
        "arrived_kws": sum(float(x) for t in steps for x in t.state.arrived_kw[env_index]) * scenario.dt_s,
        "unserved_kws": unserved,
        "loss_mean_kw": sum(loss) / len(loss),
        "loss_energy_kwh": sum(loss) * scenario.dt_s / 3600,
        "q_effort_pct": 100 * sum(effort) / len(effort),
        "clock_mean_pct": 100 * sum(clocks) / len(clocks) if clocks else 100.0,
        "steps": len(steps),
        "power_flow_converged": float(steps[-1].converged[env_index]),
    }


@pytest.mark.parametrize(
    "extra", [{}, {"datacenters.clock_law": PrefillDecodeDvfs(), "trace": "mixed"}], ids=["linear", "work_classes"]
)
@pytest.mark.parametrize("dt_s", [1.0, 0.5])
@pytest.mark.parametrize("name", FORMS)
def test_metrics_of_a_short_episode(name, dt_s, extra):
    scenario = make_scenario(name, horizon=45, dt_s=dt_s, **extra)
    n_env = 3
    recorder, course = record(scenario, n_env, random_action(scenario, n_env))
    found = recorder.metrics()
    assert len(found) == n_env
    for env_index in range(n_env):
        assert all(type(value) is float and math.isfinite(value) for value in found[env_index].values())
        by_hand = reckoned(scenario, course, env_index)
        assert only(by_hand, found[env_index]) == pytest.approx(by_hand, rel=1e-6, abs=1e-7)
        terms = sum(found[env_index][f"cost_{term}"] for term in Costs._fields)
        assert terms == pytest.approx(found[env_index]["J"])
    # The episodes differ, and something happened in them.
    assert len({m["J"] for m in found}) == n_env
    assert all(m["steps"] == 45.0 and m["power_flow_converged"] == 1.0 for m in found)


def test_the_figures_say_something():
    scenario = make_scenario("ieee33-weak", horizon=60)
    recorder, course = record(scenario, 6, random_action(scenario, 6))
    found = recorder.metrics()
    for name in reckoned(scenario, course, 0).keys() - {"cost_clock", "cost_step", "cost_loss", "delay_p50_s"}:
        assert max(m[name] for m in found) > 0.0, name
    assert any(0.0 < m["outside_bus_seconds_pct"] < m["outside_buses_pct"] for m in found)


def test_a_voltage_at_the_edge_of_the_band_is_within_it():
    scenario = make_scenario("toy6", cost={"band_pu": 0.0625}, horizon=1)
    _, (begun, ended) = record(scenario, 1, random_action(scenario, 1))
    # 1 +- 0.0625 are exact in binary; of five buses two are at the edges and one is beyond.
    v_pu = np.array([[1.0, 1.0625, 0.9375, 1.0, np.nextafter(1.0625, 2.0), 1.0]])
    at_edge = ended._replace(state=ended.state._replace(v_pu=v_pu))
    found = Series(scenario, [begun, at_edge], 0).metrics()
    assert found["outside_bus_seconds_pct"] == found["outside_buses_pct"] == pytest.approx(20.0)


def test_no_datacenter_has_neither_work_nor_clock():
    scenario = make_scenario("toy6", n_datacenters=0, datacenters={"buses": ()}, horizon=5)
    recorder, course = record(scenario, 2, random_action(scenario, 2))
    for env_index, found in enumerate(recorder.metrics()):
        by_hand = reckoned(scenario, course, env_index)
        assert only(by_hand, found) == pytest.approx(by_hand)
        assert found["clock_mean_pct"] == 100.0
        assert found["delay_mean_s"] == found["arrived_kws"] == found["unserved_kws"] == 0.0


def test_series_has_the_reset_as_its_first_row():
    scenario = make_scenario("ieee33-weak", horizon=7)
    recorder, course = record(scenario, 2, random_action(scenario, 2))
    for env_index in range(2):
        series = recorder.series(env_index)
        assert series.v_pu.shape == (8, 33)
        assert series.backlog_kws.shape == (8, 3)
        for k, t in enumerate(course):
            np.testing.assert_array_equal(series.v_pu[k], t.state.v_pu[env_index])
            np.testing.assert_array_equal(series.backlog_kws[k], t.state.backlog_kws[env_index])
        for k, t in enumerate(course[1:]):
            for field in ("f_mhz", "p_kw", "q_kvar", "arrived_kw", "served_kw", "class_arrived_kw", "class_served_kw"):
                np.testing.assert_array_equal(getattr(series, field)[k], getattr(t.state, field)[env_index])
            assert series.loss_kw[k] == t.loss_kw[env_index]
            assert series.cost_j[k] == t.cost_j[env_index]
            assert {name: values[k] for name, values in series.costs.items()} == {
                name: values[env_index] for name, values in t.costs._asdict().items()
            }
        assert series.f_mhz.shape == (7, 3)
        assert series.p_kw.shape == series.q_kvar.shape == (7, 7)
        assert series.converged is True


def test_work_is_conserved_in_an_episode():
    scenario = make_scenario("ieee33-weak", horizon=40)
    recorder, _ = record(scenario, 4, random_action(scenario, 4))
    for env_index, found in enumerate(recorder.metrics()):
        series = recorder.series(env_index)
        assert found["unserved_kws"] == pytest.approx(series.backlog_kws[-1].sum(), rel=1e-9, abs=1e-6)
        served = series.served_kw.sum() * scenario.dt_s
        assert found["arrived_kws"] == pytest.approx(served + found["unserved_kws"], rel=1e-9)
        # Little's law, as the episode's own backlog has it.
        waited = series.backlog_kws[1:].sum() * scenario.dt_s
        assert found["delay_mean_s"] * found["arrived_kws"] == pytest.approx(waited, rel=1e-6)


# --- requests --------------------------------------------------------------------------------------


@pytest.fixture
def pool(monkeypatch: pytest.MonkeyPatch) -> TraceRows:
    """Four rows of 200 s of noisy load with requests of every length, which every scenario draws from."""
    rng = np.random.default_rng(0)
    arrival = np.sort(rng.uniform(0.0, 200.0, (4, 3000)), axis=1)
    first = rng.uniform(0.01, 2.0, arrival.shape)
    rows = TraceRows(
        p_share=rng.uniform(0.2, 1.0, (4, 200)),
        compute_share=rng.uniform(0.0, 1.0, (4, 200)),
        requests=tuple(map(RequestTimes, arrival, first, first + rng.uniform(0.0, 20.0, arrival.shape), 0.5 * first)),
    )
    for module in (episode, episode_record):
        monkeypatch.setattr(module, "trace_pool", lambda scenario: rows)
    return rows


def in_episode(pool: TraceRows, start: np.ndarray, steps: int) -> RequestTimes:
    """Requests of all sites that arrive within an episode's steps of a second, one after another."""
    found = []
    for position in start.tolist():
        row, offset = divmod(position, 200)
        times = np.array(pool.requests[row])
        found.append(times[:, (times[0] >= offset + 1) & (times[0] < offset + 1 + steps)])
    return RequestTimes(*np.concatenate(found, axis=1))


@pytest.mark.parametrize("dvfs", [{}, {"datacenters.clock_law": PrefillDecodeDvfs()}], ids=["linear", "work_classes"])
def test_requests_at_the_top_clock_wait_for_nothing(pool, dvfs):
    scenario = make_scenario("ieee33-weak", horizon=30, **dvfs)
    recorder, course = record(scenario, 3, lambda k: np.ones((3, 10)))
    for env_index, found in enumerate(recorder.metrics()):
        assert set(RequestDelays._fields) <= set(found)
        taken = in_episode(pool, course[0].trace_start[env_index], 30)
        assert found["requests_sampled"] == len(taken.arrival_s) > 500
        assert found["requests_unfinished_pct"] == 0.0
        assert found["ttft_mean_s"] == pytest.approx(taken.first_token_s.mean(), rel=1e-12)
        assert found["e2e_mean_s"] == pytest.approx(taken.end_s.mean(), rel=1e-12)
        assert found["ttft_p50_s"] in taken.first_token_s
        assert (taken.end_s <= found["e2e_p95_s"]).mean() == pytest.approx(0.95, abs=2e-3)
        assert found["delay_mean_s"] == 0.0


@pytest.mark.parametrize("dvfs", [{}, {"datacenters.clock_law": PrefillDecodeDvfs()}], ids=["linear", "work_classes"])
def test_requests_of_a_throttled_site_wait(pool, dvfs):
    scenario = make_scenario("ieee33-weak", horizon=30, **dvfs)
    recorder, course = record(scenario, 3, lambda k: np.tile([-0.5, 0.0] * 3 + [0.0] * 4, (3, 1)))
    for env_index, found in enumerate(recorder.metrics()):
        taken = in_episode(pool, course[0].trace_start[env_index], 30)
        assert found["requests_sampled"] == len(taken.arrival_s)
        assert found["requests_unfinished_pct"] > 5.0
        assert found["ttft_mean_s"] > taken.first_token_s.mean() + 0.3
        assert found["ttft_p50_s"] <= found["ttft_p95_s"] <= found["ttft_p99_s"]
        assert found["e2e_mean_s"] > taken.end_s.mean()
        assert found["e2e_p50_s"] <= found["e2e_p95_s"] <= found["e2e_p99_s"]
        assert all(math.isfinite(value) for value in found.values())


def test_requests_of_an_environment_that_was_reset_are_its_new_episodes(pool):
    scenario = make_scenario("ieee33-weak", horizon=10)
    simulation = Simulation(scenario, 2)
    simulation.reset([0, 1])
    for _ in range(3):
        simulation.step(np.ones((2, 10)))
    begun = simulation.reset([5, 5], np.array([True, False]))
    fresh = Simulation(scenario, 1).reset([5])
    np.testing.assert_array_equal(begun.trace_start[0], fresh.trace_start[0])
    np.testing.assert_array_equal(begun.trace_start, simulation.now.episode.start)


def test_no_site_has_no_requests(pool):
    scenario = make_scenario("toy6", n_datacenters=0, datacenters={"buses": ()}, horizon=5)
    metrics = record(scenario, 1, random_action(scenario, 1))[0].metrics()[0]
    assert set(RequestDelays._fields).isdisjoint(metrics)


def collapse() -> tuple[Scenario, Any]:
    """The site's full load, from t = 20 s on, is more than the feeder carries; only environment 1 asks for it."""
    scenario = make_scenario("toy6", datacenters={"p_rated_kw": 25_000.0}, horizon=30)
    return scenario, lambda k: np.array([[-1.0, 0, 0, 0], [1.0, 0, 0, 0], [-1.0, 0, 0, 0]])


def test_a_collapsed_environment_counts_its_own_steps_alone():
    scenario, action = collapse()
    recorder, course = record(scenario, 3, action)
    found = recorder.metrics()
    assert [m["steps"] for m in found] == [30.0, 20.0, 30.0]
    assert [m["power_flow_converged"] for m in found] == [1.0, 0.0, 1.0]
    for env_index, last in enumerate((31, 21, 31)):
        by_hand = reckoned(scenario, course[:last], env_index)
        assert only(by_hand, found[env_index]) == pytest.approx(by_hand, rel=1e-6, abs=1e-7)
    assert all(math.isfinite(value) for m in found for value in m.values())
    assert recorder.series(1).v_pu.shape == (21, 6)
    assert recorder.series(1).converged is False
    # The charge for what would have followed is in J, which is over the horizon and dearer than any other one's.
    assert found[1]["J"] > max(found[0]["J"], found[2]["J"])


def test_what_follows_an_environments_end_is_not_counted():
    scenario, action = collapse()
    recorder, course = record(scenario, 3, action)
    before = recorder.metrics()
    recorder.add(course[-1])
    recorder.add(course[5])
    assert recorder.metrics() == before


def test_metrics_before_the_end_are_refused():
    scenario, action = collapse()
    recorder, _ = record(scenario, 3, action, steps=29)
    assert not recorder.over  # environment 1 is, the others are not
    with pytest.raises(ValueError, match="not ended; step until every environment is over"):
        recorder.metrics()
    recorder, _ = record(scenario, 3, action, steps=30)
    assert recorder.over
    assert len(recorder.metrics()) == 3


def test_series_of_one_environment_is_that_of_a_batch():
    scenario = make_scenario("ieee123", horizon=5)
    recorder, course = record(scenario, 3, lambda k: np.full((3, 17), 0.3))
    alone, _ = record(scenario, 1, lambda k: np.full((1, 17), 0.3))
    assert alone.metrics()[0] == pytest.approx(recorder.metrics()[0], rel=1e-9, abs=1e-12)
    assert Series(scenario, course, 0).metrics() == recorder.metrics()[0]
