"""A data centre's work and draw: steps worked by hand, and laws that hold for any sequence."""

import math
from typing import NamedTuple

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from dcgrid_env.devices import DataCenterParams, LinearDvfs, PrefillDecodeDvfs
from dcgrid_env.devices.datacenter import datacenter

# 1000 kW of which 230 idle: 770 kW of dynamic power at 1410 MHz, 385 at 705.


def params(*p_rated_kw: float) -> DataCenterParams:
    p = np.array(p_rated_kw)
    one = np.ones_like(p)
    return DataCenterParams(p, 0.23 * p, p - 0.23 * p, 210.0 * one, 1410.0 * one, 1.1 * p, 0.33 * p)


def advance(backlog_kws: float, p_ref_kw: float, f_mhz: float, dt_s: float) -> list[float]:
    done = datacenter.step(
        params(1000.0), LinearDvfs(), np.array([backlog_kws]), np.array([p_ref_kw]), np.array([f_mhz]), dt_s
    )
    return [float(field[0]) for field in done[:4]]


CASES = {
    # name: (backlog, p_ref, f, dt) -> (backlog', arrived, served, p)
    "idle at the floor": ((0.0, 230.0, 1410.0, 1.0), (0.0, 0.0, 0.0, 230.0)),
    "below the floor": ((0.0, 200.0, 1410.0, 1.0), (0.0, 0.0, 0.0, 200.0)),
    "switched off": ((0.0, 0.0, 210.0, 1.0), (0.0, 0.0, 0.0, 0.0)),
    "below the floor, with a queue": ((100.0, 200.0, 1410.0, 1.0), (0.0, 0.0, 100.0, 300.0)),
    "as asked at the top clock": ((0.0, 640.0, 1410.0, 1.0), (0.0, 410.0, 410.0, 640.0)),
    "at the rating": ((0.0, 1000.0, 1410.0, 1.0), (0.0, 770.0, 770.0, 1000.0)),
    "throttled": ((0.0, 1000.0, 705.0, 1.0), (385.0, 770.0, 385.0, 615.0)),
    "throttled for a tenth of a second": ((0.0, 1000.0, 705.0, 0.1), (38.5, 770.0, 385.0, 615.0)),
    "throttled for five seconds": ((10.0, 1000.0, 705.0, 5.0), (1935.0, 770.0, 385.0, 615.0)),
    "a clock that is just enough": ((0.0, 615.0, 705.0, 1.0), (0.0, 385.0, 385.0, 615.0)),
    "queue empty at the end": ((200.0, 430.0, 1410.0, 1.0), (0.0, 200.0, 400.0, 630.0)),
    "queue empty in mid-step": ((200.0, 430.0, 1410.0, 5.0), (0.0, 200.0, 240.0, 470.0)),
    "queue shrinks": ((500.0, 430.0, 1410.0, 0.5), (215.0, 200.0, 770.0, 1000.0)),
    "a burst on a full queue": ((5000.0, 1000.0, 1410.0, 1.0), (5000.0, 770.0, 770.0, 1000.0)),
    "more than the rating without a boost": ((0.0, 1200.0, 1410.0, 1.0), (200.0, 970.0, 770.0, 1000.0)),
    "queue grows at the lowest clock": ((1000.0, 1000.0, 141.0, 1.0), (1693.0, 770.0, 77.0, 307.0)),
}


@pytest.mark.parametrize(("given", "wanted"), CASES.values(), ids=CASES)
def test_step_worked_by_hand(given, wanted):
    assert advance(*given) == pytest.approx(wanted, rel=1e-12, abs=1e-9)


def test_a_burst_that_is_throttled_and_then_served():
    queue = []
    backlog = 0.0
    for p_ref, f in ((1000.0, 705.0), (1000.0, 705.0), (230.0, 705.0), (230.0, 1410.0), (230.0, 1410.0)):
        backlog, _, served, _ = advance(backlog, p_ref, f, 1.0)
        queue.append((backlog, served))
    assert queue == [(385.0, 385.0), (770.0, 385.0), (385.0, 385.0), (0.0, 385.0), (0.0, 0.0)]


