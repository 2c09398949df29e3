"""What an import gives: tables, what became of each element, and the voltages that the source's own solver finds."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass

import numpy as np

from dcgrid_env.apps.importers.bus_branch.description import BusBranchGrid
from dcgrid_env.apps.importers.bus_branch.reduction import reduced_network
from dcgrid_env.apps.importers.import_report import Finding, Report
from dcgrid_env.grid.network import Network
from dcgrid_env.traces import ProfileTable


@dataclass(frozen=True)
class ImportedFeeder:
    """A balanced feeder read from another program's grid.

    Attributes
    ----------
    network
        Its tables, which ``Feeder.from_network`` compiles.
    findings
        Treatment of each element.
    bus_of
        Bus of the tables for each bus of the source that is supplied: several where closed switches make them one.
    v_pu
        Voltage magnitude of each bus of the tables by the source's solver, p.u. of the bus's base; empty if the solver
        found none.
    solver
        Name of that solver.
    notes
        Lines that the user should read in addition to the findings.
    profiles
        Load over time of each bus of the tables whose loads have profiles, kW and kvar; None if there are none.
    """

    network: Network
    findings: tuple[Finding, ...]
    bus_of: dict[str, str]
    v_pu: dict[str, float]
    solver: str
    notes: tuple[str, ...] = ()
    profiles: ProfileTable | None = None


def imported(
    grid: BusBranchGrid,
    report: Report,
    voltages: Callable[[], Mapping[str, float]],
    *,
    solver: str,
    source: str | None,
    allow: Collection[str],
    source_of_facts: str,
    notes: tuple[str, ...] = (),
) -> ImportedFeeder:
    """Reduce a grid and assign the solver's voltages, by bus of the grid, to the buses of the tables.

    The solver runs only after the grid is known to be a feeder.
    """
    reduced = reduced_network(grid, report, source=source, allow=allow, source_of_facts=source_of_facts)
    there = {bus: float(v) for bus, v in voltages().items() if reduced.bus_of.get(bus) == bus and np.isfinite(v)}
    return ImportedFeeder(reduced.network, report.findings, reduced.bus_of, there, solver, notes)
