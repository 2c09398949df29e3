"""Sites: the sum of what is under their roof, load, hours of the day, shared users, and requests that come along."""

from dataclasses import replace

import numpy as np
import pytest

from dcgrid_env.traces import (
    AWAKE_SHARE,
    GPUS,
    IDLE_SHARE,
    SERVICES,
    TRACE_SOURCES,
    Arrivals,
    PowerTrace,
    RequestTimes,
    Service,
    Site,
    Tenant,
    TraceError,
    generate_site,
    generate_sites,
    generate_training,
)
from dcgrid_env.traces.serving import site

# Poisson arrivals with the tokens of the chat service: the least spread for a mean.
EVEN = replace(SERVICES["chat"], name="even", arrivals=Arrivals(1.0))


def small(load, service: str | Service = EVEN, **options):
    """Four replicas on sixteen GPUs, the same at all hours."""
    return Site("H100", 16, (Tenant(service, "llama3-70b", 1.0, load),), **{"daily_swing": 0.0, **options})


@pytest.fixture
def even_days(monkeypatch):
    """Every day has the same demand."""
    monkeypatch.setattr(site, "_DAY_SPREAD", 0.0)


@pytest.fixture
def keep_all(monkeypatch):
    """No request is left out of what comes with a trace."""
    monkeypatch.setattr(site, "_KEPT_PER_S", 1e9)


def mean_share(traces):
    return np.mean([trace.power_kw[:-1].mean() for trace in traces])


def served(trace: PowerTrace) -> RequestTimes:
    assert trace.requests is not None
    return trace.requests


def compute(trace: PowerTrace) -> np.ndarray:
    assert trace.compute_kw is not None
    return trace.compute_kw


def counts(trace, window_s):
    edges = np.arange(0.0, trace.duration_s + 0.5 * window_s, window_s)
    return np.histogram(trace.requests.arrival_s, edges)[0]


def test_rating():
    assert Site().rated_kw == pytest.approx(279.3)
    assert Site("A100", 100, (Tenant("chat", "llama3-8b", 1.0, 0.3),)).rated_kw == pytest.approx(60.0)


def test_whole_replicas_only():
    whole = Site(n_gpus=266)
    found, n = whole.replicas(whole.tenants[0])
    assert (found.n_gpus, n) == (4, 66)
    shared = Site(tenants=(Tenant("chat", "llama3-70b", 0.4, 0.3), Tenant("code", "llama3-405b", 0.3, 0.3)))
    assert [shared.replicas(tenant)[1] for tenant in shared.tenants] == [26, 9]
    # A share that means a whole number of GPUs is not rounded off below it.
    assert (
        Site("H100", 40, (Tenant("chat", "llama3-70b", 0.7, 0.3),)).replicas(Tenant("chat", "llama3-70b", 0.7, 1))[1]
        == 7
    )


def test_what_is_under_one_roof_adds_up():
    chat, code = Tenant("chat", "llama3-70b", 0.4, 0.35), Tenant("code", "llama3-70b", 0.3, 0.15)
    parts = [
        generate_site(120.0, 5, Site(tenants=tenants, training_share=training))
        for tenants, training in (((chat,), 0.0), ((chat, code), 0.0), ((chat, code), 0.3))
    ]
    share = [part.power_kw for part in parts]
    # Sixty GPUs without work lift the site no less than the floor, and not above their own ceiling.
    assert (share[1] >= share[0] - 2e-6).all()
    assert (share[1] - share[0]).max() <= 0.3 * (1.0 - IDLE_SHARE)
    training = generate_training(120.0, 5)
    np.testing.assert_allclose(share[2] - share[1], 0.3 * (training.power_kw - IDLE_SHARE), atol=3e-6)
    np.testing.assert_allclose(compute(parts[2]) - compute(parts[1]), 0.3 * compute(training), atol=3e-6)
    # One in so many requests is kept of all tenants together, so that more tenants leave fewer of each.
    own, both = (served(part).arrival_s for part in parts[:2])
    assert len(own) == pytest.approx(len(both), rel=0.5)
    np.testing.assert_array_equal(served(parts[2]).arrival_s, both)


def test_what_one_tenant_is_asked_does_not_depend_on_who_else_is_there(keep_all):
    chat, code = Tenant("chat", "llama3-70b", 0.4, 0.35), Tenant("code", "llama3-70b", 0.3, 0.15)
    own, both = (served(generate_site(60.0, 5, Site(tenants=tenants))) for tenants in ((chat,), (chat, code)))
    assert len(both.arrival_s) > len(own.arrival_s)
    mine = np.isin(both.arrival_s, own.arrival_s)
    for one, other in zip(own, both, strict=True):
        np.testing.assert_array_equal(one, other[mine])


