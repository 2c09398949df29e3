"""A three-phase feeder in power-grid-model, as far as that library goes: lines, and constant power to ground.

That library has no regulator with a tap for each phase, no delta load and no single-phase capacitor, so both libraries
solve the same plain feeder. Its regulators and transformers are closed switches, every leg draws constant power from
its first node to ground, capacitors are off and the source is stiff. A missing phase is modelled without load.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dcgrid_env.core.threads import n_threads
from dcgrid_env.grid import ThreePhaseFeeder
from dcgrid_env.grid.network import (
    CapacitorTable,
    PhaseLoadTable,
    RegulatorTable,
    SourceTable,
    SwitchTable,
    TransformerTable,
)
from docs.studies.speed.reference_solvers import TOLERANCE_PU

FloatArray = NDArray[np.float64]
SWITCH_OHM = 1e-4
"""Resistance of a closed switch, small against every line's."""
_NOTHING = ((0.0,) * 3,) * 3
_UPPER = ("aa", "ba", "bb", "ca", "cb", "cc")


def plain_feeder(feeder: ThreePhaseFeeder) -> ThreePhaseFeeder:
    """Make the feeder that both libraries can represent: without loads, as devices' legs draw all power."""
    network, source, node = feeder.network, feeder.network.source, feeder.network.node
    kv_ln = float(feeder.base_kv_ln[0])
    joined: dict[tuple[str, str], str] = {}
    for table in (network.switch, network.regulator, network.transformer):
        for k in range(len(table)):
            if table is not network.switch or network.switch.state[k] == "closed":
                ends = (table.from_bus[k], table.to_bus[k])
                joined[ends] = "".join(sorted({*joined.get(ends, ""), *table.phases[k]}))
    n = len(joined)
    switches = SwitchTable(
        [f"s{k}" for k in range(n)], [i for i, _ in joined], [j for _, j in joined], list(joined.values()),
        ["closed"] * n, [SWITCH_OHM] * n, [0.0] * n,
    )  # fmt: skip
    return ThreePhaseFeeder.from_network(
        replace(
            network,
            source=SourceTable(
                source.bus, [kv_ln * math.sqrt(3.0)], source.v_pu, source.angle_deg, [_NOTHING], [_NOTHING]
            ),
            node=replace(node, base_kv_ln=[kv_ln] * len(node)),
            switch=switches,
            regulator=RegulatorTable(),
            transformer=TransformerTable(),
            phase_load=PhaseLoadTable(),
            capacitor=CapacitorTable(),
        )
    )


def power_grid_model_batch(feeder: ThreePhaseFeeder) -> Callable[[FloatArray, FloatArray], FloatArray]:
    """Set a plain feeder up; the batch takes powers (row, n_leg) to voltages (row, n_node), on all threads."""
    import power_grid_model as pgm  # pyright: ignore[reportMissingImports]  (in the bench extra only)

    n, kv_ln = feeder.n_bus, float(feeder.base_kv_ln[0])
    nodes = _table(pgm, "node", np.arange(n), u_rated=kv_ln * math.sqrt(3.0) * 1e3)
    source = _table(pgm, "source", [3 * n], node=0, status=1, u_ref=feeder.v0_pu, sk=1e18)
    loads = _table(pgm, "asym_load", np.arange(2 * n, 3 * n), node=np.arange(n), status=1)
    loads["type"] = pgm.LoadGenType.const_power
    loads["p_specified"] = loads["q_specified"] = 0.0
    model = pgm.PowerGridModel({"node": nodes, "source": source, "asym_load": loads, "asym_line": _lines(pgm, feeder)})
    phase = feeder.node_phase - 1

    def solve_batch(p_kw: FloatArray, q_kvar: FloatArray) -> FloatArray:
        update = pgm.initialize_array("update", "asym_load", (len(p_kw), n))
        update["id"] = loads["id"]
        for field, values in (("p_specified", p_kw), ("q_specified", q_kvar)):
            by_phase = np.zeros((len(p_kw), n, 3))
            by_phase[:, feeder.node_bus, phase] = values * 1e3
            update[field] = by_phase
        found: Any = model.calculate_power_flow(
            symmetric=False,
            update_data={"asym_load": update},
            threading=n_threads(),
            error_tolerance=TOLERANCE_PU,
            max_iterations=100,
            calculation_method=pgm.CalculationMethod.iterative_current,
            output_component_types=["node"],
        )
        return found["node"]["u_pu"][:, feeder.node_bus, phase]

    return solve_batch


def _lines(pgm: Any, feeder: ThreePhaseFeeder) -> Any:
    n, base_ohm = feeder.n_bus, float(feeder.base_kv_ln[0]) ** 2
    lines = _table(pgm, "asym_line", np.arange(n, 2 * n - 1), from_node=feeder.parent, to_node=np.arange(1, n))
    lines["from_status"] = lines["to_status"] = 1
    lines["i_n"] = 1e3
    z, farad = np.zeros((n, 3, 3), np.complex128), np.zeros((n, 3, 3))
    z[:, range(3), range(3)] = 1.0
    for k in range(1, n):
        phases = ["abc".index(p) for p in feeder.bus_phases[k]]
        at, size = np.ix_(phases, phases), len(phases)
        z[k][at] = feeder.branches.b[k, :size, :size] * base_ohm
        siemens = 2.0 * feeder.branches.sending_shunt[k, :size, :size] / base_ohm
        farad[k][at] = siemens / (2.0 * math.pi * 50.0)  # the library counts at 50 Hz
    for entry in _UPPER:
        i, j = "abc".index(entry[0]), "abc".index(entry[1])
        for name, values in (("r", z.real), ("x", z.imag), ("c", farad)):
            lines[f"{name}_{entry}"] = values[1:, i, j]
    return lines


def _table(pgm: Any, kind: str, ids: Any, **columns: Any) -> Any:
    table = pgm.initialize_array("input", kind, len(ids))
    table["id"] = ids
    for name, values in columns.items():
        table[name] = values
    return table
