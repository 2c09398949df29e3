"""The named scenarios: every constant of the design's table."""

import math
from operator import attrgetter

import numpy as np
import pytest

from dcgrid_env import (
    IDS,
    PRESETS,
    CostWeights,
    Fault,
    FeederError,
    LoadTarget,
    PowerSmoothing,
    RandomFeeders,
    Routing,
    Scenario,
    ScenarioError,
    ServiceLevels,
    action_layout,
    field_names,
    forecast,
    load_feeder,
    make_scenario,
)
from dcgrid_env.baselines import NoControl, rollout
from dcgrid_env.devices.ride_through.rules import RideThrough, UpsRideThrough
from dcgrid_env.devices.ride_through.sags import virginia_2024
from dcgrid_env.engine.family_simulation import simulation as simulation_of
from dcgrid_env.engine.simulation import Simulation
from helpers.intervals import interval

WEAK, ENDS = (7, 14, 20, 30), (18, 33, 25, 22)
I33 = (3, 7, 14, 20, 24, 30)
I123 = (2, 11, 40, 54, 87, 92, 103)

# name: feeder, v0, sites, rating, s, buses, inverters, kvar each, trace, sigma, horizon
TABLE = {
    "toy6": ("toy6", 1.0, 1, 2500.0, 1.1, (4,), (3, 5), 1000.0, "step", 0.02, 100),
    "ieee123": ("ieee123", 1.04375, 5, 280.0, 1.1, None, I123, 50.0, "inference", 0.05, 120),
    "ieee33-weak": ("ieee33", 1.05, 3, 1000.0, 1.02, (18, 33, 25), WEAK, 100.0, "inference", 0.05, 120),
    "ieee33": ("ieee33", 1.05, 4, 600.0, 1.02, ENDS, I33, 500.0, "inference", 0.05, 120),
    "das69": (
        "das69", 1.05, 4, 1000.0, 1.02, (27, 65, 35, 69), (5, 12, 21, 40, 50, 61), 500.0, "inference", 0.05, 120,
    ),
    "khodr141": (
        "khodr141", 1.05, 4, 2500.0, 1.02, (141, 32, 52, 87), (10, 40, 60, 75, 100, 120), 600.0, "inference", 0.05, 120,
    ),
    "bursty": ("ieee33", 1.05, 3, 1000.0, 1.02, (18, 33, 25), WEAK, 100.0, "code", 0.05, 120),
    "sync": ("ieee33", 1.05, 4, 1000.0, 1.02, ENDS, I33, 300.0, "inference", 0.05, 120),
    "training": ("ieee33", 1.05, 3, 600.0, 1.02, (18, 33, 25), WEAK, 100.0, "training", 0.05, 200),
    "mixed": ("ieee33", 1.05, 4, 600.0, 1.02, ENDS, I33, 1500.0, "mixed", 0.05, 120),
    "fault": ("ieee123", 1.04375, 5, 280.0, 1.1, None, I123, 150.0, "inference", 0.05, 120),
    "robust": ("ieee33", 1.05, 4, 600.0, 1.02, ENDS, I33, 500.0, "inference", 0.05, 120),
    "wrong-model": ("ieee33", 1.05, 4, 1000.0, 1.02, ENDS, I33, 300.0, "code", 0.2, 120),
    "late-measurements": ("ieee33", 1.05, 4, 600.0, 1.02, ENDS, I33, 1500.0, "mixed", 0.05, 120),
    "scale-32": (
        "khodr141", 1.05, 32, 500.0, 1.02, None, (10, 32, 40, 52, 60, 75, 100, 120), 600.0, "inference", 0.05, 60,
    ),
    "ieee33-weak-ups": ("ieee33", 1.05, 3, 1000.0, 1.02, (18, 33, 25), WEAK, 100.0, "code", 0.05, 120),
    "ieee13-3ph": (
        "ieee13-3ph", 1.0001, 2, 500.0, 1.1, (671, 680), (633, 675, 611, 652), (300.0, 400.0, 120.0, 120.0),
        "inference", 0.05, 120,
    ),
    "ieee34-3ph": (
        "ieee34-3ph", 1.05, 2, 250.0, 1.1, (840, 860), (816, 834, 848, 822, 838), (100.0, 100.0, 100.0, 30.0, 30.0),
        "inference", 0.05, 120,
    ),
    "ieee123-3ph": ("ieee123-3ph", 1.0, 5, 280.0, 1.1, None, I123, 50.0, "inference", 0.05, 120),
    "ieee123-3ph-day": ("ieee123-3ph", 1.0, 5, 280.0, 1.1, None, I123, 300.0, "inference", 0.05, 1440),
    "ride-through": (
        "ieee34-3ph", 1.05, 3, 450.0, 1.1, (840, 860, 848), (816, 834, 844, 822, 838),
        (400.0, 400.0, 400.0, 80.0, 80.0), "inference", 0.05, 300,
    ),
    "smoothing": ("ieee33", 1.05, 3, 600.0, 1.02, (18, 33, 25), WEAK, 100.0, "training", 0.05, 6000),
    "routing": ("ieee33", 1.05, 4, 1000.0, 1.02, (18, 33, 25, 12), WEAK, 100.0, "code", 0.05, 60),
    "load-target": ("ieee33", 1.05, 3, 600.0, 1.02, (18, 33, 25), WEAK, 100.0, "mixed", 0.05, 120),
    "zero-shot": (
        RandomFeeders(n_bus=60, style="us-mv", load_kw=4000.0, ood="rural", batch=128), 1.05, 4, 1000.0, 1.02, None,
        (9, 19, 29, 39, 49, 59), 400.0, "inference", 0.05, 120,
    ),
}  # fmt: skip
TABLE |= {f"{name}-published": TABLE[name] for name in ("ieee13-3ph", "ieee34-3ph", "ieee123-3ph")}
# What a preset has beyond that; all else is the same in all.
PUBLISHED = {"power_flow": "sweep", "grid_control.regulator_settings.timer": "reset"}
COORDINATED = {
    "power_flow": "sweep",
    "grid_control.regulator_settings.timer": "integrating",
    "cost.weights": CostWeights(switching=10.0),
}
OFFSETS = "grid_control.regulator_settings.offset_v"
BEYOND = {
    "ieee13-3ph": COORDINATED | {OFFSETS: (("reg1", -2.4), ("reg2", -5.7), ("reg3", -1.7))},
    "ieee34-3ph": COORDINATED
    | {
        OFFSETS: (
            ("creg1a", -1.2),
            ("creg1b", -1.1),
            ("creg1c", -0.9),
            ("creg2a", -3.6),
            ("creg2b", -3.3),
            ("creg2c", -2.2),
        )
    },
    "ieee123-3ph": COORDINATED
    | {OFFSETS: (("creg1a", -2.0), ("creg2a", 0.3), ("creg4a", -4.5), ("creg4b", -5.1), ("creg4c", -4.5))},
    "ieee13-3ph-published": PUBLISHED,
    "ieee34-3ph-published": PUBLISHED,
    "ieee123-3ph-published": PUBLISHED,
    "ieee123-3ph-day": {
        "power_flow": "sweep",
        "inverters.injection": "pv",
        "grid_control.regulators": "setpoint",
        "grid_control.capacitors": "setpoint",
        "background.start_hour": 0.0,
        "dt_s": 60.0,
        "cost.weights": CostWeights(leftover=0.15, switching=10.0),
    },
    "ride-through": {
        "power_flow": "sweep",
        "inverters.injection": "pv",
        "sags": virginia_2024(),
        "datacenters.ride_through": UpsRideThrough(
            curve="itic",
            release="agent",
            by_hand_s=60.0,
            stagger_s=20.0,
            trip_weight=300.0,
            away_weight=1.0,
            missing_weight=3.0,
        ),
        "inverters.ride_through": RideThrough(
            curve="ieee1547-cat2", return_delay_s=60.0, walk_in_s=60.0, trip_weight=300.0
        ),
    },
    "smoothing": {
        "dt_s": 0.1,
        "datacenters.smoothing": PowerSmoothing(
            floor_share=0.9,
            ramp_up_w_per_s=12_000.0,
            ramp_down_w_per_s=12_000.0,
            hysteresis_s=2.0,
            control="agent",
            change_every_s=10.0,
            burnt_weight=3.0,
        ),
        "cost.ramp_limit_kw_per_s": 60.0,
        "cost.ramp_window_s": 1.0,
        "cost.voltage_step_limit_pu": 0.01,
        "cost.weights": CostWeights(leftover=90.0, ramp_excess=1.0, voltage_step_excess=10.0),
    },
    "routing": {
        "datacenters.routing": Routing(movable_share=0.5, move_latency_s=0.1),
        "datacenters.service": ServiceLevels(target_s=2.0, deadline_s=20.0, interactive_share=0.6),
        "cost.weights": CostWeights(backlog=0.0),
    },
    "load-target": {
        "grid_request.targets": (
            LoadTarget(value_share=(0.38, 0.46), begin_s=(30.0, 45.0), ramp_s=(10.0, 10.0), duration_s=(40.0, 50.0)),
        ),
        "grid_request.notice_s": 20.0,
        "cost.weights": CostWeights(grid_request=30.0),
    },
    "toy6": {"workload.window": "start"},
    "sync": {"workload.site_correlation": 1.0},
    "training": {"dt_s": 0.1, "cost.weights": CostWeights(leftover=90.0)},
    "mixed": {"inverters.injection": "pv"},
    "fault": {
        "faults": (
            Fault(("inverter", "capacitor"), (10.0, 60.0)),
            Fault(("datacenter",), (10.0, 60.0), (20.0, 40.0)),
        )
    },
    "robust": {
        "sensing.noise_pu": 0.005,
        "sensing.delay_steps": 2,
        "sensing.preview": False,
        "sensing.r_model_share": 0.8,
        "sensing.x_model_share": 1.2,
    },
    "wrong-model": {
        "workload.site_correlation": 1.0,
        "sensing.r_model_share": 0.8,
        "sensing.x_model_share": 1.2,
        "sensing.model_open": (("7", "8"), ("9", "10"), ("14", "15"), ("32", "33")),
        "sensing.model_closed": (
            ("8", "21", 2.0, 2.0),
            ("9", "15", 2.0, 2.0),
            ("12", "22", 2.0, 2.0),
            ("18", "33", 0.5, 0.5),
        ),
    },
    "late-measurements": {
        "inverters.injection": "pv",
        "sensing.noise_pu": 0.005,
        "sensing.delay_steps": 5,
        "sensing.observe": "neighbours",
        "sensing.preview": False,
        "sensing.r_model_share": 0.8,
        "sensing.x_model_share": 1.2,
    },
}
COMMON = {
    "background.capacitors": True, "datacenters.idle_share": 0.23, "datacenters.f_min_mhz": 210.0,
    "datacenters.f_max_mhz": 1410.0, "datacenters.q_max_share": 0.33,
    "datacenters.boost_share": 1.0, "workload.window": "random", "workload.site_correlation": 0.0,
    "inverters.injection": None, "faults": (),
    "background.load_rho": 0.9, "sensing.noise_pu": 0.0, "sensing.delay_steps": 0, "dt_s": 1.0,
    "power_flow": "distflow",
    "grid_control.regulators": "controlled", "grid_control.capacitors": "fixed", "background.start_hour": None,
    "split": "train", "cost.weights": CostWeights(100.0, 1000.0, 0.3, 0.02, 9.0, 0.0, 0.0, 0.0), "cost.band_pu": 0.05,
    "cost.voltage": "l1", "cost.reference": "nominal", "cost.reward": "shared",
    "grid_control.regulator_settings.timer": "integrating", OFFSETS: 0.0,
    "sensing.observe": "local", "sensing.preview": True, "sensing.r_model_share": 1.0,
    "sensing.x_model_share": 1.0, "sensing.model_open": (), "sensing.model_closed": (),
}  # fmt: skip


