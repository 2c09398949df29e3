"""Online feedback optimisation: a step by hand, its stability, and its limits."""

import numpy as np
import pytest

from dcgrid_env import make_scenario
from dcgrid_env.baselines import Droop, Local, rollout
from dcgrid_env.baselines.model_based.feedback import FeedbackOptimisation
from dcgrid_env.baselines.model_based.linear_model import Estimate, slopes


def on_toy6(law, v_pu, p_kw=575.0, p_ref_kw=575.0, p_ref_next_kw=575.0, backlog_kws=0.0, q_kvar=0.0):
    """Return one environment's estimate on toy6 with agents at buses 4, 3 and 5 and slopes around 1 p.u."""
    scenario = make_scenario("toy6", observe="feeder")
    law.reset(scenario)
    known = slopes(scenario, np.array([[4, 3, 5]]))
    column = np.ones((1, 1))
    seen = Local(
        v_pu=np.full((1, 3), v_pu),
        p_kw=np.array([[p_kw, 0.0, 0.0]]),
        q_kvar=np.full((1, 3), q_kvar),
        p_ref_next_kw=p_ref_next_kw * column,
        backlog_kws=backlog_kws * column,
        r_pu_per_mw=np.zeros((1, 3)),
        x_pu_per_mvar=np.zeros((1, 3)),
        stored_kwh=np.zeros((1, 0)),
    )
    limit = np.array([[825.0, 1000.0, 1000.0]])
    return Estimate(seen, np.full((1, 5), v_pu), limit, known.by_p, known.by_q, p_ref_kw * column)


def test_a_step_by_hand():
    """All buses are low by more than the width, so every multiplier is the weight of a bus, 100 / 5 = 20.

    Slopes on toy6 are in p.u. per MW and Mvar at the buses 1 to 5, with r = 0.01 and x = 0.02. The site at 4 has
    (0, 0, 0, 1, 1) r and x. The inverters have (1, 1, 2, 0, 0) x at 3 and (0, 0, 0, 1, 2) x at 5. The gain is
    k = 20 / 0.01 = 2000.
    """
    law = FeedbackOptimisation(gain=0.1, dual_step=1.0, width_pu=0.01)
    now = on_toy6(law, 0.97, p_kw=1575.0, p_ref_kw=1775.0, p_ref_next_kw=1475.0, backlog_kws=500.0)
    f_mhz, q_kvar = law.plan(now)

    # What the devices' full range does: site 1.925 MW, 0.825 Mvar, inverters 1 Mvar. Their sums at 1, 2, 3, 4, 5:
    at4, at5 = 0.01925 + 0.0165 + 0.02, 0.01925 + 0.0165 + 0.04
    curvature = {
        "d": 2000.0 * 0.01925 * (at4 + at5),
        "q": 2000.0 * 0.0165 * (at4 + at5),
        "inv_3": 2000.0 * (0.02**2 + 0.02**2 + 0.04**2),
        "inv_5": 2000.0 * (0.02 * at4 + 0.04 * at5),
    }
    # The rise of the cost for each kvar, less the effort's price 0.02 / 3 / s_rated.
    pulls = {"q": 20.0 * 0.04e-3, "inv_3": 20.0 * 0.08e-3, "inv_5": 20.0 * 0.06e-3}
    sizes, rated = {"q": 825.0, "inv_3": 1000.0, "inv_5": 1000.0}, {"q": 2750.0, "inv_3": 1000.0, "inv_5": 1000.0}
    expected = [0.1 * sizes[a] ** 2 / curvature[a] * (pulls[a] - 0.02 / 3 / rated[a]) for a in ("q", "inv_3", "inv_5")]
    assert q_kvar[0] == pytest.approx(expected)
    # 1000 kW were served of 1200 that came; 900 come now. A kW served costs 20 * 0.02e-3 and saves 9.3 / 2500.
    d = 1000.0 + 900.0 - 1200.0 + 0.1 * 1925.0**2 / curvature["d"] * (9.3 / 2500.0 - 20.0 * 0.02e-3)
    assert f_mhz[0] == pytest.approx([d / 1925.0 * 1410.0])


