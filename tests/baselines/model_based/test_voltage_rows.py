"""Rows that are left out change nothing: the program's optimum is that of all rows."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import sparse
from scipy.optimize import linprog

from dcgrid_env.baselines.model_based.voltage_rows import Linear, voltage_rows

BAND, PRICE, EXCESS = 0.05, 2.0, 30.0


def _drawn(seed, level):
    rng = np.random.default_rng(seed)
    steps, n, n_dc, n_agent = 3, 4, 2, 3
    v_pu = Linear(
        1.0 + level * rng.normal(size=(steps, n)),
        0.01 * rng.normal(size=(steps, n, n_dc)),
        0.01 * rng.normal(size=(steps, n, n_agent)),
    )
    ranges = [np.sort(rng.normal(size=(steps, width, 2)), axis=-1) for width in (n_dc, n_agent)]
    own = rng.normal(size=steps * (n_dc + n_agent)) * 0.05
    return v_pu, *ranges, own


def _optimum(sizes, limits, prices, ranges):
    rows = [
        sparse.hstack([parts.get(name, sparse.csr_array((len(most), size))) for name, size in sizes.items()])
        for parts, most in limits
    ]
    found = linprog(prices, sparse.vstack(rows), np.concatenate([most for _, most in limits]), bounds=ranges)
    assert found.status == 0
    return found.fun


@settings(max_examples=60)
@given(
    seed=st.integers(0, 10_000),
    level=st.sampled_from([0.0, 0.01, 0.05, 0.2]),
    uncharged_pu=st.sampled_from([None, 0.0, 0.0083]),
)
@pytest.mark.slow
def test_the_optimum_is_that_of_all_rows(seed, level, uncharged_pu):
    v_pu, d, q, own = _drawn(seed, level)
    profile = () if uncharged_pu is None else (1.0 + 0.03 * np.random.default_rng(seed).normal(size=4), uncharged_pu)
    size = v_pu.at_zero.size
    sizes = {"d": d[..., 0].size, "q": q[..., 0].size, "e": size, "w": size}
    ranges = np.concatenate((d.reshape(-1, 2), q.reshape(-1, 2), np.tile([0.0, np.inf], (2 * size, 1))))
    prices = np.concatenate((own, np.full(size, PRICE), np.full(size, EXCESS)))
    one, every = sparse.csr_array(sparse.identity(size)), np.ones(size, bool)
    by_d, by_q = v_pu.rows(every)
    target_pu, free_pu = profile or (np.ones(4), 0.0)
    apart, off = v_pu.at_zero.ravel() - 1.0, (v_pu.at_zero - target_pu).ravel()
    all_rows = [
        ({"d": by_d, "q": by_q, "e": -one}, free_pu - off),
        ({"d": -by_d, "q": -by_q, "e": -one}, free_pu + off),
        ({"d": by_d, "q": by_q, "w": -one}, BAND - apart),
        ({"d": -by_d, "q": -by_q, "w": -one}, BAND + apart),
    ]
    expected = _optimum(sizes, all_rows, prices, ranges)
    fewer = voltage_rows(v_pu, d, q, BAND, target_pu if profile else None, free_pu)
    assert sum(len(most) for _, most in fewer.limits) <= (4 if profile else 3) * size
    left = prices.copy()
    left[: sizes["d"]] += PRICE * fewer.by_d
    left[sizes["d"] : sizes["d"] + sizes["q"]] += PRICE * fewer.by_q
    found = _optimum(sizes, fewer.limits, left, ranges) + PRICE * fewer.at_zero
    assert found == pytest.approx(expected, rel=1e-7, abs=1e-9)


def test_a_feeder_above_nominal_needs_no_row():
    v_pu, d, q, _ = _drawn(0, 0.0)
    v_pu = Linear(v_pu.at_zero + 0.04, 0.01 * v_pu.by_d, 0.01 * v_pu.by_q)
    above = voltage_rows(v_pu, d, q, BAND)
    assert sum(len(most) for _, most in above.limits) == 0
    assert above.at_zero == pytest.approx((v_pu.at_zero - 1.0).sum())
