"""Sums and extremes of voltages have the bits that NumPy gives the same reductions of rows."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from dcgrid_env.engine.physics.voltage_figures import voltage_figures


@settings(deadline=None, max_examples=60)
@given(n=st.integers(1, 1200), n_row=st.integers(1, 3), first=st.integers(0, 3), seed=st.integers(0, 2**32 - 1))
def test_bits_of_reductions(n, n_row, first, seed):
    rng = np.random.default_rng(seed)
    v = rng.normal(1.0, 0.05, (n_row, first + n)) * 10.0 ** rng.integers(-3, 2, (n_row, first + n))
    v[:, :first] = np.nan
    figures = voltage_figures(v, first, 0.05)
    deviation = np.abs(np.ascontiguousarray(v[:, first:]) - 1.0)
    assert figures.deviation_pu.tobytes() == np.add.reduce(deviation, -1).tobytes()
    assert figures.excess_pu.tobytes() == np.add.reduce(np.maximum(deviation - 0.05, 0.0), -1).tobytes()
    assert figures.lowest_pu.tobytes() == v[:, first:].min(-1).tobytes()
    assert figures.highest_pu.tobytes() == v[:, first:].max(-1).tobytes()
