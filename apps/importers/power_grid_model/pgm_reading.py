"""Read a balanced feeder from a power-grid-model JSON file."""

from __future__ import annotations

import math
from collections.abc import Collection
from pathlib import Path
from typing import Any

import numpy as np

from dcgrid_env.apps.importers.bus_branch import Branch, BusBranchGrid, ImportedFeeder, Source, imported
from dcgrid_env.apps.importers.bus_branch.bus_naming import errors_naming, named_buses
from dcgrid_env.apps.importers.bus_branch.description import empty_grid
from dcgrid_env.apps.importers.import_report import UNBALANCED, Report
from dcgrid_env.apps.importers.power_grid_model.pgm_branches import (
    BASE_MVA,
    read_generic_branches,
    read_lines,
    read_links,
    read_transformers,
)
from dcgrid_env.apps.importers.power_grid_model.pgm_data import Data, input_data
from dcgrid_env.grid.topology import FeederError

_REFUSED = {
    "three_winding_transformer": "three windings: give it as three transformers to a node between",
    "asym_line": "a line whose phases differ",
    "voltage_regulator": "it keeps a voltage, which no load does",
}
_NO_MATTER = ("sym_voltage_sensor", "asym_voltage_sensor", "sym_power_sensor", "asym_power_sensor",
              "sym_current_sensor", "asym_current_sensor", "fault")  # fmt: skip
_CONSTANT_POWER, _CONSTANT_IMPEDANCE, _CONSTANT_CURRENT = 0, 1, 2
IDEAL_SK_VA = 1e15
"""Short-circuit power from which a source is an ideal one."""
_MOST_SK_VA = 1e20
"""Largest short-circuit power that power-grid-model is run with."""
_LOWEST_V, _HIGHEST_V = 1e-3, 1e8
_SK_VA, _RX_RATIO = 1e10, 0.1
"""What power-grid-model takes where a file does not say."""


def read_power_grid_model(
    path: str | Path,
    *,
    source: str | None = None,
    allow: Collection[str] = (),
    frequency_hz: float = 50.0,
    bus_names: bool = False,
) -> ImportedFeeder:
    """Read a file of input data; needs power-grid-model, of the extra of this name.

    Parameters
    ----------
    path
        The JSON file.
    source
        Node of the source whose island is taken, where there are several.
    allow
        Kinds of elements that may be left out although something is lost.
    frequency_hz
        Frequency of the system, which the file does not hold.
    bus_names
        Call buses by a field ``name`` of the nodes rather than by their ids.

    Raises
    ------
    FeederError
        For a cell that cannot be used, naming component, row, id and field, for what cannot be represented, naming
        it, and where power-grid-model is missing.
    """
    path = Path(path)
    if not (math.isfinite(frequency_hz) and frequency_hz > 0):
        raise FeederError(f"frequency is {frequency_hz} Hz; give a positive number such as 50")
    with errors_naming(path):
        report = Report("grid")
        data, names = input_data(path, report)
        grid, rows = _grid(path, data, names, bus_names)
        u_rated = 1000.0 * grid.base_kv
        grid.branches += read_lines(data, rows, u_rated, frequency_hz)
        grid.branches += read_transformers(data, rows, u_rated)
        grid.branches += read_generic_branches(data, rows, u_rated)
        grid.switches += read_links(data, rows, report)
        _add_loads(grid, data, rows, report)
        _add_rest(data, report)
        chosen = next((s.name for s in grid.sources if grid.buses[_node_of(grid, s)] == source), source)
        source_bus = next((grid.buses[s.bus] for s in grid.sources if s.name == chosen), chosen)
        facts = f"power-grid-model file {path.name}"

        def voltages() -> dict[str, float]:
            return {grid.buses[rows[node]]: v for node, v in _solved(data, frequency_hz).items()}

        return imported(
            grid, report, voltages, solver="power-grid-model", source=source_bus, allow=allow, source_of_facts=facts
        )


def _solved(data: Data, frequency_hz: float) -> dict[int, float]:
    """Voltage of each energised node, p.u., empty where power-grid-model finds none."""
    from power_grid_model import PowerGridModel
    from power_grid_model.errors import PowerGridError  # pyright: ignore[reportPrivateImportUsage]

    # power-grid-model finds no solution with an impedance that rounding takes away.
    data = data | {"source": data["source"].copy()}
    data["source"]["sk"] = np.minimum(data["source"]["sk"], _MOST_SK_VA)
    for tolerance in (1e-11, 1e-9, 1e-7):
        try:
            model = PowerGridModel(data, system_frequency=frequency_hz)  # pyright: ignore[reportArgumentType]
            node = model.calculate_power_flow(symmetric=True, error_tolerance=tolerance, max_iterations=50)["node"]
        except PowerGridError:
            continue
        live = [(int(i), float(v)) for i, v, on in zip(node["id"], node["u_pu"], node["energized"], strict=True) if on]
        return dict(live)
    return {}


