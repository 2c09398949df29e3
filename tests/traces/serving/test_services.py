"""Services: the published statistics of the presets, the laws of tokens, and requests on demand."""

from dataclasses import replace
from statistics import NormalDist

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dcgrid_env.traces import SERVICES, Arrivals, Requests, Service, TokenLaw, TraceError, requests
from docs.studies.traces.generated_requests import FIGURES, RECORDED, TOLERANCE, fano, figures

DAY_S = 86_400.0
SEEDS = (0, 1, 2)


@pytest.fixture(scope="module")
def days():
    return {name: [requests(name, hours=24, seed=seed) for seed in SEEDS] for name in SERVICES}


@pytest.mark.parametrize("figure", FIGURES)
@pytest.mark.parametrize("name", SERVICES)
def test_figures_are_those_of_the_recording(days, name, figure):
    at = FIGURES.index(figure)
    measured = np.array([figures(day)[at] for day in days[name]])
    assert measured.mean() == pytest.approx(RECORDED[name][at], rel=TOLERANCE[at])
    # And so in each single day, but for the spread of days.
    np.testing.assert_allclose(measured, RECORDED[name][at], rtol=TOLERANCE[at] + 0.05)


def test_the_tables_of_figures_are_as_long_as_each_other():
    assert set(RECORDED) == set(SERVICES)
    assert all(len(table) == len(FIGURES) for table in (TOLERANCE, *RECORDED.values()))


def test_windows_of_the_fano_factor_are_whole():
    # Five a second for a minute and for half of another one.
    made = Requests(np.arange(0.0, 90.0, 0.2), np.ones(450, int), np.ones(450, int), 90.0)
    assert fano(made, 60.0) == 0.0
    assert fano(made, 1.0) == pytest.approx(0.0, abs=1e-9)
    assert fano(replace(made, duration_s=120.0), 60.0) == pytest.approx(75.0**2 / 225.0)
    # No window is lost to rounding.
    assert fano(replace(made, arrival_s=np.sort(made.arrival_s % 0.3), duration_s=0.3), 0.1) > 0.0


def test_the_fano_factor_of_chat_lies_between_that_of_whole_minutes_and_the_published_one(days):
    at = FIGURES.index("Fano factor at 60 s")
    assert RECORDED["chat"][at] < np.mean([figures(day)[at] for day in days["chat"]]) < 20.6


@pytest.mark.parametrize("name", SERVICES)
def test_requests_are_what_their_type_promises(days, name):
    service = SERVICES[name]
    for day in days[name]:
        assert day.arrival_s.dtype == np.float64
        assert day.context_tokens.dtype == day.generated_tokens.dtype == np.int64
        assert len(day) == len(day.arrival_s) == len(day.context_tokens) == len(day.generated_tokens)
        assert day.duration_s == DAY_S
        assert 1 <= day.context_tokens.min() <= day.context_tokens.max() <= service.context.most
        assert 1 <= day.generated_tokens.min() <= day.generated_tokens.max() <= service.generated.most


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
    law = TokenLaw(((1, 5, 1),), 999)
    even = {name: Service(name, Arrivals(5.0), law, law) for name in ("a", "b")}
    a, b = (requests(service, 0.1, 1) for service in even.values())
    assert not np.array_equal(a.arrival_s[:50], b.arrival_s[:50])
    # Contexts and answers of one law are drawn apart.
    assert not np.array_equal(a.context_tokens, a.generated_tokens)


def test_another_rate_keeps_the_shape_of_the_bursts():
    made = requests("code", 24, 1, rate_per_s=10.0)
    assert len(made) / DAY_S == pytest.approx(10.0, rel=0.05)
    # For long windows the Fano factor of a two-state process grows with the rate.
    recorded = dict(zip(FIGURES, RECORDED["code"], strict=True))
    assert fano(made, 60.0) == pytest.approx(recorded["Fano factor at 60 s"] * 10.0 / recorded["rate (1/s)"], rel=0.15)
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


