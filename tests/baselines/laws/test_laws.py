"""Volt-var, deadband, switching reference, adaptive alpha and static rules: each law by hand on toy6's three agents."""

from typing import Any

import numpy as np
import pytest

from dcgrid_env import CostWeights, PrefillDecodeDvfs, make_scenario, sensitivity
from dcgrid_env.baselines import (
    CONTROLLERS,
    ConstantQ,
    DeadbandDroop,
    Droop,
    Local,
    NeedsPlacement,
    PlacementRule,
    SwitchingReference,
    VoltVar,
    make_controller,
    rollout,
)
from helpers.forms import each_preset
from helpers.needs import NEEDING_A_DEVICE, drives


def seen(v_pu, q_kvar: Any = 0.0, p_ref_kw=2500.0, backlog_kws=0.0, p_kw=0.0, r: Any = 0.01, x: Any = 0.02):
    """A local observation of toy6's data centre and two inverters, in physical units."""
    three = np.ones(3)
    return Local(
        v_pu=v_pu * three,
        p_kw=p_kw * three,
        q_kvar=q_kvar * three,
        p_ref_next_kw=np.array([p_ref_kw]),
        backlog_kws=np.array([backlog_kws]),
        r_pu_per_mw=r * three,
        x_pu_per_mvar=x * three,
        stored_kwh=np.zeros(0),
    )


def started(controller, **overrides):
    controller.reset(make_scenario("toy6", **overrides))
    return controller


# Toy6: the data centre has 2750 kVA and a limit of 825 kvar, the inverters 1000 kVA, all of it reactive.
@pytest.mark.parametrize(
    ("v_pu", "share"),
    [(0.90, 0.44), (0.92, 0.44), (0.95, 0.22), (0.98, 0.0), (1.0, 0.0), (1.02, 0.0), (1.05, -0.22), (1.10, -0.44)],
)
def test_volt_var_curve(v_pu, share):
    f, q = started(VoltVar(response_s=0.0)).control(seen(v_pu, q_kvar=123.0))
    assert f == pytest.approx([1410.0])
    assert q == pytest.approx([np.clip(2750.0 * share, -825.0, 825.0), 1000.0 * share, 1000.0 * share])


def test_volt_var_does_nine_tenths_of_a_step_within_the_response_time():
    _, q = started(VoltVar(), dt_s=5.0).control(seen(0.95, q_kvar=20.0))
    assert q[1] == pytest.approx(20.0 + 0.9 * (220.0 - 20.0))
    # Five steps of a fifth of it lead to the same.
    controller, q = started(VoltVar()), np.full(3, 20.0)
    for _ in range(5):
        _, q = controller.control(seen(0.95, q_kvar=q))
    assert q[1] == pytest.approx(200.0)


def test_deadband():
    droop = started(DeadbandDroop(k_share_per_pu=20.0, deadband_pu=0.01, ramp_share_per_s=0.1))
    for v in (0.991, 1.0, 1.009):
        assert droop.control(seen(v))[1] == pytest.approx([0.0] * 3, abs=1e-9)
    # 20 (0.993 - 0.99) = 0.06 of the limit beyond the band, within the ramp's 0.1
    f, q = droop.control(seen(0.987))
    assert f == pytest.approx([1410.0])
    assert q == pytest.approx([0.06 * 825.0, 60.0, 60.0])
    assert droop.control(seen(1.013))[1] == pytest.approx([-0.06 * 825.0, -60.0, -60.0])


def test_deadband_ramp_follows_dt_and_ends_at_the_limit():
    droop = DeadbandDroop(k_share_per_pu=20.0, ramp_share_per_s=0.1)
    assert started(droop).control(seen(0.90))[1] == pytest.approx([82.5, 100.0, 100.0])
    assert started(droop, dt_s=0.5).control(seen(0.90))[1] == pytest.approx([41.25, 50.0, 50.0])
    assert droop.control(seen(0.90, q_kvar=[820.0, 990.0, 400.0]))[1] == pytest.approx([825.0, 1000.0, 450.0])
    assert droop.control(seen(1.0, q_kvar=400.0))[1] == pytest.approx([358.75, 350.0, 350.0])