def test_the_share_of_the_gpus_scales_what_a_tenant_draws(even_days):
    part = [generate_site(600.0, 1, Site("H100", 64, (Tenant(EVEN, "llama3-70b", s, 0.3),))) for s in (0.25, 0.5, 1.0)]
    above = [mean_share([trace]) - IDLE_SHARE for trace in part]
    np.testing.assert_allclose(above[:2], [0.25 * above[2], 0.5 * above[2]], rtol=0.05)


def test_training_alone():
    trace, training = generate_site(300.0, 4, Site(tenants=(), training_share=1.0)), generate_training(300.0, 4)
    assert trace.requests is None
    np.testing.assert_array_equal(trace.compute_kw, training.compute_kw)
    working = training.power_kw > AWAKE_SHARE
    np.testing.assert_allclose(trace.power_kw[working], training.power_kw[working], atol=2e-6)
    half = generate_site(300.0, 4, Site(tenants=(), training_share=0.5))
    np.testing.assert_allclose(
        half.power_kw[working], IDLE_SHARE + 0.5 * (training.power_kw[working] - IDLE_SHARE), atol=0.045
    )


def test_a_site_without_work_idles():
    trace = generate_site(300.0, 1, small(1e-6))
    assert trace.power_kw.min() >= IDLE_SHARE
    assert trace.power_kw.max() <= AWAKE_SHARE
    assert compute(trace).max() == 0.0
    assert len(served(trace).arrival_s) == 0


@pytest.mark.parametrize("service", [EVEN, "code"])
def test_load_is_the_rate_over_what_full_batches_serve(service, even_days):
    for load in (0.1, 0.4):
        unit = small(load, service)
        found, n = unit.replicas(unit.tenants[0])
        law = site.find_service(service)
        busy_s = found.busy_s(law.context.mean, law.generated.mean)
        rate = unit.rate_per_s(unit.tenants[0])
        assert rate == pytest.approx(load * n / busy_s)
        traces = [generate_site(1800.0, 24 * day, unit) for day in range(6)]
        # Reading does not gain by batches: it takes its share of the load at all loads.
        reading = rate / n * law.context.mean / found.prefill_tokens_per_s
        measured = np.mean([compute(trace).mean() for trace in traces]) / (1.0 - IDLE_SHARE)
        assert measured == pytest.approx(reading, rel=0.02 if service is EVEN else 0.15)


def test_a_load_above_one_is_never_answered_in_time(even_days):
    below, above = (served(generate_site(1200.0, 0, small(load))) for load in (0.85, 1.25))
    assert np.quantile(below.first_token_s, 0.99) < 2.0
    thirds = [third.mean() for third in np.array_split(above.first_token_s, 3)]
    assert thirds[0] < thirds[1] < thirds[2]
    assert thirds[2] > 60.0


@pytest.mark.parametrize("service", [EVEN, "code"])
def test_a_trace_begins_in_full_swing(service, even_days):
    rows = np.array([generate_site(120.0, 24 * day, small(0.5, service)).resample(10.0) for day in range(40)])
    begin, rest = rows[:, 0], rows[:, 4:].mean(axis=1)
    spread = np.std(begin - rest) / np.sqrt(len(rows))
    assert abs(begin.mean() - rest.mean()) < 3.0 * spread
    # Batches fill up over some 10 s; had they begun empty, the first ones would show it.
    if service is EVEN:
        assert spread < 0.01


def test_a_seed_is_an_hour_of_a_day(even_days):
    unit = small(0.2, daily_swing=0.4)
    hours = [0, 3, 6, 9, 12, 15, 18, 21]
    rate = np.mean(
        [[len(served(generate_site(900.0, 24 * day + hour, unit)).arrival_s) for hour in hours] for day in range(3)],
        axis=0,
    )
    # The hour's first quarter, on average 7.5 minutes after it began.
    expected = 1.0 + 0.4 * np.cos(2.0 * np.pi * (np.array(hours) + 0.125 - 15.0) / 24.0)
    np.testing.assert_allclose(rate / rate.mean(), expected / expected.mean(), rtol=0.05)
    known = generate_site(10.0, 24 * 7 + 15, unit).provenance.parameters
    assert known["hour"] == 15
    assert "day" not in known


@pytest.mark.parametrize("step", [1, 24])
def test_every_seed_is_a_day_of_its_own(step):
    # The hour does not matter to this site.
    rate = [len(served(generate_site(900.0, step * k, small(0.1))).arrival_s) for k in range(30)]
    spread = np.std(rate) / np.mean(rate)
    # 0.1 by the day, 0.02 by the count.
    assert 0.06 < spread < 0.15


