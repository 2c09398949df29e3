"""Checks of a MATPOWER case's figures: each refusal names file, line, table and column."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from dcgrid_env.apps.importers.matpower.case_tables import CaseTables
from dcgrid_env.grid.topology import FeederError

_LARGEST = 1e12
_COLUMNS = {
    "bus": ["bus_i", "type", "Pd", "Qd", "Gs", "Bs", "area", "Vm", "Va", "baseKV", "zone", "Vmax", "Vmin"],
    "gen": ["bus", "Pg", "Qg", "Qmax", "Qmin", "Vg", "mBase", "status"],
    "branch": ["fbus", "tbus", "r", "x", "b", "rateA", "rateB", "rateC", "ratio", "angle", "status"],
    "dcline": ["fbus", "tbus", "status"],
}
_USED = {
    "bus": ("bus_i", "type", "Pd", "Qd", "Gs", "Bs", "baseKV"),
    "gen": ("bus", "Pg", "Qg", "Vg", "status"),
    "branch": ("fbus", "tbus", "r", "x", "b", "rateA", "ratio", "angle", "status"),
    "dcline": ("fbus", "tbus", "status"),
}
"""Columns that the power flow or the feeder has a use for; others may hold anything."""


def check_case(file: str, case: CaseTables) -> None:
    """FeederError at the first figure of a case that cannot be used."""
    check = _Check(file, case)
    for table in case.tables:
        for column in _USED[table]:
            check.each(table, column, lambda v: np.abs(v) < _LARGEST, "give a finite number")
    check.each("bus", "bus_i", lambda v: (v >= 1) & (v == np.floor(v)), "a bus has a whole number above 0")
    check.once("bus", "bus_i")
    check.each("bus", "type", lambda v: np.isin(v, (1, 2, 3, 4)), "it is 1 (PQ), 2 (PV), 3 (reference) or 4 (isolated)")
    check.each("bus", "baseKV", lambda v: (v > 0) & (v < 1e5), "give the bus's base voltage in kV")
    check.each("gen", "Vg", lambda v: (v > 0) & (v < 100), "give a voltage in p.u.")
    check.each("branch", "ratio", lambda v: v >= 0, "it is 0 for a line, positive for a transformer")
    check.each("branch", "rateA", lambda v: v >= 0, "it is 0 where there is no limit, positive else")
    check.each("branch", "status", lambda v: np.isin(v, (0, 1)), "it is 0 or 1")
    buses = case.tables["bus"][:, 0]
    for table, column in (
        ("gen", "bus"),
        ("branch", "fbus"),
        ("branch", "tbus"),
        ("dcline", "fbus"),
        ("dcline", "tbus"),
    ):
        if table in case.tables:
            check.each(table, column, lambda v: np.isin(v, buses), "it is no bus of mpc.bus")
    branch = case.tables["branch"]
    same = np.flatnonzero(branch[:, 0] == branch[:, 1])
    if len(same):
        check.refuse("branch", "tbus", int(same[0]), "it joins a bus with itself")


class _Check:
    def __init__(self, file: str, case: CaseTables) -> None:
        self.file, self.case = file, case

    def each(self, table: str, column: str, good: Callable[[np.ndarray], np.ndarray], why: str) -> None:
        """Refuse the first cell of a column that is not good."""
        values = self.case.tables[table][:, _COLUMNS[table].index(column)]
        bad = np.flatnonzero(~good(values))
        if len(bad):
            self.refuse(table, column, int(bad[0]), why)

    def once(self, table: str, column: str) -> None:
        """Refuse a value that is there twice."""
        values = self.case.tables[table][:, _COLUMNS[table].index(column)]
        _, first = np.unique(values, return_index=True)
        again = np.setdiff1d(np.arange(len(values)), first)
        if len(again):
            self.refuse(table, column, int(again[0]), "it is there twice")

    def refuse(self, table: str, column: str, row: int, why: str) -> None:
        """FeederError that names a cell."""
        value = self.case.tables[table][row, _COLUMNS[table].index(column)]
        line = self.case.lines[table][row]
        raise FeederError(f"{self.file}, line {line}: mpc.{table}, row {row + 1}, {column} is {value:g}: {why}")
