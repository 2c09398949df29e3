"""The droop that acts once in an interval."""

import numpy as np
import pytest

from dcgrid_env import make_scenario
from dcgrid_env.apps.reproduction.sampled_droop import SampledDroop
from dcgrid_env.baselines import Droop, rollout


@pytest.fixture(scope="module")
def fine():
    return make_scenario("ieee123", split="test", dt_s=0.1, horizon=100)


def test_an_interval_of_one_step_is_the_droop(fine):
    laws = SampledDroop(k_p_mw_per_pu=10.0), Droop(k_p_mw_per_pu=10.0)
    one, other = (rollout(fine, law, [0]).series(0) for law in laws)
    np.testing.assert_array_equal(one.v_pu, other.v_pu)
    np.testing.assert_array_equal(one.backlog_kws, other.backlog_kws)


def test_reactive_power_moves_once_an_interval_by_the_gain_times_the_interval(fine):
    run = rollout(fine, SampledDroop(k_p_mw_per_pu=0.0, hold_steps=50), [0]).series(0)
    # At the top clock nothing queues, so limits of the data centres move with p_ref; the inverters' stand still.
    q = run.q_kvar[:, 5:]
    assert (q[:50] == q[0]).all()
    assert (q[50:] == q[50]).all()
    assert not (q[50] == q[0]).all()
    buses = [fine.feeder.index(bus) for bus in fine.inverters.buses]
    # Q = -k_q (V - 1) T = -500 kvar/(p.u. s) (V - 1) 5 s, cut at 50 kvar; V as observed, in float32.
    by_hand = np.clip(-500.0 * (run.v_pu[0, buses] - 1.0) * 5.0, -50.0, 50.0)
    np.testing.assert_allclose(q[0], by_hand, atol=1e-2)


def test_the_load_passes_between_measurements():
    # toy6 in steps of 0.1 s: the step at 20 s falls in the middle of an interval of 7 s and must not be held back.
    toy = make_scenario("toy6", split="test", dt_s=0.1, horizon=260)
    run = rollout(toy, SampledDroop(k_p_mw_per_pu=0.0, hold_steps=70), [0]).series(0)
    assert run.p_kw[-1, 0] == pytest.approx(2500.0, rel=1e-5)
    assert run.backlog_kws.max() == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize("wrong", [{"hold_steps": 0}, {"hold_steps": 10, "memory": "one_step"}])
def test_what_cannot_be_held(wrong):
    with pytest.raises(ValueError, match="sampled droop: hold_steps is"):
        SampledDroop(**wrong)
