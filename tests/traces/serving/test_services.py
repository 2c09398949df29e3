"""Services: the published statistics of the presets, the laws of tokens, and requests on demand."""

from statistics import NormalDist

import numpy as np
import pytest

from dcgrid_env.traces import SERVICES, Arrivals, Service, TokenLaw, TraceError, requests

DAY_S = 86_400.0
SEEDS = (0, 1, 2)

# Read off the hour of each service in the Azure LLM inference trace 2023 (CC-BY 4.0; Splitwise, ISCA 2024).
PUBLISHED = {
    "chat": {"rate": 5.53, "variation": 1.09, "fano 1 s": 1.39, "fano 60 s": 20.6},
    "code": {"rate": 2.57, "variation": 13.2, "fano 1 s": 13.2, "fano 60 s": 161.0},
}
TOKENS = {
    "chat": ((1020, 2734, 4142), (129, 424, 601)),
    "code": ((1469, 5186, 7436), (13, 55, 249)),
}
# Relative, of each single day of 24 h.
TOLERANCE = {"rate": 0.05, "variation": 0.05, "fano 1 s": 0.08, "fano 60 s": 0.10}
TOKEN_TOLERANCE = 0.15


@pytest.fixture(scope="module")
def days():
    return {name: [requests(name, hours=24, seed=seed) for seed in SEEDS] for name in SERVICES}


def fano(arrival_s, window_s):
    counts = np.histogram(arrival_s, np.arange(0.0, DAY_S + 0.5 * window_s, window_s))[0]
    return counts.var() / counts.mean()


@pytest.mark.parametrize("day", SEEDS)
@pytest.mark.parametrize("name", SERVICES)
def test_arrivals_reproduce_the_published_statistics(days, name, day):
    arrival_s = days[name][day].arrival_s
    gap_s = np.diff(arrival_s)
    measured = {
        "rate": len(arrival_s) / DAY_S,
        "variation": gap_s.std() / gap_s.mean(),
        "fano 1 s": fano(arrival_s, 1.0),
        "fano 60 s": fano(arrival_s, 60.0),
    }
    for figure, published in PUBLISHED[name].items():
        assert measured[figure] == pytest.approx(published, rel=TOLERANCE[figure]), figure


@pytest.mark.parametrize("name", SERVICES)
def test_tokens_reproduce_the_published_quantiles(days, name):
    for day in days[name]:
        for counts, published in zip((day.context_tokens, day.generated_tokens), TOKENS[name], strict=True):
            np.testing.assert_allclose(np.quantile(counts, [0.5, 0.9, 0.99]), published, rtol=TOKEN_TOLERANCE)


@pytest.mark.parametrize("name", SERVICES)
def test_requests_are_what_their_type_promises(days, name):
    service = SERVICES[name]
    for day in days[name]:
        assert day.arrival_s.dtype == np.float64
        assert day.context_tokens.dtype == day.generated_tokens.dtype == np.int64
        assert len(day) == len(day.arrival_s) == len(day.context_tokens) == len(day.generated_tokens)
        assert day.duration_s == DAY_S
        assert 1 <= day.context_tokens.min() <= day.context_tokens.max() == service.context.most
        assert 1 <= day.generated_tokens.min() <= day.generated_tokens.max() == service.generated.most


def test_tokens_do_not_hang_on_each_other_or_on_the_time(days):
    for day in (*days["chat"], *days["code"]):
        logs = np.log(np.stack((day.context_tokens, day.generated_tokens)))
        assert abs(np.corrcoef(logs)[0, 1]) < 0.01
        assert abs(np.corrcoef(logs[0], day.arrival_s)[0, 1]) < 0.01


@pytest.mark.parametrize("name", SERVICES)
def test_same_seed_same_bytes_and_another_seed_others(name):
    first, again, other = requests(name, 0.2, 5), requests(name, 0.2, 5), requests(name, 0.2, 6)
    for field in ("arrival_s", "context_tokens", "generated_tokens"):
        assert getattr(first, field).tobytes() == getattr(again, field).tobytes()
        assert getattr(first, field)[:20].tobytes() != getattr(other, field)[:20].tobytes()
    assert (first.name, first.provenance.seed) == (f"{name}-5", 5)