def test_sites_and_rows_do_not_touch_each_other():
    sites = params(1000.0, 500.0)
    backlog = np.array([[0.0, 100.0], [50.0, 0.0], [0.0, 0.0]])
    p_ref = np.array([[1000.0, 500.0], [230.0, 115.0], [400.0, 100.0]])
    f = np.array([[705.0, 1410.0], [1410.0, 210.0], [210.0, 210.0]])
    together = datacenter.step(sites, LinearDvfs(), backlog, p_ref, f, 1.0)
    for row in range(3):
        for site, rated in enumerate((1000.0, 500.0)):
            at = row, slice(site, site + 1)
            alone = datacenter.step(params(rated), LinearDvfs(), backlog[at], p_ref[at], f[at], 1.0)
            assert [field[row, site] for field in together] == [field[0] for field in alone]
    np.testing.assert_allclose(together.p_kw[0], [615.0, 500.0])
    np.testing.assert_allclose(together.backlog_kws[0], [385.0, 100.0])


class _ThriftyDvfs:
    """Serves as the linear law does but draws half as much: what a model in which speed and power differ would do."""

    def serve(self, params, f_mhz, work_kw):
        served, _ = LinearDvfs().serve(params, f_mhz, work_kw)
        return served, 0.5 * served


def test_power_is_the_clock_laws_own():
    done = datacenter.step(params(1000.0), _ThriftyDvfs(), np.array([0.0]), np.array([1000.0]), np.array([705.0]), 1.0)
    assert done.served_kw == pytest.approx([385.0])
    assert done.backlog_kws == pytest.approx([385.0])
    assert done.p_kw == pytest.approx([230.0 + 192.5])


class Course(NamedTuple):
    dt_s: float
    p_ref_kw: np.ndarray
    f_mhz: np.ndarray


shares = st.one_of(st.sampled_from([0.0, 0.23, 1.0]), st.floats(0.0, 1.0))
courses = st.lists(st.tuples(shares, shares), min_size=1, max_size=120)


def _course(dt_s: float, drawn: list[tuple[float, float]]) -> Course:
    p, f = np.array(drawn).T
    return Course(dt_s, 1000.0 * p, 210.0 + 1200.0 * f)


@pytest.mark.parametrize("dt_s", [0.1, 1.0, 5.0])
@settings(max_examples=60, deadline=None)
@given(drawn=courses)
def test_laws_of_any_sequence(dt_s, drawn):
    course = _course(dt_s, drawn)
    site, backlog = params(1000.0), np.zeros(1)
    arrived, served, before = [], [], 0.0
    for p_ref, f in zip(course.p_ref_kw, course.f_mhz, strict=True):
        done = datacenter.step(site, LinearDvfs(), backlog, np.array([p_ref]), np.array([f]), dt_s)
        backlog = done.backlog_kws
        arrived.append(float(done.arrived_kw[0]))
        served.append(float(done.served_kw[0]))
        came, left, queue = dt_s * math.fsum(arrived), dt_s * math.fsum(served), float(backlog[0])
        scale = max(1.0, came)
        assert came == pytest.approx(left + queue, rel=1e-9, abs=1e-9), "work is conserved"
        assert left <= came + 1e-9 * scale, "nothing is served before it arrives"
        assert queue >= 0.0
        assert 0.0 <= served[-1] <= 770.0 * f / 1410.0 + 1e-9
        assert arrived[-1] == pytest.approx(max(p_ref - 230.0, 0.0), abs=1e-9)
        assert min(p_ref, 230.0) - 1e-9 <= done.p_kw[0] <= 1000.0 + 1e-9
        assert done.p_kw[0] == pytest.approx(min(p_ref, 230.0) + served[-1], abs=1e-9)
        if queue > 1e-6 * scale:  # work that is there is served as fast as the clock allows
            assert served[-1] == pytest.approx(770.0 * f / 1410.0, rel=1e-9)
        assert queue <= before + arrived[-1] * dt_s + 1e-9 * scale
        before = queue


