"""A feeder written as power-grid-model's JSON input data."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

from dcgrid_env.apps.importers.bus_branch import BalancedFeeder, Branch, BusBranchGrid, described
from dcgrid_env.apps.importers.power_grid_model.pgm_branches import BASE_MVA
from dcgrid_env.apps.importers.power_grid_model.pgm_reading import IDEAL_SK_VA
from dcgrid_env.core.files import write_text
from dcgrid_env.grid.network import bus_numbers
from dcgrid_env.grid.topology import FeederError

_LARGEST_ID = 2**30
Row = dict[str, Any]


def write_power_grid_model(feeder: BalancedFeeder, path: str | Path) -> None:
    """Write a feeder as a file of input data; FeederError for one that power-grid-model cannot hold."""
    write_text(Path(path), power_grid_model_text(feeder))


def power_grid_model_text(feeder: BalancedFeeder) -> str:
    """Text of a JSON file; nodes have the feeder's buses as ids where all are whole numbers, and a ``name`` in any
    case.

    A branch without impedance becomes a link. FeederError for a transformer without impedance.
    """
    grid = described(feeder, BASE_MVA)
    numbers = bus_numbers(grid.buses)
    fits = numbers is not None and min(numbers) >= 0 and max(numbers) < _LARGEST_ID
    ids = list(numbers) if numbers is not None and fits else list(range(1, grid.n_bus + 1))
    data: dict[str, list[Row]] = {
        "node": [
            {"id": i, "u_rated": 1000.0 * float(kv), "name": bus}
            for i, kv, bus in zip(ids, grid.base_kv, grid.buses, strict=True)
        ]
    }
    number = iter(range(max(ids) + 1, max(ids) + 1 + 4 * grid.n_bus))
    data["source"] = [
        {"id": next(number), "node": ids[0], "status": 1, "u_ref": grid.sources[0].v_pu, "sk": IDEAL_SK_VA}
    ]
    for b in grid.branches:
        kind, row = _branch(feeder.name, grid, b)
        ends = {"from_node": ids[b.from_bus], "to_node": ids[b.to_bus], "from_status": 1, "to_status": 1}
        data.setdefault(kind, []).append({"id": next(number), **ends, **row})
    for k, i in enumerate(ids):
        p, q = 1000.0 * float(grid.p_kw[k]), 1000.0 * float(grid.q_kvar[k])
        if p or q:
            load = {"id": next(number), "node": i, "status": 1, "type": 0, "p_specified": p, "q_specified": q}
            data.setdefault("sym_load", []).append(load)
        square_kv2 = 1000.0 * float(grid.base_kv[k]) ** 2
        g1, b1 = float(grid.shunt_kw[k]) / square_kv2, float(grid.shunt_kvar[k]) / square_kv2
        if g1 or b1:
            row = {"id": next(number), "node": i, "status": 1, "g1": g1, "b1": b1, "g0": 0.0, "b0": 0.0}
            data.setdefault("shunt", []).append(row)
    head = {"version": "1.0", "type": "input", "is_batch": False, "attributes": {}, "data": data}
    return json.dumps(head, indent=1) + "\n"


def _branch(feeder: str, grid: BusBranchGrid, b: Branch) -> tuple[str, Row]:
    """Component and fields of a branch."""
    volts = 1000.0 * float(grid.base_kv[b.to_bus])
    z_ohm = b.z_pu * volts**2 / (1e6 * grid.base_mva)
    rating_va = b.rating_pu * 1e6 * grid.base_mva
    if b.kind == "line":
        if b.z_pu == 0:
            return "link", {}
        row = {"r1": z_ohm.real, "x1": z_ohm.imag, "c1": 0.0, "tan1": 0.0}
        return "line", row if math.isnan(rating_va) else row | {"i_n": rating_va / (math.sqrt(3.0) * volts)}
    if b.z_pu == 0:
        raise FeederError(
            f"feeder {feeder!r}: branch {b.name} is a transformer without impedance, which power-grid-model cannot hold"
        )
    row = {"r1": z_ohm.real, "x1": z_ohm.imag, "g1": 0.0, "b1": 0.0, "k": b.tap, "theta": 0.0}
    return "generic_branch", row if math.isnan(rating_va) else row | {"sn": rating_va}