@pytest.mark.parametrize("correlation", [0.0, 0.5, 1.0])
def test_sites_share_requests_for_that_share_of_the_time(correlation):
    # 72 blocks of ten minutes; the share of them that falls out shared has a standard error of 0.06.
    first, second = generate_sites(2, 43_200.0, 3, small(0.05), correlation=correlation)
    common = np.isin(served(first).arrival_s, served(second).arrival_s).mean()
    assert common == pytest.approx(correlation, abs=0.12)
    assert np.corrcoef(counts(first, 10.0), counts(second, 10.0))[0, 1] == pytest.approx(common, abs=0.06)
    power = np.corrcoef(first.resample(10.0), second.resample(10.0))[0, 1]
    assert power == pytest.approx(correlation, abs=0.15)


def test_shared_requests_are_the_very_same():
    first, second, third = generate_sites(3, 300.0, 3, small(0.3), correlation=1.0)
    for other in (second, third):
        for mine, theirs in zip(served(first), served(other), strict=True):
            np.testing.assert_array_equal(mine, theirs)
        working = (first.power_kw > AWAKE_SHARE) & (other.power_kw > AWAKE_SHARE)
        np.testing.assert_array_equal(first.power_kw[working], other.power_kw[working])
    # Another group has other users.
    stranger = generate_site(300.0, 3, small(0.3), correlation=1.0, group=4)
    assert not np.isin(served(stranger).arrival_s, served(first).arrival_s).any()


def test_blocks_are_shared_or_not_as_a_whole():
    first, second = generate_sites(2, 7200.0, 8, small(0.1), correlation=0.5)
    shared = np.isin(served(first).arrival_s, served(second).arrival_s)
    # Blocks begin with the warm-up, two minutes before the trace.
    block = ((served(first).arrival_s + 120.0) / 600.0).astype(int)
    per_block = [shared[block == k] for k in np.unique(block)]
    assert all(part.all() or not part.any() for part in per_block)
    assert 0 < sum(part.all() for part in per_block) < len(per_block)


@pytest.mark.slow
def test_independent_sites_have_days_of_their_own():
    groups = [generate_sites(2, 600.0, 24 * day, small(0.1)) for day in range(60)]
    pairs = np.array([[len(served(trace).arrival_s) for trace in group] for group in groups])
    assert abs(np.corrcoef(pairs.T)[0, 1]) < 0.3


@pytest.mark.slow
def test_a_site_alone_looks_the_same_whatever_the_correlation():
    figures = {}
    for correlation in (0.0, 0.5, 1.0):
        rows = []
        for seed in range(14):
            trace = generate_site(3600.0, 24 * seed, small(0.35, "chat"), correlation=correlation, group=seed)
            second = trace.resample(1.0)
            rows.append((second.mean(), second.std(), np.abs(np.diff(second)).mean(), compute(trace).mean()))
        figures[correlation] = np.array(rows)
    for correlation in (0.5, 1.0):
        a, b = figures[0.0], figures[correlation]
        error = np.sqrt((a.var(axis=0) + b.var(axis=0)) / len(a))
        np.testing.assert_array_less(np.abs(a.mean(axis=0) - b.mean(axis=0)), 3.0 * error)


@pytest.mark.parametrize("correlation", [0.0, 0.5])
@pytest.mark.parametrize("gpu", GPUS)
def test_requests_come_with_the_trace(gpu, correlation):
    tenants = (Tenant("chat", "llama3-70b", 0.5, 0.4), Tenant("code", "llama3-8b", 0.3, 0.2))
    trace = generate_site(400.0, 30, Site(gpu, 266, tenants), correlation=correlation, group=2)
    times = served(trace)
    assert len({len(values) for values in times}) == 1
    # About five a second are kept, out of some hundred; code comes in bursts.
    assert 300 < len(times.arrival_s) < 6000
    assert np.isfinite(np.stack(times)).all()
    assert (np.diff(times.arrival_s) >= 0).all()
    assert 0.0 <= times.arrival_s[0] < 5.0
    assert 395.0 < times.arrival_s[-1] < 400.0
    assert (times.first_token_s > 0).all()
    assert (times.prefill_s > 0).all()
    assert (times.first_token_s >= times.prefill_s - 1e-9).all()
    assert (times.end_s >= times.first_token_s).all()