@pytest.mark.parametrize("dt_s", [0.1, 1.0, 5.0])
@settings(max_examples=60, deadline=None)
@given(drawn=st.lists(st.tuples(shares, shares, shares), min_size=1, max_size=80))
@pytest.mark.slow
def test_laws_of_any_sequence_of_two_classes(dt_s, drawn):
    # Up to 1.3 of the rating, in any composition.
    p_ref_kw, f_mhz, share = np.array(drawn).T * [[1300.0], [1200.0], [1.0]] + [[0.0], [210.0], [0.0]]
    law, site, backlog = PrefillDecodeDvfs(), params(1000.0), np.zeros((1, 2))
    sites, queue = DataCenterParams(*map(torch.tensor, site)), torch.zeros((1, 2), dtype=torch.float64)
    came, left, before = np.zeros(2), np.zeros(2), 0.0
    for p_ref, f, compute in zip(p_ref_kw, f_mhz, share, strict=True):
        asked, clock, mix = np.array([p_ref]), np.array([f]), np.array([compute])
        done = datacenter.step(site, law, backlog, asked, clock, dt_s, mix, boost=True)
        asked, clock, mix = map(torch.tensor, (asked, clock, mix))
        tensors = datacenter.step(sites, law, queue, asked, clock, dt_s, mix, boost=True)
        for a, b in zip(done, tensors, strict=True):
            np.testing.assert_allclose(b.numpy(), a, rtol=1e-12, atol=1e-9)
        backlog, queue = done.class_backlog_kws, tensors.class_backlog_kws
        came, left = came + done.class_arrived_kw[0] * dt_s, left + done.class_served_kw[0] * dt_s
        scale, arrived = max(1.0, came.sum()), max(p_ref - 230.0, 0.0)
        np.testing.assert_allclose(came, left + backlog[0], rtol=1e-9, atol=1e-9, err_msg="work is conserved")
        assert np.all(left <= came + 1e-9 * scale), "nothing is served before it arrives"
        assert np.all(backlog >= 0.0)
        assert done.class_arrived_kw[0] == pytest.approx([arrived * compute, arrived * (1.0 - compute)], abs=1e-9)
        for field in ("backlog_kws", "arrived_kw", "served_kw"):
            np.testing.assert_allclose(getattr(done, field), getattr(done, f"class_{field}").sum(-1), atol=1e-9)
        # Neither faster nor hungrier than at the top clock, which serves what arrives.
        top = max(770.0, arrived)
        assert done.served_kw[0] <= top + 1e-9
        assert -1e-9 <= done.p_kw[0] - min(p_ref, 230.0) <= top + 1e-9
        if f == 1410.0:
            assert backlog.sum() <= before + 1e-9 * scale
        before = float(backlog.sum())


def test_each_row_of_a_batch_is_stepped_as_it_would_be_alone():
    rng, site = np.random.default_rng(3), params(1000.0, 400.0, 50.0)
    backlog, power = rng.uniform(0.0, 900.0, (5, 3, 2)), rng.uniform(0.2, 1.0, (5, 3)) * site.p_rated_kw
    clock, share = rng.uniform(210.0, 1410.0, (5, 3)), rng.uniform(0.0, 1.0, (5, 3))
    batch = datacenter.step(site, PrefillDecodeDvfs(), backlog, power, clock, 0.5, share)
    assert batch.class_served_kw.shape == batch.class_backlog_kws.shape == (5, 3, 2)
    for row in range(5):
        alone = datacenter.step(site, PrefillDecodeDvfs(), backlog[row], power[row], clock[row], 0.5, share[row])
        for found, wanted in zip(batch, alone, strict=True):
            np.testing.assert_array_equal(found[row], wanted)


