"""The pooled serving model: nothing is lost, and it agrees with a slow one that follows every replica and token."""

import heapq
import math
from dataclasses import asdict, replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dcgrid_env.traces import (
    GPUS,
    IDLE_SHARE,
    SERVICES,
    Arrivals,
    Requests,
    TraceError,
    replica,
    requests,
    serve,
)
from dcgrid_env.traces.serving.pool import Pool, decode_share, in_chunks

UNIT = replica("H100", "llama3-70b")
HALF_MORE: Any = 1.5
SMALL = replace(UNIT, batch_limit=3)
EVEN = replace(SERVICES["chat"], name="even", arrivals=Arrivals(1.0))


class SlowReplica:
    """One replica, event by event: reads one request at a time and gives each request of its batch a token a step."""

    def __init__(self, unit):
        self.unit = unit
        self.rise = (decode_share(unit.gpu, np.arange(257.0)) - unit.gpu.idle_share).tolist()
        self.now_s = self.read_s = self.decode_s = 0.0
        self.queue, self.reading, self.ends = [], [], []
        self.unread_s = self.step_left_s = 0.0
        self.step = 0
        self.in_step = False
        self.first_s, self.end_s = {}, {}

    def held(self):
        return len(self.queue) + len(self.reading) + len(self.ends)

    def run(self, until_s):
        while self.now_s < until_s:
            while self.queue and len(self.reading) + len(self.ends) < self.unit.batch_limit:
                self.reading.append(self.queue.pop(0))
                if len(self.reading) == 1:
                    self.unread_s = self.reading[0][1] / self.unit.prefill_tokens_per_s
            if self.ends and not self.in_step:
                self.in_step, self.step_left_s = True, self.unit.decode_step_s(len(self.ends))
            if not (self.reading or self.ends):
                self.now_s = until_s if until_s < math.inf else self.now_s
                return
            # Reading goes first, but leaves a tenth of the time to those who are being answered.
            read = (0.9 if self.ends else 1.0) if self.reading else 0.0
            decode = 1.0 - read if self.ends else 0.0
            dt_s = until_s - self.now_s
            dt_s = min(dt_s, self.unread_s / read if read else math.inf)
            dt_s = min(dt_s, self.step_left_s / decode if decode else math.inf)
            self.now_s += dt_s
            self.read_s += read * dt_s
            if decode:
                self.decode_s += decode * dt_s * self.rise[len(self.ends)]
            self.unread_s -= read * dt_s
            self.step_left_s -= decode * dt_s
            if decode and self.step_left_s <= 1e-12:
                self.step, self.in_step = self.step + 1, False
                while self.ends and self.ends[0][0] <= self.step:
                    self.end_s[heapq.heappop(self.ends)[1]] = self.now_s
            if read and self.unread_s <= 1e-12:
                number, _, tokens = self.reading.pop(0)
                self.first_s[number] = self.now_s
                if self.reading:
                    self.unread_s = self.reading[0][1] / self.unit.prefill_tokens_per_s
                if tokens == 1:
                    self.end_s[number] = self.now_s
                else:
                    heapq.heappush(self.ends, (self.step + self.in_step + tokens - 1, number))


def serve_slowly(made, unit, n_replicas):
    """Time to first token and end to end, s, and mean draw above idle, share of the GPUs' rated power: total, reading.

    A request goes to the replica that holds the fewest.
    """
    pool = [SlowReplica(unit) for _ in range(n_replicas)]
    columns = zip(made.arrival_s.tolist(), made.context_tokens.tolist(), made.generated_tokens.tolist(), strict=True)
    for number, (arrival_s, context, tokens) in enumerate(columns):
        for one in pool:
            one.run(arrival_s)
        min(pool, key=SlowReplica.held).queue.append((number, context, tokens))
    for one in pool:
        one.run(made.duration_s)
    time_s = n_replicas * made.duration_s
    reading = sum(one.read_s for one in pool) * (unit.gpu.prefill_share - unit.gpu.idle_share) / time_s
    dynamic = reading + sum(one.decode_s for one in pool) / time_s
    for one in pool:
        one.run(math.inf)
    first_s = {number: at_s for one in pool for number, at_s in one.first_s.items()}
    end_s = {number: at_s for one in pool for number, at_s in one.end_s.items()}
    numbers = range(len(made))
    return (
        np.array([first_s[i] for i in numbers]) - made.arrival_s,
        np.array([end_s[i] for i in numbers]) - made.arrival_s,
        dynamic,
        reading,
    )


