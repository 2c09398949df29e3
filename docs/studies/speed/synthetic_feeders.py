"""Feeders of any size for measuring: random trees with a depth that grows with them, and a drop that does not."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from dcgrid_env.grid import Feeder, ThreePhaseFeeder
from dcgrid_env.grid.network import Network, NodeTable, PhaseLineTable, PhaseLoadTable, SourceTable
from dcgrid_env.powerflow import lindistflow

LOAD_KW, LOAD_KVAR = 5000.0, 1500.0
"""Load of a feeder, in equal parts at its buses."""
REACH = 20
"""A bus hangs on one of so many before it: the way to the last has a tenth as many branches as there are buses."""
DROP_PU = 0.05
WAY_OHM = 3.0
"""Reactance of the longest way in a three-phase feeder, if all its lines are of three phases."""


def balanced_feeder(n_bus: int, seed: int = 0, chain: bool = False) -> Feeder:
    """A balanced feeder of ``n_bus`` buses, 5 MW in all and 0.05 p.u. of drop; all in a line for ``chain``."""
    rng = np.random.default_rng(seed)
    hang_on = _hang_on(n_bus, rng, chain)
    share = np.concatenate(([0.0], np.full(n_bus - 1, 1.0 / (n_bus - 1))))
    feeder = Feeder.from_tables(
        name=f"synthetic-{n_bus}",
        base_kv=12.47,
        substation=0,
        v0_pu=1.02,
        bus_ids=range(n_bus),
        p_load_kw=(LOAD_KW * share).tolist(),
        q_load_kvar=(LOAD_KVAR * share).tolist(),
        from_bus=hang_on,
        to_bus=range(1, n_bus),
        r_ohm=(1e-6 * rng.uniform(0.5, 1.5, n_bus - 1)).tolist(),
        x_ohm=(1e-6 * rng.uniform(0.5, 1.5, n_bus - 1)).tolist(),
    )
    lowest = lindistflow(feeder, feeder.p_load_kw, feeder.q_load_kvar).v_pu.min()
    longer = (feeder.v0_pu**2 - (feeder.v0_pu - DROP_PU) ** 2) / (feeder.v0_pu**2 - float(lowest) ** 2)
    return feeder.scaled(longer, longer)


def three_phase_feeder(n_node: int, seed: int = 0) -> ThreePhaseFeeder:
    """A three-phase feeder of some ``n_node`` nodes: a trunk of three phases, laterals of one, a load at every bus.

    Lines have self and mutual impedance and charging; loads are constant power from a phase to ground.
    """
    rng = np.random.default_rng(seed)
    phases, feeds = _three_phase_tree(n_node, rng)
    n_bus = len(phases)
    depth = [0] * n_bus
    for k in range(1, n_bus):
        depth[k] = depth[feeds[k]] + 1
    ohm = WAY_OHM / max(depth)
    full = np.full((3, 3), math.nan)

    def matrix(of: str, own: float, mutual: float) -> Any:
        values, at = full.copy(), ["abc".index(phase) for phase in of]
        values[np.ix_(at, at)] = mutual + (own - mutual) * np.eye(len(at))
        return values.tolist()

    alike = {
        of: [matrix(of, *pair) for pair in ((ohm, 0.3 * ohm), (2.0 * ohm, ohm), (0.01, 0.0))] for of in set(phases)
    }
    buses, lines = [str(k) for k in range(n_bus)], range(1, n_bus)
    node = [(buses[k], "abc".index(phase) + 1) for k, of in enumerate(phases) for phase in of]
    kw = LOAD_KW / len(node)
    legs = [[kw * (phase in phases[k]) for phase in "abc"] for k in lines]
    network = Network(
        name=f"synthetic-{len(node)}-3ph",
        source=SourceTable(["0"], [12.47], [1.02], [0.0], [np.eye(3) * 0.01], [np.eye(3) * 0.1]),  # pyright: ignore
        node=NodeTable(
            [b for b, _ in node], [p for _, p in node], [math.nan] * len(node), [math.nan] * len(node),
            [12.47 / math.sqrt(3.0)] * len(node),
        ),
        phase_line=PhaseLineTable(
            [f"l{k}" for k in lines], [buses[feeds[k]] for k in lines], buses[1:], phases[1:], [math.nan] * (n_bus - 1),
            *([alike[phases[k]][column] for k in lines] for column in range(3)),
        ),
        phase_load=PhaseLoadTable(
            [f"s{k}" for k in lines], buses[1:], ["wye"] * (n_bus - 1), ["PQ"] * (n_bus - 1),
            [12.47 / math.sqrt(3.0)] * (n_bus - 1), legs, [[0.3 * leg for leg in row] for row in legs],
            [0.8] * (n_bus - 1), [1.2] * (n_bus - 1), [0.5] * (n_bus - 1), [()] * (n_bus - 1),
        ),
    )  # fmt: skip
    return ThreePhaseFeeder.from_network(network)


def _hang_on(n_bus: int, rng: np.random.Generator, chain: bool) -> list[int]:
    """For each bus but the first, the one before it that feeds it."""
    if chain:
        return list(range(n_bus - 1))
    before = np.arange(n_bus - 1)
    return (before - rng.integers(0, np.minimum(before, REACH) + 1)).tolist()


def _three_phase_tree(n_node: int, rng: np.random.Generator) -> tuple[list[str], list[int]]:
    """Phases of each bus, and the bus that feeds it; a tenth of the nodes' buses are of the trunk."""
    n_trunk = max(n_node // 9, 1)
    phases = ["abc"] * n_trunk
    feeds = [0, *_hang_on(n_trunk, rng, False)]
    count = 3 * n_trunk
    while count < n_node:
        start = int(rng.integers(n_trunk))
        phase = "abc"[int(rng.integers(3))]
        for k in range(min(int(rng.integers(1, 12)), n_node - count)):
            feeds.append(start if k == 0 else len(phases) - 1)
            phases.append(phase)
            count += 1
    return phases, feeds
