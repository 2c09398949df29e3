"""How others answer what an agent injects: worked by hand, and against answering again and again."""

import numpy as np
import pytest

from dcgrid_env.baselines.model_aided.answers import answered, slopes

BY_Q = np.array([[4.0, 2.0, 1.0], [2.0, 5.0, 2.0], [1.0, 2.0, 3.0]]) * 1e-5


def test_two_agents_by_hand():
    by_q = BY_Q[:2]
    x = answered(by_q, by_q[:, :2], np.array([0.0, -1e4]))
    # The second sees 2e-5 p.u. a kvar of the first, and answers with 1e4 kvar a p.u.: -0.2 kvar.
    assert x[0] == pytest.approx(by_q[0] - 0.2 * by_q[1])
    assert x[1] == pytest.approx(by_q[1])


def test_it_is_where_answering_again_and_again_leads():
    slope, i = np.array([-2e4, -1e4, -3e4]), 0
    kvar = np.array([1.0, 0.0, 0.0])
    for _ in range(200):
        seen = kvar @ BY_Q - kvar * np.diag(BY_Q)
        kvar = 0.5 * kvar + 0.5 * np.where(np.arange(3) == i, 1.0, slope * seen)
    assert answered(BY_Q, BY_Q, slope)[i] == pytest.approx(kvar @ BY_Q, rel=1e-9)


def test_others_that_stand_still_leave_it_and_are_not_moved_by_it():
    assert answered(BY_Q, BY_Q, np.zeros(3)) == pytest.approx(BY_Q)
    assert answered(BY_Q[:1], BY_Q[:1, :1], np.array([-1e4])) == pytest.approx(BY_Q[:1])


def test_the_slope_of_a_response_is_found_and_one_that_rises_counts_as_none():
    rng = np.random.default_rng(0)
    e = rng.normal(1.0, 0.01, (500, 3))
    kvar = 30.0 + e * [-2e3, 1e3, 0.0] + rng.normal(0.0, 1.0, e.shape)
    found = slopes(e, kvar)
    assert found[0] == pytest.approx(-2e3, rel=0.02)
    assert found[1] == 0.0
    assert abs(found[2]) < 20.0
    assert (slopes(np.ones((5, 3)), kvar[:5]) == 0.0).all()