def at_load(service, unit, n_replicas, load, seed=1, duration_s=600.0):
    busy_s = unit.busy_s(service.context.mean, service.generated.mean)
    return requests(service, duration_s / 3600.0, seed, rate_per_s=load * n_replicas / busy_s)


# Service, model, replicas, load: from hardly any to a queue of minutes.
CASES = [
    *((EVEN, "llama3-70b", n, load) for n in (1, 4) for load in (0.05, 0.5, 0.95)),
    *((SERVICES["chat"], "llama3-70b", n, load) for n in (1, 4) for load in (0.2, 0.7, 0.95)),
    *((SERVICES["code"], "llama3-70b", n, load) for n in (1, 4) for load in (0.05, 0.2, 0.7)),
    *((SERVICES["chat"], "deepseek-v3", 1, load) for load in (0.05, 0.5, 0.85)),
]


@pytest.mark.parametrize(("service", "model", "n_replicas", "load"), CASES)
def test_agrees_with_every_replica_and_token(service, model, n_replicas, load):
    unit = replica("H100", model)
    made = at_load(service, unit, n_replicas, load)
    assert len(made) >= 100
    served = serve(made, unit, n_replicas)
    first_s, end_s, dynamic, reading = serve_slowly(made, unit, n_replicas)
    share, compute = served.trace.power_kw[:-1], served.trace.compute_kw
    assert compute is not None
    scale = (1.0 - unit.gpu.idle_share) / (1.0 - IDLE_SHARE)
    # Reading is as long in both, but for what straddles the end.
    assert scale * compute[:-1].mean() == pytest.approx(reading, abs=1e-3)
    # Few requests on several replicas: the pool spreads them evenly at all times, real ones double up on some.
    even = 0.022 if load < 0.1 and n_replicas > 1 else 0.004
    assert scale * (share.mean() - IDLE_SHARE) == pytest.approx(dynamic, rel=0.01, abs=even)
    assert served.end_to_end_s.mean() == pytest.approx(end_s.mean(), rel=0.04, abs=0.03)
    np.testing.assert_allclose(
        np.quantile(served.end_to_end_s, [0.5, 0.9, 0.99]), np.quantile(end_s, [0.5, 0.9, 0.99]), rtol=0.1, atol=0.05
    )
    # Any replica of the pool that is free reads on, real ones have queues of their own: the pool is optimistic, by up
    # to 0.04 s on one replica and 0.12 s on four in the mean; within a queue of seconds that is little.
    optimistic_s = 0.04 if n_replicas == 1 else 0.12
    assert served.time_to_first_token_s.mean() == pytest.approx(first_s.mean(), abs=0.1 * first_s.mean() + optimistic_s)
    np.testing.assert_allclose(
        np.quantile(served.time_to_first_token_s, [0.5, 0.9]), np.quantile(first_s, [0.5, 0.9]), rtol=0.2, atol=0.25
    )


@pytest.mark.parametrize(("service", "model", "n_replicas", "load"), CASES)
def test_no_request_is_faster_than_its_replica(service, model, n_replicas, load):
    unit = replica("H100", model)
    made = at_load(service, unit, n_replicas, load, seed=2)
    served = serve(made, unit, n_replicas)
    read_s = made.context_tokens / unit.prefill_tokens_per_s
    answer_s = (made.generated_tokens - 1) * unit.decode_step_s(1)
    assert (served.time_to_first_token_s >= read_s - 1e-9).all()
    assert (served.end_to_end_s - served.time_to_first_token_s >= answer_s - 1e-9).all()
    several = made.generated_tokens > 1
    assert (served.time_per_output_token_s[several] >= unit.decode_step_s(1) - 1e-9).all()
    np.testing.assert_allclose(served.time_per_output_token_s[~several], 0.0, atol=1e-9)
    slowest_s = unit.decode_step_s(unit.batch_limit) / 0.1
    assert served.time_per_output_token_s.max() < slowest_s