def _grid(path: Path, data: Data, names: dict[int, str], bus_names: bool) -> tuple[BusBranchGrid, dict[int, int]]:
    """Return nodes and sources, with the buses behind the sources' impedances."""
    nodes, sources = data.get("node", np.zeros(0)), [s for s in data.get("source", ()) if s["status"]]
    if not len(nodes):
        raise FeederError(f"{path}: it has no node; give power-grid-model's input data")
    for node in nodes:
        if not _LOWEST_V <= node["u_rated"] <= _HIGHEST_V:
            raise FeederError(f"{path}: node {node['id']}: u_rated is {node['u_rated']:g}; give the rated voltage in V")
    ids = [int(node["id"]) for node in nodes]
    rows = {i: k for k, i in enumerate(ids)}
    weak = [s for s in sources if _value_or_default(s["sk"], _SK_VA) < IDEAL_SK_VA]
    called = [names.get(i, str(i)) if bus_names else str(i) for i in ids]
    behind = [f"source-{int(s['id'])}" for s in weak]
    base_kv = [float(node["u_rated"]) / 1000.0 for node in nodes]
    base_kv += [base_kv[rows[int(s["node"])]] for s in weak]
    grid = empty_grid(path.stem, BASE_MVA, named_buses(str(path), [*called, *behind]), np.array(base_kv))
    for s in sources:
        node, bus = rows[int(s["node"])], rows[int(s["node"])]
        name = str(int(s["id"]))
        if f"source-{name}" in behind:
            bus = len(nodes) + behind.index(f"source-{name}")
            z_pu = BASE_MVA * 1e6 / _value_or_default(s["sk"], _SK_VA)
            ratio = _value_or_default(s["rx_ratio"], _RX_RATIO)
            x_pu = z_pu / math.sqrt(1.0 + ratio**2)
            grid.branches.append(Branch("source", name, bus, node, complex(ratio * x_pu, x_pu)))
        grid.sources.append(Source("source", name, bus, float(s["u_ref"])))
    return grid, rows


def _node_of(grid: BusBranchGrid, source: Source) -> int:
    """Row of the node that a source feeds."""
    return next((b.to_bus for b in grid.branches if b.kind == "source" and b.name == source.name), source.bus)


def _add_loads(grid: BusBranchGrid, data: Data, rows: dict[int, int], report: Report) -> None:
    """Put loads, generators and shunts into the grid."""
    kinds = {"sym_load": 1.0, "asym_load": 1.0, "sym_gen": -1.0, "asym_gen": -1.0}
    for kind, sign in kinds.items():
        for one in data.get(kind, ()):
            name, i = str(int(one["id"])), rows[int(one["node"])]
            if not one["status"]:
                report.add("nothing lost", kind, name, "out of service: it is left out")
                continue
            p_kw, q_kvar = (sign * float(np.sum(one[field])) / 1000.0 for field in ("p_specified", "q_specified"))
            if one["type"] == _CONSTANT_IMPEDANCE:
                grid.shunt_kw[i] += p_kw
                grid.shunt_kvar[i] -= q_kvar
            else:
                grid.p_kw[i] += p_kw
                grid.q_kvar[i] += q_kvar
            lost = [UNBALANCED] if _is_unbalanced(one) else []
            if one["type"] == _CONSTANT_CURRENT:
                lost.append("its constant current becomes constant power")
            for text in lost:
                report.add("lost", kind, name, text)
            if not lost:
                load = "a load" if sign > 0 else "a negative load"
                text = "a shunt, of constant impedance" if one["type"] == _CONSTANT_IMPEDANCE else load
                report.add("taken", kind, name, text)
    for one in data.get("shunt", ()):
        name, i = str(int(one["id"])), rows[int(one["node"])]
        if one["status"]:
            square_kv2 = float(grid.base_kv[i]) ** 2
            grid.shunt_kw[i] += 1000.0 * float(one["g1"]) * square_kv2
            grid.shunt_kvar[i] += 1000.0 * float(one["b1"]) * square_kv2
        text = "a shunt" if one["status"] else "out of service: it is left out"
        report.add("taken" if one["status"] else "nothing lost", "shunt", name, text)


def _is_unbalanced(one: Any) -> bool:
    """Whether the phases of a load or generator differ."""
    return any(not np.allclose(one[field], np.mean(one[field]), atol=0.0) for field in ("p_specified", "q_specified"))


def _add_rest(data: Data, report: Report) -> None:
    """Report how components are treated that have no place in the tables."""
    for one in data.get("source", ()):
        if not one["status"]:
            report.add("nothing lost", "source", str(int(one["id"])), "out of service: it is left out")
        elif _value_or_default(one["u_ref_angle"], 0.0):
            report.add(
                "nothing lost", "source", str(int(one["id"])), "its angle turns all voltages alike: it is left out"
            )
    for kind, meaning in _REFUSED.items():
        report.add_all("refused", kind, [str(int(one["id"])) for one in data.get(kind, ())], meaning)
    for kind in _NO_MATTER:
        ids = [str(int(one["id"])) for one in data.get(kind, ())]
        report.add_all("nothing lost", kind, ids, "the power flow has no use for it")
    for one in data.get("transformer_tap_regulator", ()):
        fate: Any = "lost" if one["status"] else "nothing lost"
        report.add(fate, "transformer_tap_regulator", str(int(one["id"])), "the tap stays as it is")


def _value_or_default(value: Any, default: float) -> float:
    return default if np.isnan(value) else float(value)
