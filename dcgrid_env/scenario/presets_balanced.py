"""The presets on balanced feeders, a function each; docs/scenarios.md describes their purpose."""

from __future__ import annotations

from dcgrid_env.devices import Storages
from dcgrid_env.devices.faults import Fault
from dcgrid_env.grid import load_feeder
from dcgrid_env.grid.random_feeders.family import RandomFeeders
from dcgrid_env.scenario.cost import CostWeights
from dcgrid_env.scenario.scenario import Scenario


def toy6() -> Scenario:
    """Make the preset ``toy6``."""
    return Scenario(
        name="toy6",
        feeder=load_feeder("toy6"),
        source_voltage_pu=1.0,
        n_datacenters=1,
        datacenters={"buses": (4,), "p_rated_kw": 2500.0, "s_rated_share": 1.1, "q_max_share": 0.33},
        inverters={"buses": (3, 5), "s_rated_kva": 1000.0},
        trace="step",
        workload={"window": "start"},
        background={"load_sigma": 0.02},
        horizon=100,
    )


def ieee123() -> Scenario:
    """Make the preset ``ieee123``."""
    return Scenario(
        name="ieee123",
        feeder=load_feeder("ieee123"),
        source_voltage_pu=1.04375,
        n_datacenters=5,
        datacenters={"p_rated_kw": 280.0, "s_rated_share": 1.1, "q_max_share": 0.33},
        inverters={"buses": (2, 11, 40, 54, 87, 92, 103), "s_rated_kva": 50.0},
    )


def ieee33_weak() -> Scenario:
    """Make the preset ``ieee33-weak``."""
    return Scenario(
        name="ieee33-weak",
        feeder=load_feeder("ieee33"),
        source_voltage_pu=1.05,
        n_datacenters=3,
        datacenters={"buses": (18, 33, 25), "p_rated_kw": 1000.0, "s_rated_share": 1.02, "q_max_share": 0.33},
        inverters={"buses": (7, 14, 20, 30), "s_rated_kva": 100.0},
    )


def ieee33() -> Scenario:
    """Make the preset ``ieee33``."""
    return ieee33_weak().replace(
        name="ieee33",
        n_datacenters=4,
        datacenters={"buses": (18, 33, 25, 22), "p_rated_kw": 600.0},
        inverters={"buses": (3, 7, 14, 20, 24, 30), "s_rated_kva": 500.0},
    )


def das69() -> Scenario:
    """Make the preset ``das69``."""
    return ieee33().replace(
        name="das69",
        feeder=load_feeder("das69"),
        datacenters={"buses": (27, 65, 35, 69), "p_rated_kw": 1000.0},
        inverters={"buses": (5, 12, 21, 40, 50, 61)},
    )


def khodr141() -> Scenario:
    """Make the preset ``khodr141``."""
    return ieee33().replace(
        name="khodr141",
        feeder=load_feeder("khodr141"),
        datacenters={"buses": (141, 32, 52, 87), "p_rated_kw": 2500.0},
        inverters={"buses": (10, 40, 60, 75, 100, 120), "s_rated_kva": 600.0},
    )


def bursty() -> Scenario:
    """Make the preset ``bursty``."""
    return ieee33_weak().replace(name="bursty", trace="code")


def ieee33_weak_ups() -> Scenario:
    """Make the preset ``ieee33-weak-ups``."""
    # What a UPS of 1 MW and 5 min lends to the grid of its 83 kWh: 300 kW for a minute, half full.
    base = bursty()
    assert base.datacenters.buses is not None
    ups = Storages.ups(base.datacenters.buses, p_rated_kw=300.0, minutes=1.0, initial_share=0.5)
    return base.replace(name="ieee33-weak-ups", devices=(*base.devices, ups))


def sync() -> Scenario:
    """Make the preset ``sync``."""
    return ieee33().replace(
        name="sync",
        datacenters={"p_rated_kw": 1000.0},
        inverters={"s_rated_kva": 300.0},
        workload={"site_correlation": 1.0},
    )


def training() -> Scenario:
    """Make the preset ``training``."""
    # What is left costs as if it waited 30 s more, which is 300 steps here.
    return ieee33_weak().replace(
        name="training",
        datacenters={"p_rated_kw": 600.0},
        trace="training",
        dt_s=0.1,
        horizon=200,
        weights=CostWeights(leftover=90.0),
    )


def mixed() -> Scenario:
    """Make the preset ``mixed``."""
    return ieee33().replace(name="mixed", inverters={"s_rated_kva": 1500.0, "injection": "pv"}, trace="mixed")


def fault() -> Scenario:
    """Make the preset ``fault``."""
    lost = Fault(("inverter", "capacitor"), begin_s=(10.0, 60.0))
    tripped = Fault(("datacenter",), begin_s=(10.0, 60.0), duration_s=(20.0, 40.0))
    return ieee123().replace(name="fault", inverters={"s_rated_kva": 150.0}, faults=(lost, tripped))


def robust() -> Scenario:
    """Make the preset ``robust``."""
    return ieee33().replace(
        name="robust",
        sensing={"noise_pu": 0.005, "delay_steps": 2, "preview": False, "r_model_share": 0.8, "x_model_share": 1.2},
    )


def wrong_model() -> Scenario:
    """Make the preset ``wrong-model``.

    The model has the switches of the loss minimum of M. E. Baran and F. F. Wu's feeder, whose ties have 2 or 0.5 ohm
    [1]_. In truth, the feeder is back in its normal state. docs/tasks.md gives the reasons for the other figures.

    References
    ----------
    .. [1] M. E. Baran, F. F. Wu, "Network reconfiguration in distribution systems for loss reduction and load
       balancing", IEEE Trans. Power Delivery 4(2), 1989.
    """
    return sync().replace(
        name="wrong-model",
        trace="code",
        background={"load_sigma": 0.2},
        sensing={
            "r_model_share": 0.8,
            "x_model_share": 1.2,
            "model_open": (("7", "8"), ("9", "10"), ("14", "15"), ("32", "33")),
            "model_closed": (
                ("8", "21", 2.0, 2.0),
                ("9", "15", 2.0, 2.0),
                ("12", "22", 2.0, 2.0),
                ("18", "33", 0.5, 0.5),
            ),
        },
    )


def late_measurements() -> Scenario:
    """Make the preset ``late-measurements``.

    Voltages have the error of meters of class 0.5 and are 5 s old; docs/tasks.md gives the reasons.
    """
    return mixed().replace(
        name="late-measurements",
        sensing={
            "noise_pu": 0.005,
            "delay_steps": 5,
            "observe": "neighbours",
            "preview": False,
            "r_model_share": 0.8,
            "x_model_share": 1.2,
        },
    )


def zero_shot() -> Scenario:
    """Make the preset ``zero-shot``."""
    # Buses are numbered depth first, so that inverters ten apart stand all over any of the feeders.
    return ieee33().replace(
        name="zero-shot",
        feeder=RandomFeeders(n_bus=60, style="us-mv", load_kw=4000.0, ood="rural"),
        datacenters={"buses": None, "p_rated_kw": 1000.0},
        inverters={"buses": (9, 19, 29, 39, 49, 59), "s_rated_kva": 400.0},
    )


def scale_32() -> Scenario:
    """Make the preset ``scale-32``."""
    # An hour of hindsight for a hundred episodes would be too long with twice the steps.
    return khodr141().replace(
        name="scale-32",
        n_datacenters=32,
        datacenters={"buses": None, "p_rated_kw": 500.0},
        inverters={"buses": (10, 32, 40, 52, 60, 75, 100, 120)},
        horizon=60,
    )