@pytest.mark.parametrize("law", [LinearDvfs(), PrefillDecodeDvfs()])
def test_a_boost_is_for_what_arrives_and_not_for_the_backlog(law):
    share = np.array([0.5]) if law.work_classes == 2 else None
    queued = np.array([[500.0, 500.0]]) if law.work_classes == 2 else np.array([1000.0])

    def served(p_ref: float, f: float = 1410.0) -> float:
        done = datacenter.step(params(1000.0), law, queued, np.array([p_ref]), np.array([f]), 1.0, share, boost=True)
        assert done.p_kw[0] == pytest.approx(230.0 + done.served_kw[0])  # at the top clock
        return float(done.served_kw[0])

    assert served(230.0) == pytest.approx(770.0)
    assert served(900.0) == pytest.approx(770.0)
    assert served(1300.0) == pytest.approx(1070.0)  # and the queue does not grow


def test_derivatives_of_two_classes_are_finite_everywhere():
    sites = DataCenterParams(*map(torch.tensor, params(1000.0)))
    for p_ref, f, share, queued in ((0.0, 210.0, 0.0, 0.0), (230.0, 1410.0, 1.0, 0.0), (1000.0, 1410.0, 0.5, 0.0),
                                    (1300.0, 700.0, 0.3, 900.0)):  # fmt: skip
        variables = [torch.tensor(v, dtype=torch.float64, requires_grad=True) for v in
                     ([[queued, queued]], [p_ref], [f], [share])]  # fmt: skip
        backlog, power, clock, compute = variables
        done = datacenter.step(sites, PrefillDecodeDvfs(), backlog, power, clock, 1.0, compute, boost=True)
        (done.p_kw.sum() + done.backlog_kws.sum() + done.class_served_kw.sum()).backward()
        assert all(v.grad is not None and bool(torch.isfinite(v.grad).all()) for v in variables)


@pytest.mark.parametrize("dt_s", [0.1, 0.7, 5.0])
def test_rounding_leaves_no_queue_below_zero(dt_s):
    # Queues that just run empty, in so many ways that rounding takes some of them below zero and must be caught.
    rng = np.random.default_rng(5)
    backlog, p_ref = rng.uniform(0.0, 60.0, (20_000, 1)), rng.uniform(230.0, 400.0, (20_000, 1))
    done = datacenter.step(params(1000.0), LinearDvfs(), backlog, p_ref, np.full((20_000, 1), 1410.0), dt_s)
    assert np.any(backlog + (done.arrived_kw - done.served_kw) * dt_s < 0.0)
    assert np.all(done.backlog_kws >= 0.0)


@pytest.mark.parametrize("dt_s", [0.1, 1.0, 5.0])
def test_top_clock_never_queues_what_the_rating_covers(dt_s):
    rng = np.random.default_rng(3)
    p_ref = rng.uniform(0.0, 1000.0, (50, 4))
    backlog = np.zeros((50, 4))
    for _ in range(20):
        done = datacenter.step(params(*[1000.0] * 4), LinearDvfs(), backlog, p_ref, np.full((50, 4), 1410.0), dt_s)
        backlog = done.backlog_kws
        np.testing.assert_allclose(done.p_kw, p_ref, atol=1e-9)
        np.testing.assert_allclose(backlog, 0.0, atol=1e-9)


def test_numpy_and_torch_step_alike():
    rng = np.random.default_rng(4)
    sites = params(1000.0, 280.0, 2500.0)
    backlog, p_ref = rng.uniform(0, 2000, (40, 3)), rng.uniform(0, 1, (40, 3)) * sites.p_rated_kw
    f = rng.uniform(210, 1410, (40, 3))
    one = datacenter.step(sites, LinearDvfs(), backlog, p_ref, f, 0.5)
    tensors = DataCenterParams(*map(torch.tensor, sites))
    two = datacenter.step(tensors, LinearDvfs(), torch.tensor(backlog), torch.tensor(p_ref), torch.tensor(f), 0.5)
    for a, b in zip(one, two, strict=True):
        np.testing.assert_array_equal(a, b.numpy())


def test_inputs_are_left_alone():
    arrays = [np.array([100.0]), np.array([900.0]), np.array([700.0])]
    for array in arrays:
        array.flags.writeable = False  # a write would raise
    datacenter.step(params(1000.0), LinearDvfs(), arrays[0], arrays[1], arrays[2], 1.0)
