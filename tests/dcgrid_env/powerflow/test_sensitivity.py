"""Sensitivity: against a case worked by hand and against what a small injection does to LinDistFlow."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dcgrid_env import Feeder, lindistflow, load_feeder, own_sensitivity, sensitivity

SMALL_KW = 1e-3


@st.composite
def feeders(draw):
    """Trees of up to 12 buses with impedances of one decade and one closed switch at most."""
    n = draw(st.integers(2, 12))
    hang_on = [draw(st.integers(0, k)) for k in range(n - 1)]
    ohm = st.floats(0.01, 0.1)
    r, x = ([draw(ohm) for _ in hang_on] for _ in "rx")
    switch = draw(st.integers(0, 2 * n))
    if switch < n - 1:
        r[switch] = x[switch] = 0.0
    return Feeder.from_tables(
        name="drawn", base_kv=draw(st.floats(1.0, 20.0)), substation=0, v0_pu=1.0, bus_ids=range(n),
        p_load_kw=[0.0] * n, q_load_kvar=[0.0] * n, from_bus=hang_on, to_bus=range(1, n), r_ohm=r, x_ohm=x,
    )  # fmt: skip


def rises(feeder):
    """Change of every voltage, p.u. per MW and per Mvar, for a small injection at each node in turn."""
    kw = SMALL_KW * np.eye(feeder.n_bus)
    for p_kw, q_kvar in ((kw, 0.0 * kw), (0.0 * kw, kw)):
        up, down = (lindistflow(feeder, -s * p_kw, -s * q_kvar, 1.0).v_pu for s in (1.0, -1.0))
        yield ((up - down) / (2.0 * SMALL_KW / 1000.0)).T


@given(feeders())
def test_is_the_finite_difference_of_lindistflow(feeder):
    for slope, rise in zip(sensitivity(feeder), rises(feeder), strict=True):
        np.testing.assert_allclose(slope, rise, atol=1e-6 * slope.max() + 1e-9)


def test_is_what_a_small_injection_does_to_the_named_feeders(feeder):
    for slope, rise in zip(sensitivity(feeder), rises(feeder), strict=True):
        np.testing.assert_allclose(slope, rise, atol=1e-6 * slope.max())


def test_toy6_worked_by_hand():
    # 0 - 1, 1 - 2, 1 - 3, 0 - 4, 4 - 5, each 0.01 + j0.02 p.u.: the number of branches that two buses share.
    shared = np.array(
        [
            [0, 0, 0, 0, 0, 0],
            [0, 1, 1, 1, 0, 0],
            [0, 1, 2, 1, 0, 0],
            [0, 1, 1, 2, 0, 0],
            [0, 0, 0, 0, 1, 1],
            [0, 0, 0, 0, 1, 2],
        ]
    )
    slopes = sensitivity(load_feeder("toy6"))
    np.testing.assert_allclose(slopes.by_p_pu_per_mw, 0.01 * shared, rtol=1e-14)
    np.testing.assert_allclose(slopes.by_q_pu_per_mvar, 0.02 * shared, rtol=1e-14)


def test_is_per_megawatt_on_the_feeders_own_base(two_bus):
    # 1 MW through 1 ohm at 1 kV drops 1 MW * 1 ohm / (1 kV)^2 = 1 p.u.
    slopes = sensitivity(two_bus(1.0, 3.0))
    assert slopes.by_p_pu_per_mw.tolist() == [[0.0, 0.0], [0.0, 1.0]]
    assert slopes.by_q_pu_per_mvar.tolist() == [[0.0, 0.0], [0.0, 3.0]]


@given(feeders())
def test_own_sensitivity_is_the_diagonal_of_the_matrices(feeder):
    for own, matrix in zip(own_sensitivity(feeder), sensitivity(feeder), strict=True):
        np.testing.assert_allclose(own, np.diag(matrix), rtol=1e-13)


def test_own_sensitivity_makes_no_matrix():
    twin = Feeder.from_tables(
        name="fresh", base_kv=1.0, substation=0, v0_pu=1.0, bus_ids=[0, 1], p_load_kw=[0.0, 0.0],
        q_load_kvar=[0.0, 0.0], from_bus=[0], to_bus=[1], r_ohm=[1.0], x_ohm=[1.0],
    )  # fmt: skip
    own_sensitivity(twin)
    assert "path" not in vars(twin)


@pytest.mark.parametrize("function", [sensitivity, own_sensitivity])
def test_is_made_once_and_cannot_be_written(toy6, function):
    assert function(toy6) is function(toy6)
    for array in function(toy6):
        with pytest.raises(ValueError, match="read-only"):
            array[...] = 1.0
