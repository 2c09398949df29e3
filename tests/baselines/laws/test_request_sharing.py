"""Request sharing: how a budget is shared, by hand, and that sites meet what they can."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from dcgrid_env import Scenario, make_scenario
from dcgrid_env.baselines import Droop, make_controller, rollout
from dcgrid_env.baselines.laws.request_sharing import RequestSharing, shared

CAP = {"value_share": 0.42, "begin_s": 20, "ramp_s": 5, "duration_s": 30}


def asking(*targets: dict[str, Any], **overrides: Any) -> Scenario:
    request = {"targets": targets or (CAP,), "notice_s": 10.0}
    given: dict[str, Any] = {"split": "validation", "horizon": 80, "weights": {"grid_request": 30.0}}
    return make_scenario("load-target", grid_request=request, **(given | overrides))


@pytest.mark.parametrize(
    ("budget", "weights", "most", "shares"),
    [
        (6.0, [1.0, 2.0, 3.0], [9.0, 9.0, 9.0], [1.0, 2.0, 3.0]),
        (6.0, [1.0, 2.0, 3.0], [9.0, 9.0, 2.0], [4 / 3, 8 / 3, 2.0]),
        (9.0, [1.0, 2.0, 3.0], [1.0, 2.0, 3.0], [1.0, 2.0, 3.0]),
        (-1.0, [1.0, 2.0, 3.0], [1.0, 2.0, 3.0], [0.0, 0.0, 0.0]),
        (2.0, [0.0, 0.0, 1.0], [1.0, 1.0, 1.0], [0.0, 0.0, 1.0]),
    ],
)
def test_a_budget_shared_by_hand(budget, weights, most, shares):
    found = shared(np.array([budget]), np.array([weights]), np.array([most]))
    np.testing.assert_allclose(found, [shares], atol=1e-12)


amounts = hnp.arrays(float, 4, elements=st.floats(0.0, 1e3, allow_subnormal=False))


@given(st.floats(-10.0, 5e3), amounts, amounts)
def test_shares_use_the_budget_and_no_more(budget, weights, most):
    found = shared(np.array(budget), weights, most)
    assert (found >= 0.0).all()
    assert (found <= most).all()
    available = most[weights > 0.0].sum()
    assert found.sum() == pytest.approx(min(max(budget, 0.0), available), rel=1e-9, abs=1e-6)


def test_sites_meet_a_cap_that_the_droop_misses():
    s = asking()
    droop, sharing = (rollout(s, law, range(4)).metrics() for law in (Droop(), RequestSharing()))
    for missed, met in zip(droop, sharing, strict=True):
        assert met["grid_request_compliance_pct"] == 100.0
        assert met["grid_request_missed_max_kw"] < 0.5
        assert met["grid_request_delivered_kwh"] == pytest.approx(met["grid_request_asked_kwh"], rel=1e-3)
        assert missed["grid_request_compliance_pct"] < 90.0


def test_without_a_request_in_force_it_is_the_droop():
    s = asking(CAP | {"begin_s": 1000})
    droop, sharing = (rollout(s, law, range(2)).series(0) for law in (Droop(), RequestSharing()))
    np.testing.assert_array_equal(droop.p_kw, sharing.p_kw)
    np.testing.assert_array_equal(droop.q_kvar, sharing.q_kvar)


def test_it_lowers_the_draw_before_a_request_by_its_ramp_in_advance():
    s = asking(CAP | {"ramp_s": 0})
    late, early = (rollout(s, RequestSharing(advance_s=a), range(4)) for a in (0.0, 8.0))
    before = slice(12, 20)
    draws = [np.mean([run.series(i).p_kw[before, :3].sum() for i in range(4)]) for run in (late, early)]
    assert draws[1] < draws[0]
    for i in range(4):
        series = early.series(i)
        most = 1.0 + (0.42 - 1.0) * np.arange(1, 8) / 8.0
        assert (series.p_kw[13:20, :3].sum(1) / 1800.0 <= most + 1e-3).all()


def test_a_target_is_met_from_the_queues():
    s = asking({"kind": "target", "value_share": 0.4, "begin_s": 20, "duration_s": 30})
    met = rollout(s, RequestSharing(), range(4)).metrics()
    assert min(m["grid_request_compliance_pct"] for m in met) > 90.0


def test_sites_with_more_queued_work_draw_more():
    s, law = asking(), RequestSharing(backlog_weight_per_s=1.0)
    law.reset(s)
    budget, arriving = np.array([300.0]), np.array([[200.0, 200.0, 200.0]])
    equal = shared(budget, arriving, arriving)
    np.testing.assert_allclose(equal, 100.0)
    unequal = shared(budget, arriving + law.backlog_weight_per_s * np.array([[0.0, 0.0, 400.0]]), arriving)
    np.testing.assert_allclose(unequal, [[60.0, 60.0, 180.0]])


def test_it_needs_no_preview_and_neither_the_paper_s_gains():
    s = asking(sensing={"preview": False})
    met = rollout(s, RequestSharing(k_p_mw_per_pu=0.0), range(2)).metrics()
    assert min(m["grid_request_compliance_pct"] for m in met) > 99.0


def test_what_it_refuses():
    with pytest.raises(ValueError, match=r"request-sharing: scenario 'ieee33' has no request of a utility; give it"):
        make_controller("request-sharing").reset(make_scenario("ieee33"))
    make: Any = RequestSharing
    for name in ("backlog_weight_per_s", "advance_s"):
        with pytest.raises(ValueError, match=f"request-sharing: {name} is -1"):
            make(**{name: -1.0})
