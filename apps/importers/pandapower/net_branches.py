"""Branches of pandapower's per-unit model, each with the element of the net that it comes from."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from dcgrid_env.apps.importers.bus_branch import Branch
from dcgrid_env.apps.importers.import_report import Report
from dcgrid_env.apps.importers.pandapower.net_schema import PandapowerNet

_FROM, _TO, _R, _X, _B, _TAP, _SHIFT, _STATUS = 0, 1, 2, 3, 4, 8, 9, 10
_R_ASYM, _X_ASYM, _G, _G_ASYM, _B_ASYM = 21, 22, 23, 24, 25
"""Columns of pandapower's model of branches: MATPOWER's, and its own for ends that differ."""

_BUS_TYPE, _ISOLATED = 1, 4
"""Column of its model of buses, and what it says of one that is out of service or that nothing feeds."""


class ModelRows:
    """Which row of pandapower's model is which bus of the net, after its power flow was run.

    Attributes
    ----------
    model_bus, model_branch
        Its tables of buses and branches in per unit.
    of_bus
        Row in the grid for each bus index of the net.
    model_row
        Row of the model for each bus index of the net; buses that switches join share one.
    of_model
        Row in the grid for each row of the model, of the first bus where several share it.
    within
        Names of buses that are within an element, such as the star point of three windings, by row of the model.
    open_ends
        Rows of the model that are but the open end of a line.
    dead
        Rows of the model of buses that are out of service.
    """

    def __init__(self, net: PandapowerNet) -> None:
        self.model_bus, self.model_branch = net._ppc["bus"], np.real(net._ppc["branch"])
        lookups = net._pd2ppc_lookups
        index = net.bus.index.tolist()
        self.of_bus = {bus: i for i, bus in enumerate(index)}
        self.model_row = {bus: int(lookups["bus"][bus]) for bus in index}
        self.of_model: dict[int, int] = {}
        for bus in index:
            self.of_model.setdefault(self.model_row[bus], self.of_bus[bus])
        self.within: dict[int, str] = {}
        for element, buses in lookups["aux"].items():
            for i, bus in zip(net[element].index.tolist(), np.asarray(buses).tolist(), strict=False):
                self.within[int(lookups["bus"][bus])] = f"{element}-{i}"
        for k, row in enumerate(self.within):
            self.of_model[row] = len(index) + k
        in_service = net.bus.in_service.tolist()
        off = {self.model_row[bus] for bus, live in zip(index, in_service, strict=True) if not live}
        self.dead = {row for row in off if self.model_bus[row, _BUS_TYPE].real == _ISOLATED}
        self.open_ends = {row for row in range(len(self.model_bus)) if row not in self.of_model}
        for row in self.open_ends:
            self.of_model[row] = 0  # nothing is drawn there, and its line ends before it


def read_branches(net: PandapowerNet, rows: ModelRows, report: Report) -> list[Branch]:
    """Return branches in the model's order; a branch that differs by direction is refused."""
    branches = []
    ratings = _ratings(net, rows)
    for k, kind, name in _elements(net):
        m = rows.model_branch[k]
        f, t = int(m[_FROM]), int(m[_TO])
        if m[_R_ASYM] or m[_X_ASYM]:
            report.add("refused", kind, name, "its impedance differs by direction; give both directions one")
        live = bool(m[_STATUS]) and f not in rows.dead and t not in rows.dead
        from_closed, to_closed = live and f not in rows.open_ends, live and t not in rows.open_ends
        branches.append(
            Branch(
                kind,
                name,
                rows.of_model[f],
                rows.of_model[t],
                complex(m[_R], m[_X]),
                complex(m[_G], m[_B]) / 2.0,
                complex(m[_G] + m[_G_ASYM], m[_B] + m[_B_ASYM]) / 2.0,
                float(m[_TAP]) or 1.0,
                float(m[_SHIFT]),
                ratings.get((kind, name), math.nan),
                from_closed,
                to_closed,
            )
        )
    return branches


def _elements(net: PandapowerNet) -> Iterator[tuple[int, str, str]]:
    """Row of the model's branches, kind and name of each element."""
    sides = ("hv", "mv", "lv")
    for kind, (begin, end) in net._pd2ppc_lookups["branch"].items():
        if kind == "switch":
            table = net.switch
            names = [str(i) for i in table.index[(table.et == "b") & table.closed & (table.z_ohm > 0)]]
        elif kind == "trafo3w":
            names = [f"{i} ({side})" for side in sides for i in net.trafo3w.index]
        else:
            names = [str(i) for i in net[kind].index]
        if len(names) != end - begin:
            names = [f"{kind} {k}" for k in range(end - begin)]
        yield from ((begin + k, kind, name) for k, name in enumerate(names))


def _ratings(net: PandapowerNet, rows: ModelRows) -> dict[tuple[str, str], float]:
    """Largest current of lines and transformers, per unit of their to bus, where it is known."""
    base_mva, ratings = float(net.sn_mva), {}
    line, trafo = net.line, net.trafo
    kv = dict(zip(net.bus.index.tolist(), net.bus.vn_kv.tolist(), strict=True))
    if "max_i_ka" in line.columns:
        columns = zip(line.index, line.to_bus, line.max_i_ka, _or_one(line, "df"), line.parallel, strict=True)
        for i, bus, limit_ka, derating, parallel in columns:
            if limit_ka is not None and limit_ka == limit_ka:
                ratings["line", str(i)] = limit_ka * derating * parallel * math.sqrt(3.0) * kv[bus] / base_mva
    columns = zip(
        trafo.index, trafo.lv_bus, trafo.sn_mva, trafo.vn_lv_kv, _or_one(trafo, "df"), trafo.parallel, strict=True
    )
    for i, bus, sn_mva, vn_kv, derating, parallel in columns:
        ratings["trafo", str(i)] = sn_mva * derating * parallel / base_mva * kv[bus] / vn_kv
    return ratings


def _or_one(table: Any, column: str) -> Any:
    return table[column] if column in table.columns else np.ones(len(table))
