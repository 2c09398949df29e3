"""The presets on three-phase feeders, a function each; docs/scenarios.md describes their purpose."""

from __future__ import annotations

from dcgrid_env.devices.ride_through.rules import RideThrough, UpsRideThrough
from dcgrid_env.grid import load_feeder
from dcgrid_env.scenario.cost import CostWeights
from dcgrid_env.scenario.scenario import Scenario


def ieee123_3ph() -> Scenario:
    """Make the preset ``ieee123-3ph``."""
    return Scenario(
        name="ieee123-3ph",
        feeder=load_feeder("ieee123-3ph"),
        source_voltage_pu=1.0,
        power_flow="sweep",
        n_datacenters=5,
        datacenters={"p_rated_kw": 280.0, "s_rated_share": 1.1, "q_max_share": 0.33},
        inverters={"buses": ("2", "11", "40", "54", "87", "92", "103"), "s_rated_kva": 50.0},
    )


def ieee13_3ph() -> Scenario:
    """Make the preset ``ieee13-3ph``."""
    return ieee123_3ph().replace(
        name="ieee13-3ph",
        feeder=load_feeder("ieee13-3ph"),
        source_voltage_pu=1.0001,
        n_datacenters=2,
        datacenters={"buses": ("671", "680"), "p_rated_kw": 500.0},
        inverters={"buses": ("633", "675", "611", "652"), "s_rated_kva": (300.0, 400.0, 120.0, 120.0)},
    )


def ieee34_3ph() -> Scenario:
    """Make the preset ``ieee34-3ph``."""
    return ieee123_3ph().replace(
        name="ieee34-3ph",
        feeder=load_feeder("ieee34-3ph"),
        source_voltage_pu=1.05,
        n_datacenters=2,
        datacenters={"buses": ("840", "860"), "p_rated_kw": 250.0},
        inverters={"buses": ("816", "834", "848", "822", "838"), "s_rated_kva": (100.0, 100.0, 100.0, 30.0, 30.0)},
    )


def ieee123_3ph_day() -> Scenario:
    """Make the preset ``ieee123-3ph-day``.

    Its constants were chosen on the validation split (docs/decisions/0010-three-phase.md).
    """
    return ieee123_3ph().replace(
        name="ieee123-3ph-day",
        inverters={"s_rated_kva": 300.0, "injection": "pv"},
        grid_control={"regulators": "agent", "capacitors": "agent"},
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
    return ieee34_3ph().replace(
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
        horizon=300,
        sags="virginia-2024",
    )
