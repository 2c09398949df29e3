"""A balanced feeder from a pandapower net.

Branches, loads and shunts come from the per-unit model that pandapower builds for its power flow. Every description of
a line, a transformer or its taps is therefore interpreted as in pandapower.
"""

from __future__ import annotations

import dataclasses
import itertools
import logging
import warnings
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import numpy as np

from dcgrid_env.apps.importers.bus_branch import BusBranchGrid, ClosedSwitch, ImportedFeeder, Source, imported
from dcgrid_env.apps.importers.bus_branch.bus_naming import errors_naming, named_buses
from dcgrid_env.apps.importers.bus_branch.description import empty_grid
from dcgrid_env.apps.importers.import_report import UNBALANCED, Report
from dcgrid_env.apps.importers.pandapower.net_branches import ModelRows, read_branches
from dcgrid_env.apps.importers.pandapower.net_profiles import NetProfiles
from dcgrid_env.apps.importers.pandapower.net_schema import EMPTY_WORDS, REFUSED, PandapowerNet, check_net
from dcgrid_env.apps.importers.pandapower.net_source import loaded_net
from dcgrid_env.grid.topology import FeederError

_TOLERANCES_MVA = (1e-9, 1e-7, 1e-5)
"""Mismatch at which pandapower's power flow ends; coarser where rounding does not let it reach a finer one."""
_OPTIONS = {
    "trafo_model", "trafo3w_losses", "voltage_depend_loads", "consider_line_temperature", "switch_rx_ratio",
    "neglect_open_switch_branches", "distributed_slack", "tdpf",
}  # fmt: skip
"""Options of pandapower's power flow that change its model of a net."""
_BS, _GS, _PD, _QD, _VALUES = 5, 4, 2, 3, (13, 14, 16, 17)
"""Columns of pandapower's model of buses: shunts, loads, and shares of constant current and impedance of P and Q."""


def read_pandapower(
    source: object,
    *,
    arguments: Mapping[str, Any] | None = None,
    at: str | None = None,
    allow: Collection[str] = (),
    fix_generators: bool = False,
    bus_names: bool = False,
    trust: bool = False,
) -> ImportedFeeder:
    """Read a net; needs pandapower, of the extra ``pandapower``.

    Parameters
    ----------
    source
        A net, the name of a function of ``pandapower.networks`` such as ``"case33bw"``, a SimBench code where
        simbench is installed, or the path of a JSON file that ``pandapower.to_json`` wrote.
    arguments
        What the function of ``pandapower.networks`` is called with.
    at
        Bus of the external grid whose island is taken, where there are several.
    allow
        Kinds of elements that may be left out although something is lost.
    fix_generators
        Generators that keep a voltage become constant loads, of the power that pandapower's power flow gives them.
    bus_names
        Call buses by the column ``name`` rather than by their index.
    trust
        Let pandapower read the JSON file, which imports what the file names.

    Raises
    ------
    FeederError
        For a cell that cannot be used, naming file, table, index and column, for what cannot be represented, naming
        it, and where pandapower is missing.
    """
    report = Report("net")
    called, net = loaded_net(source, arguments or {}, trust, report)
    with errors_naming(called):
        for name in ("bus", "line", "trafo", "load", "ext_grid", "switch"):
            if name not in net:
                raise FeederError(f"{called}: the table {name} is missing; give a net of this pandapower's format")
        check_net(called, net)
        if len(net.controller) and trust | (not isinstance(source, str)):
            report.add_all(
                "lost", "controller", map(str, net.controller.index), "it moves nothing: taps stay as they are"
            )
        _report_what_is_refused(net, report)
        if any(row.fate == "refused" for row in report.findings):
            report.refuse_unless(str(net.name or called), ())  # pandapower may be unable to build its model of them
        _report_taps(net, report)
        _report_options(net, report)
        converged = _solve(called, net)
        rows = ModelRows(net)
        grid = _grid(called, net, rows, bus_names)
        grid.branches = read_branches(net, rows, report)
        _add_switches(net, grid, rows, report)
        _add_loads(net, grid, rows, report)
        _add_sources(net, grid, rows, report, fix_generators and converged)
        volts = net.res_bus.vm_pu.to_dict() if converged else {}
        voltages = {grid.buses[rows.of_bus[bus]]: volt for bus, volt in volts.items()}
        facts = f"pandapower net {grid.name}"
        profiles = NetProfiles(called, net, report)
        result = imported(
            grid, report, lambda: voltages, solver="pandapower.runpp", source=at, allow=allow, source_of_facts=facts
        )
        names = {bus: grid.buses[rows.of_bus[bus]] for bus in net.bus.index}
        buses = {bus: result.bus_of[name] for bus, name in names.items() if name in result.bus_of}
        load = result.network.load
        loads = {bus: (p, q) for bus, p, q in zip(load.bus, load.p_kw, load.q_kvar, strict=True)}
        return dataclasses.replace(result, profiles=profiles.table(buses, loads))


