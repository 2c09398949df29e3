"""Scenarios on the three-phase feeders that ship: devices of one and of three phases, given and drawn buses."""

from functools import cache
from typing import Any

from dcgrid_env import Scenario, load_feeder


@cache
def ieee13() -> Any:
    """Two sites and four inverters on the IEEE 13 node feeder, two of them on one phase."""
    return Scenario(
        name="ieee13-three-phase",
        feeder=load_feeder("ieee13-3ph"),
        source_voltage_pu=1.0001,
        power_flow="sweep",
        datacenter_buses=("671", "680"),
        n_datacenters=2,
        p_rated_kw=500.0,
        s_rated_share=1.1,
        q_max_share=0.33,
        inverter_buses=("633", "675", "611", "652"),
        inverter_s_kva=(150.0, 200.0, 60.0, 60.0),
        horizon=20,
        split="test",
    )


@cache
def ieee34() -> Any:
    """Two sites and five inverters on the IEEE 34 node feeder, which is long and weak."""
    return Scenario(
        name="ieee34-three-phase",
        feeder=load_feeder("ieee34-3ph"),
        source_voltage_pu=1.05,
        power_flow="sweep",
        n_datacenters=2,
        datacenter_buses=("840", "860"),
        p_rated_kw=250.0,
        s_rated_share=1.1,
        q_max_share=0.33,
        inverter_buses=("816", "834", "848", "822", "838"),
        inverter_s_kva=(100.0, 100.0, 100.0, 30.0, 30.0),
        horizon=20,
        split="test",
    )


@cache
def ieee123() -> Any:
    """The paper's study on the IEEE 123 node feeder itself: five sites at random, seven inverters."""
    return Scenario(
        name="ieee123-three-phase",
        feeder=load_feeder("ieee123-3ph"),
        source_voltage_pu=1.0,
        power_flow="sweep",
        n_datacenters=5,
        p_rated_kw=280.0,
        s_rated_share=1.1,
        q_max_share=0.33,
        inverter_buses=(2, 11, 40, 54, 87, 92, 103),
        inverter_s_kva=50.0,
        horizon=20,
        split="test",
    )


SCENARIOS = {"ieee13": ieee13, "ieee34": ieee34, "ieee123": ieee123}