def test_one_request_alone():
    made = Requests(np.array([1.03]), np.array([1401]), np.array([101]), 20.0)
    served = serve(made, UNIT, 2)
    read_s, answer_s = 1401 / UNIT.prefill_tokens_per_s, 100 * UNIT.decode_step_s(1)
    assert served.time_to_first_token_s[0] == pytest.approx(read_s)
    # To a step: its answer begins at the next one.
    assert served.end_to_end_s[0] == pytest.approx(read_s + answer_s, abs=0.1)
    assert served.time_per_output_token_s[0] == pytest.approx(UNIT.decode_step_s(1), abs=1e-3)
    assert served.queued == 0
    # One replica of two works, the other is idle.
    gpu = UNIT.gpu
    energy = read_s * (gpu.prefill_share - gpu.idle_share) + answer_s * (gpu.decode_low_share - gpu.idle_share)
    scale = (1.0 - IDLE_SHARE) / (1.0 - gpu.idle_share)
    assert served.trace.energy_kws == pytest.approx(20.0 * IDLE_SHARE + scale * energy / 2, abs=5e-3)
    before = served.trace.power_kw[:10]
    np.testing.assert_allclose(before, IDLE_SHARE, atol=1e-6)


def test_an_answer_of_one_token_ends_with_its_first():
    made = at_load(EVEN, UNIT, 1, 0.5)
    made = replace(made, generated_tokens=np.ones(len(made), int))
    served = serve(made, UNIT)
    np.testing.assert_allclose(served.end_to_end_s, served.time_to_first_token_s, atol=1e-9)


@pytest.mark.parametrize("load", [0.3, 0.9, 1.5])
def test_one_replica_gives_first_tokens_in_the_order_of_arrival(load):
    # To a step of the grid, within which the order is not followed.
    made = at_load(EVEN, UNIT, 1, load)
    first_s = made.arrival_s + serve(made, UNIT).time_to_first_token_s
    assert np.diff(first_s).min() > -0.1


@pytest.mark.parametrize("n_replicas", [1, 3])
def test_the_batch_limit_holds(n_replicas):
    made = at_load(EVEN, UNIT, n_replicas, 1.0, duration_s=200.0)
    served = serve(made, SMALL, n_replicas)
    # A place counts from the first token on, and is filled again in the next step.
    events = np.concatenate((made.arrival_s + served.time_to_first_token_s, made.arrival_s + served.end_to_end_s - 0.1))
    change = np.repeat([1, -1], len(made))
    answered = np.cumsum(change[np.lexsort((change, events))])
    assert answered.max() == 3 * n_replicas
    assert served.queued > 100


def test_a_request_waits_for_a_place():
    made = Requests(np.zeros(4), np.full(4, 100), np.full(4, 500), 60.0)
    served = serve(made, SMALL)
    assert served.time_to_first_token_s[:3].max() < 0.2
    assert served.time_to_first_token_s[3] == pytest.approx(served.end_to_end_s[0], abs=0.3)


def test_a_queue_grows_and_drains():
    made = at_load(EVEN, UNIT, 2, 1.5, duration_s=300.0)
    pool = Pool(UNIT, 2)
    waiting, answered = [], 0
    for minute in range(5):
        now = (made.arrival_s >= 60.0 * minute) & (made.arrival_s < 60.0 * (minute + 1))
        load = pool.advance(made.arrival_s[now], made.context_tokens[now], made.generated_tokens[now], 600)
        answered += load.done.shape[1]
        waiting.append(pool.waiting)
        # No replica is ever idle: a full batch draws 0.69 above idle, reading more.
        assert minute == 0 or load.dynamic.min() >= 0.69 - 1e-9
    # A third of the requests cannot be answered; the batches hold 512.
    assert (np.diff(waiting) > 0).all()
    assert waiting[-1] == pytest.approx(len(made) / 3, rel=0.3)
    assert waiting[-1] + answered == len(made)
    while pool.waiting:
        assert answered < len(made)
        answered += pool.rest().done.shape[1]
    assert answered == len(made)
    np.testing.assert_allclose(pool.rest().dynamic, 0.0, atol=1e-12)