def test_every_preset_is_in_the_table():
    assert set(PRESETS) == set(TABLE)
    assert all(PRESETS.values())
    assert set(IDS.values()) == set(PRESETS)


@pytest.mark.parametrize("name", TABLE)
def test_constants_of_a_preset(name):
    feeder, v0, n, rating, s_share, buses, inverters, kvar, trace, sigma, horizon = TABLE[name]
    s = make_scenario(name)
    buses = None if buses is None else tuple(map(str, buses))
    assert s.name == name
    assert s.feeder == (load_feeder(feeder) if isinstance(feeder, str) else feeder)
    assert s.source_voltage_pu == v0
    assert (s.datacenters.count, s.datacenters.p_rated_kw, s.datacenters.buses) == (n, rating, buses)
    assert (s.inverters.buses, s.inverters.s_rated_kva) == (tuple(map(str, inverters)), kvar)
    assert (s.workload.trace, s.background.load_sigma, s.horizon) == (trace, sigma, horizon)
    for field, value in (COMMON | BEYOND.get(name, {})).items():
        assert attrgetter(field)(s) == value, field
    # What follows from them, in kW and kvar.
    np.testing.assert_allclose(s.datacenters.parameters.p_rated_kw, [rating] * n)
    np.testing.assert_allclose(s.datacenters.parameters.p_idle_kw, [0.23 * rating] * n)
    np.testing.assert_allclose(s.datacenters.parameters.s_rated_kva, [s_share * rating] * n)
    np.testing.assert_allclose(s.datacenters.parameters.q_max_kvar, [0.33 * rating] * n)
    np.testing.assert_allclose(s.inverters.parameters.s_rated_kva, np.broadcast_to(kvar, len(inverters)))