def test_the_multipliers_are_filtered_and_bounded():
    law = FeedbackOptimisation(dual_step=0.25, width_pu=0.01)
    on_toy6(law, 1.0)
    e = np.array([[0.004, -0.1, 0.052, 0.0, 0.004]])
    # k = 2000: l = 0.25 * 2000 e; beyond the band the excess counts once more, up to 1000 / 5 = 200.
    assert law._dual(e)[0] == pytest.approx([2.0, -20.0 - 25.0, 20.0 + 1.0, 0.0, 2.0])
    assert law._dual(e)[0] == pytest.approx([3.5, -20.0 - 43.75, 20.0 + 1.75, 0.0, 3.5])
    later = [law._dual(np.full((1, 5), -0.3)) for _ in range(40)]
    assert later[-1][0] == pytest.approx([-220.0] * 5)


def test_work_that_waits_is_served_again():
    """At 1 p.u. nothing is gained by holding back, so the clock goes up until nothing waits."""
    law = FeedbackOptimisation()
    f_mhz, q_kvar = law.plan(on_toy6(law, 1.0, p_kw=1000.0, p_ref_kw=1500.0, p_ref_next_kw=1500.0, backlog_kws=3000.0))
    assert f_mhz[0] > (1000.0 - 575.0) / 1925.0 * 1410.0
    assert q_kvar[0] == pytest.approx([0.0, 0.0, 0.0], abs=1e-9)


def moves(**parameters):
    """Mean movement of the voltages in a second at the end of a quiet toy6 on a linear grid."""
    scenario = make_scenario("toy6", background={"load_sigma": 0.0}, power_flow="lindistflow")
    v = rollout(scenario, FeedbackOptimisation(**parameters), [0]).series(0).v_pu
    return np.abs(np.diff(v[-30:], axis=0)).mean()


def test_within_its_limit_it_settles_and_well_beyond_it_oscillates():
    assert moves(gain=1.9, dual_step=1.0) < 1e-4
    assert moves(gain=0.95 * 2.0 * 1.7 / 0.3, dual_step=0.3) < 1e-4
    assert moves(gain=12.0, dual_step=1.0, width_pu=0.003) > 3e-3


@pytest.mark.parametrize(
    "spoiled", [{}, {"sensing.noise_pu": 0.01, "sensing.delay_steps": 3, "sensing.preview": False}]
)
def test_it_beats_the_droop_and_conserves_work(spoiled):
    scenario = make_scenario("ieee33-weak", split="validation", **spoiled)
    ours = rollout(scenario, FeedbackOptimisation(), range(6))
    droop = rollout(make_scenario("ieee33-weak", split="validation"), Droop(), range(6)).metrics()
    assert np.mean([m["J"] for m in ours.metrics()]) < np.mean([m["J"] for m in droop]) - 0.1
    for env_index in range(6):
        series = ours.series(env_index)
        served, arrived = (np.cumsum(x, axis=0) for x in (series.served_kw, series.arrived_kw))
        assert (served <= arrived + 1e-6).all()
        np.testing.assert_allclose((arrived - served) * scenario.dt_s, series.backlog_kws[1:], atol=1e-6)
    assert [m["arrived_kws"] for m in ours.metrics()] == [m["arrived_kws"] for m in droop]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"gain": -1.0}, "feedback: gain is -1.0; give a finite number >= 0"),
        ({"dual_step": 0.0}, "feedback: dual_step is 0.0; give a number above 0 and up to 1"),
        ({"dual_step": 1.5}, "feedback: dual_step is 1.5"),
        ({"width_pu": 0.0}, "feedback: width_pu is 0; give a number > 0"),
        ({"width_pu": float("nan")}, "feedback: width_pu is nan"),
    ],
)
def test_bad_parameters(arguments, message):
    with pytest.raises(ValueError, match=message):
        FeedbackOptimisation(**arguments)