@st.composite
def arriving(draw):
    """Requests within some steps of 0.1 s, and where these steps are cut."""
    n_steps = draw(st.integers(1, 300))
    n = draw(st.integers(0, 40))
    times = draw(st.lists(st.floats(0.0, 0.1 * n_steps, exclude_max=True), min_size=n, max_size=n))
    context = draw(st.lists(st.integers(1, 20_000), min_size=n, max_size=n))
    tokens = draw(st.lists(st.integers(1, 600), min_size=n, max_size=n))
    cuts = sorted(draw(st.sets(st.integers(1, n_steps), max_size=6)) | {n_steps})
    return np.sort(np.array(times)), np.array(context, dtype=int), np.array(tokens, dtype=int), cuts


def advanced(unit, n_replicas, made, cuts, every=1):
    """Serve in pieces that end at `cuts`; the loads, the requests answered in them, and the pool."""
    arrival_s, context, tokens, _ = made
    pool, loads, begin = Pool(unit, n_replicas, every), [], 0
    for end in cuts:
        low, high = np.searchsorted(arrival_s, [0.1 * begin, 0.1 * end if end < cuts[-1] else np.inf])
        loads.append(pool.advance(arrival_s[low:high], context[low:high], tokens[low:high], end - begin))
        begin = end
    return loads, np.concatenate([load.done for load in loads], axis=1), pool


@settings(max_examples=80, deadline=None)
@given(made=arriving(), n_replicas=st.integers(1, 5), unit=st.sampled_from([UNIT, SMALL, replica("H200", "llama3-8b")]))
@pytest.mark.slow
def test_every_request_is_answered_or_waits(made, n_replicas, unit):
    arrival_s, context, tokens, cuts = made
    loads, done, pool = advanced(unit, n_replicas, made, cuts)
    assert done.shape == (5, len(arrival_s) - pool.waiting)
    while pool.waiting:
        done = np.concatenate((done, pool.rest().done), axis=1)
    assert done.shape[1] == len(arrival_s)
    done = done[:, np.argsort(done[0])]
    np.testing.assert_array_equal(done[0], np.arange(len(arrival_s)))
    np.testing.assert_array_equal(done[1], arrival_s)
    np.testing.assert_allclose(done[4], context / unit.prefill_tokens_per_s, rtol=1e-12)
    assert (done[2] >= context / unit.prefill_tokens_per_s - 1e-9).all()
    assert (done[3] - done[2] >= (tokens - 1) * unit.decode_step_s(1) - 1e-9).all()
    for load in loads:
        assert (load.compute >= 0.0).all()
        assert (load.dynamic >= load.compute - 1e-12).all()
        assert (load.dynamic <= unit.gpu.prefill_share - unit.gpu.idle_share + 1e-12).all()


@settings(max_examples=60, deadline=None)
@given(made=arriving(), n_replicas=st.integers(1, 5))
def test_many_pieces_give_the_same_as_one(made, n_replicas):
    whole, whole_done, whole_pool = advanced(SMALL, n_replicas, made, made[3][-1:])
    parts, parts_done, parts_pool = advanced(SMALL, n_replicas, made, made[3])
    for field in ("dynamic", "compute"):
        np.testing.assert_array_equal(
            np.concatenate([getattr(load, field) for load in parts]), getattr(whole[0], field)
        )
    assert whole_pool.waiting == parts_pool.waiting
    np.testing.assert_allclose(
        parts_done[:, np.argsort(parts_done[0])], whole_done[:, np.argsort(whole_done[0])], atol=1e-9
    )