@pytest.mark.slow
def test_in_sync_all_sites_draw_alike_and_with_pv_more_load_helps_at_noon():
    known = forecast(make_scenario("sync", split="test"), 0)
    np.testing.assert_array_equal(known.p_ref_kw, known.p_ref_kw[:, :1] * np.ones(4))
    # Under PV the mean voltage is above 1 p.u., and a site's load brings it nearer.
    calm = make_scenario("mixed", split="test")
    apart = [
        rollout(scenario, NoControl(), range(20)).costs().mean()
        for scenario in (
            calm,
            calm.replace(datacenters={"p_rated_kw": 400.0}),
            calm.replace(inverters={"injection": None}),
        )
    ]
    assert apart[0] < apart[1]  # a third less load, a higher cost
    assert apart[2] < apart[0]  # without PV there is less to do


def test_what_controllers_know_of_a_robust_feeder_is_wrong():
    s = make_scenario("robust")
    np.testing.assert_allclose(s.model.r_ohm, 0.8 * s.feeder.r_ohm)
    np.testing.assert_allclose(s.model.x_ohm, 1.2 * s.feeder.x_ohm)
    assert make_scenario("ieee33").model is s.feeder
    true, believed = (make_scenario(name) for name in ("ieee33", "robust"))
    one, two = (Simulation(x, 1).reset([0]).observation[0] for x in (true, believed))
    at = [i for i, name in enumerate(field_names(true)["dc_0"]) if name in ("r", "x")]
    np.testing.assert_allclose(two[at], one[at] * [0.8, 1.2], rtol=1e-6)


