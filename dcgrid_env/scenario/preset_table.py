"""The scenarios that ship, each a function and a line of the table; docs/scenarios.md says what they are for."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from dcgrid_env.devices.faults import Fault
from dcgrid_env.grid import load_feeder
from dcgrid_env.scenario.cost import CostWeights
from dcgrid_env.scenario.scenario import Scenario


def _toy6() -> Scenario:
    return Scenario(
        name="toy6",
        feeder=load_feeder("toy6"),
        v0_pu=1.0,
        n_datacenters=1,
        datacenter_buses=(4,),
        p_rated_kw=2500.0,
        s_rated_share=1.1,
        q_max_share=0.33,
        inverter_buses=(3, 5),
        inverter_s_kva=1000.0,
        trace="step",
        trace_window="start",
        load_sigma=0.02,
        horizon=100,
    )


def _ieee123() -> Scenario:
    return Scenario(
        name="ieee123",
        feeder=load_feeder("ieee123"),
        v0_pu=1.04375,
        n_datacenters=5,
        p_rated_kw=280.0,
        s_rated_share=1.1,
        q_max_share=0.33,
        inverter_buses=(2, 11, 40, 54, 87, 92, 103),
        inverter_s_kva=50.0,
    )


def _ieee33_weak() -> Scenario:
    return Scenario(
        name="ieee33-weak",
        feeder=load_feeder("ieee33"),
        v0_pu=1.05,
        n_datacenters=3,
        datacenter_buses=(18, 33, 25),
        p_rated_kw=1000.0,
        s_rated_share=1.02,
        q_max_share=0.33,
        inverter_buses=(7, 14, 20, 30),
        inverter_s_kva=100.0,
    )


def _ieee33() -> Scenario:
    return _ieee33_weak().replace(
        name="ieee33",
        n_datacenters=4,
        datacenter_buses=(18, 33, 25, 22),
        p_rated_kw=600.0,
        inverter_buses=(3, 7, 14, 20, 24, 30),
        inverter_s_kva=500.0,
    )


def _das69() -> Scenario:
    return _ieee33().replace(
        name="das69",
        feeder=load_feeder("das69"),
        datacenter_buses=(27, 65, 35, 69),
        p_rated_kw=1000.0,
        inverter_buses=(5, 12, 21, 40, 50, 61),
    )


def _khodr141() -> Scenario:
    return _ieee33().replace(
        name="khodr141",
        feeder=load_feeder("khodr141"),
        datacenter_buses=(141, 32, 52, 87),
        p_rated_kw=2500.0,
        inverter_buses=(10, 40, 60, 75, 100, 120),
        inverter_s_kva=600.0,
    )


def _bursty() -> Scenario:
    return _ieee33_weak().replace(name="bursty", trace="code")


def _sync() -> Scenario:
    return _ieee33().replace(name="sync", p_rated_kw=1000.0, inverter_s_kva=300.0, site_correlation=1.0)


def _training() -> Scenario:
    # What is left costs as if it waited 30 s more, which is 300 steps here.
    return _ieee33_weak().replace(
        name="training", p_rated_kw=600.0, trace="training", dt_s=0.1, horizon=200, weights=CostWeights(leftover=90.0)
    )


def _mixed() -> Scenario:
    return _ieee33().replace(name="mixed", inverter_s_kva=1500.0, inverter_trace="pv", trace="mixed")


def _fault() -> Scenario:
    lost = Fault(("inverter", "capacitor"), begin_s=(10.0, 60.0))
    tripped = Fault(("datacenter",), begin_s=(10.0, 60.0), duration_s=(20.0, 40.0))
    return _ieee123().replace(name="fault", inverter_s_kva=150.0, faults=(lost, tripped))


def _robust() -> Scenario:
    return _ieee33().replace(
        name="robust",
        voltage_noise_pu=0.005,
        measurement_delay=2,
        preview=False,
        r_model_share=0.8,
        x_model_share=1.2,
    )


def _scale_32() -> Scenario:
    # An hour of hindsight for a hundred episodes would be too long with twice the steps.
    return _khodr141().replace(
        name="scale-32",
        n_datacenters=32,
        datacenter_buses=None,
        p_rated_kw=500.0,
        inverter_buses=(10, 32, 40, 52, 60, 75, 100, 120),
        horizon=60,
    )


def _ieee123_3ph() -> Scenario:
    return Scenario(
        name="ieee123-3ph",
        feeder=load_feeder("ieee123-3ph"),
        source_voltage_pu=1.0,
        power_flow="sweep",
        n_datacenters=5,
        p_rated_kw=280.0,
        s_rated_share=1.1,
        q_max_share=0.33,
        inverter_buses=("2", "11", "40", "54", "87", "92", "103"),
        inverter_s_kva=50.0,
    )


def _ieee13_3ph() -> Scenario:
    return _ieee123_3ph().replace(
        name="ieee13-3ph",
        feeder=load_feeder("ieee13-3ph"),
        source_voltage_pu=1.0001,
        n_datacenters=2,
        datacenter_buses=("671", "680"),
        p_rated_kw=500.0,
        inverter_buses=("633", "675", "611", "652"),
        inverter_s_kva=(300.0, 400.0, 120.0, 120.0),
    )


def _ieee34_3ph() -> Scenario:
    return _ieee123_3ph().replace(
        name="ieee34-3ph",
        feeder=load_feeder("ieee34-3ph"),
        source_voltage_pu=1.05,
        n_datacenters=2,
        datacenter_buses=("840", "860"),
        p_rated_kw=250.0,
        inverter_buses=("816", "834", "848", "822", "838"),
        inverter_s_kva=(100.0, 100.0, 100.0, 30.0, 30.0),
    )


def _ieee123_3ph_day() -> Scenario:
    """Its constants were chosen on the validation split (docs/decisions/0010-three-phase.md)."""
    return _ieee123_3ph().replace(
        name="ieee123-3ph-day",
        inverter_s_kva=300.0,
        inverter_trace="pv",
        regulators="agent",
        capacitor_banks="agent",
        start_hour=0.0,
        dt_s=60.0,
        horizon=1440,
        weights=CostWeights(leftover=0.15, switching=10.0),
    )


class Preset(NamedTuple):
    """A scenario that ships. This is the one place where it is registered."""

    name: str
    gym_id: str
    """Its id in the registries of Gymnasium and PettingZoo."""
    about: str
    """What it is, on one line."""
    make: Callable[[], Scenario]


TABLE = (
    Preset(
        "toy6",
        "dcgrid/Toy6-v0",
        "6 buses; one 2.5 MW data centre steps from idle to full at t = 20 s (the paper's Fig. 3)",
        _toy6,
    ),
    Preset(
        "ieee123",
        "dcgrid/IEEE123-v0",
        "IEEE 123-bus equivalent, 5 data centres of 280 kW at random, 7 inverters (the paper's study)",
        _ieee123,
    ),
    Preset(
        "ieee33-weak",
        "dcgrid/IEEE33Weak-v0",
        "33 buses of high r/x, 3 data centres of 1 MW at the ends; the clock must help",
        _ieee33_weak,
    ),
    Preset(
        "ieee33",
        "dcgrid/IEEE33-v0",
        "33 buses, 4 data centres of 600 kW, 6 inverters of 500 kvar; the place of an inverter matters",
        _ieee33,
    ),
    Preset("das69", "dcgrid/Das69-v0", "69 buses, 4 data centres of 1 MW at the ends, 6 inverters", _das69),
    Preset("khodr141", "dcgrid/Khodr141-v0", "141 buses of a city, 4 data centres of 2.5 MW, 6 inverters", _khodr141),
    Preset(
        "bursty",
        "dcgrid/Bursty-v0",
        "ieee33-weak under code completion: bursts of ten seconds and silence",
        _bursty,
    ),
    Preset("sync", "dcgrid/Sync-v0", "ieee33 with 4 sites of 1 MW that all ramp together", _sync),
    Preset(
        "training",
        "dcgrid/Training-v0",
        "ieee33-weak with training jobs of 600 kW, near the rating and near idle in turn, dt = 0.1 s",
        _training,
    ),
    Preset(
        "mixed",
        "dcgrid/Mixed-v0",
        "ieee33 with PV at the inverters under passing clouds: at noon more load helps",
        _mixed,
    ),
    Preset(
        "fault",
        "dcgrid/Fault-v0",
        "ieee123 with inverters of 150 kvar; an inverter or a capacitor is lost, a data centre trips and returns",
        _fault,
    ),
    Preset(
        "robust",
        "dcgrid/Robust-v0",
        "ieee33 with a wrong model, noisy and late measurements and no preview",
        _robust,
    ),
    Preset(
        "scale-32",
        "dcgrid/Scale32-v0",
        "khodr141 with 32 data centres of 500 kW at random and 8 inverters",
        _scale_32,
    ),
    Preset(
        "ieee13-3ph",
        "dcgrid/IEEE13ThreePhase-v0",
        "IEEE 13 node feeder with its phases, 2 data centres of 500 kW, 4 inverters of one to three phases",
        _ieee13_3ph,
    ),
    Preset(
        "ieee34-3ph",
        "dcgrid/IEEE34ThreePhase-v0",
        "IEEE 34 node feeder with its phases, long and weak, 2 data centres of 250 kW, 5 inverters",
        _ieee34_3ph,
    ),
    Preset(
        "ieee123-3ph",
        "dcgrid/IEEE123ThreePhase-v0",
        "IEEE 123 node feeder with its phases and regulators that act: the paper's study on the true feeder",
        _ieee123_3ph,
    ),
    Preset(
        "ieee123-3ph-day",
        "dcgrid/IEEE123ThreePhaseDay-v0",
        "ieee123-3ph over a day in steps of a minute, PV at the inverters, regulators and capacitors as agents",
        _ieee123_3ph_day,
    ),
)
"""All presets, in the order in which they are listed."""
