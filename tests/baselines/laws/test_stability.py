"""The stability bounds: against closed forms, and against what the environment itself does."""

import numpy as np
import pytest

from dcgrid_env import make_scenario, sensitivity
from dcgrid_env.baselines import Droop, NoControl, rollout
from dcgrid_env.baselines.laws import stability
from dcgrid_env.baselines.laws.stability import largest_stable, placements, spectral_radius, warning, worst_radius
from dcgrid_env.traces import PowerTrace

TOY6 = (4, 3, 5)


def matrices(scenario, buses):
    at = [scenario.feeder.index(bus) for bus in buses]
    return (m[np.ix_(at, at)] for m in sensitivity(scenario.feeder))


@pytest.mark.parametrize("dt_s", [0.1, 1.0])
def test_reactive_axis_alone(dt_s):
    scenario = make_scenario("toy6", dt_s=dt_s)
    _, x = matrices(scenario, TOY6)
    bound = 2.0 / (dt_s * np.linalg.eigvalsh(x).max())
    assert largest_stable(scenario, k_p_mw_per_pu=0.0) == pytest.approx(bound, rel=1e-5)
    assert spectral_radius(scenario, TOY6, 0.0, 1.5 * bound) == pytest.approx(2.0)
    inverters = 2.0 / (dt_s * np.linalg.eigvalsh(x[1:, 1:]).max())
    assert largest_stable(scenario, k_p_mw_per_pu=0.0, datacenters=False) == pytest.approx(inverters, rel=1e-5)


@pytest.mark.parametrize("alpha_per_s", [0.0, 0.3])
def test_active_axis_alone(alpha_per_s):
    scenario = make_scenario("ieee33-weak")
    r, _ = matrices(scenario, (18, 33, 25))
    bound = (1.0 - 0.5 * alpha_per_s) / np.abs(np.linalg.eigvals(r)).max()
    found = largest_stable(scenario, k_q_mvar_per_pu_s=0.0, alpha_per_s=alpha_per_s)
    assert found == pytest.approx(bound, rel=1e-5)


def test_both_axes_by_hand():
    """One data centre alone, toy6's bus 4: q' = q - k_q (X q - R p), p' = k_p (X q - R p)."""
    scenario = make_scenario("toy6", inverters={"buses": ()})
    r, x = (m.item() for m in matrices(scenario, (4,)))
    loop = np.array([[1.0 - 5.0 * x, 5.0 * r], [40.0 * x, -40.0 * r]])
    found = spectral_radius(scenario, (4,), 40.0, 5.0)
    assert found == pytest.approx(np.abs(np.linalg.eigvals(loop)).max())


def test_the_axes_tighten_each_other():
    scenario = make_scenario("ieee123")
    k_p = [largest_stable(scenario, k_q_mvar_per_pu_s=k_q, alpha_per_s=0.3) for k_q in (0.0, 0.5, 3.0, 9.0)]
    assert k_p[0] > k_p[1] > k_p[2] > k_p[3] == 0.0


def test_drawn_placements_are_those_of_the_first_seeds():
    scenario = make_scenario("ieee123", split="validation")
    drawn = placements(scenario, 5)
    assert len(set(drawn)) == 5
    droop = Droop(k_p_mw_per_pu=10.0)
    radii = [spectral_radius(scenario, b, 10.0, 0.5, alpha_per_s=0.3) for b in drawn]
    assert worst_radius(scenario, droop, 5) == pytest.approx(max(radii))
    assert placements(make_scenario("toy6"), 5) == [TOY6]


