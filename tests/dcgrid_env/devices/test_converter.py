"""Reactive capability of a converter: |q| <= min(q_max, sqrt(s^2 - p^2))."""

import math

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from dcgrid_env.devices.converter import dispatch

CASES = {
    # name: (s, q_max, p, setpoint) -> (q, limit); 3-4-5 triangles
    "asked for within the limit": ((500.0, 500.0, 300.0, 100.0), (100.0, 400.0)),
    "cut to the circle": ((500.0, 500.0, 300.0, 450.0), (400.0, 400.0)),
    "cut to the circle, absorbing": ((500.0, 500.0, 300.0, -450.0), (-400.0, 400.0)),
    "cut to q_max": ((500.0, 200.0, 300.0, 450.0), (200.0, 200.0)),
    "cut to q_max, absorbing": ((500.0, 200.0, 300.0, -450.0), (-200.0, 200.0)),
    "an injection counts like a draw": ((500.0, 500.0, -400.0, 450.0), (300.0, 300.0)),
    "idle": ((500.0, 500.0, 0.0, 500.0), (500.0, 500.0)),
    "none left at the rating": ((500.0, 200.0, 500.0, 200.0), (0.0, 0.0)),
    "none left, injecting at the rating": ((500.0, 200.0, -500.0, -1.0), (0.0, 0.0)),
    "none beyond it": ((500.0, 200.0, 501.0, 1.0), (0.0, 0.0)),
    "nothing asked for": ((500.0, 200.0, 100.0, 0.0), (0.0, 200.0)),
}


@pytest.mark.parametrize(("given", "wanted"), CASES.values(), ids=CASES)
def test_dispatch_worked_by_hand(given, wanted):
    q, limit = dispatch(*(np.array([x]) for x in given))
    assert [float(q[0]), float(limit[0])] == pytest.approx(wanted, rel=1e-12, abs=1e-12)


@settings(max_examples=200, deadline=None)
@given(
    s=st.floats(1.0, 1e5),
    q_share=st.floats(0.0, 1.0),
    p_share=st.floats(-1.2, 1.2),
    setpoint_share=st.floats(-3.0, 3.0),
)
def test_capability_is_kept_and_used(s, q_share, p_share, setpoint_share):
    q_max, p, setpoint = q_share * s, p_share * s, setpoint_share * s
    q, limit = (float(x[0]) for x in dispatch(*(np.array([x]) for x in (s, q_max, p, setpoint))))
    wanted = min(q_max, math.sqrt(max(s * s - p * p, 0.0)))
    assert limit == pytest.approx(wanted, rel=1e-12, abs=1e-9 * s)
    assert abs(q) <= limit <= q_max
    if abs(p) <= s:
        assert math.hypot(p, q) <= s * (1 + 1e-12)
    if abs(setpoint) <= limit:
        assert q == setpoint  # what can be given is given, to the bit
    else:
        assert q == math.copysign(limit, setpoint)


def test_numpy_and_torch_dispatch_alike():
    rng = np.random.default_rng(0)
    s, q_max = rng.uniform(1, 2, 5), rng.uniform(0, 1, 5)
    p, setpoint = rng.uniform(-2.5, 2.5, (30, 5)), rng.uniform(-2, 2, (30, 5))
    one = dispatch(s, q_max, p, setpoint)
    two = dispatch(*map(torch.tensor, (s, q_max, p, setpoint)))
    for a, b in zip(one, two, strict=True):
        np.testing.assert_array_equal(a, b.numpy())