def test_switching_reference_halves_the_jump():
    law = started(SwitchingReference(k_q_mvar_per_pu_s=1.0, window_s=3.0))
    # Nothing is known yet: 1000 (0.99 - 1) kvar, the plain droop.
    assert law.control(seen(0.99))[1] == pytest.approx([10.0] * 3)
    # A step of 0.04 up: the references are 1 +- 0.02, and the voltage is at the upper one.
    f, q = law.control(seen(1.03, q_kvar=10.0))
    assert f == pytest.approx([1410.0])
    assert q == pytest.approx([10.0 - 10.0] * 3)
    # Down again: at 0.975 the lower one, 0.98 - 0.0075 as the larger step of 0.055 now counts.
    assert law.control(seen(0.975))[1] == pytest.approx([1000.0 * (1.0 - 0.0275 - 0.975)] * 3)
    # Three quiet steps later the jumps have left the window.
    for _ in range(2):
        law.control(seen(0.975))
    assert law.control(seen(0.975))[1] == pytest.approx([25.0] * 3)


def test_switching_reference_deadband_and_reset():
    law = started(SwitchingReference(k_q_mvar_per_pu_s=1.0, deadband_pu=0.02))
    assert law.control(seen(0.985))[1] == pytest.approx([0.0] * 3)
    assert law.control(seen(0.885))[1] == pytest.approx([1000.0 * (0.95 - 0.02 - 0.885)] * 3)
    started(law)
    assert law.control(seen(0.97))[1] == pytest.approx([10.0] * 3)