def test_ieee123_is_regulated_and_compensated():
    s = make_scenario("ieee123")
    assert s.source_voltage_pu == 1.0 + 7 * 0.00625  # tap +7 of a regulator of 32 steps over 10 %
    assert s.feeder.capacitor_kvar.sum() > 0
    assert s.feeder.n_bus == 123
    # 1 to 5 sites by option.
    for n in range(1, 6):
        assert make_scenario("ieee123", n_datacenters=n).n_agents == n + 7


def test_ieee33_weak_loses_the_band_at_peak_and_reactive_power_alone_cannot_keep_it():
    # Voltages under full sites: no control, all the reactive power there is, and the lowest clocks with it.
    from dcgrid_env.engine.exogenous import episode
    from dcgrid_env.engine.physics import dynamics

    s = make_scenario("ieee33-weak", background={"load_sigma": 0.0})
    zero = np.zeros(1, np.uint64)
    drawn = episode.draw(s, zero, zero)
    outside, _ = interval(s, drawn, np.zeros(1, int), np.zeros((1, 33)), np.full((1, 3), 1000.0))
    start, grid = dynamics.initial_state(s, outside)
    assert grid.solution.converged.all()
    lowest = {
        name: float(dynamics.step(s, start, np.array([[clock, q] * 3 + [q] * 4]), outside)[0].v_pu.min())
        for name, clock, q in (("nothing", 1.0, 0.0), ("reactive", 1.0, 1.0), ("both", -1.0, 1.0))
    }
    assert lowest["nothing"] < lowest["reactive"] < 0.95 < lowest["both"]