def test_the_two_services_have_streams_of_their_own():
    even = {name: Service(name, Arrivals(5.0), TokenLaw(5, 1, 999), TokenLaw(5, 1, 999)) for name in ("a", "b")}
    a, b = (requests(service, 0.1, 1) for service in even.values())
    assert not np.array_equal(a.arrival_s[:50], b.arrival_s[:50])
    # Contexts and answers of one law are drawn apart.
    assert not np.array_equal(a.context_tokens, a.generated_tokens)


def test_another_rate_keeps_the_shape_of_the_bursts():
    made = requests("code", 24, 1, rate_per_s=10.0)
    assert len(made) / DAY_S == pytest.approx(10.0, rel=0.05)
    # For long windows the Fano factor of a two-state process grows with the rate.
    assert fano(made.arrival_s, 60.0) == pytest.approx(161 * 10.0 / 2.57, rel=0.15)
    assert made.provenance.parameters["arrivals"]["rate_per_s"] == 10.0


def test_a_daily_cycle_on_request():
    flat, cycle = requests("chat", 24, 3), requests("chat", 24, 3, daily_swing=0.5)
    hours = np.arange(25) * 3600.0
    level = [np.histogram(made.arrival_s, hours)[0] / 3600.0 / 5.53 for made in (flat, cycle)]
    expected = 1.0 + 0.5 * np.cos(2.0 * np.pi * (np.arange(24) + 0.5 - 15.0) / 24.0)
    # The calm and the busy state of the chat service move an hour's count by some 8 %.
    np.testing.assert_allclose(level[0], 1.0, atol=0.25)
    np.testing.assert_allclose(level[1], expected, atol=0.3)
    assert np.corrcoef(level[1], expected)[0, 1] > 0.95
    evening = requests("chat", 6, 3, daily_swing=0.5, begin_hour=12.0)
    night = requests("chat", 6, 3, daily_swing=0.5, begin_hour=0.0)
    assert len(evening) > 2.0 * len(night)


def test_nothing_may_come():
    none = requests("chat", hours=0.001, seed=1, rate_per_s=1e-6)
    assert len(none) == 0
    assert none.arrival_s.dtype == np.float64
    assert none.context_tokens.dtype == np.int64


@pytest.mark.parametrize("law", [TokenLaw(5.0, 0.8, 10_000), TokenLaw(6.8, 0.87, 4142), TokenLaw(2.58, 1.2, 1900)])
def test_token_law_has_its_mean_and_quantiles(law):
    counts = law.draw(np.random.default_rng(1), 400_000)
    assert counts.mean() == pytest.approx(law.mean, rel=0.02)
    for share in (0.1, 0.5, 0.9):
        quantile = min(np.exp(law.log_mean + law.log_std * NormalDist().inv_cdf(share)), law.most)
        assert np.quantile(counts, share) == pytest.approx(quantile, rel=0.02, abs=0.6)


def test_a_token_law_is_cut_at_both_ends():
    counts = TokenLaw(0.0, 3.0, 7).draw(np.random.default_rng(1), 1000)
    assert set(counts) == set(range(1, 8))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((0.0, 1.0, 0), r"give a number, and at least 1"),
        ((np.nan, 1.0, 5), r"TokenLaw\(log_mean=nan, most=5\)"),
        ((0.0, 0.0, 5), r"TokenLaw.log_std = 0.0"),
    ],
)
def test_bad_token_laws_are_named(arguments, message):
    with pytest.raises(TraceError, match=message):
        TokenLaw(*arguments)


@pytest.mark.parametrize(
    ("arguments", "options", "message"),
    [
        (("email",), {}, r"service 'email' is unknown; choose one of chat, code or give a Service"),
        (("chat", 0.0), {}, r"hours = 0.0 is not a finite number above 0"),
        (("chat", np.inf), {}, r"hours = inf"),
        (("chat", 1.0, -1), {}, r"seed = -1"),
        (("chat", 1.0, 1.5), {}, r"seed = 1.5"),
        (("chat", 1.0, 1), {"rate_per_s": 0.0}, r"rate_per_s = 0.0"),
        (("chat", 1.0, 1), {"daily_swing": 1.5}, r"daily_swing = 1.5 is not in 0 to 1"),
        (("chat", 1.0, 1), {"begin_hour": 24.5}, r"begin_hour = 24.5 is not an hour of the day"),
        (("chat", 1.0, 1), {"begin_hour": np.nan}, r"begin_hour = nan"),
    ],
)
def test_bad_requests_are_named(arguments, options, message):
    with pytest.raises(TraceError, match=message):
        requests(*arguments, **options)
