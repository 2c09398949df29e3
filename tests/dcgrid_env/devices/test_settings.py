"""Settings of devices and equipment: their defaults and ranges, and the refusal of values beyond the ranges."""

import dataclasses
import re
from typing import Any

import pytest

from dcgrid_env import Batching, DataCenters, PowerSmoothing, RideThrough, Routing, ServiceLevels, UpsRideThrough
from dcgrid_env.core.checked import FieldError
from dcgrid_env.devices.capacitor_bank.capacitor_control import CapacitorControl
from dcgrid_env.devices.datacenter.cooled_site import Cooling
from dcgrid_env.devices.tap_changer.regulator_control import RegulatorControl

SITES = {"count": 1, "p_rated_kw": 100.0, "s_rated_share": 1.5, "q_max_share": 0.3}
CURVE = {"curve": "itic"}
DAY_S, LONG_S, WEIGHT = 86_400.0, 1e6, 1e9
RANGES: list[tuple[Any, dict[str, Any], dict[str, tuple[float | None, float, float]]]] = [
    (
        CapacitorControl,
        {},
        {
            "on_below_pu": (0.98, 0.5, 1.5),
            "off_above_pu": (1.04, 0.5, 1.5),
            "on_above_share": (0.5, -10.0, 10.0),
            "off_below_share": (-0.75, -10.0, 10.0),
            "delay_s": (100.0, 0.0, DAY_S),
            "hold_s": (60.0, 60.0, DAY_S),
        },
    ),
    (RegulatorControl, {}, {"hold_s": (60.0, 60.0, DAY_S)}),
    (
        Batching,
        {},
        {
            "lowest": (8.0, 1.0, 65_536.0),
            "highest": (512.0, 1.0, 65_536.0),
            "reference": (64.0, 1.0, 65_536.0),
            "batch_energy_share": (0.3, 0.0, 0.99),
            "gather_s": (0.1, 0.0, 3600.0),
            "batch_weight": (0.3, 0.0, WEIGHT),
        },
    ),
    (
        Cooling,
        {},
        {
            "cooling_share": (0.2, 0.0, 2.0),
            "time_constant_s": (120.0, 0.0, DAY_S),
            "auxiliary_share": (0.05, 0.0, 2.0),
        },
    ),
    (
        PowerSmoothing,
        {},
        {
            "floor_share": (0.9, 0.0, 1.0),
            "ramp_up_w_per_s": (1200.0, 1e-9, 1e9),
            "ramp_down_w_per_s": (1200.0, 1e-9, 1e9),
            "hysteresis_s": (5.0, 0.0, DAY_S),
            "change_every_s": (10.0, 0.0, DAY_S),
            "slowest_share": (0.01, 1e-6, 1.0),
            "burnt_weight": (1.0, 0.0, WEIGHT),
        },
    ),
    (
        ServiceLevels,
        {},
        {
            "target_s": (2.0, 0.0, LONG_S),
            "deadline_s": (30.0, 0.001, LONG_S),
            "interactive_share": (0.7, 0.0, 1.0),
            "late_weight": (3.0, 0.0, WEIGHT),
        },
    ),
    (
        Routing,
        {},
        {"movable_share": (1.0, 0.0, 1.0), "move_latency_s": (0.05, 0.0, 3600.0), "move_weight": (0.3, 0.0, WEIGHT)},
    ),
    (
        RideThrough,
        CURVE,
        {"return_delay_s": (300.0, 0.0, LONG_S), "walk_in_s": (300.0, 0.0, LONG_S), "trip_weight": (0.0, 0.0, WEIGHT)},
    ),
    (
        UpsRideThrough,
        CURVE,
        {
            "return_delay_s": (3.0, 0.0, LONG_S),
            "walk_in_s": (10.0, 0.0, LONG_S),
            "trip_weight": (0.0, 0.0, WEIGHT),
            "lockout_events": (3, 0, 10),
            "lockout_window_s": (60.0, 1.0, LONG_S),
            "returns_per_minute": (3, 0, 10),
            "by_hand_s": (600.0, 0.0, LONG_S),
            "stagger_s": (30.0, 0.0, LONG_S),
            "battery_s": (300.0, 0.0, LONG_S),
            "recharge_share": (0.1, 0.0, 1.0),
            "charge_efficiency": (0.95, 0.01, 1.0),
            "away_weight": (0.0, 0.0, WEIGHT),
            "missing_weight": (9.0, 0.0, WEIGHT),
        },
    ),
    (
        DataCenters,
        SITES,
        {
            "count": (None, 0, 10_000),
            "idle_share": (0.23, 0.0, 0.99),
            "f_max_mhz": (1410.0, 1e-9, 1e6),
            "f_min_mhz": (210.0, 1e-9, 1410.0),
            "s_rated_share": (None, 1.0, 1e6),
            "q_max_share": (None, 0.0, 1.5),
            "boost_share": (1.0, 1.0, 2.0),
        },
    ),
]
CASES = [(kind, needed, name, *rest) for kind, needed, fields in RANGES for name, rest in fields.items()]
IDS = [f"{case[0].__name__}.{case[2]}" for case in CASES]


def refusal(kind, fields):
    """The message that refuses some fields, empty if they are valid."""
    try:
        kind(**fields)
    except FieldError as error:
        return str(error)
    return ""


@pytest.mark.parametrize(("kind", "needed", "name", "default", "low", "high"), CASES, ids=IDS)
def test_default_and_range_of_a_setting(kind, needed, name, default, low, high):
    if default is not None:
        assert getattr(kind(**needed), name) == default
    beyond = (low - 1, high + 1) if isinstance(low, int) else (low - max(1e-3 * abs(low), 1e-12), high * 1.001)
    out_of_range = re.compile(f"^{kind.__name__}: {name} is .*; give a (finite number in|whole number of at least) ")
    for value in beyond:
        assert out_of_range.match(refusal(kind, needed | {name: value}))
    for value in (low, min(high, 1e300)):  # another rule may refuse it together with the other fields' defaults
        assert not out_of_range.match(refusal(kind, needed | {name: value}))


def test_the_table_has_every_bounded_setting():
    for kind, _, fields in RANGES:
        assert {f.name for f in dataclasses.fields(kind) if "bounds" in f.metadata} == set(fields), kind.__name__