@pytest.mark.parametrize("name", PRESETS)
def test_every_preset_and_split_plays(name):
    for split in ("train", "validation", "test"):
        simulation = simulation_of(make_scenario(name, split=split, horizon=3), 2)
        simulation.reset([0, 1])
        n = len(action_layout(simulation.scenario).names)
        transition = [simulation.step(np.zeros((2, n))) for _ in range(3)][-1]
        assert transition.truncated.all()
        assert np.isfinite(transition.reward).all()


def test_overrides_reach_the_scenario_and_leave_the_preset():
    s = make_scenario(
        "toy6",
        horizon=5,
        feeder="ieee33",
        datacenters={"buses": (18,)},
        inverters={"buses": (7, 14)},
        source_voltage_pu=1.05,
    )
    assert s.horizon == 5
    assert s.feeder is load_feeder("ieee33")
    assert make_scenario("toy6").horizon == 100
    assert make_scenario("toy6").feeder.name == "toy6"


def test_a_scenario_is_taken_as_it_is():
    s = make_scenario("toy6")
    assert make_scenario(s) is s
    assert make_scenario(s, horizon=9).horizon == 9
    assert make_scenario(s, horizon=9).name == "toy6"


@pytest.mark.parametrize(
    ("name", "near"),
    [("ieee321", r"did you mean ieee33 or ieee123\? "), ("", ""), ("IEEE123", "did you mean ieee123, .*")],
)
def test_an_unknown_scenario_gets_suggestions(name, near):
    with pytest.raises(ScenarioError, match=rf"^no scenario '{name}'; {near}`dcgrid list scenarios` lists all$"):
        make_scenario(name)


def test_what_is_no_scenario_is_refused():
    wrong: object = ["toy6"]
    with pytest.raises(ScenarioError, match=r"scenario is \['toy6'\]; give a name \(toy6.*or a Scenario"):
        make_scenario(wrong)  # type: ignore[arg-type]


def test_an_unknown_override_gets_a_suggestion():
    with pytest.raises(TypeError, match=r"^no scenario field 'n_data_centers'; did you mean n_datacenters"):
        make_scenario("ieee123", n_data_centers=3)


def test_an_unknown_feeder_gets_suggestions():
    with pytest.raises(FeederError, match=r"^no feeder 'ieee34'; did you mean ieee33, "):
        make_scenario("toy6", feeder="ieee34")


@pytest.mark.parametrize("name", PRESETS)
def test_presets_are_made_anew_but_alike(name):
    one, two = make_scenario(name), make_scenario(name)
    assert isinstance(one, Scenario)
    assert one.feeder is two.feeder
    assert one.agents == two.agents
    assert math.isfinite(one.source_voltage_pu)