def test_switching_reference_spares_reactive_effort_under_a_square_wave():
    """Two levels for 5 s each about 1 p.u.: the droop chases them, the switching references stand still."""
    droop, law = (started(make(k_q_mvar_per_pu_s=0.5)) for make in (lambda **k: Droop(0.0, **k), SwitchingReference))
    levels = np.where(np.arange(40) // 5 % 2, 1.02, 0.98)
    moved = []
    for controller in (droop, law):
        q, total = np.zeros(3), 0.0
        for v in levels:
            _, after = controller.control(seen(v, q_kvar=q))
            q, total = after, total + np.abs(after - q).sum()
        moved.append(total)
    assert moved[1] < 0.2 * moved[0]


def test_adaptive_alpha():
    # 1250 kW s are 0.5 s of the rating, so alpha is 0.1 (1 + 2 * 0.5) = 0.2 and 250 kW are added to 1000.
    droop = started(Droop(k_p_mw_per_pu=0.0, alpha_per_s=0.1, alpha_growth_per_s=2.0))
    f, _ = droop.control(seen(1.0, p_ref_kw=1000.0, backlog_kws=1250.0))
    assert f == pytest.approx([(1250.0 - 575.0) / 1925.0 * 1410.0])


def test_adaptive_alpha_does_not_grow_with_work_done_ahead():
    droop = started(Droop(k_p_mw_per_pu=0.0, alpha_per_s=0.5, alpha_growth_per_s=9.0, memory="one_step"))
    droop.control(seen(1.0, p_ref_kw=1000.0))
    f, _ = droop.control(seen(1.0, p_ref_kw=1000.0, p_kw=1200.0))
    assert f == pytest.approx([(900.0 - 575.0) / 1925.0 * 1410.0])


def test_alpha_that_does_not_grow_is_the_plain_droop():
    plain, still, grows = Droop(10.0), Droop(10.0, alpha_growth_per_s=0.0), Droop(10.0, alpha_growth_per_s=0.5)
    scenario = make_scenario("ieee33-weak")
    runs = [rollout(scenario, droop, [5]).series(0).cost_j for droop in (plain, still, grows)]
    assert np.array_equal(runs[0], runs[1])
    assert not np.array_equal(runs[0], runs[2])


def test_constant_q():
    f, q = started(ConstantQ(-0.5)).control(seen(0.9, q_kvar=7.0))
    assert f == pytest.approx([1410.0])
    assert q == pytest.approx([-412.5, -500.0, -500.0])
    _, q = started(ConstantQ((1.0, 0.25, -1.0))).control(seen(0.9))
    assert q == pytest.approx([825.0, 250.0, -1000.0])
    assert ConstantQ(np.array([1.0, 0.25, -1.0])) == ConstantQ((1.0, 0.25, -1.0))  # pyright: ignore[reportArgumentType]
    with pytest.raises(ValueError, match="q_share has 2 shares; toy6 has 3 agents"):
        started(ConstantQ((1.0, 0.25)))


def test_placement_rule():
    rule = started(PlacementRule(at_substation=-0.2, per_r_mw_per_pu=10.0, per_x_mvar_per_pu=20.0))
    f, q = rule.control(seen(0.9, r=np.array([0.01, 0.0, 0.2]), x=np.array([0.02, 0.0, 0.0])))
    assert f == pytest.approx([1410.0])
    assert q == pytest.approx([0.3 * 825.0, -200.0, 1000.0])


@pytest.mark.parametrize("band_pu", [0.05, 0.1, 0.0])
def test_a_controller_sees_physical_voltages_and_sensitivities_whatever_the_band(band_pu):
    """Buses 4, 3 and 5 of toy6."""

    class Watching(ConstantQ):
        def control(self, local):
            self.seen = local
            return super().control(local)

    watching = Watching(0.0)
    scenario = make_scenario("toy6", cost={"band_pu": band_pu}, horizon=1, weights=CostWeights(violation=0.0))
    before = rollout(scenario, watching, [0]).series(0).v_pu[0]
    at = [scenario.feeder.index(bus) for bus in (4, 3, 5)]
    r, x = sensitivity(scenario.feeder)
    assert watching.seen.r_pu_per_mw[0] == pytest.approx(r[at, at], rel=1e-6)
    assert watching.seen.x_pu_per_mvar[0] == pytest.approx(x[at, at], rel=1e-6)
    assert watching.seen.v_pu[0] == pytest.approx(before[at], rel=1e-6)


@pytest.mark.parametrize(
    ("make", "arguments", "message"),
    [
        (VoltVar, {"response_s": -1.0}, "volt-var: response_s is -1.0"),
        (VoltVar, {"v_pu": (0.9, 1.0, 1.1)}, "v_pu has 3 points"),
        (VoltVar, {"v_pu": (0.92, 1.02, 0.98, 1.08)}, "ascending"),
        (VoltVar, {"q_share": (0.44, 0.0, 0.1, -0.44)}, "do not rise"),
        (VoltVar, {"q_share": (float("nan"), 0.0, 0.0, -0.44)}, r"q_share\[0\] is nan"),
        (DeadbandDroop, {"deadband_pu": float("inf")}, "deadband: deadband_pu is inf"),
        (SwitchingReference, {"window_s": -2.0}, "switching: window_s is -2.0"),
        (Droop, {"alpha_growth_per_s": -0.1}, "droop: alpha_growth_per_s is -0.1"),
        (ConstantQ, {"q_share": 1.5}, "constant-q: q_share is 1.5"),
        (ConstantQ, {"q_share": (0.0, float("nan"))}, "constant-q: q_share is nan"),
        (PlacementRule, {"per_r_mw_per_pu": float("nan")}, "placement: per_r_mw_per_pu is nan"),
    ],
)
def test_bad_parameters(make, arguments, message):
    with pytest.raises(ValueError, match=message):
        make(**arguments)


@pytest.mark.parametrize(
    "law", [{}, {"datacenters.clock_law": PrefillDecodeDvfs()}, {"dt_s": 0.1}], ids=["linear", "work_classes", "fast"]
)
@pytest.mark.parametrize("preset", each_preset())
def test_every_controller_runs_under_every_preset(preset, law):
    scenario = make_scenario(preset, horizon=5, **law)
    for name in CONTROLLERS:
        if not drives(name, scenario) or (name == "droop-one-step" and not scenario.sensing.preview):
            continue  # it refuses what it cannot do, see test_controllers
        controller = make_controller(name)
        if isinstance(controller, NeedsPlacement) and scenario.work_classes == 2:
            continue  # the models know the linear clock law alone, see test_model
        metrics = rollout(scenario, controller, [0, 1]).metrics()
        assert all(np.isfinite(list(m.values())).all() and m["steps"] == 5.0 for m in metrics), name


@pytest.mark.parametrize("name", [name for name in CONTROLLERS if name not in NEEDING_A_DEVICE])
def test_every_controller_runs_without_data_centres_or_inverters(name):
    for overrides in ({"n_datacenters": 0, "datacenters.buses": None}, {"inverters.buses": ()}):
        rollout(make_scenario("ieee123", horizon=3, **overrides), make_controller(name), [0])