@pytest.mark.parametrize(("log_mean", "log_std", "most"), [(5.0, 0.8, 10_000), (6.8, 0.87, 4142), (2.58, 1.2, 1900)])
def test_a_law_of_one_part_is_log_normal(log_mean, log_std, most):
    # Whatever its weight.
    one, two = (TokenLaw(((weight, log_mean, log_std),), most) for weight in (1.0, 0.2))
    counts = one.draw(np.random.default_rng(1), 400_000)
    np.testing.assert_array_equal(counts[:100], two.draw(np.random.default_rng(1), 400_000)[:100])
    assert one.mean == two.mean
    assert counts.mean() == pytest.approx(one.mean, rel=0.02)
    for share in (0.1, 0.5, 0.9):
        quantile = min(np.exp(log_mean + log_std * NormalDist().inv_cdf(share)), most)
        assert np.quantile(counts, share) == pytest.approx(quantile, rel=0.02, abs=0.6)


def test_a_mixture_draws_its_parts_by_their_weights():
    # Parts that do not overlap: 7, 55 and 403 tokens, give or take a few.
    law = TokenLaw(((1.0, 2.0, 0.02), (2.0, 4.0, 0.02), (5.0, 6.0, 0.02)), 1000)
    counts = law.draw(np.random.default_rng(1), 200_000)
    below = np.array([np.mean(counts < edge) for edge in (20, 150)])
    np.testing.assert_allclose(below, [1 / 8, 3 / 8], atol=0.005)
    for low, high, log_mean in ((0, 20, 2.0), (20, 150, 4.0), (150, 1000, 6.0)):
        part = counts[(counts > low) & (counts < high)]
        assert np.median(part) == pytest.approx(np.exp(log_mean), abs=0.6)
    # Weights need not add up to one.
    scaled = TokenLaw(tuple((weight / 8.0, mean, std) for weight, mean, std in law.parts), 1000)
    np.testing.assert_array_equal(scaled.draw(np.random.default_rng(1), 1000), law.draw(np.random.default_rng(1), 1000))
    assert scaled.mean == pytest.approx(law.mean)


@pytest.mark.parametrize("kind", ["context", "generated"])
@pytest.mark.parametrize("name", SERVICES)
def test_the_mean_of_a_law_is_that_of_its_draws(name, kind):
    law = getattr(SERVICES[name], kind)
    counts = law.draw(np.random.default_rng(2), 400_000)
    assert counts.mean() == pytest.approx(law.mean, rel=0.01)


@settings(max_examples=40, deadline=None)
@given(
    parts=st.lists(st.tuples(st.floats(0.1, 10.0), st.floats(2.0, 7.0), st.floats(0.01, 1.2)), min_size=1, max_size=4),
    most=st.integers(1, 5000),
    seed=st.integers(0, 2**32),
)
@pytest.mark.slow
def test_any_law_of_tokens(parts, most, seed):
    law = TokenLaw(tuple(parts), most)
    counts = law.draw(np.random.default_rng(seed), 20_000)
    assert counts.dtype == np.int64
    assert counts.shape == (20_000,)
    assert 1 <= counts.min() <= counts.max() <= most
    # Five standard errors, and what rounding does to a narrow part.
    assert counts.mean() == pytest.approx(law.mean, abs=5.0 * counts.std() / np.sqrt(20_000) + 0.5)
    assert law.draw(np.random.default_rng(seed), 0).shape == (0,)


def test_a_token_law_is_cut_at_both_ends():
    counts = TokenLaw(((1.0, 0.0, 3.0),), 7).draw(np.random.default_rng(1), 1000)
    assert set(counts) == set(range(1, 8))


@pytest.mark.parametrize(
    ("parts", "most", "message"),
    [
        (((1.0, 0.0, 1.0),), 0, r"give a part, and at least 1 token"),
        ((), 5, r"TokenLaw\(parts=\(\), most=5\): give a part"),
        (((1.0, np.nan, 1.0),), 5, r"TokenLaw: log_mean = nan is not a finite number"),
        (((1.0, 0.0, 1.0), (1.0, 0.0, 0.0)), 5, r"TokenLaw: log_std = 0.0"),
        (((0.0, 0.0, 1.0),), 5, r"TokenLaw: weight = 0.0"),
        (((1.0, 0.0, 1.0), (-1.0, 0.0, 1.0)), 5, r"TokenLaw: weight = -1.0"),
    ],
)
def test_bad_token_laws_are_named(parts, most, message):
    with pytest.raises(TraceError, match=message):
        TokenLaw(parts, most)


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