def test_warning():
    scenario = make_scenario("ieee123")
    assert warning(scenario, Droop()) is None
    assert warning(scenario, NoControl()) is None
    assert warning(make_scenario("ieee123", n_datacenters=0), Droop(datacenters=False)) is None
    text = warning(scenario, Droop(k_p_mw_per_pu=20.0))
    assert text is not None
    assert "ieee123: k_p = 20 MW/p.u." in text


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda s: spectral_radius(s, TOY6, -1.0, 0.5), "stability: k_p_mw_per_pu is -1.0"),
        (lambda s: spectral_radius(s, (4, 3), 1.0, 0.5), "2 buses; toy6 has 3 agents"),
        (lambda s: largest_stable(s), "give one of"),
        (lambda s: largest_stable(s, k_p_mw_per_pu=1.0, k_q_mvar_per_pu_s=1.0), "give one of"),
        (lambda s: largest_stable(s, k_p_mw_per_pu=float("nan")), "k_p_mw_per_pu is nan"),
    ],
)
def test_bad_input(call, message):
    with pytest.raises(ValueError, match=message):
        call(make_scenario("toy6"))


def steady(name, **overrides):
    """A scenario in which nothing moves by itself and reactive limits are far away; sites draw 60 % of their rating."""
    trace = PowerTrace([0.0, 2000.0], [0.6, 0.6], rated_kw=1.0)
    free = {
        "background.load_sigma": 0.0,
        "trace": (trace,),
        "datacenters.s_rated_share": 20.0,
        "datacenters.q_max_share": 20.0,
        "datacenters.f_min_mhz": 10.0,
    }
    return make_scenario(name, **free, **overrides)


def last_steps_pu(scenario, droop):
    """Largest change of any voltage from step to step over the last ten steps of seed 0."""
    v = rollout(scenario, droop, [0]).series(0).v_pu
    return np.abs(np.diff(v[-11:], axis=0)).max()


@pytest.mark.parametrize(("k_p", "is_stable"), [(0.0, True), (1.0, False)])
def test_in_long_steps_a_backlog_swings_only_if_the_clock_makes_it(k_p, is_stable):
    """With steps of a minute and alpha 0.3 /s the law asks for 18 times the backlog; all that waits is served."""
    scenario, droop = steady("toy6", dt_s=60.0, horizon=18), Droop(k_p_mw_per_pu=k_p, k_q_mvar_per_pu_s=0.0)
    assert stability.is_stable(worst_radius(scenario, droop)) is is_stable
    late_mhz = rollout(scenario, droop, [0]).series(0).f_mhz[-10:]
    assert (np.ptp(late_mhz, axis=0) < 1.0).all() is np.bool_(is_stable)


@pytest.mark.parametrize(("name", "s_kva"), [("toy6", 10000.0), ("ieee123", 5000.0)])
def test_reactive_gains_about_the_bound_in_the_environment(name, s_kva):
    scenario = steady(name, inverters={"s_rated_kva": s_kva})
    bound = largest_stable(scenario, k_p_mw_per_pu=0.0, n=1)
    assert last_steps_pu(scenario, Droop(k_p_mw_per_pu=0.0, k_q_mvar_per_pu_s=0.95 * bound)) < 1e-4
    assert last_steps_pu(scenario, Droop(k_p_mw_per_pu=0.0, k_q_mvar_per_pu_s=1.1 * bound)) > 1e-1


@pytest.mark.parametrize("alpha_per_s", [0.0, 0.3])
def test_active_gains_about_the_bound_in_the_environment(alpha_per_s):
    # The exact power flow is steeper here than the linearised one, see the module; v0 keeps the draw off its limits.
    scenario = steady("toy6", source_voltage_pu=1.01, horizon=300)
    bound = largest_stable(scenario, k_q_mvar_per_pu_s=0.0, alpha_per_s=alpha_per_s)
    runs = [
        last_steps_pu(scenario, Droop(share * bound, k_q_mvar_per_pu_s=0.0, alpha_per_s=alpha_per_s))
        for share in (0.88, 1.2)
    ]
    assert runs[0] < 1e-4
    assert runs[1] > 1e-2


def test_rounding_of_a_marginal_loop_is_stable():
    assert stability.is_stable(1.0 + 1e-12)
    assert not stability.is_stable(1.001)