def test_answers_of_one_token_end_when_read_in_pieces_too():
    # Nothing is decoded, so no token tells the time within a piece. Each answer of one token ends with its reading.
    n = 6
    made = np.zeros(n), np.full(n, 1000), np.ones(n, dtype=int), [1, 2, 3, 40]
    for cuts in (made[3], made[3][-1:]):
        _, done, pool = advanced(UNIT, 1, made, cuts)
        assert pool.waiting == 0
        np.testing.assert_allclose(done[3], done[2], atol=1e-9)


@settings(max_examples=60, deadline=None)
@given(made=arriving(), n_replicas=st.integers(1, 5))
def test_time_of_reading_is_the_tokens_read(made, n_replicas):
    loads, _, pool = advanced(UNIT, n_replicas, made, made[3])
    while pool.waiting:
        loads.append(pool.rest())
    gpu = UNIT.gpu
    replica_s = 0.1 * n_replicas * sum(load.compute.sum() for load in loads) / (gpu.prefill_share - gpu.idle_share)
    assert replica_s * UNIT.prefill_tokens_per_s == pytest.approx(float(made[1].sum()), rel=1e-9, abs=1e-6)


def test_a_pool_reports_on_one_request_in_some():
    made = at_load(EVEN, UNIT, 1, 0.5)
    columns = (made.arrival_s, made.context_tokens, made.generated_tokens, [3000, 6000])
    all_loads, everyone, _ = advanced(UNIT, 1, columns, [3000, 6000])
    loads, some, _ = advanced(UNIT, 1, columns, [3000, 6000], every=7)
    np.testing.assert_array_equal(some, everyone[:, everyone[0] % 7 == 0])
    assert all(np.array_equal(a.dynamic, b.dynamic) for a, b in zip(all_loads, loads, strict=True))


@settings(max_examples=60, deadline=None)
@given(sizes=st.lists(st.integers(0, 30), max_size=8), n_steps=st.integers(1, 10_000), seed=st.integers(0, 2**32))
def test_chunks_neither_lose_nor_double_a_request(sizes, n_steps, seed):
    rng = np.random.default_rng(seed)
    # Times to 0.1 s, so that some fall on the edges between chunks.
    times = np.sort(rng.integers(0, n_steps, sum(sizes)).astype(np.float64) * 0.1)
    parts = [
        (part, np.full(len(part), k + 1, dtype=np.int64), rng.integers(1, 9, len(part)))
        for k, part in enumerate(np.split(times, np.cumsum(sizes)[:-1]) if sizes else [])
    ]
    chunks = list(in_chunks(iter(parts), n_steps))
    assert sum(chunk[3] for chunk in chunks) == n_steps
    for column in range(3):
        together = np.concatenate([chunk[column] for chunk in chunks])
        expected = np.concatenate([part[column] for part in parts]) if parts else np.zeros(0)
        np.testing.assert_array_equal(together, expected)
    end = 0
    for arrival_s, _, _, steps in chunks:
        assert (arrival_s >= 0.1 * end - 1e-9).all()
        end += steps
        assert (arrival_s < 0.1 * end + 1e-9).all()


@pytest.mark.parametrize("gpu", GPUS)
@pytest.mark.parametrize("load", [0.02, 0.5, 3.0])
def test_power_stays_between_idle_and_the_rating(gpu, load):
    unit = replica(gpu, "llama3-70b")
    served = serve(at_load(SERVICES["chat"], unit, 3, load), unit, 3)
    assert served.trace.power_kw.min() >= IDLE_SHARE
    highest = IDLE_SHARE + (1.0 - IDLE_SHARE) * (unit.gpu.prefill_share - unit.gpu.idle_share) / (
        1.0 - unit.gpu.idle_share
    )
    assert served.trace.power_kw.max() <= highest + 1e-6
    assert served.trace.compute_kw is not None
    assert (served.trace.compute_kw <= served.trace.power_kw - IDLE_SHARE + 1e-6).all()


