"""The presets on three-phase feeders, a function each; docs/scenarios.md describes their purpose."""

from __future__ import annotations

from dcgrid_env.devices.ride_through.rules import RideThrough, UpsRideThrough
from dcgrid_env.grid import load_feeder
from dcgrid_env.scenario.cost import CostWeights
from dcgrid_env.scenario.scenario import Scenario


def ieee123_3ph_published() -> Scenario:
    """Make the preset ``ieee123-3ph-published``."""
    return Scenario(
        name="ieee123-3ph-published",
        feeder=load_feeder("ieee123-3ph"),
        source_voltage_pu=1.0,
        power_flow="sweep",
        n_datacenters=5,
        datacenters={"p_rated_kw": 280.0, "s_rated_share": 1.1, "q_max_share": 0.33},
        inverters={"buses": ("2", "11", "40", "54", "87", "92", "103"), "s_rated_kva": 50.0},
        grid_control={"regulator_settings": {"timer": "reset"}},
    )


def ieee13_3ph_published() -> Scenario:
    """Make the preset ``ieee13-3ph-published``."""
    return ieee123_3ph_published().replace(
        name="ieee13-3ph-published",
        feeder=load_feeder("ieee13-3ph"),
        source_voltage_pu=1.0001,
        n_datacenters=2,
        datacenters={"buses": ("671", "680"), "p_rated_kw": 500.0},
        inverters={"buses": ("633", "675", "611", "652"), "s_rated_kva": (300.0, 400.0, 120.0, 120.0)},
    )


def ieee34_3ph_published() -> Scenario:
    """Make the preset ``ieee34-3ph-published``."""
    return ieee123_3ph_published().replace(
        name="ieee34-3ph-published",
        feeder=load_feeder("ieee34-3ph"),
        source_voltage_pu=1.05,
        n_datacenters=2,
        datacenters={"buses": ("840", "860"), "p_rated_kw": 250.0},
        inverters={"buses": ("816", "834", "848", "822", "838"), "s_rated_kva": (100.0, 100.0, 100.0, 30.0, 30.0)},
    )


def _coordinated(published: Scenario, offset_v: dict[str, float]) -> Scenario:
    """Change a scenario to other set points, timers that integrate and a price on taps.

    The offsets were chosen on the validation split (docs/decisions/0039-coordinated-set-points.md).
    """
    return published.replace(
        name=published.name.removesuffix("-published"),
        grid_control={"regulator_settings": {"timer": "integrating", "offset_v": offset_v}},
        weights=CostWeights(switching=10.0),
    )


def ieee13_3ph() -> Scenario:
    """Make the preset ``ieee13-3ph``."""
    return _coordinated(ieee13_3ph_published(), {"reg1": -2.4, "reg2": -5.7, "reg3": -1.7})


def ieee34_3ph() -> Scenario:
    """Make the preset ``ieee34-3ph``."""
    offset_v = {"creg1a": -1.2, "creg1b": -1.1, "creg1c": -0.9, "creg2a": -3.6, "creg2b": -3.3, "creg2c": -2.2}
    return _coordinated(ieee34_3ph_published(), offset_v)


def ieee123_3ph() -> Scenario:
    """Make the preset ``ieee123-3ph``."""
    offset_v = {"creg1a": -2.0, "creg2a": 0.3, "creg4a": -4.5, "creg4b": -5.1, "creg4c": -4.5}
    return _coordinated(ieee123_3ph_published(), offset_v)


def ieee123_3ph_day() -> Scenario:
    """Make the preset ``ieee123-3ph-day``.

    Its constants were chosen on the validation split (docs/decisions/0010-three-phase.md).
    """
    return ieee123_3ph_published().replace(
        name="ieee123-3ph-day",
        inverters={"s_rated_kva": 300.0, "injection": "pv"},
        grid_control={
            "regulators": "setpoint",
            "capacitors": "setpoint",
            "regulator_settings": {"timer": "integrating"},
        },
        background={"start_hour": 0.0},
        dt_s=60.0,
        horizon=1440,
        weights=CostWeights(leftover=0.15, switching=10.0),
    )


def ride_through() -> Scenario:
    """Make the preset ``ride-through``.

    Its sizes were chosen on the validation split (docs/ride-through.md): uncontrolled, sites trip at every dip, PV
    trips inverters while the sites are away, and some sites trip by undervoltage without any dip.
    """
    return ieee34_3ph_published().replace(
        name="ride-through",
        n_datacenters=3,
        datacenters={
            "buses": ("840", "860", "848"),
            "p_rated_kw": 450.0,
            "ride_through": UpsRideThrough(
                curve="itic",
                release="agent",
                by_hand_s=60.0,
                stagger_s=20.0,
                trip_weight=300.0,
                away_weight=1.0,
                missing_weight=3.0,
            ),
        },
        inverters={
            "buses": ("816", "834", "844", "822", "838"),
            "s_rated_kva": (400.0, 400.0, 400.0, 80.0, 80.0),
            "injection": "pv",
            "ride_through": RideThrough(curve="ieee1547-cat2", return_delay_s=60.0, walk_in_s=60.0, trip_weight=300.0),
        },
        grid_control={"regulator_settings": {"timer": "integrating"}},
        horizon=300,
        sags="virginia-2024",
    )
