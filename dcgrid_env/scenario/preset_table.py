"""Table of the bundled scenarios as plain data; docs/scenarios.md describes their purpose.

A preset is one record. It gives the fields of a scenario, or a base and the fields that differ from it.
"""

from __future__ import annotations

from typing import Any

from dcgrid_env.devices import Storages
from dcgrid_env.grid.random_feeders.family import RandomFeeders


class Preset:
    """Bundled scenario. This is the only place where it is registered.

    Parameters
    ----------
    name
        Name for ``make_scenario``.
    gym_id
        Id in the registries of Gymnasium and PettingZoo.
    about
        One-line description.
    base
        Name of the preset that it changes; None for a scenario without a base.
    fields
        Fields of the scenario, see ``make_scenario``.
    """

    def __init__(self, name: str, gym_id: str, about: str, base: str | None = None, **fields: Any):
        self.name, self.gym_id, self.about, self.base, self.fields = name, gym_id, about, base, fields


_MODEL_ERROR = {"r_model_share": 0.8, "x_model_share": 1.2}
_INTEGRATING = {"regulator_settings": {"timer": "integrating"}}

TABLE = (
    Preset(
        "toy6", "dcgrid/Toy6-v0",
        "6 buses; one 2.5 MW data centre steps from idle to full at t = 20 s (the paper's Fig. 3)",
        feeder="toy6",
        source_voltage_pu=1.0,
        datacenters={"buses": (4,), "p_rated_kw": 2500.0, "s_rated_share": 1.1, "q_max_share": 0.33},
        inverters={"buses": (3, 5), "s_rated_kva": 1000.0},
        trace="step",
        workload={"window": "start"},
        background={"load_sigma": 0.02},
        horizon=100,
    ),
    Preset(
        "ieee123", "dcgrid/IEEE123-v0",
        "IEEE 123-bus equivalent, 5 data centres of 280 kW at random, 7 inverters (the paper's study)",
        feeder="ieee123",
        source_voltage_pu=1.04375,
        n_datacenters=5,
        datacenters={"p_rated_kw": 280.0, "s_rated_share": 1.1, "q_max_share": 0.33},
        inverters={"buses": (2, 11, 40, 54, 87, 92, 103), "s_rated_kva": 50.0},
    ),
    Preset(
        "ieee33-weak", "dcgrid/IEEE33Weak-v0",
        "33 buses of high r/x, 3 data centres of 1 MW at the ends; reactive power alone is not enough",
        feeder="ieee33",
        source_voltage_pu=1.05,
        datacenters={"buses": (18, 33, 25), "p_rated_kw": 1000.0, "s_rated_share": 1.02, "q_max_share": 0.33},
        inverters={"buses": (7, 14, 20, 30), "s_rated_kva": 100.0},
    ),
    Preset(
        "ieee33", "dcgrid/IEEE33-v0",
        "33 buses, 4 data centres of 600 kW, 6 inverters of 500 kvar; the place of an inverter matters",
        base="ieee33-weak",
        datacenters={"buses": (18, 33, 25, 22), "p_rated_kw": 600.0},
        inverters={"buses": (3, 7, 14, 20, 24, 30), "s_rated_kva": 500.0},
    ),
    Preset(
        "das69", "dcgrid/Das69-v0", "69 buses, 4 data centres of 1 MW at the ends, 6 inverters",
        base="ieee33",
        feeder="das69",
        datacenters={"buses": (27, 65, 35, 69), "p_rated_kw": 1000.0},
        inverters={"buses": (5, 12, 21, 40, 50, 61)},
    ),
    Preset(
        "khodr141", "dcgrid/Khodr141-v0", "141 buses of a city, 4 data centres of 2.5 MW, 6 inverters",
        base="ieee33",
        feeder="khodr141",
        datacenters={"buses": (141, 32, 52, 87), "p_rated_kw": 2500.0},
        inverters={"buses": (10, 40, 60, 75, 100, 120), "s_rated_kva": 600.0},
    ),
    Preset(
        "bursty", "dcgrid/Bursty-v0", "ieee33-weak under code completion: bursts of ten seconds and silence",
        base="ieee33-weak",
        trace="code",
    ),
    Preset(
        "sync", "dcgrid/Sync-v0", "ieee33 with 4 sites of 1 MW that all ramp together",
        base="ieee33",
        datacenters={"p_rated_kw": 1000.0},
        inverters={"s_rated_kva": 300.0},
        workload={"site_correlation": 1.0},
    ),
    # What is left costs as if it waited 30 s more, which is 300 steps here.
    Preset(
        "training", "dcgrid/Training-v0",
        "ieee33-weak with training jobs of 600 kW, near the rating and near idle in turn, dt = 0.1 s",
        base="ieee33-weak",
        datacenters={"p_rated_kw": 600.0},
        trace="training",
        dt_s=0.1,
        horizon=200,
        weights={"leftover": 90.0},
    ),
    Preset(
        "mixed", "dcgrid/Mixed-v0", "ieee33 with PV at the inverters under passing clouds: at noon more load helps",
        base="ieee33",
        inverters={"s_rated_kva": 1500.0, "injection": "pv"},
        trace="mixed",
    ),
    Preset(
        "fault", "dcgrid/Fault-v0",
        "ieee123 with inverters of 150 kvar; an inverter or a capacitor is lost, a data centre trips and returns",
        base="ieee123",
        inverters={"s_rated_kva": 150.0},
        faults=[
            {"among": ("inverter", "capacitor"), "begin_s": (10.0, 60.0)},
            {"among": ("datacenter",), "begin_s": (10.0, 60.0), "duration_s": (20.0, 40.0)},
        ],
    ),
    Preset(
        "robust", "dcgrid/Robust-v0", "ieee33 with a wrong model, noisy and late measurements and no preview",
        base="ieee33",
        sensing={"noise_pu": 0.005, "delay_steps": 2, "preview": False, **_MODEL_ERROR},
    ),
    # The model has the switches of the loss minimum of M. E. Baran and F. F. Wu's feeder, whose ties have 2 or 0.5 ohm
    # ("Network reconfiguration in distribution systems for loss reduction and load balancing", IEEE Trans. Power
    # Delivery 4(2), 1989). In truth, the feeder is back in its normal state. docs/tasks.md has the other reasons.
    Preset(
        "wrong-model", "dcgrid/WrongModel-v1",
        "sync in bursts of code completion; the model has other switches closed and wrong R and X",
        base="sync",
        trace="code",
        background={"load_sigma": 0.2},
        sensing={
            **_MODEL_ERROR,
            "model_open": ((7, 8), (9, 10), (14, 15), (32, 33)),
            "model_closed": ((8, 21, 2.0, 2.0), (9, 15, 2.0, 2.0), (12, 22, 2.0, 2.0), (18, 33, 0.5, 0.5)),
        },
    ),
    # Voltages have the error of meters of class 0.5 and are 5 s old; docs/tasks.md gives the reasons.
    Preset(
        "late-measurements", "dcgrid/LateMeasurements-v1",
        "mixed with voltages that are 5 s old and noisy, a wrong model, neighbours in view and no preview",
        base="mixed",
        sensing={
            "noise_pu": 0.005, "delay_steps": 5, "observe": "neighbours", "preview": False, **_MODEL_ERROR,
        },
    ),
    # An hour of hindsight for a hundred episodes would be too long with twice the steps.
    Preset(
        "scale-32", "dcgrid/Scale32-v0", "khodr141 with 32 data centres of 500 kW at random and 8 inverters",
        base="khodr141",
        n_datacenters=32,
        datacenters={"buses": None, "p_rated_kw": 500.0},
        inverters={"buses": (10, 32, 40, 52, 60, 75, 100, 120)},
        horizon=60,
    ),
    # Offsets of the next three were chosen on the validation split (docs/decisions/0039-coordinated-set-points.md).
    Preset(
        "ieee13-3ph", "dcgrid/IEEE13ThreePhase-v1",
        "IEEE 13 node feeder with its phases, 2 data centres of 500 kW, 4 inverters of one to three phases",
        base="ieee13-3ph-published",
        grid_control={
            "regulator_settings": {"timer": "integrating", "offset_v": {"reg1": -2.4, "reg2": -5.7, "reg3": -1.7}}
        },
        weights={"switching": 10.0},
    ),
    Preset(
        "ieee34-3ph", "dcgrid/IEEE34ThreePhase-v1",
        "IEEE 34 node feeder with its phases, long and weak, 2 data centres of 250 kW, 5 inverters",
        base="ieee34-3ph-published",
        grid_control={
            "regulator_settings": {
                "timer": "integrating",
                "offset_v": {
                    "creg1a": -1.2, "creg1b": -1.1, "creg1c": -0.9, "creg2a": -3.6, "creg2b": -3.3, "creg2c": -2.2,
                },
            }
        },
        weights={"switching": 10.0},
    ),
    Preset(
        "ieee123-3ph", "dcgrid/IEEE123ThreePhase-v1",
        "IEEE 123 node feeder with its phases and regulators that act: the paper's study on the true feeder",
        base="ieee123-3ph-published",
        grid_control={
            "regulator_settings": {
                "timer": "integrating",
                "offset_v": {"creg1a": -2.0, "creg2a": 0.3, "creg4a": -4.5, "creg4b": -5.1, "creg4c": -4.5},
            }
        },
        weights={"switching": 10.0},
    ),
    Preset(
        "ieee13-3ph-published", "dcgrid/IEEE13ThreePhasePublished-v1",
        "ieee13-3ph with the published set points of its regulators, resetting timers and no price on taps",
        base="ieee123-3ph-published",
        feeder="ieee13-3ph",
        source_voltage_pu=1.0001,
        datacenters={"buses": ("671", "680"), "p_rated_kw": 500.0},
        inverters={"buses": ("633", "675", "611", "652"), "s_rated_kva": (300.0, 400.0, 120.0, 120.0)},
    ),
    Preset(
        "ieee34-3ph-published", "dcgrid/IEEE34ThreePhasePublished-v1",
        "ieee34-3ph with the published set points of its regulators, resetting timers and no price on taps",
        base="ieee123-3ph-published",
        feeder="ieee34-3ph",
        source_voltage_pu=1.05,
        datacenters={"buses": ("840", "860"), "p_rated_kw": 250.0},
        inverters={"buses": ("816", "834", "848", "822", "838"), "s_rated_kva": (100.0, 100.0, 100.0, 30.0, 30.0)},
    ),
    Preset(
        "ieee123-3ph-published", "dcgrid/IEEE123ThreePhasePublished-v1",
        "ieee123-3ph with the published set points of its regulators, resetting timers and no price on taps",
        feeder="ieee123-3ph",
        source_voltage_pu=1.0,
        power_flow="sweep",
        n_datacenters=5,
        datacenters={"p_rated_kw": 280.0, "s_rated_share": 1.1, "q_max_share": 0.33},
        inverters={"buses": ("2", "11", "40", "54", "87", "92", "103"), "s_rated_kva": 50.0},
        grid_control={"regulator_settings": {"timer": "reset"}},
    ),
    # Its constants were chosen on the validation split (docs/decisions/0010-three-phase.md).
    Preset(
        "ieee123-3ph-day", "dcgrid/IEEE123ThreePhaseDay-v1",
        "ieee123-3ph-published over a day in steps of a minute with PV; agents choose set points of regulators too",
        base="ieee123-3ph-published",
        inverters={"s_rated_kva": 300.0, "injection": "pv"},
        grid_control={"regulators": "setpoint", "capacitors": "setpoint", **_INTEGRATING},
        background={"start_hour": 0.0},
        dt_s=60.0,
        horizon=1440,
        weights={"leftover": 0.15, "switching": 10.0},
    ),
    # Its sizes were chosen on the validation split (docs/ride-through.md): uncontrolled, sites trip at every dip, PV
    # trips inverters while the sites are away, and some sites trip by undervoltage without any dip.
    Preset(
        "ride-through", "dcgrid/RideThrough-v1",
        "34 nodes under the six dips of July 2024: 3 sites of 450 kW leave for their UPS and return, PV trips",
        base="ieee34-3ph-published",
        datacenters={
            "buses": ("840", "860", "848"),
            "p_rated_kw": 450.0,
            "ride_through": {
                "curve": "itic",
                "release": "agent",
                "by_hand_s": 60.0,
                "stagger_s": 20.0,
                "trip_weight": 300.0,
                "away_weight": 1.0,
                "missing_weight": 3.0,
            },
        },
        inverters={
            "buses": ("816", "834", "844", "822", "838"),
            "s_rated_kva": (400.0, 400.0, 400.0, 80.0, 80.0),
            "injection": "pv",
            "ride_through": {
                "curve": "ieee1547-cat2", "return_delay_s": 60.0, "walk_in_s": 60.0, "trip_weight": 300.0,
            },
        },
        grid_control=_INTEGRATING,
        horizon=300,
        sags="virginia-2024",
    ),
    # What a UPS of 1 MW and 5 min lends to the grid of its 83 kWh: 300 kW for a minute, half full.
    Preset(
        "ieee33-weak-ups", "dcgrid/IEEE33WeakUPS-v0",
        "bursty with 300 kW and 5 kWh of a UPS at each data centre: storage beside the clock",
        base="bursty",
        devices=[
            {"kind": "datacenter", "buses": (18, 33, 25), "p_rated_kw": 1000.0, "s_rated_share": 1.02,
             "q_max_share": 0.33},
            {"kind": "inverter", "buses": (7, 14, 20, 30), "s_rated_kva": 100.0},
            Storages.ups((18, 33, 25), p_rated_kw=300.0, minutes=1.0, initial_share=0.5),
        ],
    ),
    # Its limits and weights were chosen on the validation split (docs/smoothing.md): without smoothing ramps and
    # flicker are bad, the highest floor burns too much, and the best floor lies between.
    Preset(
        "smoothing", "dcgrid/Smoothing-v0",
        "ieee33-weak with training jobs over ten minutes in steps of 0.1 s; agents set GPU power smoothing",
        base="training",
        horizon=6000,
        datacenters={
            "smoothing": {
                "floor_share": 0.9,
                "ramp_up_w_per_s": 12_000.0,
                "ramp_down_w_per_s": 12_000.0,
                "hysteresis_s": 2.0,
                "control": "agent",
                "change_every_s": 10.0,
                "burnt_weight": 3.0,
            }
        },
        cost={"ramp_limit_kw_per_s": 60.0, "ramp_window_s": 1.0, "voltage_step_limit_pu": 0.01},
        weights={"ramp_excess": 1.0, "voltage_step_excess": 10.0},
    ),
    # Sizes were chosen on validation, so that no site is always the strongest. Waiting within a deadline is free. Half
    # the steps of others make hindsight, which has many more unknowns here, a third as long.
    Preset(
        "routing", "dcgrid/Routing-v0",
        "4 sites of 1 MW under code completion that move half of their work, with a target and a deadline",
        base="bursty",
        datacenters={
            "buses": (18, 33, 25, 12),
            "routing": {"movable_share": 0.5, "move_latency_s": 0.1},
            "service": {"target_s": 2.0, "deadline_s": 20.0, "interactive_share": 0.6},
        },
        horizon=60,
        weights={"backlog": 0.0},
    ),
    # docs/load-target.md gives the reasons for these numbers.
    Preset(
        "load-target", "dcgrid/LoadTarget-v0",
        "ieee33-weak with sites of 600 kW that a utility asks to draw less for 40 to 50 s",
        base="ieee33-weak",
        datacenters={"p_rated_kw": 600.0},
        trace="mixed",
        grid_request={
            "targets": [
                {"value_share": (0.38, 0.46), "begin_s": (30.0, 45.0), "ramp_s": 10.0, "duration_s": (40.0, 50.0)}
            ],
            "notice_s": 20.0,
        },
        weights={"grid_request": 30.0},
    ),
    # Buses are numbered depth first, so that inverters ten apart stand all over any of the feeders.
    Preset(
        "zero-shot", "dcgrid/ZeroShot-v0",
        "random feeders of 60 buses, another in each batch of training and 64 to be tested on; 4 sites of 1 MW",
        base="ieee33",
        feeder=RandomFeeders(n_bus=60, style="us-mv", load_kw=4000.0, ood="rural"),
        datacenters={"buses": None, "p_rated_kw": 1000.0},
        inverters={"buses": (9, 19, 29, 39, 49, 59), "s_rated_kva": 400.0},
    ),
)  # fmt: skip
"""All presets, in the order in which they are listed."""
