"""Scenarios on the three-phase feeders that ship: devices of one and of three phases, given and drawn buses."""

import math
from functools import cache
from typing import Any

from dcgrid_env import Scenario, ThreePhaseFeeder, load_feeder
from dcgrid_env.grid.network import Network, NodeTable, SourceTable
from dcgrid_env.grid.three_phase_tables import PhaseLineTable


def _scenario(number: int, source_voltage_pu: float, **given: Any) -> Any:
    shares = {"datacenters.s_rated_share": 1.1, "datacenters.q_max_share": 0.33}
    return Scenario(
        name=f"ieee{number}-three-phase",
        feeder=load_feeder(f"ieee{number}-3ph"),
        source_voltage_pu=source_voltage_pu,
        power_flow="sweep",
        horizon=20,
        split="test",
        **shares,
        **given,
    )


@cache
def ieee13() -> Any:
    """Two sites and four inverters on the IEEE 13 node feeder, two of them on one phase."""
    return _scenario(
        13,
        1.0001,
        n_datacenters=2,
        datacenters={"buses": ("671", "680"), "p_rated_kw": 500.0},
        inverters={"buses": ("633", "675", "611", "652"), "s_rated_kva": (150.0, 200.0, 60.0, 60.0)},
    )


@cache
def ieee34() -> Any:
    """Two sites and five inverters on the IEEE 34 node feeder, which is long and weak."""
    return _scenario(
        34,
        1.05,
        n_datacenters=2,
        datacenters={"buses": ("840", "860"), "p_rated_kw": 250.0},
        inverters={"buses": ("816", "834", "848", "822", "838"), "s_rated_kva": (100.0, 100.0, 100.0, 30.0, 30.0)},
    )


@cache
def ieee123() -> Any:
    """The paper's study on the IEEE 123 node feeder itself: five sites at random, seven inverters."""
    return _scenario(
        123, 1.0, n_datacenters=5, datacenters={"p_rated_kw": 280.0},
        inverters={"buses": (2, 11, 40, 54, 87, 92, 103), "s_rated_kva": 50.0}, )  # fmt: skip


@cache
def one_phase() -> Any:
    """A source of three phases, and two buses on phase b alone: a site at the nearer, an inverter at the other."""
    own = [[v if i == j == 1 else math.nan for j in range(3)] for v in (0.05, 0.1, 0.0) for i in range(3)]
    r, x, b = own[:3], own[3:6], own[6:]
    nothing = [[0.0] * 3] * 3
    network = Network(
        name="one phase",
        source=SourceTable(["0"], [math.sqrt(3.0)], [1.0], [0.0], [nothing], [nothing]),
        node=NodeTable(list("00012"), [1, 2, 3, 2, 2], [0.0, 0.0, 0.0, 1.0, 2.0], [0.0] * 5, [1.0] * 5),
        phase_line=PhaseLineTable(["l", "m"], ["0", "1"], ["1", "2"], ["b"] * 2, [1.0] * 2, [r] * 2, [x] * 2, [b] * 2),
    )
    return Scenario(
        name="one phase",
        feeder=ThreePhaseFeeder.from_network(network),
        power_flow="sweep",
        source_voltage_pu=1.0,
        horizon=20,
        n_datacenters=1,
        datacenters={"buses": ("1",), "phases": ("b",), "p_rated_kw": 50.0, "s_rated_share": 1.1, "q_max_share": 0.33},
        inverters={"buses": ("2",), "s_rated_kva": 20.0},
    )


SCENARIOS = {"ieee13": ieee13, "ieee34": ieee34, "ieee123": ieee123}