def test_kept_requests_stand_for_all(monkeypatch):
    # Pooled over tenants with rates, contexts and answers of their own.
    generate = TRACE_SOURCES["site"].generate
    seeds = (3, 16, 35)
    kept = [generate(900.0, seed) for seed in seeds]
    monkeypatch.setattr(site, "_KEPT_PER_S", 1e9)
    every = [generate(900.0, seed) for seed in seeds]
    for some, whole in zip(kept, every, strict=True):
        assert some.power_kw.tobytes() == whole.power_kw.tobytes()
        assert compute(some).tobytes() == compute(whole).tobytes()
        assert np.isin(served(some).arrival_s, served(whole).arrival_s).all()
        assert len(served(whole).arrival_s) > 15 * len(served(some).arrival_s)
    for field in ("first_token_s", "end_s", "prefill_s"):
        some, whole = (np.concatenate([getattr(served(trace), field) for trace in each]) for each in (kept, every))
        assert some.mean() == pytest.approx(whole.mean(), rel=0.04)
        np.testing.assert_allclose(np.quantile(some, [0.5, 0.9]), np.quantile(whole, [0.5, 0.9]), rtol=0.1)


def test_few_requests_are_all_kept(monkeypatch):
    some = served(generate_site(600.0, 3, small(0.01)))
    monkeypatch.setattr(site, "_KEPT_PER_S", 1e9)
    for one, other in zip(some, served(generate_site(600.0, 3, small(0.01))), strict=True):
        np.testing.assert_array_equal(one, other)


def test_bounds_and_determinism():
    busy = Site("H100", 64, (Tenant("chat", "llama3-70b", 0.6, 2.0), Tenant("code", "llama3-8b", 0.2, 1.0)), 0.2)
    first, again, other = (generate_site(200.05, seed, busy) for seed in (3, 3, 4))
    assert first.duration_s == pytest.approx(200.1)
    assert first.power_kw.min() >= IDLE_SHARE
    assert first.power_kw.max() <= 1.0
    assert (compute(first) <= first.power_kw - IDLE_SHARE).all()
    assert first.power_kw.tobytes() == again.power_kw.tobytes()
    assert compute(first).tobytes() == compute(again).tobytes()
    for mine, theirs in zip(served(first), served(again), strict=True):
        assert mine.tobytes() == theirs.tobytes()
    assert not np.array_equal(first.power_kw, other.power_kw)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"gpu": "T4"}, r"Site.gpu = 'T4' is unknown; choose one of A100, H100, H200"),
        ({"n_gpus": 0}, r"Site.n_gpus = 0 is not a whole number of at least 1"),
        ({"n_gpus": 4.0}, r"Site.n_gpus = 4.0"),
        ({"n_gpus": True}, r"Site.n_gpus = True"),
        ({"n_gpus": 2}, r"1 of 2 H100 is less than the 4 that 'llama3-70b' needs; give it more GPUs or a smaller"),
        ({"training_share": 0.1}, r"shares of the GPUs \[0.1, 1.0\] \(training first\) must be in 0 to 1 and add up"),
        ({"tenants": ()}, r"shares of the GPUs \[0.0\]"),
        ({"training_share": -0.1}, r"shares of the GPUs \[-0.1, 1.0\]"),
        ({"training_share": np.nan}, r"shares of the GPUs \[nan, 1.0\]"),
        ({"tenants": (Tenant("chat", "llama3-70b", 1.0, 0.0),)}, r"Tenant.load = 0.0 of 'llama3-70b'"),
        ({"tenants": (Tenant("chat", "llama3-70b", 1.0, np.inf),)}, r"Tenant.load = inf"),
        ({"tenants": (Tenant("chat", "llama3-70b", 0.01, 0.3),)}, r"0.01 of 266 H100 is less than the 4"),
        ({"tenants": (Tenant("chat", "gpt", 1.0, 0.3),)}, r"model 'gpt' is unknown"),
        ({"tenants": (Tenant("mail", "llama3-8b", 1.0, 0.3),)}, r"service 'mail' is unknown; choose one of chat, code"),
        ({"daily_swing": 1.5}, r"daily_swing = 1.5 is not in 0 to 1"),
    ],
)
def test_bad_sites_are_named(options, message):
    with pytest.raises(TraceError, match=message):
        Site(**options)


@pytest.mark.parametrize(
    ("duration_s", "seed", "options", "message"),
    [
        (0.0, 1, {}, r"duration_s = 0.0"),
        (10.0, -1, {}, r"seed = -1"),
        (10.0, 1.5, {}, r"seed = 1.5"),
        (10.0, 1, {"correlation": 1.1, "group": 1}, r"correlation = 1.1 with group 1: give 0 to 1"),
        (10.0, 1, {"correlation": np.nan, "group": 1}, r"correlation = nan"),
        (10.0, 1, {"correlation": 0.5}, r"correlation = 0.5 with group None: give 0 to 1, and a group"),
        (10.0, 1, {"correlation": 0.5, "group": -2}, r"seed = -2"),
    ],
)
def test_bad_arguments_are_named(duration_s, seed, options, message):
    with pytest.raises(TraceError, match=message):
        generate_site(duration_s, seed, small(0.1), **options)