def _solve(called: str, net: PandapowerNet) -> bool:
    """Run pandapower's power flow, which builds its model; whether it found a solution."""
    import pandapower

    run: Any = pandapower.runpp  # its annotations do not fit its documentation
    net["user_pf_options"] = {}
    for start, tolerance in itertools.product(("dc", "flat"), _TOLERANCES_MVA):
        try:
            with quiet():
                run(
                    net,
                    init=start,
                    calculate_voltage_angles=True,
                    tolerance_mva=tolerance,
                    max_iteration=40,
                    numba=False,
                )
            return True
        except pandapower.LoadflowNotConverged:
            continue
        except Exception as error:
            text = f"{type(error).__name__}: {' '.join(str(error).split())[:200]}"
            raise FeederError(f"{called}: pandapower cannot build its model of the net ({text})") from None
    return False


@contextmanager
def quiet() -> Iterator[None]:
    """Silence pandapower's log and warnings, whose content the checks and the report cover."""
    log = logging.getLogger("pandapower")
    level = log.level
    log.setLevel(logging.CRITICAL + 1)
    try:
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")
            yield
    finally:
        log.setLevel(level)


def _grid(called: str, net: PandapowerNet, rows: ModelRows, bus_names: bool) -> BusBranchGrid:
    """Buses with their base voltages and coordinates; those within pandapower's model come after its own."""
    index = net.bus.index.tolist()
    names = net.bus.name.tolist() if bus_names else index
    named = named_buses(called, [str(name) if name is not None else "" for name in names])
    within = tuple(rows.within.values())
    base_kv = np.concatenate([net.bus.vn_kv.to_numpy(dtype=float), rows.model_bus[list(rows.within), 9].real])
    grid = empty_grid(str(net.name or called), float(net.sn_mva), named_buses(called, named + within), base_kv)
    for i, bus in enumerate(index):
        grid.x[i], grid.y[i] = _place(net, bus, i)
    return grid


def _place(net: PandapowerNet, bus: int, row: int) -> tuple[float, float]:
    """Coordinates of a bus, NaN where none can be read."""
    import json

    if "geo" not in net.bus.columns:
        return np.nan, np.nan
    geo = net.bus.geo.iat[row]
    try:
        x, y = (json.loads(geo) if isinstance(geo, str) else geo)["coordinates"][:2]
        x, y = float(x), float(y)
    except (TypeError, ValueError, KeyError, IndexError, RecursionError):
        return np.nan, np.nan
    return (x, y) if np.isfinite(x) and np.isfinite(y) else (np.nan, np.nan)


def _report_what_is_refused(net: PandapowerNet, report: Report) -> None:
    for name, meaning in REFUSED.items():
        table = net.get(name, ())
        if len(table):
            live = table.in_service.to_numpy(dtype=bool) if "in_service" in table.columns else np.ones(len(table), bool)
            report.add_all(
                "refused", name, map(str, table.index[live]), f"{meaning}, which a balanced feeder has none of"
            )
            report.add_all("nothing lost", name, map(str, table.index[~live]), "out of service: it is left out")


def _report_options(net: PandapowerNet, report: Report) -> None:
    options = _OPTIONS & set(net.get("user_pf_options") or ())
    text = "the net's option of the power flow is ignored: pandapower's default holds"
    report.add_all("lost", "user_pf_options", sorted(options), text)


def _add_switches(net: PandapowerNet, grid: BusBranchGrid, rows: ModelRows, report: Report) -> None:
    table = net.switch
    for i, bus, element, et, closed in zip(table.index, table.bus, table.element, table.et, table.closed, strict=True):
        if not closed:
            report.add("nothing lost", "switch", str(i), "open")
        elif et != "b":
            report.add("nothing lost", "switch", str(i), "closed: it is part of its branch")
        elif rows.model_row[bus] == rows.model_row[element]:
            grid.switches.append(ClosedSwitch(str(i), rows.of_bus[bus], rows.of_bus[element]))