def test_served_requests_come_with_their_trace():
    made = at_load(SERVICES["chat"], UNIT, 2, 1.3)
    served = serve(made, UNIT, 2)
    assert served.trace.duration_s == pytest.approx(made.duration_s)
    assert served.trace.rated_kw == 1.0
    known = served.trace.provenance
    assert (known.name, known.seed) == (made.provenance.name, made.provenance.seed)
    served_by = {"replica": asdict(UNIT), "replicas": 2}
    assert known.parameters == {**made.provenance.parameters, "served_by": served_by}
    times = served.trace.requests
    assert times is not None
    np.testing.assert_array_equal(times.arrival_s, made.arrival_s)
    np.testing.assert_array_equal(times.first_token_s, served.time_to_first_token_s)
    np.testing.assert_array_equal(times.end_s, served.end_to_end_s)
    np.testing.assert_allclose(times.prefill_s, made.context_tokens / UNIT.prefill_tokens_per_s, rtol=1e-12)
    assert (times.first_token_s >= times.prefill_s - 1e-9).all()
    late = np.count_nonzero(made.arrival_s + served.end_to_end_s > made.duration_s)
    assert served.queued == pytest.approx(late, abs=2)


def test_what_cannot_be_served_is_named():
    none = Requests(np.zeros(0), np.zeros(0, int), np.zeros(0, int), 10.0)
    with pytest.raises(TraceError, match="0 requests and n_replicas = 1; give at least one of each"):
        serve(none, UNIT)
    one = Requests(np.zeros(1), np.ones(1, int), np.ones(1, int), 10.0)
    with pytest.raises(TraceError, match="1 requests and n_replicas = 0"):
        serve(one, UNIT, 0)
    with pytest.raises(TraceError, match=r"1 requests and n_replicas = 1.5; give at least one of each, whole"):
        serve(one, UNIT, HALF_MORE)
    long = np.ones(9000, int)
    long[[8000, 8500]] = 7681, 100_000
    made = Requests(np.arange(9000.0), np.ones(9000, int), long, 9000.0)
    with pytest.raises(TraceError, match="request 8000 has an answer of 7681 tokens, more than the 7680 that can be"):
        serve(made, UNIT)
    # The longest that can be.
    assert serve(replace(made, generated_tokens=np.minimum(long, 7680)), UNIT).queued == 0


@pytest.mark.parametrize("duration_s", [0.1, 0.3, 0.7, 10.0, 299.9, 300.0, 1234.5])
def test_a_request_at_the_very_end_is_served(duration_s):
    made = Requests(np.array([0.0, duration_s]), np.full(2, 1401), np.full(2, 11), duration_s)
    served = serve(made, UNIT)
    # The trace has the step of 0.1 s in which it comes; 0.3 s are three steps but for the last bit.
    assert duration_s < served.trace.duration_s <= duration_s + 0.1 + 1e-9
    assert np.isfinite(served.end_to_end_s).all()
    read_s = 1401 / UNIT.prefill_tokens_per_s
    assert read_s - 1e-9 <= served.time_to_first_token_s[1] <= read_s + 0.1 + served.end_to_end_s[0]
    assert served.queued >= 1
    longer = serve(replace(made, duration_s=duration_s + 0.1), UNIT)
    n_steps = len(served.trace.power_kw) - 1
    np.testing.assert_array_equal(served.trace.power_kw[:n_steps], longer.trace.power_kw[:n_steps])
    np.testing.assert_array_equal(served.time_to_first_token_s, longer.time_to_first_token_s)


@pytest.mark.parametrize("step", [3, 7, 1009, 2999, 3000, 29_999])
def test_a_request_at_the_edge_of_a_step_is_served(step):
    # 0.1 k and what repeated addition gives differ in the last bit.
    for arrival_s in (step * 0.1, np.nextafter(step * 0.1, 0.0), np.nextafter(step * 0.1, 1e9)):
        served = serve(Requests(np.array([arrival_s]), np.full(1, 10), np.full(1, 5), 3000.0), UNIT)
        assert served.time_to_first_token_s[0] == pytest.approx(10 / UNIT.prefill_tokens_per_s, abs=0.11)