def _add_loads(net: PandapowerNet, grid: BusBranchGrid, rows: ModelRows, report: Report) -> None:
    """Put what buses draw into the grid, by pandapower's sums: their power, and how it depends on the voltage."""
    model = rows.model_bus.real
    p, q = 1000.0 * model[:, _PD], 1000.0 * model[:, _QD]
    i_p, z_p, i_q, z_q = (model[:, k] for k in _VALUES)
    of_row = np.array([rows.of_model[k] for k in range(len(model))], dtype=np.intp)
    np.add.at(grid.p_kw, of_row, p * (1.0 - z_p))
    np.add.at(grid.q_kvar, of_row, q * (1.0 - z_q))
    np.add.at(grid.shunt_kw, of_row, 1000.0 * model[:, _GS] + p * z_p)
    np.add.at(grid.shunt_kvar, of_row, 1000.0 * model[:, _BS] - q * z_q)
    for kind in ("load", "sgen", "storage", "motor", "asymmetric_load", "asymmetric_sgen", "ward", "shunt"):
        table = net[kind]
        live = table.in_service.to_numpy(dtype=bool) & table.bus.map(net.bus.in_service).to_numpy(dtype=bool)
        text = "a load" if "load" in kind or kind == "motor" else "a negative load" if "sgen" in kind else kind
        texts = {"storage": "a load of its present power", "ward": "a load and a shunt", "shunt": "a shunt"}
        unbalanced = live & _is_unbalanced(table) if kind.startswith("asymmetric") else np.zeros(len(table), bool)
        report.add_all("taken", kind, map(str, table.index[live & ~unbalanced]), texts.get(kind, text))
        report.add_all("lost", kind, map(str, table.index[unbalanced]), UNBALANCED)
        report.add_all("nothing lost", kind, map(str, table.index[~live]), "out of service: it is left out")
    moved = (abs(p * i_p) > 0) | (abs(q * i_q) > 0)
    share = [c for c in ("const_i_p_percent", "const_i_q_percent") if c in net.load.columns]
    if moved.any():
        names = net.load.index[(net.load[share] != 0).any(axis=1)]
        report.add_all("lost", "load", map(str, names), "its share of constant current becomes constant power")


def _is_unbalanced(table: Any) -> np.ndarray:
    """Whether the phases of each load or generator differ, (row,)."""
    different = np.zeros(len(table), bool)
    for unit in ("p_{}_mw", "q_{}_mvar"):
        phases = table[[unit.format(phase) for phase in "abc"]].to_numpy(dtype=float)
        different |= ~np.isclose(phases, phases.mean(axis=1, keepdims=True), atol=0.0).all(axis=1)
    return different


def _report_taps(net: PandapowerNet, report: Report) -> None:
    """Report taps off their neutral position that pandapower ignores because they have no type."""
    for kind, tap in itertools.product(("trafo", "trafo3w"), ("tap", "tap2")):
        table = net[kind]
        if f"{tap}_pos" not in table.columns:
            continue
        steps = [f"{tap}_step_{unit}" for unit in ("percent", "degree") if f"{tap}_step_{unit}" in table.columns]
        for i, row in table.iterrows():
            of_type = row.get(f"{tap}_changer_type")
            has_type = of_type == of_type and of_type not in EMPTY_WORDS
            position, neutral = _number(row[f"{tap}_pos"]), _number(row.get(f"{tap}_neutral"))
            if not has_type and position != neutral and any(_number(row[step]) for step in steps):
                text = (
                    f"its {tap}_pos {position:g} has no effect, as in pandapower, because {tap}_changer_type is empty: "
                    "write Ratio if the tap is there"
                )
                report.add("nothing lost", f"tap of {kind}", str(i), text)


def _number(cell: Any) -> float:
    """A cell as a number; 0 for an empty one."""
    return float(cell) if isinstance(cell, int | float | np.number) and cell == cell else 0.0


def _add_sources(net: PandapowerNet, grid: BusBranchGrid, rows: ModelRows, report: Report, fix: bool) -> None:
    """Put external grids in as sources, and generators as what they may be; ``fix`` gives them their solved power."""
    for kind in ("ext_grid", "gen"):
        table = net[kind]
        for i, bus, v_pu, live in zip(table.index, table.bus, table.vm_pu, table.in_service, strict=True):
            slack = kind == "ext_grid" or bool(table.slack.at[i])
            if not live or not net.bus.in_service.at[bus]:
                report.add("nothing lost", kind, str(i), "out of service: it is left out")
            elif slack:
                grid.sources.append(Source(kind, str(i), rows.of_bus[bus], float(v_pu)))
            elif fix:
                solved = net.res_gen.loc[i]
                grid.p_kw[rows.of_bus[bus]] -= 1000.0 * float(solved.p_mw)
                grid.q_kvar[rows.of_bus[bus]] -= 1000.0 * float(solved.q_mvar)
                report.add("taken", kind, str(i), "a negative load, of the power that pandapower's power flow gives it")
            else:
                text = "it keeps a voltage, which no load does: --fix-generators makes it a constant power"
                report.add("refused", kind, str(i), text)
